//! Bicubic patches: the natural tensor-product cubic spline through the 33 x 33 vertices (section 7 of the LOD-space
//! specification).
//!
//! A natural cubic spline on whole numbers is a cubic on each interval, twice continuously differentiable, with second
//! derivative 0 at both ends. It is held as values and second derivatives at the knots, from which an interval is
//!
//! ```text
//! f(x) = p + (q - p) x - h ((1 + u) m + (1 + x) n)      u = 1 - x,  h = (x u) / 6  (times the rounded 1/6)
//! ```
//!
//! with values p, q and second derivatives m, n at its ends. The patch is the spline along t of the splines along s, in
//! either order. Every patch has its own ends: two patches of a level need not agree where they overlap, and its error
//! is measured for itself.

use super::{Local, Vertices, cell};
use crate::height::lod::SIDE;
use multiversion::multiversion;

/// A bicubic patch: four numbers at each vertex, each kind in an array of its own, so that a line through the patch reads
/// along rows.
pub struct Spline {
    values: Vertices,
    /// Second derivatives by s.
    by_s: Vertices,
    /// By t.
    by_t: Vertices,
    /// The mixed fourth one, by ss and tt.
    mixed: Vertices,
}

/// Pivots of the elimination below: 1 / (4 - the one before).
const PIVOTS: [f64; SIDE - 1] = {
    let mut p = [0.0; SIDE - 1];
    let mut k = 1;
    while k < SIDE - 1 {
        p[k] = 1.0 / (4.0 - p[k - 1]);
        k += 1;
    }
    p
};

const SIXTH: f64 = 1.0 / 6.0;

/// Second derivatives by t of the natural splines through the columns of `z`: m[b-1] + 4 m[b] + m[b+1] = 6 (second
/// difference), solved by elimination from the first row to the last, and back; 0 at both ends. Columns lie side by side in
/// vectors.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
fn second_derivatives(z: &Vertices, m: &mut Vertices) {
    m[..SIDE].fill(0.0);
    m[(SIDE - 1) * SIDE..].fill(0.0);
    for (b, pivot) in PIVOTS.iter().enumerate().skip(1) {
        let (done, rest) = m.split_at_mut(b * SIDE);
        let (before, here) = (&done[(b - 1) * SIDE..], &mut rest[..SIDE]);
        let [low, middle, high] = [b - 1, b, b + 1].map(|b| &z[b * SIDE..][..SIDE]);
        for a in 0..SIDE {
            let d = 6.0 * ((high[a] - middle[a]) - (middle[a] - low[a]));
            here[a] = (d - before[a]) * pivot;
        }
    }
    for (b, pivot) in PIVOTS.iter().enumerate().skip(1).rev() {
        let (rest, done) = m.split_at_mut((b + 1) * SIDE);
        for (m, next) in rest[b * SIDE..].iter_mut().zip(&done[..SIDE]) {
            *m -= pivot * next;
        }
    }
}

/// Rows as columns.
fn transposed(z: &Vertices) -> Vertices {
    let mut out = [0.0; SIDE * SIDE];
    for (b, row) in z.chunks_exact(SIDE).enumerate() {
        for (a, v) in row.iter().enumerate() {
            out[a * SIDE + b] = *v;
        }
    }
    out
}

/// One interval at x: values and second derivatives at its ends.
#[inline(always)]
pub fn value(x: f64, p: f64, q: f64, m: f64, n: f64) -> f64 {
    let u = 1.0 - x;
    let h = (x * u) * SIXTH;
    (p + (q - p) * x) - h * ((1.0 + u) * m + (1.0 + x) * n)
}

/// Its derivative.
#[inline(always)]
fn slope(x: f64, p: f64, q: f64, m: f64, n: f64) -> f64 {
    let u = 1.0 - x;
    (q - p) + SIXTH * ((3.0 * x * x - 1.0) * n - (3.0 * u * u - 1.0) * m)
}

/// Its second derivative.
#[inline(always)]
fn bend(x: f64, m: f64, n: f64) -> f64 {
    m + (n - m) * x
}

impl Spline {
    pub fn new(z: &Vertices) -> Spline {
        let [mut by_s, mut by_t, mut mixed] = [[0.0; SIDE * SIDE]; 3];
        // Along s for the values; then along t for both.
        second_derivatives(&transposed(z), &mut by_s);
        let by_s = transposed(&by_s);
        second_derivatives(z, &mut by_t);
        second_derivatives(&by_s, &mut mixed);
        Spline { values: *z, by_s, by_t, mixed }
    }

    /// At (s, t) in cells from the first vertex, `0 <= s, t <= 32`: along t first, then along s.
    #[inline(always)]
    pub fn evaluate(&self, s: f64, t: f64) -> Local {
        let ((a, x), (b, y)) = (cell(s), cell(t));
        let at = b * SIDE + a;
        // Value and second derivative by s of the two columns, and their first two derivatives by t.
        let column = |k: usize, of: usize, f: fn(f64, f64, f64, f64, f64) -> f64| {
            let (v, m) = self.kinds(of);
            f(y, v[at + k], v[at + k + SIDE], m[at + k], m[at + k + SIDE])
        };
        let bent = |k: usize, of: usize| {
            let (_, m) = self.kinds(of);
            bend(y, m[at + k], m[at + k + SIDE])
        };
        let [p, q, m, n] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(k, of)| column(k, of, value));
        let [pt, qt, mt, nt] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(k, of)| column(k, of, slope));
        let [ptt, qtt, mtt, ntt] = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(k, of)| bent(k, of));
        Local {
            z: value(x, p, q, m, n),
            first: [slope(x, p, q, m, n), value(x, pt, qt, mt, nt)],
            second: [bend(x, m, n), slope(x, pt, qt, mt, nt), value(x, ptt, qtt, mtt, ntt)],
        }
    }

    /// Values (0) or second derivatives by s (1), and the second derivatives of those by t.
    #[inline(always)]
    fn kinds(&self, of: usize) -> (&Vertices, &Vertices) {
        if of == 0 { (&self.values, &self.by_t) } else { (&self.by_s, &self.mixed) }
    }

    /// Its height at `x` in column `a`, `y` in row `b` of its cells. The same bits as [`Spline::evaluate`].
    #[inline(always)]
    pub fn height(&self, a: usize, x: f64, b: usize, y: f64) -> f64 {
        let at = b * SIDE + a;
        let column = |k: usize, of: usize| {
            let (v, m) = self.kinds(of);
            value(y, v[at + k], v[at + k + SIDE], m[at + k], m[at + k + SIDE])
        };
        value(x, column(0, 0), column(1, 0), column(0, 1), column(1, 1))
    }

    /// The spline along s at a fixed t: at `y` in the row of cells `b`. The same bits as [`Spline::evaluate`].
    pub fn line(&self, b: usize, y: f64) -> Line {
        let mut line = Line { values: [0.0; SIDE], bends: [0.0; SIDE] };
        self.along(b, y, &mut line.values, &mut line.bends);
        line
    }

    /// The numbers of [`Spline::line`]: into the first 33 of each.
    #[inline(always)]
    pub fn along(&self, b: usize, y: f64, values: &mut [f64], bends: &mut [f64]) {
        let at = b * SIDE;
        for (of, to) in [values, bends].into_iter().enumerate() {
            let (v, m) = self.kinds(of);
            let (low, high) = (&v[at..][..SIDE], &v[at + SIDE..][..SIDE]);
            let (m, n) = (&m[at..][..SIDE], &m[at + SIDE..][..SIDE]);
            for (a, to) in to[..SIDE].iter_mut().enumerate() {
                *to = value(y, low[a], high[a], m[a], n[a]);
            }
        }
    }
}

/// A spline along s: values and second derivatives at its 33 knots.
pub struct Line {
    values: [f64; SIDE],
    bends: [f64; SIDE],
}

impl Line {
    /// At `x` in cell `a`.
    #[inline(always)]
    pub fn at(&self, a: usize, x: f64) -> f64 {
        value(x, self.values[a], self.values[a + 1], self.bends[a], self.bends[a + 1])
    }
}

/// The eight neighbours of a vertex, row by row.
const AROUND: [(i32, i32); 8] = [(-1, -1), (0, -1), (1, -1), (-1, 0), (1, 0), (-1, 1), (0, 1), (1, 1)];

/// Gives heights to the vertices that have neither a sample nor a fill (`open`), so that the spline does not swing at
/// the edge of the data.
///
/// In rounds, from the known vertices outwards: an open vertex next to known ones gets the mean of what they say, in
/// the order of [`AROUND`]; a neighbour says its own height plus half its rise from the vertex beyond it, if that one is
/// known. So slopes halve with each round and nothing runs away. Where nothing is known at all, heights stay as they are.
pub fn extend(z: &mut Vertices, open: &mut [bool; SIDE * SIDE]) {
    let mut left = open.iter().filter(|o| **o).count();
    if left == 0 || left == open.len() {
        return;
    }
    let side = SIDE as i32;
    let number = |a: i32, b: i32| {
        ((0..side).contains(&a) && (0..side).contains(&b)).then_some((b * side + a) as usize)
    };
    while left > 0 {
        let mut found = Vec::new();
        for k in (0..SIDE * SIDE).filter(|k| open[*k]) {
            let (a, b) = ((k % SIDE) as i32, (k / SIDE) as i32);
            let (mut sum, mut count) = (0.0, 0);
            for (da, db) in AROUND {
                let Some(near) = number(a + da, b + db).filter(|n| !open[*n]) else { continue };
                let beyond = number(a + 2 * da, b + 2 * db).filter(|n| !open[*n]);
                sum += z[near] + beyond.map_or(0.0, |m| (z[near] - z[m]) * 0.5);
                count += 1;
            }
            if count > 0 {
                found.push((k, sum / f64::from(count)));
            }
        }
        left -= found.len();
        for (k, height) in found {
            z[k] = height;
            open[k] = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rough() -> Vertices {
        std::array::from_fn(|k| ((k * 7919 + k * k * 31) % 977) as f64 / 10.0)
    }

    #[test]
    fn the_spline_meets_its_vertices_and_has_natural_ends() {
        let z = rough();
        let spline = Spline::new(&z);
        for (k, z) in z.iter().enumerate() {
            let found = spline.evaluate((k % SIDE) as f64, (k / SIDE) as f64);
            assert!((found.z - z).abs() < 1e-12, "{k}");
        }
        for t in 0..65 {
            let t = t as f64 / 2.0;
            for end in [0.0, 32.0] {
                assert_eq!(spline.evaluate(end, t).second[0], 0.0);
                assert_eq!(spline.evaluate(t, end).second[2], 0.0);
            }
        }
    }

    #[test]
    fn value_slopes_and_bends_are_continuous_across_cells_and_derivatives_of_each_other() {
        let spline = Spline::new(&rough());
        let e = 1e-9;
        for k in 1..SIDE - 1 {
            for t in [0.3, 7.0, 15.8, 31.9] {
                for swap in [false, true] {
                    let at = |d: f64| {
                        let (s, t) = (k as f64 + d, t);
                        if swap { spline.evaluate(t, s) } else { spline.evaluate(s, t) }
                    };
                    let (l, r) = (at(-e), at(e));
                    assert!((l.z - r.z).abs() < 1e-5);
                    for n in 0..2 {
                        assert!((l.first[n] - r.first[n]).abs() < 1e-4);
                    }
                    for n in 0..3 {
                        assert!((l.second[n] - r.second[n]).abs() < 1e-3, "{k} {t} {l:?} {r:?}");
                    }
                }
            }
        }
        let h = 1e-5;
        for (s, t) in [(0.5, 0.5), (3.2, 17.9), (31.4, 0.1), (12.5, 31.7)] {
            let c = spline.evaluate(s, t);
            let [e, w] = [h, -h].map(|d| spline.evaluate(s + d, t));
            let [n, o] = [h, -h].map(|d| spline.evaluate(s, t + d));
            let central = |a: f64, b: f64| (a - b) / (2.0 * h);
            for (found, truth) in [
                (c.first[0], central(e.z, w.z)),
                (c.first[1], central(n.z, o.z)),
                (c.second[0], central(e.first[0], w.first[0])),
                (c.second[1], central(e.first[1], w.first[1])),
                (c.second[1], central(n.first[0], o.first[0])),
                (c.second[2], central(n.first[1], o.first[1])),
            ] {
                assert!((found - truth).abs() < 1e-4 * (1.0 + truth.abs()), "{found} {truth}");
            }
        }
    }

    #[test]
    fn a_line_has_the_bits_of_the_patch() {
        let spline = Spline::new(&rough());
        for (s, t) in [(0.0, 0.0), (5.25, 9.75), (31.5, 32.0), (32.0, 31.125)] {
            let ((a, x), (b, y)) = (cell(s), cell(t));
            assert_eq!(spline.line(b, y).at(a, x).to_bits(), spline.evaluate(s, t).z.to_bits());
        }
    }

    #[test]
    fn flat_and_tilted_ground_are_kept() {
        let flat = Spline::new(&[123.4; SIDE * SIDE]);
        let tilted = Spline::new(&std::array::from_fn(|k| (k % SIDE) as f64 * 3.0 - (k / SIDE) as f64));
        for (s, t) in [(0.3, 0.7), (15.1, 31.9), (8.0, 30.5)] {
            assert_eq!(flat.evaluate(s, t).z, 123.4);
            let found = tilted.evaluate(s, t);
            assert!((found.z - (s * 3.0 - t)).abs() < 1e-12 && found.second == [0.0; 3]);
        }
    }

    #[test]
    fn open_vertices_go_on_as_the_known_ones_do() {
        let plane = |k: usize| 900.0 + (k % SIDE) as f64 * 2.0;
        let mut z: Vertices = std::array::from_fn(|k| if k % SIDE < 20 { plane(k) } else { 0.0 });
        let mut open: [bool; SIDE * SIDE] = std::array::from_fn(|k| k % SIDE >= 20);
        extend(&mut z, &mut open);
        let row = &z[15 * SIDE..16 * SIDE];
        // Rises of 2, then 1, 1/2, ...: never more than one step in all.
        assert_eq!(row[19], 938.0);
        assert!((row[20] - 939.0).abs() < 1e-12 && (row[21] - 939.5).abs() < 1e-12);
        assert!(row[32] < 940.0 && row[32] > 939.9);
        // Without it, a cliff of 938 m would make the spline swing by metres well inside the data.
        let inside = |z: &Vertices| (Spline::new(z).evaluate(17.5, 15.5).z - 935.0).abs();
        let cliff: Vertices = std::array::from_fn(|k| if k % SIDE < 20 { plane(k) } else { 0.0 });
        assert!(inside(&cliff) > 5.0 && inside(&z) < 0.02, "{} {}", inside(&cliff), inside(&z));
        let mut none = [7.0; SIDE * SIDE];
        extend(&mut none, &mut [true; SIDE * SIDE]);
        assert_eq!(none, [7.0; SIDE * SIDE]);
    }
}
