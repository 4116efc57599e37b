//! Lines with integer coefficients and convex polygons bounded by them, without rounding.
//!
//! A corner is never a pair of coordinates but the two lines that meet there. Cutting a polygon needs only
//! the side of a line on which a corner lies, a 3 x 3 determinant of line coefficients, and adds only lines
//! that were given: numbers do not grow, however often a polygon is cut.
//!
//! Signs come from floating point where its error bound allows, else from `i128`, else from big integers.

use num_bigint::{BigInt, Sign};
use std::cmp::Ordering;

/// `a x + b y + c`, positive on one side.
#[derive(Clone, Copy, Debug)]
pub struct Line {
    exact: [i128; 3],
    rounded: [f64; 3],
}

impl Line {
    /// Common powers of two are taken out, so that lattices of round steps stay within `i128`.
    pub fn new(a: i128, b: i128, c: i128) -> Line {
        let shift = (a | b | c).trailing_zeros().min(126);
        let exact = [a >> shift, b >> shift, c >> shift];
        Line { exact, rounded: exact.map(|x| x as f64) }
    }

    /// The line through two points, positive on the left of `p` to `q`.
    pub fn through(p: [i128; 2], q: [i128; 2]) -> Line {
        let d = [q[0] - p[0], q[1] - p[1]];
        Line::new(-d[1], d[0], d[1] * p[0] - d[0] * p[1])
    }
}

/// Where two lines of the polygon's list meet, in homogeneous coordinates with positive weight.
///
/// The weight must fit `i128`: `a` and `b` of every line below 2^63.
#[derive(Clone, Copy, Debug)]
struct Corner {
    lines: [u32; 2],
    at: [f64; 3],
    /// What bounds the rounding error of `at`: the sums of the absolute products.
    size: [f64; 3],
}

impl Corner {
    fn new(lines: &[Line], l: u32, m: u32) -> Corner {
        let weight = |l: u32, m: u32| {
            let ([a, b, _], [d, e, _]) = (lines[l as usize].exact, lines[m as usize].exact);
            a * e - d * b
        };
        let (l, m) = if weight(l, m) < 0 { (m, l) } else { (l, m) };
        let w = weight(l, m);
        assert!(w > 0, "parallel lines have no corner");
        let ([a, b, c], [d, e, f]) = (lines[l as usize].rounded, lines[m as usize].rounded);
        Corner {
            lines: [l, m],
            at: [b * f - e * c, c * d - f * a, w as f64],
            size: [(b * f).abs() + (e * c).abs(), (c * d).abs() + (f * a).abs(), w as f64],
        }
    }

    fn side(&self, lines: &[Line], line: &Line) -> Ordering {
        let [a, b, c] = line.rounded;
        let value = a * self.at[0] + b * self.at[1] + c * self.at[2];
        let size = a.abs() * self.size[0] + b.abs() * self.size[1] + c.abs() * self.size[2];
        // Each of the six products has fewer than 16 roundings behind it, each of at most 2^-53.
        if value.abs() > size * 2f64.powi(-47) {
            return value.total_cmp(&0.0);
        }
        let [l, m] = self.lines.map(|k| &lines[k as usize].exact);
        small_side(l, m, &line.exact).unwrap_or_else(|| big_side(l, m, &line.exact))
    }
}

fn small_side(l: &[i128; 3], m: &[i128; 3], n: &[i128; 3]) -> Option<Ordering> {
    let minor = |p: usize, q: usize| l[p].checked_mul(m[q])?.checked_sub(l[q].checked_mul(m[p])?);
    let terms =
        [n[0].checked_mul(minor(1, 2)?)?, n[1].checked_mul(minor(2, 0)?)?, n[2].checked_mul(minor(0, 1)?)?];
    Some(terms[0].checked_add(terms[1])?.checked_add(terms[2])?.cmp(&0))
}

fn big_side(l: &[i128; 3], m: &[i128; 3], n: &[i128; 3]) -> Ordering {
    let big = |x: i128| BigInt::from(x);
    let minor = |p: usize, q: usize| big(l[p]) * big(m[q]) - big(l[q]) * big(m[p]);
    let sum = big(n[0]) * minor(1, 2) + big(n[1]) * minor(2, 0) + big(n[2]) * minor(0, 1);
    match sum.sign() {
        Sign::Minus => Ordering::Less,
        Sign::NoSign => Ordering::Equal,
        Sign::Plus => Ordering::Greater,
    }
}

/// A convex polygon with interior, counter-clockwise: each corner with the line that leaves it.
#[derive(Clone, Debug)]
pub struct Polygon {
    edges: Vec<(Corner, u32)>,
}

/// What a line leaves of a polygon.
pub enum Cut {
    Below(Polygon),
    Above(Polygon),
    Both(Polygon, Polygon),
}

impl Polygon {
    /// A convex polygon from its corners in counter-clockwise order; its lines are added to `lines`.
    pub fn new(corners: &[[i128; 2]], lines: &mut Vec<Line>) -> Polygon {
        let (start, count) = (lines.len() as u32, corners.len() as u32);
        for (k, &p) in corners.iter().enumerate() {
            lines.push(Line::through(p, corners[(k + 1) % corners.len()]));
        }
        let corner = |k: u32| Corner::new(lines, start + (k + count - 1) % count, start + k);
        Polygon { edges: (0..count).map(|k| (corner(k), start + k)).collect() }
    }

    /// Divides by line `l` of `lines`. A part without interior is no part.
    pub fn cut(self, lines: &[Line], l: u32) -> Cut {
        let line = &lines[l as usize];
        let sides: Vec<Ordering> = self.edges.iter().map(|(corner, _)| corner.side(lines, line)).collect();
        if sides.iter().all(|&s| s != Ordering::Greater) {
            return Cut::Below(self);
        }
        if sides.iter().all(|&s| s != Ordering::Less) {
            return Cut::Above(self);
        }
        let part = |out: Ordering| {
            let mut edges = Vec::with_capacity(self.edges.len() + 1);
            for (k, &(corner, edge)) in self.edges.iter().enumerate() {
                let (here, next) = (sides[k], sides[(k + 1) % sides.len()]);
                if here != out {
                    edges.push((corner, if here == Ordering::Equal && next == out { l } else { edge }));
                }
                if here != Ordering::Equal && next == here.reverse() {
                    edges.push((Corner::new(lines, edge, l), if next == out { l } else { edge }));
                }
            }
            Polygon { edges }
        };
        Cut::Both(part(Ordering::Greater), part(Ordering::Less))
    }

    /// The least value of `a x + b y + c` over the corners, roughly: a place to begin, never a decision.
    pub fn least(&self, [a, b, c]: [f64; 3]) -> f64 {
        let values = self.edges.iter().map(|(p, _)| (a * p.at[0] + b * p.at[1]) / p.at[2] + c);
        values.fold(f64::INFINITY, f64::min)
    }

    /// Area, rounded.
    pub fn area(&self) -> f64 {
        let points: Vec<[f64; 2]> =
            self.edges.iter().map(|(p, _)| [p.at[0] / p.at[2], p.at[1] / p.at[2]]).collect();
        let o = points[0];
        let from = |p: [f64; 2]| [p[0] - o[0], p[1] - o[1]];
        let fan = points.windows(2).map(|w| (from(w[0]), from(w[1])));
        fan.map(|(p, q)| p[0] * q[1] - p[1] * q[0]).sum::<f64>() / 2.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn filtered_signs_are_those_of_big_integers() {
        let mut state = 1u64;
        let mut next = |bits: u32| {
            state = state.wrapping_mul(0x5851_f42d_4c95_7f2d).wrapping_add(0x1405_7b7e_f767_814f);
            i128::from((state >> (64 - bits)) as i64 - (1i64 << (bits - 1)))
        };
        let mut ties = 0;
        for bits in [4, 12, 30, 45, 61] {
            for round in 0..4000 {
                let mut p: Vec<[i128; 2]> = (0..5).map(|_| [next(bits), next(bits)]).collect();
                // The last line passes the corner of the first two exactly, or by a hair.
                let near = if round % 3 == 0 { 0 } else { next(4) };
                p[4] = [p[0][0] + near, p[0][1]];
                let lines = [Line::through(p[0], p[1]), Line::through(p[2], p[0]), Line::through(p[3], p[4])];
                let weight = lines[0].exact[0] * lines[1].exact[1] - lines[1].exact[0] * lines[0].exact[1];
                if weight == 0 || p[3] == p[4] {
                    continue;
                }
                let corner = Corner::new(&lines, 0, 1);
                let (l, m) = if weight > 0 { (0, 1) } else { (1, 0) };
                let expected = big_side(&lines[l].exact, &lines[m].exact, &lines[2].exact);
                assert_eq!(corner.side(&lines, &lines[2]), expected, "{p:?}");
                let d = [p[4][0] - p[3][0], p[4][1] - p[3][1]];
                let turn = d[0] * (p[0][1] - p[3][1]) - d[1] * (p[0][0] - p[3][0]);
                assert_eq!(expected, turn.cmp(&0), "{p:?}");
                ties += usize::from(expected == Ordering::Equal);
            }
        }
        assert!(ties > 5000, "{ties}");
    }
}
