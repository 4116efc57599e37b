//! A triangulation in flat arrays: half edges on an integer grid, exact predicates.
//!
//! Half edge `h` is side `h % 3` of triangle `h / 3`, from `corners[h]` to `corners[next(h)]`, the triangle on its left;
//! `twins[h]` is the same side seen from the neighbour, [`NONE`] on the border of the region, [`SEAM`] between parts. So a triangle takes 24 bytes,
//! and a flip moves six numbers. A triangle that was taken out has [`NONE`] as its first corner.

/// No half edge, no vertex.
pub(super) const NONE: u32 = u32::MAX;
/// Instead of a twin: the triangle on the other side is in another part (see [`parts`](super::parts)). Such a side stays.
pub(super) const SEAM: u32 = u32::MAX - 1;

/// Whether what stands for a twin says that there is no triangle in this part.
pub(super) fn is_outside(twin: u32) -> bool {
    twin >= SEAM
}

/// A vertex: its place on the grid of [`grid_unit`](super::grid_unit), below 2^24 either way; the same on the lattice of
/// posts; its height, a 32-bit float.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vertex {
    pub x: i32,
    pub y: i32,
    pub i: f64,
    pub j: f64,
    pub z: f64,
    /// The field at its place.
    pub field: f64,
    /// On the border of the region or of its part: stays where it is.
    pub fixed: bool,
}

#[derive(Debug, Clone, Default)]
pub(super) struct Flat {
    pub vertices: Vec<Vertex>,
    pub corners: Vec<u32>,
    pub twins: Vec<u32>,
    /// A half edge that leaves each vertex.
    pub leaving: Vec<u32>,
}

pub(super) fn next(h: u32) -> u32 {
    if h % 3 == 2 { h - 2 } else { h + 1 }
}

pub(super) fn previous(h: u32) -> u32 {
    if h.is_multiple_of(3) { h + 2 } else { h - 1 }
}

/// Twice the area of a triangle in grid units, exact; above zero if it is counter-clockwise.
pub(super) fn area(a: &Vertex, b: &Vertex, c: &Vertex) -> i64 {
    let d = |p: i32, q: i32| i64::from(p) - i64::from(q);
    d(b.x, a.x) * d(c.y, a.y) - d(c.x, a.x) * d(b.y, a.y)
}

/// Whether `d` is inside the circle through the counter-clockwise `a`, `b`, `c`, exactly.
fn in_circle(a: &Vertex, b: &Vertex, c: &Vertex, d: &Vertex) -> bool {
    let rel = |p: &Vertex| (f64::from(p.x) - f64::from(d.x), f64::from(p.y) - f64::from(d.y));
    let ((ax, ay), (bx, by), (cx, cy)) = (rel(a), rel(b), rel(c));
    // Differences have 26 bits, so squares and products of two are exact in 53.
    let (aa, bb, cc) = (ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy);
    let (bc, ca, ab) = (bx * cy - by * cx, cx * ay - cy * ax, ax * by - ay * bx);
    let found = aa * bc + bb * ca + cc * ab;
    // Three products and two sums of terms not above the sum of their magnitudes, each off by 2^-53 of it.
    let doubt = (aa * bc.abs() + bb * ca.abs() + cc * ab.abs()) * 1e-15;
    if found.abs() > doubt {
        return found > 0.0;
    }
    let exact = |v: f64, w: f64| v as i128 * w as i128;
    exact(aa, bc) + exact(bb, ca) + exact(cc, ab) > 0
}

impl Flat {
    /// Triangles over vertices; sides that two of them share become twins. The vertices of other sides are fixed.
    pub fn new(vertices: Vec<Vertex>, triangles: &[[u32; 3]]) -> Flat {
        let corners: Vec<u32> = triangles.iter().flatten().copied().collect();
        let count = corners.len();
        let mut flat =
            Flat { leaving: vec![NONE; vertices.len()], vertices, corners, twins: vec![NONE; count] };
        // Sides in order of their ends: both halves of one come side by side.
        let mut sides: Vec<(u32, u32, u32)> = (0..count as u32)
            .map(|h| {
                let (a, b) = flat.ends(h);
                flat.leaving[a as usize] = h;
                (a.min(b), a.max(b), h)
            })
            .collect();
        sides.sort_unstable();
        let mut k = 0;
        while k < sides.len() {
            let (a, b, h) = sides[k];
            match sides.get(k + 1) {
                Some(&(c, d, twin)) if (a, b) == (c, d) => {
                    flat.pair(h, twin);
                    k += 2;
                }
                _ => {
                    [a, b].into_iter().for_each(|v| flat.vertices[v as usize].fixed = true);
                    k += 1;
                }
            }
        }
        flat
    }

    pub fn triangle_count(&self) -> usize {
        self.corners.len() / 3
    }

    pub fn vertex(&self, v: u32) -> &Vertex {
        &self.vertices[v as usize]
    }

    /// The corners of a triangle, counter-clockwise.
    pub fn triangle(&self, t: u32) -> [u32; 3] {
        let h = t as usize * 3;
        [self.corners[h], self.corners[h + 1], self.corners[h + 2]]
    }

    pub fn at(&self, t: u32) -> [&Vertex; 3] {
        self.triangle(t).map(|v| self.vertex(v))
    }

    pub fn is_dead(&self, t: u32) -> bool {
        self.corners[t as usize * 3] == NONE
    }

    pub fn ends(&self, h: u32) -> (u32, u32) {
        (self.corners[h as usize], self.corners[next(h) as usize])
    }

    pub fn twin(&self, h: u32) -> u32 {
        self.twins[h as usize]
    }

    fn pair(&mut self, h: u32, twin: u32) {
        self.twins[h as usize] = twin;
        if !is_outside(twin) {
            self.twins[twin as usize] = h;
        }
    }

    fn set(&mut self, t: u32, corners: [u32; 3]) {
        for (k, v) in corners.into_iter().enumerate() {
            let h = t * 3 + k as u32;
            self.corners[h as usize] = v;
            self.leaving[v as usize] = h;
        }
    }

    fn add(&mut self, corners: [u32; 3]) -> u32 {
        let t = self.triangle_count() as u32;
        self.corners.extend([NONE; 3]);
        self.twins.extend([NONE; 3]);
        self.set(t, corners);
        t
    }

    pub fn push(&mut self, vertex: Vertex) -> u32 {
        self.vertices.push(vertex);
        self.leaving.push(NONE);
        self.vertices.len() as u32 - 1
    }

    /// Half edges that leave a vertex, counter-clockwise; of a border vertex from the border on.
    pub fn star(&self, v: u32, out: &mut Vec<u32>) {
        out.clear();
        let first = self.leaving[v as usize];
        let mut start = first;
        loop {
            let twin = self.twin(start);
            if is_outside(twin) {
                break;
            }
            start = next(twin);
            if start == first {
                break;
            }
        }
        let mut h = start;
        loop {
            out.push(h);
            h = self.twin(previous(h));
            if is_outside(h) || h == start {
                break;
            }
        }
    }

    /// Turns the side that two triangles share: `a b c` and `b a d` become `d b c` and `c a d`.
    pub fn flip(&mut self, h: u32) {
        let twin = self.twin(h);
        let ((t, u), (ph, pt)) = ((h / 3, twin / 3), (previous(h), previous(twin)));
        let (c, d) = (self.corners[ph as usize], self.corners[pt as usize]);
        debug_assert!(t != u);
        let (of_h, of_twin) = (self.twin(pt), self.twin(ph));
        self.corners[h as usize] = d;
        self.corners[twin as usize] = c;
        self.pair(h, of_h);
        self.pair(twin, of_twin);
        self.pair(ph, pt);
        for side in [h, next(h), ph, twin, next(twin), pt] {
            self.leaving[self.corners[side as usize] as usize] = side;
        }
    }

    /// Whether the quad around a side is convex, so that [`Flat::flip`] leaves two triangles with an area.
    pub fn can_flip(&self, h: u32) -> bool {
        let twin = self.twin(h);
        if is_outside(twin) {
            return false;
        }
        let (a, b) = self.ends(h);
        let (c, d) = (self.corners[previous(h) as usize], self.corners[previous(twin) as usize]);
        let [a, b, c, d] = [a, b, c, d].map(|v| self.vertex(v));
        area(d, b, c) > 0 && area(c, a, d) > 0
    }

    /// Puts a vertex into a triangle.
    pub fn split_triangle(&mut self, t: u32, v: u32) {
        let [a, b, c] = self.triangle(t);
        let (bc, ca) = (self.twin(t * 3 + 1), self.twin(t * 3 + 2));
        self.set(t, [a, b, v]);
        let (second, third) = (self.add([b, c, v]), self.add([c, a, v]));
        self.pair(second * 3, bc);
        self.pair(third * 3, ca);
        self.pair(t * 3 + 1, second * 3 + 2);
        self.pair(second * 3 + 1, third * 3 + 2);
        self.pair(third * 3 + 1, t * 3 + 2);
    }

    /// Puts a vertex on a side, the border's too.
    pub fn split_side(&mut self, h: u32, v: u32) {
        let twin = self.twin(h);
        let (ahead, behind) = self.halve(h, v);
        if !is_outside(twin) {
            let (ahead_of_twin, behind_of_twin) = self.halve(twin, v);
            self.pair(behind, ahead_of_twin);
            self.pair(ahead, behind_of_twin);
        }
    }

    /// Halves the triangle of a side `a b` at a vertex on it; returns the sides `v b` and `a v`, not paired.
    fn halve(&mut self, h: u32, v: u32) -> (u32, u32) {
        let (a, b) = self.ends(h);
        let c = self.corners[previous(h) as usize];
        let bc = self.twin(next(h));
        let t = h / 3;
        let ca = self.twin(previous(h));
        self.set(t, [a, v, c]);
        let other = self.add([v, b, c]);
        self.pair(other * 3 + 1, bc);
        self.pair(t * 3 + 2, ca);
        self.pair(t * 3 + 1, other * 3 + 2);
        (self.twins[t as usize * 3], self.twins[other as usize * 3]) = (NONE, NONE);
        (other * 3, t * 3)
    }

    /// Makes the triangulation Delaunay again around a vertex that has just come (Lawson's flips).
    pub fn legalise(&mut self, v: u32, star: &mut Vec<u32>) {
        self.star(v, star);
        // The sides across from the vertex.
        star.iter_mut().for_each(|h| *h = next(*h));
        while let Some(h) = star.pop() {
            let twin = self.twin(h);
            if is_outside(twin) {
                continue;
            }
            let [a, b, c] = self.at(h / 3);
            let d = self.corners[previous(twin) as usize];
            if in_circle(a, b, c, self.vertex(d)) && self.can_flip(h) {
                self.flip(h);
                // `d b v` and `v a d`: the sides that were across from `a b` are now across from the vertex.
                star.push(h);
                star.push(next(twin));
            }
        }
    }
}

impl Flat {
    /// Moves a vertex inside into one of its neighbours: `star` are the half edges that leave it, `m` is the one to the
    /// neighbour. The two triangles beside that are taken out.
    pub fn collapse(&mut self, star: &[u32], m: usize) {
        let n = star.len();
        let (gone, into) = self.ends(star[m]);
        let (ahead, behind, before) = (star[(m + 1) % n], star[(m + n - 1) % n], star[(m + n - 2) % n]);
        let (x, y) = (self.twin(next(star[m])), self.twin(next(behind)));
        for &h in star {
            self.corners[h as usize] = into;
        }
        self.pair(ahead, x);
        self.pair(previous(before), y);
        for h in [ahead, next(ahead), previous(ahead), before, next(before), previous(before)] {
            self.leaving[self.corners[h as usize] as usize] = h;
        }
        for t in [star[m] / 3, behind / 3] {
            (0..3).for_each(|k| self.corners[(t * 3 + k) as usize] = NONE);
        }
        self.leaving[gone as usize] = NONE;
    }

    /// Without the triangles and vertices that were taken out; the others keep their order. Also which vertices were kept.
    pub fn compacted(&self) -> (Flat, Vec<u32>) {
        let mut kept = Vec::with_capacity(self.vertices.len());
        let mut place = vec![NONE; self.vertices.len()];
        let mut vertices = Vec::with_capacity(self.vertices.len());
        let mut new_triangle = vec![NONE; self.triangle_count()];
        let mut count = 0;
        for (t, number) in new_triangle.iter_mut().enumerate() {
            if !self.is_dead(t as u32) {
                *number = count;
                count += 1;
            }
        }
        for (v, vertex) in self.vertices.iter().enumerate() {
            if self.leaving[v] != NONE {
                place[v] = vertices.len() as u32;
                vertices.push(*vertex);
                kept.push(v as u32);
            }
        }
        let half = |h: u32| if is_outside(h) { h } else { new_triangle[h as usize / 3] * 3 + h % 3 };
        let leaving = self.leaving.iter().filter(|h| **h != NONE).map(|h| half(*h)).collect();
        let alive = |h: &usize| self.corners[*h / 3 * 3] != NONE;
        let corners =
            (0..self.corners.len()).filter(alive).map(|h| place[self.corners[h] as usize]).collect();
        let twins = (0..self.corners.len()).filter(alive).map(|h| half(self.twins[h])).collect();
        (Flat { vertices, corners, twins, leaving }, kept)
    }
}
