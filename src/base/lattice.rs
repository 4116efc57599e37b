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
/// Exact, deterministic, independent of the order of `cover`. Cost grows with the number of cover quads that meet `k` times
/// the number of them that it takes to cover it: an edge is covered by as few as possible, and only the edges of those
/// that were needed are looked at. If all of these are covered by what was needed, that alone covers `k`; where one is not,
/// there is a gap beside it.
pub fn covered(k: &Quad, cover: &[Quad]) -> bool {
    let kb = k.bounds();
    let mut near: Vec<Near> = Vec::new();
    for c in cover {
        let bounds = c.bounds();
        if bounds.overlaps(&kb) && c.overlaps(k) {
            if c.contains(k) {
                return true;
            }
            near.push(Near { quad: *c, bounds, needed: false });
        }
    }
    if near.is_empty() {
        return false;
    }
    let mut needed: Vec<usize> = Vec::new();
    let mut spans: Vec<Span> = Vec::new();
    for (a, b) in k.edges() {
        if !cover_edge(
            [a, b],
            Side::Left,
            [Fraction::ZERO, Fraction::ONE],
            &mut near,
            &mut needed,
            &mut spans,
        ) {
            return false;
        }
    }
    let mut next = 0;
    while let Some(&n) = needed.get(next) {
        next += 1;
        for (a, b) in near[n].quad.edges() {
            if let Some((lo, hi)) = interval(a, b, Side::Right, k)
                && !cover_edge([a, b], Side::Right, [lo, hi], &mut near, &mut needed, &mut spans)
            {
                return false;
            }
        }
    }
    true
}

/// A quad of a cover that meets what is to be covered.
struct Near {
    quad: Quad,
    bounds: Bounds,
    needed: bool,
}

/// The part of an edge that a quad of the cover takes.
struct Span {
    from: Fraction,
    to: Fraction,
    near: usize,
}

/// Covers an edge from one fraction to another, on one side, by as few quads as possible: at each end reached, the one that
/// reaches farthest. Adds those that were not needed before to `needed`. `spans` is room to work in.
fn cover_edge(
    [a, b]: [Point; 2],
    side: Side,
    [lo, hi]: [Fraction; 2],
    near: &mut [Near],
    needed: &mut Vec<usize>,
    spans: &mut Vec<Span>,
) -> bool {
    spans.clear();
    let eb = Bounds { min: a, max: a }.union(&Bounds { min: b, max: b });
    for (k, c) in near.iter_mut().enumerate() {
        // An edge may run along the border of a cover quad, so touching boxes count.
        let cb = &c.bounds;
        if cb.min.x > eb.max.x || eb.min.x > cb.max.x || cb.min.y > eb.max.y || eb.min.y > cb.max.y {
            continue;
        }
        if let Some((from, to)) = interval(a, b, side, &c.quad) {
            if from.compare(&lo) != Ordering::Greater && to.compare(&hi) != Ordering::Less {
                // One that covers the whole edge is as few as can be.
                if !std::mem::replace(&mut c.needed, true) {
                    needed.push(k);
                }
                return true;
            }
            spans.push(Span { from, to, near: k });
        }
    }
    spans.sort_by(|x, y| x.from.compare(&y.from));
    let (mut reached, mut next) = (lo, 0);
    while reached.compare(&hi) == Ordering::Less {
        let mut best: Option<&Span> = None;
        while let Some(s) = spans.get(next).filter(|s| s.from.compare(&reached) != Ordering::Greater) {
            if best.is_none_or(|b| s.to.compare(&b.to) == Ordering::Greater) {
                best = Some(s);
            }
            next += 1;
        }
        match best {
            Some(s) if s.to.compare(&reached) == Ordering::Greater => {
                reached = s.to;
                if !std::mem::replace(&mut near[s.near].needed, true) {
                    needed.push(s.near);
                }
            }
            _ => return false,
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

    /// The predicate as section 3.2 of the specification states it: every edge of `k` and of every quad that meets it.
    fn covered_by_definition(k: &Quad, cover: &[Quad]) -> bool {
        let near: Vec<Quad> = cover.iter().copied().filter(|c| c.overlaps(k)).collect();
        let edge = |a: Point, b: Point, side: Side, lo: Fraction, hi: Fraction| {
            let mut spans: Vec<_> = near.iter().filter_map(|c| interval(a, b, side, c)).collect();
            spans.sort_by(|x, y| x.0.compare(&y.0));
            let reached = spans.iter().fold(lo, |r, (s, e)| {
                let joins = s.compare(&r) != Ordering::Greater && e.compare(&r) == Ordering::Greater;
                if joins { *e } else { r }
            });
            reached.compare(&hi) != Ordering::Less
        };
        !near.is_empty()
            && k.edges().iter().all(|&(a, b)| edge(a, b, Side::Left, Fraction::ZERO, Fraction::ONE))
            && near.iter().flat_map(Quad::edges).all(|(a, b)| {
                interval(a, b, Side::Right, k).is_none_or(|(lo, hi)| edge(a, b, Side::Right, lo, hi))
            })
    }

    #[test]
    fn few_edges_decide_as_all_do() {
        let mut seed = 0x2545_f491_4f6c_dd1du64;
        let mut below = |n: i64| {
            seed ^= seed << 13;
            seed ^= seed >> 7;
            seed ^= seed << 17;
            (seed >> 11) as i64 % n
        };
        let (mut yes, mut no) = (0, 0);
        for round in 0..20_000 {
            // Parallelograms on a coarse grid, so that edges touch, coincide and cross; some turned.
            let mut quad = |most: i64| {
                let (x, y, w, h) = (below(9) - 2, below(9) - 2, 1 + below(most), 1 + below(most));
                let t = if round % 2 == 0 { 0 } else { below(3) - 1 };
                let p = |i: i64, j: i64| Point::new(4 * (x + i) - t * j, 4 * (y + j) + t * i);
                Quad([p(0, 0), p(w, 0), p(w, h), p(0, h)])
            };
            let k = quad(4);
            let cover: Vec<Quad> = (0..1 + round % 24).map(|_| quad(5)).collect();
            let found = covered(&k, &cover);
            assert_eq!(found, covered_by_definition(&k, &cover), "{k:?} {cover:?}");
            if !cover.iter().any(|c| c.contains(&k)) {
                if found { yes += 1 } else { no += 1 }
            }
        }
        assert!(yes > 300 && no > 3000, "{yes} covered by several, {no} not");
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
