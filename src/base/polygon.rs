//! Polygons that name a region: any number of parts with holes, in any order, in the plane.
//!
//! A point is in a part if a ray from it crosses the part's rings an odd number of times, and in the polygon if it is in
//! any part; borders belong to it. Every decision is exact (orientation tests of J. Shewchuk, 1997): it is the polygon of
//! these very 64-bit floats. A tree of boxes over the edges, in their order, makes questions fast.

use super::{Error, Result, limits};

/// A ring of points; the first is not repeated at the end.
pub type Ring = Vec<[f64; 2]>;

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Polygon {
    parts: Vec<Vec<Ring>>,
    edges: Vec<Edge>,
    /// Boxes over 2^k edges each, from single edges (k = 0) up to all of them.
    boxes: Vec<Vec<[f64; 4]>>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Edge {
    from: [f64; 2],
    to: [f64; 2],
    part: u32,
    /// Number of the ring in the part.
    ring: u32,
}

/// Twice the area of a triangle, with the exact sign: positive if counter-clockwise.
fn turn(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    let coord = |p: [f64; 2]| robust::Coord { x: p[0], y: p[1] };
    robust::orient2d(coord(a), coord(b), coord(c))
}

impl Edge {
    fn bounds(&self) -> [f64; 4] {
        let (a, b) = (self.from, self.to);
        [a[0].min(b[0]), a[1].min(b[1]), a[0].max(b[0]), a[1].max(b[1])]
    }

    /// Where this edge and another meet in more than an end they share in their ring, if they do.
    /// `neighbours`: the end of the one is the beginning of the other. `touching`: whether one point in common is
    /// allowed.
    fn crossing(&self, other: &Edge, neighbours: bool, touching: bool) -> Option<[f64; 2]> {
        let (a, b, c, d) = (self.from, self.to, other.from, other.to);
        let (ta, tb) = (turn(c, d, a), turn(c, d, b));
        let (tc, td) = (turn(a, b, c), turn(a, b, d));
        if ta == 0.0 && tb == 0.0 {
            // On one line: they share a stretch, a point or nothing.
            let k = usize::from((a[1] - b[1]).abs() > (a[0] - b[0]).abs());
            let lower = if c[k] < d[k] { c } else { d };
            let upper = if c[k] < d[k] { d } else { c };
            let (mine, last) = if a[k] < b[k] { (a, b) } else { (b, a) };
            let from = if mine[k] > lower[k] { mine } else { lower };
            let to = if last[k] < upper[k] { last } else { upper };
            let shared = from[k] < to[k];
            let point = from[k] == to[k] && !touching && !neighbours;
            return (shared || point).then_some(from);
        }
        let opposite = |s: f64, t: f64| (s > 0.0 && t < 0.0) || (s < 0.0 && t > 0.0);
        if opposite(ta, tb) && opposite(tc, td) {
            let t = ta / (ta - tb);
            return Some([0, 1].map(|k| a[k] + t * (b[k] - a[k])));
        }
        if touching || neighbours {
            return None;
        }
        let on = |t: f64, p: [f64; 2], e: &Edge| {
            let b = e.bounds();
            t == 0.0 && b[0] <= p[0] && p[0] <= b[2] && b[1] <= p[1] && p[1] <= b[3]
        };
        [(ta, a, other), (tb, b, other), (tc, c, self), (td, d, self)]
            .into_iter()
            .find(|(t, p, e)| on(*t, *p, e))
            .map(|(_, p, _)| p)
    }

    /// Whether the edge has a point within a convex quad (counter-clockwise), its border not counted.
    fn enters(&self, quad: &[[f64; 2]; 4]) -> bool {
        let (a, b) = (self.from, self.to);
        let outside = |k: usize| {
            let (p, q) = (quad[k], quad[(k + 1) % 4]);
            turn(p, q, a) <= 0.0 && turn(p, q, b) <= 0.0
        };
        let sides = quad.map(|p| turn(a, b, p));
        !((0..4).any(outside) || sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0))
    }
}

fn meet(a: &[f64; 4], b: &[f64; 4]) -> bool {
    a[0] <= b[2] && b[0] <= a[2] && a[1] <= b[3] && b[1] <= a[3]
}

fn around(a: [f64; 4], b: &[f64; 4]) -> [f64; 4] {
    [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])]
}

impl Polygon {
    /// A polygon of parts, each an outer ring and its holes. `what` names it in errors (a file). Points that follow
    /// themselves are left out.
    ///
    /// # Errors
    /// If it has no part, a coordinate is not finite, a ring has fewer than three points, touches or crosses itself or
    /// crosses another ring of its part, or a hole lies outside; all name the place. [`Error::Limit`] for more than
    /// [`limits::POLYGON_POINTS_MAX`] points, or if so many edges lie beside each other that they cannot be told apart
    /// within [`limits::POLYGON_COMPARISONS_MAX`] comparisons.
    pub fn new(what: &str, mut parts: Vec<Vec<Ring>>) -> Result<Polygon> {
        let points: usize = parts.iter().flatten().map(Vec::len).sum();
        if points as u64 > limits::POLYGON_POINTS_MAX {
            return Err(Error::limit(
                format!("points of the polygon in {what}"),
                limits::POLYGON_POINTS_MAX,
                points as u64,
            ));
        }
        let mut edges = Vec::with_capacity(points);
        for (n, part) in parts.iter_mut().enumerate() {
            for (m, ring) in part.iter_mut().enumerate() {
                let place = name(n, m);
                if let Some(p) = ring.iter().find(|p| !p.iter().all(|v| v.is_finite())) {
                    return Err(Error::invalid(what, format!("{place}: {p:?} is no point")));
                }
                ring.dedup();
                while ring.len() > 1 && ring.first() == ring.last() {
                    ring.pop();
                }
                if ring.len() < 3 {
                    let reason = format!("{place} has {} different points; a ring needs 3", ring.len());
                    return Err(Error::invalid(what, reason));
                }
                for k in 0..ring.len() {
                    let (from, to) = (ring[k], ring[(k + 1) % ring.len()]);
                    edges.push(Edge { from, to, part: n as u32, ring: m as u32 });
                }
            }
        }
        if edges.is_empty() {
            return Err(Error::invalid(what, "holds no polygon, so the region is empty"));
        }
        let mut boxes: Vec<Vec<[f64; 4]>> = vec![edges.iter().map(Edge::bounds).collect()];
        while boxes[boxes.len() - 1].len() > 1 {
            let below = &boxes[boxes.len() - 1];
            let over = below.chunks(2).map(|c| c[1..].iter().fold(c[0], around)).collect();
            boxes.push(over);
        }
        let polygon = Polygon { parts, edges, boxes };
        polygon.is_simple(what)?;
        polygon.holes_are_inside(what)?;
        Ok(polygon)
    }

    /// Outer ring first, then the holes, of each part.
    pub fn parts(&self) -> &[Vec<Ring>] {
        &self.parts
    }

    pub fn points(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        self.edges.iter().map(|e| e.from)
    }

    /// xmin, ymin, xmax, ymax.
    pub fn bounds(&self) -> [f64; 4] {
        self.boxes[self.boxes.len() - 1][0]
    }

    /// Whether a point is in the polygon or on its border.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        let (mut part, mut odd, mut found) = (u32::MAX, false, false);
        self.visit(&|b| b[1] <= p[1] && p[1] <= b[3] && p[0] <= b[2], &mut |e| {
            if e.part != part {
                found |= odd;
                (part, odd) = (e.part, false);
            }
            let (a, b) = if e.from[1] <= e.to[1] { (e.from, e.to) } else { (e.to, e.from) };
            let t = turn(a, b, p);
            let reach = e.bounds();
            if t == 0.0 && reach[0] <= p[0] && p[0] <= reach[2] {
                found = true;
            }
            // A ray towards the east; of the two ends of an edge the lower one counts.
            if a[1] <= p[1] && p[1] < b[1] && t > 0.0 {
                odd = !odd;
            }
            found
        });
        found | odd
    }

    /// Whether the inside of a convex quad (counter-clockwise) and the polygon have a point in common.
    pub fn meets(&self, quad: &[[f64; 2]; 4]) -> bool {
        let b = quad[1..].iter().fold([quad[0][0], quad[0][1], quad[0][0], quad[0][1]], |b, p| {
            around(b, &[p[0], p[1], p[0], p[1]])
        });
        let mut entered = false;
        self.visit(&|c| meet(c, &b), &mut |e| {
            entered |= e.enters(quad);
            entered
        });
        // No edge inside: the quad is wholly in or wholly out.
        entered || self.contains([0, 1].map(|k| quad.iter().map(|p| p[k]).sum::<f64>() / 4.0))
    }

    /// Calls `found` with the edges whose boxes pass, in order, until it says true.
    fn visit<'a>(&'a self, pass: &impl Fn(&[f64; 4]) -> bool, found: &mut impl FnMut(&'a Edge) -> bool) {
        let mut stack = vec![(self.boxes.len() - 1, 0usize)];
        while let Some((level, k)) = stack.pop() {
            if !pass(&self.boxes[level][k]) {
                continue;
            }
            if level == 0 {
                if found(&self.edges[k]) {
                    return;
                }
                continue;
            }
            if 2 * k + 1 < self.boxes[level - 1].len() {
                stack.push((level - 1, 2 * k + 1));
            }
            stack.push((level - 1, 2 * k));
        }
    }

    /// No ring touches or crosses itself, or crosses another of its part. Tells how many boxes and edges were compared.
    fn is_simple(&self, what: &str) -> Result<u64> {
        let mut first = 0usize;
        let mut compared = 0u64;
        for (n, part) in self.parts.iter().enumerate() {
            for (m, ring) in part.iter().enumerate() {
                let count = ring.len();
                for k in first..first + count {
                    let e = &self.edges[k];
                    let reach = e.bounds();
                    let mut at = None;
                    let mut other = (0, 0);
                    compared += self.visit_from(k + 1, &|b| meet(b, &reach), &mut |j, f| {
                        if f.part != e.part {
                            return true;
                        }
                        let same = f.ring == e.ring;
                        let neighbours = same && (j == k + 1 || (k == first && j == first + count - 1));
                        // A triangle's edges are all neighbours, and share an end each.
                        at = e.crossing(f, neighbours, !same);
                        other = (f.part as usize, f.ring as usize);
                        at.is_some()
                    });
                    if compared > limits::POLYGON_COMPARISONS_MAX {
                        return Err(Error::limit(
                            format!(
                                "comparisons of edges (many run side by side; simplify the polygon or cut it into \
                                 parts) of {} in {what}",
                                name(n, m)
                            ),
                            limits::POLYGON_COMPARISONS_MAX,
                            compared,
                        ));
                    }
                    if let Some([x, y]) = at {
                        let (mine, whose) = (name(n, m), name(other.0, other.1));
                        let reason = if mine == whose {
                            format!("{mine} touches or crosses itself at {x}, {y}")
                        } else {
                            format!("{mine} and {whose} cross at {x}, {y}")
                        };
                        return Err(Error::invalid(what, format!("{reason}; mend the polygon first")));
                    }
                }
                first += count;
            }
        }
        Ok(compared)
    }

    /// Like [`Polygon::visit`], for the edges from number `first` on; tells how many boxes and edges it looked at.
    fn visit_from<'a>(
        &'a self,
        first: usize,
        pass: &impl Fn(&[f64; 4]) -> bool,
        found: &mut impl FnMut(usize, &'a Edge) -> bool,
    ) -> u64 {
        let mut looked = 0;
        let mut stack = vec![(self.boxes.len() - 1, 0usize)];
        while let Some((level, k)) = stack.pop() {
            looked += 1;
            if (k + 1) << level <= first || !pass(&self.boxes[level][k]) {
                continue;
            }
            if level == 0 {
                if found(k, &self.edges[k]) {
                    return looked;
                }
                continue;
            }
            if 2 * k + 1 < self.boxes[level - 1].len() {
                stack.push((level - 1, 2 * k + 1));
            }
            stack.push((level - 1, 2 * k));
        }
        looked
    }

    /// Every point of a hole is in its part's outer ring or on it.
    fn holes_are_inside(&self, what: &str) -> Result<()> {
        for (n, part) in self.parts.iter().enumerate().filter(|(_, p)| p.len() > 1) {
            let outer = Polygon::new(what, vec![vec![part[0].clone()]])?;
            for (m, hole) in part.iter().enumerate().skip(1) {
                if let Some([x, y]) = hole.iter().find(|p| !outer.contains(**p)) {
                    let reason = format!("{} lies outside its outer ring at {x}, {y}", name(n, m));
                    return Err(Error::invalid(what, format!("{reason}; mend the polygon first")));
                }
            }
        }
        Ok(())
    }
}

fn name(part: usize, ring: usize) -> String {
    if ring == 0 {
        format!("outer ring of part {}", part + 1)
    } else {
        format!("hole {ring} of part {}", part + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(state: &mut u64) -> f64 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        (*state >> 11) as f64 / (1u64 << 53) as f64
    }

    fn square(x: f64, y: f64, side: f64) -> Ring {
        vec![[x, y], [x + side, y], [x + side, y + side], [x, y + side]]
    }

    /// A star with random radii: a ring that does not cross itself, in either sense.
    fn star(s: &mut u64, middle: [f64; 2], size: f64, points: usize) -> Ring {
        let mut ring: Ring = (0..points)
            .map(|k| {
                let (sin, cos) = (std::f64::consts::TAU * k as f64 / points as f64).sin_cos();
                let r = size * (0.3 + 0.7 * random(s));
                [middle[0] + r * cos, middle[1] + r * sin]
            })
            .collect();
        if random(s) < 0.5 {
            ring.reverse();
        }
        ring
    }

    /// The angle that a ring turns around a point: 0 outside, 2 pi or more inside.
    fn winds(ring: &Ring, p: [f64; 2]) -> bool {
        let angle = |q: &[f64; 2]| (q[1] - p[1]).atan2(q[0] - p[0]);
        let turns: f64 = (0..ring.len())
            .map(|k| {
                let d = angle(&ring[(k + 1) % ring.len()]) - angle(&ring[k]);
                d - (d / std::f64::consts::TAU).round() * std::f64::consts::TAU
            })
            .sum();
        turns.abs() > 3.0
    }

    #[test]
    fn points_inside_are_those_the_rings_wind_around() {
        let mut s = 8;
        for n in 0..40 {
            let parts: Vec<Vec<Ring>> = (0..1 + n % 3)
                .map(|k| {
                    let middle = [60.0 * k as f64, 10.0 * random(&mut s)];
                    let outer = star(&mut s, middle, 100.0, 3 + n * 3);
                    let hole = star(&mut s, middle, 20.0, 3 + n % 9);
                    vec![outer, hole]
                })
                .filter(|p| Polygon::new("star", vec![p.clone()]).is_ok())
                .collect();
            let Ok(polygon) = Polygon::new("stars", parts.clone()) else { continue };
            for _ in 0..2000 {
                let p = [400.0 * random(&mut s) - 150.0, 300.0 * random(&mut s) - 150.0];
                let truth = parts.iter().any(|rings| winds(&rings[0], p) && !winds(&rings[1], p));
                assert_eq!(polygon.contains(p), truth, "{p:?}");
            }
        }
    }

    #[test]
    fn borders_belong_and_quads_meet() {
        let p = Polygon::new("p", vec![vec![square(0.0, 0.0, 10.0), square(4.0, 4.0, 2.0)]]).unwrap();
        for (at, inside) in [
            ([0.0, 0.0], true),
            ([10.0, 5.0], true),
            ([5.0, 10.0], true),
            ([4.0, 5.0], true),
            ([5.0, 5.0], false),
            ([-1e-12, 5.0], false),
            ([5.0, 10.000000001], false),
            ([-5.0, 0.0], false),
            ([15.0, 10.0], false),
        ] {
            assert_eq!(p.contains(at), inside, "{at:?}");
        }
        let quad = |x: f64, y: f64, side: f64| -> [[f64; 2]; 4] { square(x, y, side).try_into().unwrap() };
        assert!(p.meets(&quad(-20.0, -20.0, 50.0)), "around everything");
        assert!(p.meets(&quad(1.0, 1.0, 1.0)), "inside");
        assert!(!p.meets(&quad(4.0, 4.0, 2.0)), "the hole itself");
        assert!(!p.meets(&quad(4.5, 4.5, 1.0)), "in the hole");
        assert!(p.meets(&quad(4.5, 4.5, 2.0)));
        assert!(!p.meets(&quad(10.0, 0.0, 5.0)), "a border in common is no point inside");
        assert!(p.meets(&[[12.0, 5.0], [14.0, 7.0], [12.0, 9.0], [9.9, 7.0]]));
        assert!(!p.meets(&[[12.0, 5.0], [14.0, 7.0], [12.0, 9.0], [10.0, 7.0]]));
    }

    #[test]
    fn quads_meet_where_points_of_both_are() {
        let mut s = 21;
        let mut hits = 0;
        for _ in 0..300 {
            let Ok(p) = Polygon::new("p", vec![vec![star(&mut s, [0.0; 2], 100.0, 12)]]) else { continue };
            let c = [240.0 * random(&mut s) - 120.0, 240.0 * random(&mut s) - 120.0];
            let (sin, cos) = (6.3 * random(&mut s)).sin_cos();
            let r = 30.0 * random(&mut s);
            let quad = [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]].map(|q: [f64; 2]| {
                [c[0] + r * (q[0] * cos - q[1] * sin), c[1] + r * (q[0] * sin + q[1] * cos)]
            });
            let seen = (0..4000).any(|_| {
                let (u, v) = (random(&mut s), random(&mut s));
                let at = [0, 1]
                    .map(|k| quad[0][k] + u * (quad[1][k] - quad[0][k]) + v * (quad[3][k] - quad[0][k]));
                p.contains(at)
            });
            // 4000 points miss slivers only.
            assert!(!seen || p.meets(&quad));
            hits += usize::from(seen == p.meets(&quad));
        }
        assert!(hits > 285, "{hits}");
    }

    #[test]
    fn crossings_are_refused_with_their_place() {
        let e = |parts: Vec<Vec<Ring>>| Polygon::new("f.geojson", parts).unwrap_err().to_string();
        let bow = vec![[0.0, 0.0], [10.0, 10.0], [10.0, 0.0], [0.0, 10.0]];
        let text = e(vec![vec![bow]]);
        assert!(text.contains("f.geojson") && text.contains("crosses itself at 5, 5"), "{text}");
        let spike = vec![[0.0, 0.0], [10.0, 0.0], [20.0, 0.0], [10.0, 0.0], [5.0, 9.0]];
        assert!(e(vec![vec![spike]]).contains("itself"));
        let pinched = vec![[0.0, 0.0], [5.0, 5.0], [10.0, 0.0], [10.0, 10.0], [5.0, 5.0], [0.0, 10.0]];
        assert!(e(vec![vec![pinched]]).contains("itself at 5, 5"));
        let text = e(vec![vec![square(0.0, 0.0, 10.0), square(5.0, 5.0, 10.0)]]);
        assert!(text.contains("hole 1 of part 1") && text.contains("cross"), "{text}");
        assert!(e(vec![vec![square(0.0, 0.0, 1.0), square(5.0, 5.0, 1.0)]]).contains("outside"));
        assert!(e(vec![vec![vec![[0.0, 0.0], [1.0, 1.0]]]]).contains("2 different points"));
        assert!(e(vec![vec![vec![[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]]]).contains("itself"));
        assert!(e(vec![vec![vec![[0.0, 0.0], [f64::NAN, 1.0], [2.0, 2.0]]]]).contains("no point"));
        assert!(e(Vec::new()).contains("empty"));
        let many = vec![vec![vec![[0.0; 2]; limits::POLYGON_POINTS_MAX as usize + 1]]];
        assert!(matches!(Polygon::new("f", many), Err(Error::Limit { .. })));
        // Parts may overlap; a hole may touch its ring at a point.
        assert!(Polygon::new("f", vec![vec![square(0.0, 0.0, 9.0)], vec![square(5.0, 5.0, 9.0)]]).is_ok());
        let touching = vec![[0.0, 5.0], [3.0, 4.0], [3.0, 6.0]];
        assert!(Polygon::new("f", vec![vec![square(0.0, 0.0, 10.0), touching]]).is_ok());
    }

    #[test]
    fn a_coast_of_many_points_is_quick() {
        // Bays within bays, and teeth of a metre.
        let mut s = 2;
        let ring: Ring = (0..100_000)
            .map(|k| {
                let angle = std::f64::consts::TAU * k as f64 / 1e5;
                let bays: f64 = [3.0, 17.0, 120.0, 901.0].iter().map(|n| (n * angle).sin() / n).sum();
                let r = 1e5 * (1.0 + bays) + random(&mut s);
                [r * angle.cos(), r * angle.sin()]
            })
            .collect();
        let p = Polygon::new("coast", vec![vec![ring]]).unwrap();
        let compared = p.is_simple("coast").unwrap();
        assert!((100_000..100 * 100_000).contains(&compared), "{compared} comparisons");
        let inside =
            (0..20_000).filter(|_| p.contains([2e5 * random(&mut s) - 1e5, 2e5 * random(&mut s) - 1e5]));
        assert!(inside.count() > 1000);
    }

    /// One line to and fro along a diagonal: the boxes of its edges overlap nearly all.
    fn comb(points: usize) -> Ring {
        let mut ring: Ring = vec![[-9.0, -9.0]];
        for k in 0..points / 2 - 1 {
            let at = k as f64 / points as f64;
            let mut ends = [[at, -at], [at + 1.0, 1.0 - at]];
            if k % 2 == 1 {
                ends.reverse();
            }
            ring.extend(ends);
        }
        ring
    }

    #[test]
    fn a_comb_whose_teeth_lie_side_by_side_ends_soon() {
        let few = Polygon::new("comb", vec![vec![comb(2002)]]).unwrap();
        let compared = few.is_simple("comb").unwrap();
        assert!(compared > 1_000_000, "{compared}: these boxes should overlap");
        let e =
            Polygon::new("comb.geojson", vec![vec![comb(limits::POLYGON_POINTS_MAX as usize)]]).unwrap_err();
        assert!(e.to_string().contains("comb.geojson") && e.to_string().contains("part 1"), "{e}");
        // Stopped at the first edge that is over.
        let Error::Limit { limit, wanted, .. } = e else { panic!("{e}") };
        assert!(limit < wanted && wanted < limit + 3 * limits::POLYGON_POINTS_MAX, "{wanted}");
    }
}
