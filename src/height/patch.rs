//! Patches: 33 x 33 vertices, bilinear between them, with an error measured at every sample
//! (sections 1 and 8 of the LOD-space specification; "Patchwork Terrains", section 4.1).
//!
//! Floating point is part of the definition here: the order of operations below fixes the bits of every
//! stored error and id on every machine (IEEE 754 doubles, no fused multiply-add).

use super::lod::{KERNEL, MARGIN, PatchId, Place, SIDE};
use crate::base::bytes::Put;
use crate::base::round::{add_up, up_f32};

/// Heights of the 33 x 33 vertices of a patch, row-major from its lowest indices, metres.
pub type Vertices = [f64; SIDE * SIDE];

/// The value of a bilinear patch and its derivatives, at (s, t) in cells from the first vertex, `0 <= s, t <= 32`.
#[inline]
pub fn evaluate(z: &Vertices, s: f64, t: f64) -> (f64, f64, f64) {
    let a = (s.floor().max(0.0) as usize).min(SIDE - 2);
    let b = (t.floor().max(0.0) as usize).min(SIDE - 2);
    let (x, y) = (s - a as f64, t - b as f64);
    let k = b * SIDE + a;
    let (z00, z10, z01, z11) = (z[k], z[k + 1], z[k + SIDE], z[k + SIDE + 1]);
    let left = z00 + (z01 - z00) * y;
    let right = z10 + (z11 - z10) * y;
    let ds = right - left;
    let dt = (z01 - z00) + ((z11 - z10) - (z01 - z00)) * x;
    (left + ds * x, ds, dt)
}

/// Bottom of the box: accuracy plus measured error, rounded up to the stored type.
pub fn bottom(accuracy_m: f64, delta: f64) -> f32 {
    up_f32(add_up(accuracy_m, delta))
}

/// The content key of a patch.
pub fn id(declaration: &[u8; 16], place: Place, z: &Vertices, bot: f32) -> PatchId {
    let mut h = blake3::Hasher::new();
    h.put(b"terraquilt patch 1");
    h.put(declaration);
    h.put_u8(place.level);
    h.put_i32(place.i);
    h.put_i32(place.j);
    h.put_f32(bot);
    let mut bytes = [0u8; SIDE * 8];
    for row in z.chunks_exact(SIDE) {
        for (out, v) in bytes.chunks_exact_mut(8).zip(row) {
            // One zero: -0 and +0 are the same height.
            out.copy_from_slice(&(v + 0.0).to_le_bytes());
        }
        h.put(&bytes);
    }
    PatchId(h.finalize().as_bytes()[..16].try_into().expect("a hash has 32 bytes"))
}

/// Largest errors of the patches of one level, gathered row of posts by row of posts.
///
/// Costs one bilinear evaluation a post and level; all patches of a level share it, since they agree where they
/// overlap.
pub struct Residuals {
    level: u8,
    /// Places whose errors are wanted: `[i0, i1) x [j0, j1)`.
    places: super::frame::CellRect,
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
    pub fn new(level: u8, places: super::frame::CellRect, col: i64, cols: usize) -> Residuals {
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
    pub fn places(&self) -> super::frame::CellRect {
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
    use crate::height::frame::CellRect;

    /// Every sample of the closed domain against the patch, one by one.
    fn brute(
        level: u8,
        place: (i64, i64),
        n: i64,
        post: &dyn Fn(i64, i64) -> f64,
        vertex: &dyn Fn(i64, i64) -> f64,
    ) -> f64 {
        let d = Place::new(level, place.0, place.1).domain();
        let r = 1i64 << level;
        let mut z = [0.0; SIDE * SIDE];
        for b in 0..SIDE as i64 {
            for a in 0..SIDE as i64 {
                z[b as usize * SIDE + a as usize] = vertex(d.i0 / r + a, d.j0 / r + b);
            }
        }
        let mut most = 0.0f64;
        for j in d.j0..=d.j1 {
            for i in d.i0..=d.i1 {
                if (0..n).contains(&i) && (0..n).contains(&j) && !post(i, j).is_nan() {
                    let (f, ..) = evaluate(&z, (i - d.i0) as f64 / r as f64, (j - d.j0) as f64 / r as f64);
                    most = most.max((post(i, j) - f).abs());
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
                    let want = brute(level, (pi, pj), n, &post, &vertex);
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
}
