//! The point of a mesh that is nearest to a place, by a hierarchy of boxes.

use super::mesh::Mesh;
use super::vector::{Vector, add, dot, scaled, sub};

/// Triangles of a leaf, at most.
const LEAF: usize = 4;

/// What of a triangle is nearest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// Its inside.
    Face,
    /// The side from corner k to the next.
    Side(usize),
    /// Corner k.
    Corner(usize),
}

/// A place on a mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// The triangle.
    pub triangle: usize,
    /// What of it.
    pub part: Part,
    /// The point on it.
    pub point: Vector,
    /// The square of the distance.
    pub square: f64,
}

/// The triangles of a mesh in a binary tree of boxes: each node's are parted in the middle along the longest side of the box of their middles.
pub struct Hierarchy {
    nodes: Vec<Node>,
    /// The triangles in the order of the leaves, and their corners.
    order: Vec<u32>,
    corners: Vec<[Vector; 3]>,
    /// Where in `order` each triangle stands.
    places: Vec<u32>,
}

struct Node {
    min: Vector,
    max: Vector,
    /// Of a leaf: its first triangle. Of another: its second child; the first one follows it.
    first: u32,
    /// Triangles of a leaf; 0 for others.
    count: u32,
}

impl Node {
    /// The square of the distance from a point to the box.
    #[inline(always)]
    fn square(&self, p: Vector) -> f64 {
        let mut sum = 0.0;
        for (v, (min, max)) in p.iter().zip(self.min.iter().zip(&self.max)) {
            let d = (min - v).max(v - max).max(0.0);
            sum += d * d;
        }
        sum
    }
}

impl Hierarchy {
    /// The tree of a mesh that was checked and has triangles. Costs n log n.
    pub fn new(mesh: &Mesh) -> Hierarchy {
        let count = mesh.triangles.len();
        let middles: Vec<Vector> = (0..count)
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                add(add(a, b), c)
            })
            .collect();
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut nodes = Vec::with_capacity(count);
        build(mesh, &middles, &mut order, 0, &mut nodes);
        let corners = order.iter().map(|t| mesh.corners(*t as usize)).collect();
        let mut places = vec![0; count];
        order.iter().enumerate().for_each(|(k, t)| places[*t as usize] = k as u32);
        Hierarchy { nodes, order, corners, places }
    }

    /// The nearest point to `p`. `guess` is a triangle that is likely near: the nearer, the sooner done. Of points equally near, one that depends on
    /// `p` and `guess` alone.
    pub fn nearest(&self, p: Vector, guess: usize) -> Nearest {
        let place = self.places[guess] as usize;
        let mut best = self.on(place, p);
        // Half of the triangles at each level: no deeper than 32.
        let mut stack = [(0u32, 0f64); 64];
        let mut depth = 1;
        stack[0] = (0, self.nodes[0].square(p));
        while depth > 0 {
            depth -= 1;
            let (at, square) = stack[depth];
            if square >= best.square {
                continue;
            }
            let node = &self.nodes[at as usize];
            if node.count > 0 {
                for k in node.first as usize..(node.first + node.count) as usize {
                    let found = self.on(k, p);
                    if found.square < best.square {
                        best = found;
                    }
                }
                continue;
            }
            let (a, b) = (at + 1, node.first);
            let (da, db) = (self.nodes[a as usize].square(p), self.nodes[b as usize].square(p));
            let (near, far) = if da <= db { ((a, da), (b, db)) } else { ((b, db), (a, da)) };
            for child in [far, near] {
                if child.1 < best.square {
                    stack[depth] = child;
                    depth += 1;
                }
            }
        }
        best
    }

    /// The nearest point of one triangle.
    #[inline]
    fn on(&self, place: usize, p: Vector) -> Nearest {
        let (point, part) = on_triangle(p, &self.corners[place]);
        let d = sub(p, point);
        Nearest { triangle: self.order[place] as usize, part, point, square: dot(d, d) }
    }
}

fn build(mesh: &Mesh, middles: &[Vector], order: &mut [u32], first: u32, nodes: &mut Vec<Node>) {
    let (mut min, mut max) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    let (mut low, mut high) = (min, max);
    for &t in order.iter() {
        let m = middles[t as usize];
        for k in 0..3 {
            (low[k], high[k]) = (low[k].min(m[k]), high[k].max(m[k]));
            for p in mesh.corners(t as usize) {
                (min[k], max[k]) = (min[k].min(p[k]), max[k].max(p[k]));
            }
        }
    }
    let at = nodes.len();
    nodes.push(Node { min, max, first, count: order.len() as u32 });
    if order.len() <= LEAF {
        return;
    }
    let span = sub(high, low);
    let axis = (0..3).fold(0, |a, b| if span[b] > span[a] { b } else { a });
    let half = order.len() / 2;
    let key = |t: &u32| middles[*t as usize][axis];
    order.select_nth_unstable_by(half, |a, b| key(a).total_cmp(&key(b)).then(a.cmp(b)));
    let (left, right) = order.split_at_mut(half);
    build(mesh, middles, left, first, nodes);
    nodes[at].first = nodes.len() as u32;
    nodes[at].count = 0;
    build(mesh, middles, right, first + half as u32, nodes);
}

/// The point of a triangle nearest to `p`, and on what of it that lies (C. Ericson, Real-Time Collision Detection, section 5.1.5).
#[inline]
pub fn on_triangle(p: Vector, [a, b, c]: &[Vector; 3]) -> (Vector, Part) {
    let (ab, ac, ap) = (sub(*b, *a), sub(*c, *a), sub(p, *a));
    let (d1, d2) = (dot(ab, ap), dot(ac, ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return (*a, Part::Corner(0));
    }
    let bp = sub(p, *b);
    let (d3, d4) = (dot(ab, bp), dot(ac, bp));
    if d3 >= 0.0 && d4 <= d3 {
        return (*b, Part::Corner(1));
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return (add(*a, scaled(ab, d1 / (d1 - d3))), Part::Side(0));
    }
    let cp = sub(p, *c);
    let (d5, d6) = (dot(ab, cp), dot(ac, cp));
    if d6 >= 0.0 && d5 <= d6 {
        return (*c, Part::Corner(2));
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return (add(*a, scaled(ac, d2 / (d2 - d6))), Part::Side(2));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return (add(*b, scaled(sub(*c, *b), t)), Part::Side(1));
    }
    let all = va + vb + vc;
    (add(*a, add(scaled(ab, vb / all), scaled(ac, vc / all))), Part::Face)
}
