//! Where the posts of a survey lie: an integer frame on the lattice (sections 3.1 and 13 of the
//! LOD-space specification).
//!
//! Post (i, j) is exactly `anchor + i u + j v`. Anchor and steps are rounded once; everything after is
//! integer arithmetic, so kernels of one survey nest exactly at every rotation.

use super::crs::{AxisUnit, Crs};
use super::source::Affine;
use crate::base::lattice::{Bounds, Point, Quad, WORLD_HALF};
use crate::base::round::{nearest, significant};
use crate::base::{Error, Result};

/// A rectangle of cells (or of posts) in index space: `[i0, i1) x [j0, j1)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct CellRect {
    pub i0: i64,
    pub j0: i64,
    pub i1: i64,
    pub j1: i64,
}

impl CellRect {
    pub fn new(i0: i64, j0: i64, i1: i64, j1: i64) -> CellRect {
        CellRect { i0, j0, i1, j1 }
    }
    pub fn is_empty(&self) -> bool {
        self.i0 >= self.i1 || self.j0 >= self.j1
    }
    pub fn intersect(&self, o: &CellRect) -> CellRect {
        CellRect {
            i0: self.i0.max(o.i0),
            j0: self.j0.max(o.j0),
            i1: self.i1.min(o.i1),
            j1: self.j1.min(o.j1),
        }
    }
    pub fn overlaps(&self, o: &CellRect) -> bool {
        !self.intersect(o).is_empty()
    }
    pub fn contains(&self, o: &CellRect) -> bool {
        self.i0 <= o.i0 && self.j0 <= o.j0 && self.i1 >= o.i1 && self.j1 >= o.j1
    }
    pub fn union(&self, o: &CellRect) -> CellRect {
        if self.is_empty() {
            return *o;
        }
        if o.is_empty() {
            return *self;
        }
        CellRect {
            i0: self.i0.min(o.i0),
            j0: self.j0.min(o.j0),
            i1: self.i1.max(o.i1),
            j1: self.j1.max(o.j1),
        }
    }
    pub fn grow(&self, by: i64) -> CellRect {
        CellRect { i0: self.i0 - by, j0: self.j0 - by, i1: self.i1 + by, j1: self.j1 + by }
    }
    pub fn width(&self) -> i64 {
        (self.i1 - self.i0).max(0)
    }
    pub fn height(&self) -> i64 {
        (self.j1 - self.j0).max(0)
    }
}

/// Size of one lattice unit: `2^exponent` units of the CRS.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LatticeUnit {
    pub exponent: i8,
}

impl LatticeUnit {
    /// 2^-35 of a length unit; 2^-51 of a degree. Either way the world cell is 2^61 units wide:
    /// +-2^25 m (33 554 km) or +-512 degrees.
    pub fn for_crs(crs: &Crs) -> LatticeUnit {
        LatticeUnit {
            exponent: match crs.unit {
                AxisUnit::Metre(_) => -35,
                AxisUnit::Degree => -51,
            },
        }
    }
    /// CRS units in one lattice unit. A power of two, so conversions are exact up to rounding once.
    pub fn size(self) -> f64 {
        (2f64).powi(i32::from(self.exponent))
    }
    /// Rounds a CRS coordinate to the lattice, if it lies in the world cell.
    pub fn round(self, x: f64) -> Option<i64> {
        let v = (x / self.size()).round();
        (v.abs() <= WORLD_HALF as f64).then_some(v as i64)
    }
}

/// The regular lattice of a survey's posts, named by decimal steps and phase: what is declared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Step from one column to the next, CRS units, 12 significant digits.
    pub col_step: [f64; 2],
    /// Step from one row to the next.
    pub row_step: [f64; 2],
    /// Position of the posts in steps modulo 1, to 1e-4.
    pub phase: [f64; 2],
}

/// How far a file's posts may lie from the posts of its survey's lattice, in steps.
pub const LATTICE_TOLERANCE: f64 = 1e-3;

impl Lattice {
    /// The lattice of a file, and the index of its first post on it.
    pub fn of_affine(a: &Affine) -> Result<Lattice> {
        let col_step = a.col_step.map(|s| significant(s, 12));
        let row_step = a.row_step.map(|s| significant(s, 12));
        let mut lattice = Lattice { col_step, row_step, phase: [0.0; 2] };
        if !(col_step.iter().chain(&row_step).chain(&a.origin).all(|s| s.is_finite()))
            || lattice.determinant() == 0.0
        {
            return Err(Error::invalid(
                "georeference",
                format!("steps {col_step:?} and {row_step:?} span no area"),
            ));
        }
        let (p, q) = lattice.position(a.origin);
        let phase = |t: f64| {
            let f = ((t - t.floor()) * 1e4).round() / 1e4;
            if f >= 1.0 { 0.0 } else { f }
        };
        lattice.phase = [phase(p), phase(q)];
        Ok(lattice)
    }

    fn determinant(&self) -> f64 {
        self.col_step[0] * self.row_step[1] - self.col_step[1] * self.row_step[0]
    }

    /// A CRS position in steps from the CRS origin.
    fn position(&self, p: [f64; 2]) -> (f64, f64) {
        let d = self.determinant();
        (
            (p[0] * self.row_step[1] - p[1] * self.row_step[0]) / d,
            (self.col_step[0] * p[1] - self.col_step[1] * p[0]) / d,
        )
    }

    /// A CRS position in post indices.
    pub fn index(&self, p: [f64; 2]) -> [f64; 2] {
        let (i, j) = self.position(p);
        [i - self.phase[0], j - self.phase[1]]
    }

    /// The CRS position of a post.
    pub fn post(&self, i: i64, j: i64) -> [f64; 2] {
        let (i, j) = (i as f64 + self.phase[0], j as f64 + self.phase[1]);
        [0, 1].map(|k| i * self.col_step[k] + j * self.row_step[k])
    }

    /// The index of the file's first post on this lattice.
    ///
    /// # Errors
    /// If either extreme post of the file, in either axis, is further than 1e-3 of a step from a post of the lattice.
    pub fn index_of(&self, a: &Affine, cols: u64, rows: u64, file: &str) -> Result<[i64; 2]> {
        let at = |c: f64, r: f64| {
            let x = a.origin[0] + c * a.col_step[0] + r * a.row_step[0];
            let y = a.origin[1] + c * a.col_step[1] + r * a.row_step[1];
            let (p, q) = self.position([x, y]);
            (p - self.phase[0], q - self.phase[1])
        };
        let (n, m) = ((cols - 1) as f64, (rows - 1) as f64);
        let (p0, q0) = at(0.0, 0.0);
        let first = [p0.round(), q0.round()];
        for (c, r) in [(0.0, 0.0), (n, 0.0), (0.0, m), (n, m)] {
            let (p, q) = at(c, r);
            let (dp, dq) = (p - (first[0] + c), q - (first[1] + r));
            if dp.abs() > LATTICE_TOLERANCE || dq.abs() > LATTICE_TOLERANCE {
                return Err(Error::invalid(
                    file,
                    format!(
                        "post ({c}, {r}) lies {dp:.5}, {dq:.5} steps from the survey's lattice (steps {} x {}, phase {} {}); \
                         at most {LATTICE_TOLERANCE} is allowed. ingest it as a survey of its own, or declare the lattice with --lattice",
                        self.nominal_steps()[0],
                        self.nominal_steps()[1],
                        self.phase[0],
                        self.phase[1]
                    ),
                ));
            }
        }
        if first.iter().any(|f| f.abs() > 1e9) {
            return Err(Error::invalid(
                file,
                format!("post index {first:?} from the CRS origin is beyond 1e9"),
            ));
        }
        Ok([first[0] as i64, first[1] as i64])
    }

    /// Lengths of the two steps, to 12 significant digits: the sizes that decide the order of patches.
    pub fn nominal_steps(&self) -> [f64; 2] {
        let length = |s: [f64; 2]| {
            if s[1] == 0.0 {
                s[0].abs()
            } else if s[0] == 0.0 {
                s[1].abs()
            } else {
                significant((s[0] * s[0] + s[1] * s[1]).sqrt(), 12)
            }
        };
        [length(self.col_step), length(self.row_step)]
    }

    /// The integer frame.
    ///
    /// # Errors
    /// If a step is too small or too large for the lattice of the database.
    pub fn frame(&self, unit: LatticeUnit) -> Result<Frame> {
        let step = |s: [f64; 2]| -> Result<Point> {
            let bad = || Error::invalid("georeference", format!("step {s:?} does not fit the lattice"));
            Ok(Point::new(unit.round(s[0]).ok_or_else(bad)?, unit.round(s[1]).ok_or_else(bad)?))
        };
        let (u, v) = (step(self.col_step)?, step(self.row_step)?);
        let anchor = [0, 1].map(|k| self.phase[0] * self.col_step[k] + self.phase[1] * self.row_step[k]);
        let anchor = Point::new(
            unit.round(anchor[0])
                .ok_or_else(|| Error::invalid("georeference", "anchor outside the world"))?,
            unit.round(anchor[1])
                .ok_or_else(|| Error::invalid("georeference", "anchor outside the world"))?,
        );
        let frame = Frame { anchor, u, v };
        // Below this a post index could not be told from its neighbour after rounding of the steps.
        if frame.determinant().unsigned_abs() < 1 << 40 {
            return Err(Error::invalid(
                "georeference",
                format!("steps {:?} {:?} are too small", self.col_step, self.row_step),
            ));
        }
        Ok(frame)
    }
}

/// Anchor and step vectors in lattice units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Frame {
    pub anchor: Point,
    pub u: Point,
    pub v: Point,
}

impl Frame {
    /// Twice signed area of half a cell: positive if rows go to the left of columns.
    pub fn determinant(&self) -> i128 {
        i128::from(self.u.x) * i128::from(self.v.y) - i128::from(self.u.y) * i128::from(self.v.x)
    }

    /// The lattice position of post (i, j); `None` outside the world.
    pub fn checked_post(&self, i: i64, j: i64) -> Option<Point> {
        let at = |a: i64, u: i64, v: i64| {
            let x = i128::from(a) + i128::from(i) * i128::from(u) + i128::from(j) * i128::from(v);
            (x.unsigned_abs() <= WORLD_HALF as u128).then_some(x as i64)
        };
        Some(Point::new(at(self.anchor.x, self.u.x, self.v.x)?, at(self.anchor.y, self.u.y, self.v.y)?))
    }

    /// The lattice position of post (i, j), which lies in the world (checked when the survey arrived).
    #[inline]
    pub fn post(&self, i: i64, j: i64) -> Point {
        Point::new(
            self.anchor.x.wrapping_add(i.wrapping_mul(self.u.x)).wrapping_add(j.wrapping_mul(self.v.x)),
            self.anchor.y.wrapping_add(i.wrapping_mul(self.u.y)).wrapping_add(j.wrapping_mul(self.v.y)),
        )
    }

    /// The closed quad of a rectangle of cells, counter-clockwise.
    pub fn quad(&self, r: &CellRect) -> Quad {
        let (a, b, c, d) =
            (self.post(r.i0, r.j0), self.post(r.i1, r.j0), self.post(r.i1, r.j1), self.post(r.i0, r.j1));
        if self.determinant() > 0 { Quad([a, b, c, d]) } else { Quad([a, d, c, b]) }
    }

    /// Whether all corners of a rectangle lie in the world.
    pub fn holds(&self, r: &CellRect) -> bool {
        [(r.i0, r.j0), (r.i1, r.j0), (r.i1, r.j1), (r.i0, r.j1)]
            .iter()
            .all(|&(i, j)| self.checked_post(i, j).is_some())
    }

    /// Index coordinates of a lattice point, in `f64` (relative error about 1e-15 of the index).
    pub fn index(&self, p: Point) -> (f64, f64) {
        let d = nearest(self.determinant());
        let (dx, dy) =
            (i128::from(p.x) - i128::from(self.anchor.x), i128::from(p.y) - i128::from(self.anchor.y));
        // The numerators are exact integers below 2^123; only the two conversions and the division round.
        let a = dx * i128::from(self.v.y) - dy * i128::from(self.v.x);
        let b = i128::from(self.u.x) * dy - i128::from(self.u.y) * dx;
        (nearest(a) / d, nearest(b) / d)
    }

    /// The cells whose interior can meet the quad: a superset, at most one cell too wide on each side.
    pub fn cells_meeting(&self, q: &Quad) -> CellRect {
        let (mut i0, mut j0, mut i1, mut j1) = (f64::MAX, f64::MAX, f64::MIN, f64::MIN);
        for p in q.0 {
            let (i, j) = self.index(p);
            (i0, i1) = (i0.min(i), i1.max(i));
            (j0, j1) = (j0.min(j), j1.max(j));
        }
        // 1e-6 cells is a thousand times the error of `index` at 1e9 posts from the origin.
        const SLACK: f64 = 1e-6;
        CellRect {
            i0: (i0 - SLACK).floor() as i64,
            j0: (j0 - SLACK).floor() as i64,
            i1: (i1 + SLACK).ceil() as i64,
            j1: (j1 + SLACK).ceil() as i64,
        }
    }

    pub fn bounds(&self, r: &CellRect) -> Bounds {
        self.quad(r).bounds()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn utm(origin: [f64; 2], step: f64) -> Affine {
        Affine { origin, col_step: [step, 0.0], row_step: [0.0, -step] }
    }

    #[test]
    fn tiles_of_one_survey_share_a_lattice() {
        let a = utm([560_005.0, 5_116_995.0], 10.0);
        let l = Lattice::of_affine(&a).unwrap();
        assert_eq!(l.phase, [0.5, 0.5]);
        assert_eq!(l.nominal_steps(), [10.0, 10.0]);
        let first = l.index_of(&a, 100, 100, "a").unwrap();
        let next = l.index_of(&utm([561_005.0, 5_116_995.0], 10.0), 100, 100, "b").unwrap();
        assert_eq!(next, [first[0] + 100, first[1]]);
        let off = l.index_of(&utm([561_005.2, 5_116_995.0], 10.0), 100, 100, "c").unwrap_err().to_string();
        assert!(off.contains("0.02000") && off.contains("c:"), "{off}");
    }

    #[test]
    fn cells_meeting_is_a_tight_superset() {
        let a = Affine { origin: [500_000.0, 4_000_000.0], col_step: [9.5, 3.1], row_step: [3.1, -9.5] };
        let l = Lattice::of_affine(&a).unwrap();
        let f = l.frame(LatticeUnit { exponent: -35 }).unwrap();
        let [i, j] = l.index_of(&a, 10, 10, "x").unwrap();
        let r = CellRect::new(i, j, i + 28, j + 28);
        let back = f.cells_meeting(&f.quad(&r));
        assert!(back.contains(&r) && r.grow(1).contains(&back), "{r:?} {back:?}");
        assert!(f.holds(&r));
    }

    #[test]
    fn rotated_steps_have_decimal_lengths() {
        let t = 17f64.to_radians();
        let a = Affine {
            origin: [1.0, 2.0],
            col_step: [70.0 * t.cos(), 70.0 * t.sin()],
            row_step: [70.0 * t.sin(), -70.0 * t.cos()],
        };
        assert_eq!(Lattice::of_affine(&a).unwrap().nominal_steps(), [70.0, 70.0]);
    }
}
