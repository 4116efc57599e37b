//! Errors of patches: the largest distance of a patch to the samples in its closed domain (section 8 of the LOD-space
//! specification). It bounds the patch at samples, not between them.

use super::bicubic::Spline;
use crate::height::frame::CellRect;
use crate::height::lod::{KERNEL, MARGIN, Place, SIDE};
use multiversion::multiversion;

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
/// overlap. Each column holds its largest error in the open row of cells; cells are looked at when their row closes.
pub struct Residuals {
    level: u8,
    /// Places whose errors are wanted: `[i0, i1) x [j0, j1)`.
    places: CellRect,
    delta: Vec<f64>,
    /// Posts of the rows that will come: first column, count.
    col: i64,
    cols: usize,
    /// First coarse cell that the columns touch.
    cell0: i64,
    /// The row of cells that is open, and the largest error of each column in it.
    open_row: Option<i64>,
    open: Vec<f64>,
    /// Heights of the patch where the row of posts meets the columns of vertices.
    line: Vec<f64>,
}

impl Residuals {
    pub fn new(level: u8, places: CellRect, col: i64, cols: usize) -> Residuals {
        let cell0 = col >> level;
        let cells = (((col + cols as i64 - 1) >> level) - cell0 + 1) as usize;
        Residuals {
            level,
            places,
            delta: vec![0.0; (places.width() * places.height()) as usize],
            col,
            cols,
            cell0,
            open_row: None,
            open: vec![0.0; cols],
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
        (self.cell0, self.line.len())
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
        let cj = row >> self.level;
        if self.open_row != Some(cj) {
            self.close();
            self.open_row = Some(cj);
        }
        let ty = (row - cj * r) as f64 / r as f64;
        for ((v, a), b) in self.line.iter_mut().zip(below).zip(above) {
            *v = a + (b - a) * ty;
        }
        let (posts, first) = (&posts[..self.cols], (self.col - (self.cell0 << self.level)) as usize);
        // A row of vertices closes the domains that end there.
        let ends = (cj - KERNEL - MARGIN).div_euclid(KERNEL);
        if row == cj * r
            && cj == (ends + 1) * KERNEL + MARGIN
            && (self.places.j0..self.places.j1).contains(&ends)
        {
            let mut alone = vec![0.0; self.cols];
            compare(posts, &mut alone, &self.line, first, self.level);
            self.reduce(ends, &alone);
        }
        compare(posts, &mut self.open, &self.line, first, self.level);
    }

    /// Takes the errors of columns for the places of one row.
    fn reduce(&mut self, pj: i64, columns: &[f64]) {
        for pi in self.places.i0..self.places.i1 {
            // The closed domain: a column of vertices belongs to the domains on both sides.
            let a = ((pi * KERNEL - MARGIN) << self.level) - self.col;
            let b = ((pi * KERNEL + KERNEL + MARGIN) << self.level) - self.col + 1;
            let inside = |k: i64| k.clamp(0, self.cols as i64) as usize;
            let most = greatest(&columns[inside(a)..inside(b)]);
            let k = ((pj - self.places.j0) * self.places.width() + pi - self.places.i0) as usize;
            self.delta[k] = self.delta[k].max(most);
        }
    }

    fn close(&mut self) {
        if let Some(cj) = self.open_row.take() {
            let open = std::mem::take(&mut self.open);
            let lo = (cj - KERNEL - MARGIN).div_euclid(KERNEL) + 1;
            let hi = (cj + MARGIN).div_euclid(KERNEL);
            for pj in lo.max(self.places.j0)..=hi.min(self.places.j1 - 1) {
                self.reduce(pj, &open);
            }
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

/// Raises `most` to the errors of a row of posts, the first of them `first` posts after the first vertex of `line`.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn compare(posts: &[f64], most: &mut [f64], line: &[f64], first: usize, level: u8) {
    let r = 1usize << level;
    // The cell in which the columns begin, whole cells, the cell in which they end.
    let head = if first == 0 { 0 } else { (r - first).min(posts.len()) };
    let whole = (posts.len() - head) / r * r;
    let (posts, rest) = posts.split_at(head);
    let (most, most_rest) = most.split_at_mut(head);
    let cells = &line[usize::from(head > 0)..];
    let ((inner, tail), (most_inner, most_tail)) = (rest.split_at(whole), most_rest.split_at_mut(whole));
    if head > 0 {
        compare_cell(posts, most, line, first, r);
    }
    match r {
        2 => compare_cells::<2>(inner, most_inner, cells),
        4 => compare_cells::<4>(inner, most_inner, cells),
        16 => compare_cells::<16>(inner, most_inner, cells),
        _ => {
            let inner = inner.chunks_exact(r).zip(most_inner.chunks_exact_mut(r));
            for ((posts, most), ends) in inner.zip(cells.windows(2)) {
                compare_cell(posts, most, ends, 0, r);
            }
        }
    }
    if !tail.is_empty() {
        compare_cell(tail, most_tail, &cells[whole / r..], 0, r);
    }
}

/// Raises `most` to the distances of posts to the line over one cell of `r` steps, of which the posts begin at `first`.
/// `ends` begins with the heights at the ends of the cell.
#[inline(always)]
fn compare_cell(posts: &[f64], most: &mut [f64], ends: &[f64], first: usize, r: usize) {
    let (v, slope, step) = (ends[0], ends[1] - ends[0], 1.0 / r as f64);
    for (m, (h, most)) in posts.iter().zip(most).enumerate() {
        let d = (h - (v + slope * (f64::from((first + m) as i32) * step))).abs();
        // A void is NaN, and no NaN is greater.
        *most = if d > *most { d } else { *most };
    }
}

/// The same for whole cells of `R` steps in a row.
#[inline(always)]
fn compare_cells<const R: usize>(posts: &[f64], most: &mut [f64], ends: &[f64]) {
    let (posts, most) = (posts.as_chunks::<R>().0, most.as_chunks_mut::<R>().0);
    for ((posts, most), ends) in posts.iter().zip(most).zip(ends.windows(2)) {
        compare_cell(posts, most, ends, 0, R);
    }
}

/// The greatest of numbers that are no less than 0, in lanes.
fn greatest(values: &[f64]) -> f64 {
    let mut lanes = [0.0f64; 8];
    let (eights, rest) = values.as_chunks::<8>();
    for eight in eights {
        for (lane, v) in lanes.iter_mut().zip(eight) {
            *lane = if *v > *lane { *v } else { *lane };
        }
    }
    lanes.iter().chain(rest).fold(0.0, |m, v| if *v > m { *v } else { m })
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

    /// Every post against every patch by the definition, in pieces of any columns and rows.
    #[test]
    fn errors_are_those_of_each_post_bit_for_bit_in_any_pieces() {
        let (cols, rows) = (230i64, 150i64);
        let post = |i: i64, j: i64| {
            let h = ((i * 7919 + j * 104729).rem_euclid(977)) as f64 / 7.0;
            if (i * 31 + j * 17).rem_euclid(23) == 0 { f64::NAN } else { h }
        };
        let vertex = |a: i64, b: i64| (a * 13 + b * 29).rem_euclid(500) as f64 / 3.0;
        for level in 1..=8u8 {
            let r = 1i64 << level;
            let places = CellRect::new(-1, -1, 4 + 60 / r, 3 + 60 / r);
            let mut want = vec![0.0f64; (places.width() * places.height()) as usize];
            for (k, want) in want.iter_mut().enumerate() {
                let at = (places.i0 + k as i64 % places.width(), places.j0 + k as i64 / places.width());
                let d = Place::new(level, at.0, at.1).domain();
                for j in d.j0.max(0)..=d.j1.min(rows - 1) {
                    for i in d.i0.max(0)..=d.i1.min(cols - 1) {
                        let (a, b) = (i >> level, j >> level);
                        let (s, t) = ((i - a * r) as f64 / r as f64, (j - b * r) as f64 / r as f64);
                        let line = |a: i64| vertex(a, b) + (vertex(a, b + 1) - vertex(a, b)) * t;
                        let e = (post(i, j) - (line(a) + (line(a + 1) - line(a)) * s)).abs();
                        if e > *want {
                            *want = e;
                        }
                    }
                }
            }
            let mut found = vec![0.0f64; want.len()];
            for (i0, i1) in [(0, 1), (1, 8), (8, 120), (120, 121), (121, 224), (224, cols)] {
                for (j0, j1) in [(0, 5), (5, 112), (112, rows)] {
                    let mut gather = Residuals::new(level, places, i0, (i1 - i0) as usize);
                    let (v0, vn) = gather.vertices();
                    let line = |b: i64| (v0..v0 + vn as i64).map(|a| vertex(a, b)).collect::<Vec<f64>>();
                    for j in j0..j1 {
                        let posts: Vec<f64> = (i0..i1).map(|i| post(i, j)).collect();
                        gather.row(j, &posts, &line(j >> level), &line((j >> level) + 1));
                    }
                    found.iter_mut().zip(gather.finish()).for_each(|(m, d)| *m = m.max(d));
                }
            }
            let bits = |v: &[f64]| v.iter().map(|d| d.to_bits()).collect::<Vec<u64>>();
            assert_eq!(bits(&found), bits(&want), "level {level}");
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
