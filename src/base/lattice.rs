//! Exact integer geometry on the lattice of a database.
//!
//! Coordinates are `i64` lattice units; any two differ by at most 2^61, so every cross product fits `i128`
//! and every comparison of interval ends fits a 256-bit product. No floats, no intersection points.
//! The coverage predicate is section 3.2 of the LOD-space specification ("edges and intervals").

use std::cmp::Ordering;

/// Half the side of the world cell, in lattice units: the world is `[-WORLD_HALF, WORLD_HALF)` in x and y.
pub const WORLD_HALF: i64 = 1 << 60;

/// A point or a vector, in lattice units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Point {
    pub x: i64,
    pub y: i64,
}

impl Point {
    pub const fn new(x: i64, y: i64) -> Point {
        Point { x, y }
    }
}

/// The z component of the cross product of `b - a` and `p - q`.
#[inline]
pub fn cross(a: Point, b: Point, q: Point, p: Point) -> i128 {
    i128::from(b.x - a.x) * i128::from(p.y - q.y) - i128::from(b.y - a.y) * i128::from(p.x - q.x)
}

#[inline]
fn dot(a: Point, b: Point, q: Point, p: Point) -> i128 {
    i128::from(b.x - a.x) * i128::from(p.x - q.x) + i128::from(b.y - a.y) * i128::from(p.y - q.y)
}

/// A convex quadrilateral, counter-clockwise, of positive area. Closed unless said otherwise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Quad(pub [Point; 4]);

/// An axis-parallel box, `min <= max`, closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bounds {
    pub min: Point,
    pub max: Point,
}

impl Bounds {
    /// Whether the open boxes meet.
    #[inline]
    pub fn overlaps(&self, o: &Bounds) -> bool {
        self.min.x < o.max.x && o.min.x < self.max.x && self.min.y < o.max.y && o.min.y < self.max.y
    }

    pub fn quad(&self) -> Quad {
        Quad([self.min, Point::new(self.max.x, self.min.y), self.max, Point::new(self.min.x, self.max.y)])
    }

    pub fn union(&self, o: &Bounds) -> Bounds {
        Bounds {
            min: Point::new(self.min.x.min(o.min.x), self.min.y.min(o.min.y)),
            max: Point::new(self.max.x.max(o.max.x), self.max.y.max(o.max.y)),
        }
    }
}

impl Quad {
    pub fn bounds(&self) -> Bounds {
        let mut b = Bounds { min: self.0[0], max: self.0[0] };
        for p in &self.0[1..] {
            b = b.union(&Bounds { min: *p, max: *p });
        }
        b
    }

    fn edges(&self) -> [(Point, Point); 4] {
        let q = &self.0;
        [(q[0], q[1]), (q[1], q[2]), (q[2], q[3]), (q[3], q[0])]
    }

    /// Whether every point of `other` is in this (closed) quad.
    pub fn contains(&self, other: &Quad) -> bool {
        self.edges().iter().all(|&(p, q)| other.0.iter().all(|&v| cross(p, q, p, v) >= 0))
    }

    /// Whether the point is in this closed quad.
    pub fn contains_point(&self, v: Point) -> bool {
        self.edges().iter().all(|&(p, q)| cross(p, q, p, v) >= 0)
    }

    /// Whether the interiors meet (separating axis test; exact).
    pub fn overlaps(&self, other: &Quad) -> bool {
        if !self.bounds().overlaps(&other.bounds()) {
            return false;
        }
        let separated =
            |a: &Quad, b: &Quad| a.edges().iter().any(|&(p, q)| b.0.iter().all(|&v| cross(p, q, p, v) <= 0));
        !separated(self, other) && !separated(other, self)
    }

    /// Whether the *open* quad meets the half-open cell `[min, max)`. Since the quad is open and both are
    /// convex with interior, this is the same as their interiors meeting.
    pub fn meets_cell(&self, cell: &Bounds) -> bool {
        // Around a corner that lies inside the cell there is interior of both.
        let inside = |p: &Point| cell.min.x < p.x && p.x < cell.max.x && cell.min.y < p.y && p.y < cell.max.y;
        self.0.iter().any(inside) || self.overlaps(&cell.quad())
    }
}

/// A fraction `num / den`, `den > 0`.
#[derive(Clone, Copy, Debug)]
struct Fraction {
    num: i128,
    den: i128,
}

impl Fraction {
    const ZERO: Fraction = Fraction { num: 0, den: 1 };
    const ONE: Fraction = Fraction { num: 1, den: 1 };

    fn new(num: i128, den: i128) -> Fraction {
        if den < 0 { Fraction { num: -num, den: -den } } else { Fraction { num, den } }
    }

    fn compare(&self, o: &Fraction) -> Ordering {
        compare_products(self.num, o.den, o.num, self.den)
    }
}

/// Compares `a * b` with `c * d` without overflow (256-bit products of magnitudes).
fn compare_products(a: i128, b: i128, c: i128, d: i128) -> Ordering {
    if let (Some(x), Some(y)) = (a.checked_mul(b), c.checked_mul(d)) {
        return x.cmp(&y);
    }
    let sign = |x: i128, y: i128| x.signum() * y.signum();
    let (s, t) = (sign(a, b), sign(c, d));
    if s != t {
        return s.cmp(&t);
    }
    let left = wide_product(a.unsigned_abs(), b.unsigned_abs());
    let right = wide_product(c.unsigned_abs(), d.unsigned_abs());
    if s >= 0 { left.cmp(&right) } else { right.cmp(&left) }
}

/// The 256-bit product of two `u128`, high half first.
fn wide_product(a: u128, b: u128) -> (u128, u128) {
    const MASK: u128 = u64::MAX as u128;
    let (a1, a0, b1, b0) = (a >> 64, a & MASK, b >> 64, b & MASK);
    let low = a0 * b0;
    let mid1 = a1 * b0;
    let mid2 = a0 * b1;
    // Each term is below 2^64, so the sum of three cannot overflow.
    let carry = (low >> 64) + (mid1 & MASK) + (mid2 & MASK);
    let high = a1 * b1 + (mid1 >> 64) + (mid2 >> 64) + (carry >> 64);
    (high, (carry << 64) | (low & MASK))
}

#[derive(Clone, Copy, PartialEq)]
enum Side {
    Left,
    Right,
}

/// The open interval of t in (0, 1) for which a + t(b-a), moved infinitesimally to `side`, is inside `c`.
fn interval(a: Point, b: Point, side: Side, c: &Quad) -> Option<(Fraction, Fraction)> {
    let (mut lo, mut hi) = (Fraction::ZERO, Fraction::ONE);
    for (p, q) in c.edges() {
        let alpha = cross(p, q, p, a);
        let beta = cross(p, q, a, b);
        if beta == 0 {
            if alpha > 0 {
                continue;
            }
            if alpha == 0 {
                let same = dot(p, q, a, b) > 0;
                if same == (side == Side::Left) {
                    continue;
                }
            }
            return None;
        }
        let t = Fraction::new(-alpha, beta);
        if beta > 0 {
            if t.compare(&lo) == Ordering::Greater {
                lo = t;
            }
        } else if t.compare(&hi) == Ordering::Less {
            hi = t;
        }
        if lo.compare(&hi) != Ordering::Less {
            return None;
        }
    }
    Some((lo, hi))
}

/// Whether the closed quad `k` lies inside the union of the closed quads of `cover`.
///
/// Exact, deterministic, independent of the order of `cover`. Cost grows with the square of the number of
/// cover quads that meet `k`.
pub fn covered(k: &Quad, cover: &[Quad]) -> bool {
    let kb = k.bounds();
    let mut near: Vec<Quad> = Vec::new();
    for c in cover {
        if c.bounds().overlaps(&kb) && c.overlaps(k) {
            if c.contains(k) {
                return true;
            }
            near.push(*c);
        }
    }
    if near.is_empty() {
        return false;
    }
    let bounds: Vec<Bounds> = near.iter().map(Quad::bounds).collect();
    let mut spans: Vec<(Fraction, Fraction)> = Vec::new();
    let mut edge_is_covered = |a: Point, b: Point, side: Side, lo: Fraction, hi: Fraction| -> bool {
        spans.clear();
        let eb = Bounds {
            min: Point::new(a.x.min(b.x), a.y.min(b.y)),
            max: Point::new(a.x.max(b.x), a.y.max(b.y)),
        };
        for (c, cb) in near.iter().zip(&bounds) {
            // An edge may run along the border of a cover quad, so touching boxes count.
            if cb.min.x > eb.max.x || eb.min.x > cb.max.x || cb.min.y > eb.max.y || eb.min.y > cb.max.y {
                continue;
            }
            if let Some(s) = interval(a, b, side, c) {
                spans.push(s);
            }
        }
        spans.sort_by(|x, y| x.0.compare(&y.0));
        let mut reached = lo;
        for (s, e) in &spans {
            if s.compare(&reached) == Ordering::Greater {
                break;
            }
            if e.compare(&reached) == Ordering::Greater {
                reached = *e;
            }
            if reached.compare(&hi) != Ordering::Less {
                break;
            }
        }
        reached.compare(&hi) != Ordering::Less
    };
    for (a, b) in k.edges() {
        if !edge_is_covered(a, b, Side::Left, Fraction::ZERO, Fraction::ONE) {
            return false;
        }
    }
    for c in &near {
        for (a, b) in c.edges() {
            if let Some((lo, hi)) = interval(a, b, Side::Right, k)
                && !edge_is_covered(a, b, Side::Right, lo, hi)
            {
                return false;
            }
        }
    }
    true
}

/// Whether every quad of `kernel` lies inside the union of `cover`.
pub fn all_covered(kernel: &[Quad], cover: &[Quad]) -> bool {
    kernel.iter().all(|k| covered(k, cover))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rect(x0: i64, y0: i64, x1: i64, y1: i64) -> Quad {
        Bounds { min: Point::new(x0, y0), max: Point::new(x1, y1) }.quad()
    }

    #[test]
    fn halves_that_touch_cover_exactly() {
        let k = rect(0, 0, 10, 10);
        assert!(covered(&k, &[rect(0, 0, 5, 10), rect(5, 0, 10, 10)]));
        assert!(!covered(&k, &[rect(0, 0, 5, 10), rect(6, 0, 10, 10)]));
        assert!(!covered(&k, &[rect(0, 0, 5, 10), rect(5, 0, 10, 9)]));
        assert!(!covered(&k, &[]));
        assert!(covered(&k, &[rect(-1, -1, 11, 11)]));
    }

    #[test]
    fn a_hole_in_the_middle_is_seen() {
        let k = rect(0, 0, 9, 9);
        let ring = [rect(0, 0, 9, 4), rect(0, 5, 9, 9), rect(0, 0, 4, 9), rect(5, 0, 9, 9)];
        assert!(!covered(&k, &ring));
        let mut all = ring.to_vec();
        all.push(rect(4, 4, 5, 5));
        assert!(covered(&k, &all));
    }

    #[test]
    fn minimality_example_of_the_specification() {
        let a = rect(-5, -5, 5, 5);
        let four = [rect(-6, -6, 2, 2), rect(-2, -6, 6, 2), rect(-6, -2, 2, 6), rect(-2, -2, 6, 6)];
        assert!(covered(&a, &four));
        assert!(!covered(&a, &four[..3]));
    }

    #[test]
    fn rotated_children_cover_their_parent() {
        // An integer frame: U = (97, 31), V = (-31, 97), far from the origin and with large steps.
        let base = Point::new(1 << 58, -(1 << 57));
        let s = 1i64 << 40;
        let post =
            |i: i64, j: i64| Point::new(base.x + (97 * i - 31 * j) * s, base.y + (31 * i + 97 * j) * s);
        let cell =
            |i: i64, j: i64, n: i64| Quad([post(i, j), post(i + n, j), post(i + n, j + n), post(i, j + n)]);
        let parent = cell(0, 0, 2);
        let children = [cell(0, 0, 1), cell(1, 0, 1), cell(0, 1, 1), cell(1, 1, 1)];
        assert!(covered(&parent, &children));
        assert!(!covered(&parent, &children[..3]));
    }

    #[test]
    fn wide_products_order_like_big_numbers() {
        let m = i128::MAX;
        assert_eq!(compare_products(m, m, m, m - 1), Ordering::Greater);
        assert_eq!(compare_products(-m, m, m, m), Ordering::Less);
        assert_eq!(compare_products(-m, m, -m, m - 1), Ordering::Less);
        assert_eq!(compare_products(m, 3, 3, m), Ordering::Equal);
    }
}
