//! A field that is bilinear in every cell of one lattice, and its exact distance from triangles.
//!
//! Over one cell, the distance of a plane and a bilinear patch is `a + b i + c j + w i j`: straight along rows and columns,
//! with no largest or smallest value inside of the cell (its only level point is a saddle). So over a triangle it is largest
//! at a post or on a side of the triangle. Along a side it is a parabola in each cell, whose ends and top are known. Posts and
//! sides therefore give the largest distance anywhere, not a sample of it.

use super::flat::Vertex;

/// Posts this near to a side, in steps, are looked at from both of its triangles.
const SLACK: f64 = 1e-7;

/// The largest whole number not above `v`: the machine's own instruction for it is not on every machine.
#[inline]
fn floor(v: f64) -> i64 {
    let whole = v as i64;
    whole - i64::from(v < whole as f64)
}

#[inline]
fn ceil(v: f64) -> i64 {
    let whole = v as i64;
    whole + i64::from(v > whole as f64)
}

/// The border of a region is rounded: it may lie this far, in steps, beside the posts that it follows.
const BESIDE: f64 = 1e-3;

/// A lattice of posts with a height each; between them the field is bilinear.
#[derive(Debug, Clone)]
pub struct PostGrid {
    /// The first post, local metres.
    pub origin: [f64; 2],
    /// From a post to the next of its row, and of its column, metres; at any angle to each other.
    pub u: [f64; 2],
    pub v: [f64; 2],
    pub cols: usize,
    pub rows: usize,
    /// Row by row, metres. Not a number where the field has no height; no cell of the region has such a corner.
    pub heights: Vec<f64>,
}

/// Where something is farthest from the field: lattice coordinates, and the distance there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Far {
    pub i: f64,
    pub j: f64,
    pub error: f64,
}

impl PostGrid {
    /// Local metres of a place on the lattice.
    pub fn place(&self, i: f64, j: f64) -> [f64; 2] {
        [0, 1].map(|k| self.origin[k] + i * self.u[k] + j * self.v[k])
    }

    /// The shorter side of a cell, metres.
    pub fn step(&self) -> f64 {
        self.u[0].hypot(self.u[1]).min(self.v[0].hypot(self.v[1]))
    }

    /// Lattice coordinates of a place.
    pub fn index(&self, p: [f64; 2]) -> (f64, f64) {
        let [x, y] = [p[0] - self.origin[0], p[1] - self.origin[1]];
        let cross = self.u[0] * self.v[1] - self.u[1] * self.v[0];
        ((x * self.v[1] - y * self.v[0]) / cross, (self.u[0] * y - self.u[1] * x) / cross)
    }

    fn height(&self, col: usize, row: usize) -> f64 {
        self.heights[row * self.cols + col]
    }

    /// The cell that holds a place; at the lattice's end the last one.
    fn cell(&self, i: f64, j: f64) -> (usize, usize) {
        ((i.max(0.0) as usize).min(self.cols - 2), (j.max(0.0) as usize).min(self.rows - 2))
    }

    /// The field at a place of the lattice; on a row or column of posts from its posts alone. Beside the border, by less than
    /// [`BESIDE`], it is that of the nearest line of posts; farther out it is not a number.
    pub fn at(&self, i: f64, j: f64) -> f64 {
        let z = self.inside(i, j);
        if z.is_nan() { self.beside(i, j) } else { z }
    }

    #[cold]
    fn beside(&self, i: f64, j: f64) -> f64 {
        let near = |v: f64, count: usize| {
            let line = v.round().clamp(0.0, (count - 1) as f64);
            if (v - line).abs() < BESIDE { line } else { v }
        };
        let (p, q) = (near(i, self.cols), near(j, self.rows));
        [(p, j), (i, q), (p, q)]
            .map(|(i, j)| self.inside(i, j))
            .into_iter()
            .find(|z| !z.is_nan())
            .unwrap_or(f64::NAN)
    }

    fn inside(&self, i: f64, j: f64) -> f64 {
        let (c, r) = self.cell(i, j);
        let (s, t) = (i - c as f64, j - r as f64);
        let k = r * self.cols + c;
        let row = |k: usize| match s {
            0.0 => self.heights[k],
            1.0 => self.heights[k + 1],
            s => self.heights[k] + (self.heights[k + 1] - self.heights[k]) * s,
        };
        match t {
            0.0 => row(k),
            1.0 => row(k + self.cols),
            t => {
                let low = row(k);
                low + (row(k + self.cols) - low) * t
            }
        }
    }

    /// By how much a cell is bent: the sum of its heights along one diagonal less that along the other.
    fn twist(&self, i: f64, j: f64) -> f64 {
        let (c, r) = self.cell(i, j);
        let k = r * self.cols + c;
        let z = &self.heights;
        z[k] - z[k + 1] - z[k + self.cols] + z[k + self.cols + 1]
    }

    /// Calls `f` with each row that crosses a triangle, and its first and last post in the triangle.
    #[inline]
    pub(super) fn rows_in(&self, at: [&Vertex; 3], mut f: impl FnMut(usize, usize, usize)) {
        let [mut a, mut b, mut c] = at;
        if b.j < a.j {
            std::mem::swap(&mut a, &mut b);
        }
        if c.j < a.j {
            std::mem::swap(&mut a, &mut c);
        }
        if c.j < b.j {
            std::mem::swap(&mut b, &mut c);
        }
        let first = ceil(a.j - SLACK).max(0) as usize;
        let end = (floor(c.j + SLACK) + 1).clamp(0, self.rows as i64) as usize;
        let slope = |a: &Vertex, b: &Vertex| if b.j - a.j > SLACK { (b.i - a.i) / (b.j - a.j) } else { 0.0 };
        let (long, low, high) = (slope(a, c), slope(a, b), slope(b, c));
        for row in first..end {
            let j = row as f64;
            let (west, east) = if c.j - a.j <= SLACK {
                (a.i.min(b.i).min(c.i), a.i.max(b.i).max(c.i))
            } else {
                let on_long = a.i + (j - a.j) * long;
                let beside = if j < b.j { a.i + (j - a.j) * low } else { b.i + (j - b.j) * high };
                (on_long.min(beside), on_long.max(beside))
            };
            let (west, east) = (ceil(west - SLACK).max(0), floor(east + SLACK).min(self.cols as i64 - 1));
            if west <= east {
                f(row, west as usize, east as usize);
            }
        }
    }

    /// The post of a triangle that is farthest from the plane through its corners; the first of equals.
    pub(super) fn farthest_post(&self, at: [&Vertex; 3]) -> Far {
        let plane = Slope::through(at);
        let mut far = Far { i: 0.0, j: 0.0, error: 0.0 };
        self.rows_in(at, |row, west, east| {
            let from = plane.at(0.0, row as f64);
            let heights = &self.heights[row * self.cols..][..self.cols];
            for (col, z) in heights.iter().enumerate().take(east + 1).skip(west) {
                let error = (from + plane.di * col as f64 - z).abs();
                if error > far.error {
                    far = Far { i: col as f64, j: row as f64, error };
                }
            }
        });
        far
    }

    /// The largest distance of a straight line from the field, and where.
    pub(super) fn farthest_on_side(&self, a: &Vertex, b: &Vertex) -> Far {
        let mut far = Far { i: a.i, j: a.j, error: 0.0 };
        self.along_side(a, b, |piece| {
            for (t, d) in [Some((piece.t1, piece.d1)), piece.top()].into_iter().flatten() {
                let error = if d.is_nan() { f64::INFINITY } else { d.abs() };
                if error > far.error {
                    far = Far { i: a.i + t * (b.i - a.i), j: a.j + t * (b.j - a.j), error };
                }
            }
            true
        });
        far
    }

    /// Walks along a side from cell to cell, until `f` says that it has seen enough.
    #[inline]
    pub(super) fn along_side(&self, a: &Vertex, b: &Vertex, mut f: impl FnMut(&Piece) -> bool) {
        let (di, dj, dz) = (b.i - a.i, b.j - a.j, b.z - a.z);
        let mut columns = Crossings::new(a.i, b.i);
        let mut rows = Crossings::new(a.j, b.j);
        let (mut t0, mut d0) = (0.0, a.field - a.z);
        while t0 < 1.0 {
            let t1 = columns.t.min(rows.t).min(1.0);
            let d1 = if t1 >= 1.0 {
                b.field - b.z
            } else {
                // The place on the line that is crossed: the field there is that of the two posts beside it.
                let (i, j) = (a.i + t1 * di, a.j + t1 * dj);
                let (on_column, on_row) = (columns.t <= t1, rows.t <= t1);
                let mut field = match (on_column, on_row) {
                    (true, true) => self.post(columns.line, rows.line),
                    (true, false) => self.on_column(columns.line, j),
                    _ => self.on_row(i, rows.line),
                };
                if field.is_nan() {
                    field = self.beside(i, j);
                }
                if on_column {
                    columns.step();
                }
                if on_row {
                    rows.step();
                }
                field - (a.z + t1 * dz)
            };
            if t1 <= t0 {
                continue;
            }
            let bend = if di == 0.0 || dj == 0.0 {
                0.0
            } else {
                let (middle, step) = ((t0 + t1) / 2.0, t1 - t0);
                let twist = self.twist(a.i + middle * di, a.j + middle * dj);
                // Beside the border there may be no cell; along a line of posts the field is straight.
                if twist.is_nan() { 0.0 } else { twist * di * dj * step * step }
            };
            if !f(&Piece { t0, t1, d0, d1, bend }) {
                return;
            }
            (t0, d0) = (t1, d1);
        }
    }

    #[inline]
    fn post(&self, i: f64, j: f64) -> f64 {
        self.heights[(j as usize).min(self.rows - 1) * self.cols + (i as usize).min(self.cols - 1)]
    }

    #[inline]
    fn on_column(&self, i: f64, j: f64) -> f64 {
        let r = (j.max(0.0) as usize).min(self.rows - 2);
        let k = r * self.cols + (i as usize).min(self.cols - 1);
        self.heights[k] + (self.heights[k + self.cols] - self.heights[k]) * (j - r as f64)
    }

    #[inline]
    fn on_row(&self, i: f64, j: f64) -> f64 {
        let c = (i.max(0.0) as usize).min(self.cols - 2);
        let k = (j as usize).min(self.rows - 1) * self.cols + c;
        self.heights[k] + (self.heights[k + 1] - self.heights[k]) * (i - c as f64)
    }

    /// Slopes of the field at a place of the lattice, metres a metre to east and north; at a post the mean of its cells.
    pub fn slopes(&self, i: f64, j: f64) -> [f64; 2] {
        let near = |v: f64| (v - v.round()).abs() < 1e-3;
        let sides = |v: f64| if near(v) { [v.round() - 0.5, v.round() + 0.5] } else { [v, v] };
        let (mut gi, mut gj, mut count) = (0.0, 0.0, 0.0);
        for y in sides(j) {
            for x in sides(i) {
                if x < 0.0 || y < 0.0 || x > (self.cols - 1) as f64 || y > (self.rows - 1) as f64 {
                    continue;
                }
                let (c, r) = self.cell(x, y);
                let (s, t) = (i - c as f64, j - r as f64);
                let [z00, z10, z01, z11] =
                    [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(a, b)| self.height(c + a, r + b));
                let (di, dj) =
                    ((z10 - z00) * (1.0 - t) + (z11 - z01) * t, (z01 - z00) * (1.0 - s) + (z11 - z10) * s);
                if (di + dj).is_finite() {
                    (gi, gj, count) = (gi + di, gj + dj, count + 1.0);
                }
            }
        }
        let cross = self.u[0] * self.v[1] - self.u[1] * self.v[0];
        let [gi, gj] = [gi / count, gj / count];
        [(gi * self.v[1] - gj * self.u[1]) / cross, (gj * self.u[0] - gi * self.v[0]) / cross]
    }
}

/// Part of a side within one cell: parameters of its ends, distances there, and by how much it is bent between them.
pub(super) struct Piece {
    pub t0: f64,
    pub t1: f64,
    pub d0: f64,
    pub d1: f64,
    /// The distance is `d0 (1 - s) + d1 s - bend s (1 - s)`, s from 0 to 1.
    pub bend: f64,
}

impl Piece {
    /// The parameter and distance of the parabola's top or bottom, if that is between the ends.
    pub fn top(&self) -> Option<(f64, f64)> {
        let rise = self.d1 - self.d0;
        if rise.abs() >= self.bend.abs() {
            return None;
        }
        let s = 0.5 - rise / (2.0 * self.bend);
        let d = (self.d0 + self.d1) / 2.0 - self.bend / 4.0 - rise * rise / (4.0 * self.bend);
        Some((self.t0 + s * (self.t1 - self.t0), d))
    }
}

/// Where a coordinate passes whole numbers on its way from `a` to `b`, one after the other.
struct Crossings {
    line: f64,
    t: f64,
    way: f64,
    start: f64,
    per_step: f64,
}

impl Crossings {
    fn new(a: f64, b: f64) -> Crossings {
        let (line, way) = if b > a { (floor(a) as f64, 1.0) } else { (ceil(a) as f64, -1.0) };
        let mut c = Crossings { line, t: f64::INFINITY, way, start: a, per_step: 0.0 };
        // Between two lines, or along one: none is crossed.
        if (b - line) * way > 1.0 {
            c.per_step = 1.0 / (b - a);
            c.step();
        }
        c
    }
    #[inline]
    fn step(&mut self) {
        self.line += self.way;
        self.t = (self.line - self.start) * self.per_step;
    }
}

/// A plane over the lattice.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slope {
    pub di: f64,
    pub dj: f64,
    pub z: f64,
}

impl Slope {
    pub fn through(at: [&Vertex; 3]) -> Slope {
        Slope::of(at, at.map(|v| v.z))
    }

    /// The plane with given heights at the corners of a triangle.
    pub fn of([a, b, c]: [&Vertex; 3], z: [f64; 3]) -> Slope {
        let (bi, bj, bz) = (b.i - a.i, b.j - a.j, z[1] - z[0]);
        let (ci, cj, cz) = (c.i - a.i, c.j - a.j, z[2] - z[0]);
        let cross = bi * cj - ci * bj;
        let (di, dj) = ((bz * cj - cz * bj) / cross, (bi * cz - ci * bz) / cross);
        Slope { di, dj, z: z[0] - di * a.i - dj * a.j }
    }

    pub fn at(&self, i: f64, j: f64) -> f64 {
        self.z + self.di * i + self.dj * j
    }
}
