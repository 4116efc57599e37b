//! Errors of patches: the largest distance of a patch to the samples in its closed domain (section 8 of the LOD-space
//! specification). It bounds the patch at samples, not between them.

use super::bicubic::Spline;
use crate::height::frame::CellRect;
use crate::height::lod::{KERNEL, MARGIN, Place, SIDE};

/// Largest distance of a bicubic patch to samples: those of `posts` (NaN = void), a rectangle `held` of posts row by row,
/// that lie in the patch's closed domain. 0 if none does.
///
/// Costs 66 cubics a row and one a post. No two patches share this, since each spline has its own ends.
pub fn worst(spline: &Spline, place: Place, held: &CellRect, posts: &[f64]) -> f64 {
    let d = place.domain();
    let here = CellRect::new(d.i0, d.j0, d.i1 + 1, d.j1 + 1).intersect(held);
    let r = 1i64 << place.level;
    let step = 1.0 / r as f64;
    // The last row and column of vertices belong to the last cell.
    let cell = |k: i64| (k >> place.level).min(SIDE as i64 - 2);
    let mut worst = 0.0f64;
    for j in here.j0..here.j1 {
        let b = cell(j - d.j0);
        let line = spline.line(b as usize, (j - d.j0 - b * r) as f64 * step);
        let row = &posts[((j - held.j0) * held.width()) as usize..][..held.width() as usize];
        let mut i = here.i0;
        while i < here.i1 {
            let a = cell(i - d.i0);
            let first = d.i0 + a * r;
            let end = if a == SIDE as i64 - 2 { here.i1 } else { (first + r).min(here.i1) };
            let mut most = 0.0f64;
            for (k, h) in row[(i - held.i0) as usize..(end - held.i0) as usize].iter().enumerate() {
                let e = (h - line.at(a as usize, (i - first + k as i64) as f64 * step)).abs();
                // A void is NaN, and no NaN is greater.
                if e > most {
                    most = e;
                }
            }
            worst = worst.max(most);
            i = end;
        }
    }
    worst
}

/// Largest errors of the bilinear patches of one level, gathered row of posts by row of posts.
///
/// Costs one bilinear evaluation a post and level; all patches of a level share it, since they agree where they
/// overlap.
pub struct Residuals {
    level: u8,
    /// Places whose errors are wanted: `[i0, i1) x [j0, j1)`.
    places: CellRect,
    delta: Vec<f64>,
    /// Posts of the rows that will come: first column, count.
    col: i64,
    cols: usize,
    /// First coarse cell that the columns touch, and per coarse cell: largest in the open row so far.
    cell0: i64,
    open: Vec<f64>,
    row_cells: Vec<f64>,
    row_edges: Vec<f64>,
    open_row: Option<i64>,
    line: Vec<f64>,
}

impl Residuals {
    pub fn new(level: u8, places: CellRect, col: i64, cols: usize) -> Residuals {
        let r = 1i64 << level;
        let cell0 = col.div_euclid(r);
        let cells = ((col + cols as i64 - 1).div_euclid(r) - cell0 + 1) as usize;
        Residuals {
            level,
            places,
            delta: vec![0.0; (places.width() * places.height()) as usize],
            col,
            cols,
            cell0,
            open: vec![0.0; cells],
            row_cells: vec![0.0; cells],
            row_edges: vec![0.0; cells + 1],
            open_row: None,
            line: vec![0.0; cells + 1],
        }
    }

    pub fn level(&self) -> u8 {
        self.level
    }

    /// The wanted places.
    pub fn places(&self) -> CellRect {
        self.places
    }

    /// Vertices of the level that [`Residuals::row`] wants: first index and count.
    pub fn vertices(&self) -> (i64, usize) {
        (self.cell0, self.open.len() + 1)
    }

    /// Whether a row of posts lies in the domain of a wanted place.
    pub fn wants(&self, row: i64) -> bool {
        let (lo, hi) = self.rows();
        (lo..=hi).contains(&row)
    }

    /// First and last row of posts in the closed domains of the wanted places.
    pub fn rows(&self) -> (i64, i64) {
        let lo = (self.places.j0 * KERNEL - MARGIN) << self.level;
        let hi = (self.places.j1 * KERNEL + MARGIN) << self.level;
        (lo, hi)
    }

    /// Takes one row of posts (NaN = void) and the vertex rows below and above it (`floor(row / 2^level)` and the next).
    pub fn row(&mut self, row: i64, posts: &[f64], below: &[f64], above: &[f64]) {
        let r = 1i64 << self.level;
        let cj = row.div_euclid(r);
        if self.open_row != Some(cj) {
            self.close();
            self.open_row = Some(cj);
        }
        let ty = (row - cj * r) as f64 / r as f64;
        for ((v, a), b) in self.line.iter_mut().zip(below).zip(above) {
            *v = a + (b - a) * ty;
        }
        let step = 1.0 / r as f64;
        let (mut k, n) = (0usize, self.cols);
        let mut cell = 0usize;
        self.row_edges.fill(0.0);
        while k < n {
            let first = self.col + k as i64 - (self.cell0 + cell as i64) * r;
            let count = ((r - first) as usize).min(n - k);
            let (v, slope) = (self.line[cell], self.line[cell + 1] - self.line[cell]);
            let mut most = 0.0f64;
            for (m, h) in posts[k..k + count].iter().enumerate() {
                let d = (h - (v + slope * ((first + m as i64) as f64 * step))).abs();
                // A void is NaN, and no NaN is greater.
                if d > most {
                    most = d;
                }
            }
            if first == 0 {
                let d = (posts[k] - v).abs();
                self.row_edges[cell] = if d > 0.0 { d } else { 0.0 };
            }
            self.row_cells[cell] = most;
            k += count;
            cell += 1;
        }
        // A row of vertices closes the domains that end there.
        if row == cj * r && (cj - KERNEL - MARGIN).rem_euclid(KERNEL) == 0 {
            let pj = (cj - KERNEL - MARGIN).div_euclid(KERNEL);
            let (cells, edges) = (std::mem::take(&mut self.row_cells), std::mem::take(&mut self.row_edges));
            self.reduce(pj, &cells, Some(&edges));
            (self.row_cells, self.row_edges) = (cells, edges);
        }
        for (o, c) in self.open.iter_mut().zip(&self.row_cells) {
            *o = o.max(*c);
        }
        // Columns of vertices close domains too: their posts belong to the next cell of this row.
        let edges = std::mem::take(&mut self.row_edges);
        self.each_place_row(cj, |s, pj| s.reduce_edges(pj, &edges));
        self.row_edges = edges;
    }

    fn each_place_row(&mut self, cj: i64, mut f: impl FnMut(&mut Self, i64)) {
        let lo = (cj - KERNEL - MARGIN).div_euclid(KERNEL) + 1;
        let hi = (cj + MARGIN).div_euclid(KERNEL);
        for pj in lo..=hi {
            f(self, pj);
        }
    }

    fn slot(&self, pi: i64, pj: i64) -> usize {
        ((pj - self.places.j0) * self.places.width() + pi - self.places.i0) as usize
    }

    fn reduce(&mut self, pj: i64, cells: &[f64], edges: Option<&[f64]>) {
        if !(self.places.j0..self.places.j1).contains(&pj) {
            return;
        }
        for pi in self.places.i0..self.places.i1 {
            let a = (pi * KERNEL - MARGIN - self.cell0).clamp(0, cells.len() as i64) as usize;
            let b = (pi * KERNEL + KERNEL + MARGIN - self.cell0).clamp(0, cells.len() as i64) as usize;
            let mut most = cells[a..b].iter().fold(0.0f64, |m, v| m.max(*v));
            if let Some(e) = edges
                && pi * KERNEL + KERNEL + MARGIN - self.cell0 == b as i64
            {
                most = most.max(e[b]);
            }
            let k = self.slot(pi, pj);
            self.delta[k] = self.delta[k].max(most);
        }
    }

    fn reduce_edges(&mut self, pj: i64, edges: &[f64]) {
        if !(self.places.j0..self.places.j1).contains(&pj) {
            return;
        }
        for pi in self.places.i0..self.places.i1 {
            let b = pi * KERNEL + KERNEL + MARGIN - self.cell0;
            if (0..edges.len() as i64).contains(&b) {
                let k = self.slot(pi, pj);
                self.delta[k] = self.delta[k].max(edges[b as usize]);
            }
        }
    }

    fn close(&mut self) {
        if let Some(cj) = self.open_row.take() {
            let open = std::mem::take(&mut self.open);
            self.each_place_row(cj, |s, pj| s.reduce(pj, &open, None));
            self.open = open;
            self.open.fill(0.0);
        }
    }

    /// The largest error of each wanted place, row-major.
    pub fn finish(mut self) -> Vec<f64> {
        self.close();
        self.delta
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::height::patch::{Kind, Shape};

    /// Every sample of the closed domain against the patch, one by one.
    fn brute(
        kind: Kind,
        level: u8,
        place: (i64, i64),
        n: i64,
        post: &dyn Fn(i64, i64) -> f64,
        vertex: &dyn Fn(i64, i64) -> f64,
    ) -> f64 {
        let d = Place::new(level, place.0, place.1).domain();
        let r = 1i64 << level;
        let mut z = Box::new([0.0; SIDE * SIDE]);
        for b in 0..SIDE as i64 {
            for a in 0..SIDE as i64 {
                z[b as usize * SIDE + a as usize] = vertex(d.i0 / r + a, d.j0 / r + b);
            }
        }
        let shape = Shape::new(kind, z);
        let mut most = 0.0f64;
        for j in d.j0..=d.j1 {
            for i in d.i0..=d.i1 {
                if (0..n).contains(&i) && (0..n).contains(&j) && !post(i, j).is_nan() {
                    let f = shape.at((i - d.i0) as f64 / r as f64, (j - d.j0) as f64 / r as f64);
                    most = most.max((post(i, j) - f.z).abs());
                }
            }
        }
        most
    }

    #[test]
    fn gathered_errors_equal_brute_force() {
        let n = 150i64;
        let post = |i: i64, j: i64| {
            let h = ((i * 7919 + j * 104729).rem_euclid(977)) as f64;
            if (i * 31 + j * 17).rem_euclid(23) == 0 { f64::NAN } else { h }
        };
        for level in 1..=3u8 {
            let r = 1i64 << level;
            let vertex = |a: i64, b: i64| (a * 13 + b * 29).rem_euclid(500) as f64;
            let places = CellRect::new(-1, -1, 4, 4);
            let mut res = Residuals::new(level, places, 0, n as usize);
            let (v0, vn) = res.vertices();
            for j in 0..n {
                let posts: Vec<f64> = (0..n).map(|i| post(i, j)).collect();
                let line = |b: i64| (0..vn as i64).map(|a| vertex(v0 + a, b)).collect::<Vec<f64>>();
                res.row(j, &posts, &line(j.div_euclid(r)), &line(j.div_euclid(r) + 1));
            }
            let found = res.finish();
            let mut k = 0;
            for pj in -1..4 {
                for pi in -1..4 {
                    let want = brute(Kind::Bilinear, level, (pi, pj), n, &post, &vertex);
                    assert!(
                        (found[k] - want).abs() < 1e-12,
                        "level {level} place {pi} {pj}: {} {want}",
                        found[k]
                    );
                    k += 1;
                }
            }
        }
    }

    #[test]
    fn errors_of_splines_equal_brute_force_bit_for_bit_in_any_bands() {
        let n = 150i64;
        let post = |i: i64, j: i64| {
            let h = ((i * 7919 + j * 104729).rem_euclid(977)) as f64 / 8.0;
            if (i * 31 + j * 17).rem_euclid(23) == 0 { f64::NAN } else { h }
        };
        for level in 1..=3u8 {
            let vertex = |a: i64, b: i64| (a * 13 + b * 29).rem_euclid(500) as f64 / 3.0;
            for (pi, pj) in [(-1, 0), (0, 0), (1, 0), (0, 1), (1, 2), (3, 3)] {
                let place = Place::new(level, pi, pj);
                let d = place.domain();
                let (i0, j0) = (d.i0 >> level, d.j0 >> level);
                let z = std::array::from_fn(|k| vertex(i0 + (k % SIDE) as i64, j0 + (k / SIDE) as i64));
                let spline = Spline::new(&z);
                let mut found = 0.0f64;
                for band in
                    [CellRect::new(0, 0, n, 37), CellRect::new(0, 37, n, 112), CellRect::new(0, 112, n, n)]
                {
                    let posts: Vec<f64> =
                        (band.j0..band.j1).flat_map(|j| (0..n).map(move |i| post(i, j))).collect();
                    found = found.max(worst(&spline, place, &band, &posts));
                }
                let want = brute(Kind::Bicubic, level, (pi, pj), n, &post, &vertex);
                assert_eq!(found.to_bits(), want.to_bits(), "level {level} place {pi} {pj}: {found} {want}");
            }
        }
    }
}
