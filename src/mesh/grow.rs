//! Greedy insertion over one lattice of posts.
//!
//! M. Garland, P. S. Heckbert: Fast Polygonal Approximation of Terrains and Height Fields, CMU-CS-95-181, 1995, section 4
//! (algorithm III). Every triangle knows its farthest post; the farthest of all becomes a vertex, the triangulation Delaunay
//! again, and the triangles that changed are looked through again. When no post is beyond the bound, the points of sides that
//! are get vertices, too (see [`posts`](super::posts) for why these two are all that is to be looked at).

use std::collections::BinaryHeap;

use rayon::prelude::*;

use super::flat::{Flat, NONE, Vertex, area, is_outside, previous};
use super::posts::{Far, PostGrid};

/// A lattice, the grid of vertices over it, and the bound.
#[derive(Clone, Copy)]
pub(super) struct Ground<'a> {
    pub grid: &'a PostGrid,
    /// Metres of a step of the grid of vertices.
    pub unit: f64,
    /// Metres.
    pub bound: f64,
}

/// Vertices between two looks at the caller's wish to stop.
const LOOK_VERTICES: usize = 4096;
/// Vertices are not nearer to each other than this many steps of the lattice.
const NEAR_STEPS: f64 = 1e-3;
/// A vertex is looked for in the triangle that it was found in and so many beside it.
const WALK_MAX: usize = 8;
/// A point nearer to a border side than this (steps) splits the side instead: a vertex next to it would leave a sliver along
/// all of it.
const RIM_STEPS: f64 = 0.5;

impl Ground<'_> {
    /// The vertex at a place of the lattice: the nearest point of the grid, on the field.
    pub fn vertex(&self, i: f64, j: f64) -> Vertex {
        let [x, y] = self.grid.place(i, j).map(|v| (v / self.unit).round() as i32);
        self.vertex_at(x, y)
    }

    pub fn vertex_at(&self, x: i32, y: i32) -> Vertex {
        let (i, j) = self.grid.index([f64::from(x) * self.unit, f64::from(y) * self.unit]);
        // A post that lies on the grid is found again to the last bit.
        let whole = |v: f64| if (v - v.round()).abs() < 1e-9 { v.round() } else { v };
        let (i, j) = (whole(i), whole(j));
        let field = self.grid.at(i, j);
        Vertex { x, y, i, j, z: f64::from(field as f32), field, fixed: false }
    }
}

pub(super) struct Grow<'a> {
    pub flat: Flat,
    ground: Ground<'a>,
    /// The farthest post of each triangle; `error` 0 if none is beyond the bound.
    far: Vec<(f32, u32)>,
    /// Distance (its bits) and triangle; entries that are not as `far` says are old.
    heap: BinaryHeap<u64>,
    star: Vec<u32>,
}

impl<'a> Grow<'a> {
    pub fn new(flat: Flat, ground: Ground<'a>) -> Grow<'a> {
        let count = flat.triangle_count();
        let far = vec![(0.0, NONE); count];
        let mut grow = Grow { flat, ground, far, heap: BinaryHeap::new(), star: Vec::new() };
        (0..count as u32).for_each(|t| grow.look(t));
        grow
    }

    /// The largest distance of a post that is still to come.
    pub fn worst(&self) -> f64 {
        self.heap.peek().map_or(0.0, |entry| f64::from(f32::from_bits((entry >> 32) as u32)))
    }

    /// Inserts posts, the farthest first, until none is beyond the bound; `look` is called from time to time with the largest
    /// distance, and ends it by an error.
    pub fn posts<E>(&mut self, look: &mut dyn FnMut(&Flat, f64) -> Result<(), E>) -> Result<(), E> {
        let mut count = 0;
        while let Some(entry) = self.heap.pop() {
            let (bits, t) = ((entry >> 32) as u32, entry as u32);
            let (error, post) = self.far[t as usize];
            if error.to_bits() != bits || post == NONE {
                continue;
            }
            count += 1;
            if count % LOOK_VERTICES == 0 {
                look(&self.flat, f64::from(error))?;
            }
            let cols = self.ground.grid.cols as u32;
            let vertex = self.ground.vertex(f64::from(post % cols), f64::from(post / cols));
            if !self.insert(t, vertex) {
                self.far[t as usize] = (0.0, NONE);
            }
        }
        Ok(())
    }

    /// Splits every side that leaves the bound at its farthest point, and the sides of the vertices that come; returns how many
    /// vertices that were.
    pub fn sides<E>(&mut self, look: &mut dyn FnMut(&Flat, f64) -> Result<(), E>) -> Result<usize, E> {
        let once = (0..self.flat.corners.len() as u32).filter(|h| self.flat.twin(*h) > *h);
        let mut queue: Vec<u32> = once.filter(|h| self.beyond(*h).is_some()).collect();
        let mut count = 0;
        while let Some(h) = queue.pop() {
            let Some(far) = self.beyond(h) else { continue };
            if !self.insert(h / 3, self.ground.vertex(far.i, far.j)) {
                continue;
            }
            count += 1;
            if count % LOOK_VERTICES == 0 {
                look(&self.flat, self.ground.bound)?;
            }
            let v = self.flat.vertices.len() as u32 - 1;
            let mut star = std::mem::take(&mut self.star);
            self.flat.star(v, &mut star);
            queue.append(&mut star);
            self.star = star;
            queue.extend(self.beyond(h).is_some_and(|next| next != far).then_some(h));
        }
        Ok(count)
    }

    /// The farthest point of a side, if that is beyond the bound.
    fn beyond(&self, h: u32) -> Option<Far> {
        let (a, b) = self.flat.ends(h);
        let far = self.ground.grid.farthest_on_side(self.flat.vertex(a), self.flat.vertex(b));
        (far.error > self.ground.bound).then_some(far)
    }

    /// Finds the farthest post of a triangle.
    fn look(&mut self, t: u32) {
        let far = self.ground.grid.farthest_post(self.flat.at(t));
        let mut found = (0.0, NONE);
        if far.error > self.ground.bound {
            let error = far.error as f32;
            found = (error, (far.j as u32) * self.ground.grid.cols as u32 + far.i as u32);
            self.heap.push(u64::from(error.to_bits()) << 32 | u64::from(t));
        }
        self.far[t as usize] = found;
    }

    /// Inserts a vertex in or near a triangle. False if it would be too near to another, or lies outside.
    fn insert(&mut self, mut t: u32, vertex: Vertex) -> bool {
        // Its place on the grid may be beside the triangle that its post is in.
        let (mut on, mut found) = (NONE, false);
        for _ in 0..WALK_MAX {
            let sides = [0, 1, 2].map(|k| {
                let (a, b) = self.flat.ends(t * 3 + k);
                area(self.flat.vertex(a), self.flat.vertex(b), &vertex)
            });
            let Some(k) = (0..3).find(|&k| sides[k] < 0) else {
                on = (0..3).find(|&k| sides[k] == 0).map_or(NONE, |k| t * 3 + k as u32);
                found = true;
                break;
            };
            let out = t * 3 + k as u32;
            match self.flat.twin(out) {
                NONE => {
                    (on, found) = (out, true);
                    break;
                }
                twin => t = twin / 3,
            }
        }
        let near = |p: &Vertex| (p.i - vertex.i).abs().max((p.j - vertex.j).abs()) < NEAR_STEPS;
        if !found || !vertex.field.is_finite() || self.flat.at(t).into_iter().any(near) {
            return false;
        }
        if let Some(split) = self.rim(t, &vertex) {
            return self.split_rim(t, split);
        }
        if on != NONE && !is_outside(self.flat.twin(on)) {
            if let Some(split) = self.rim(self.flat.twin(on) / 3, &vertex) {
                return self.split_rim(self.flat.twin(on) / 3, split);
            }
            let v = self.flat.push(vertex);
            self.flat.split_side(on, v);
            self.settle(v);
            return true;
        }
        if on != NONE {
            return false;
        }
        let v = self.flat.push(vertex);
        self.flat.split_triangle(t, v);
        self.settle(v);
        true
    }

    /// Splits a border side; false if a vertex is at that place, or next to it.
    fn split_rim(&mut self, t: u32, (h, vertex): (u32, Vertex)) -> bool {
        let near = |p: &Vertex| (p.i - vertex.i).abs().max((p.j - vertex.j).abs()) < NEAR_STEPS;
        if self.flat.at(t).into_iter().any(near) {
            return false;
        }
        let v = self.flat.push(vertex);
        self.flat.split_side(h, v);
        self.settle(v);
        true
    }

    /// The border side of a triangle that a vertex is too near to, and where it is to be split instead.
    fn rim(&self, t: u32, vertex: &Vertex) -> Option<(u32, Vertex)> {
        for h in t * 3..t * 3 + 3 {
            if self.flat.twin(h) != NONE {
                continue;
            }
            let (a, b) = self.flat.ends(h);
            let (a, b) = (self.flat.vertex(a), self.flat.vertex(b));
            let c = self.flat.vertex(self.flat.corners[previous(h) as usize]);
            let metres = |v: &Vertex| [f64::from(v.x) * self.ground.unit, f64::from(v.y) * self.ground.unit];
            let (pa, pb, p) = (metres(a), metres(b), metres(vertex));
            let (ex, ey) = (pb[0] - pa[0], pb[1] - pa[1]);
            let squared = ex * ex + ey * ey;
            let step = self.ground.grid.step();
            let distance = (ex * (p[1] - pa[1]) - ey * (p[0] - pa[0])).abs() / squared.sqrt();
            let along = (ex * (p[0] - pa[0]) + ey * (p[1] - pa[1])) / squared;
            let from_end = along.min(1.0 - along) * squared.sqrt();
            if distance < step * NEAR_STEPS || (distance < step * RIM_STEPS && from_end > distance) {
                let [x, y] =
                    [pa[0] + along * ex, pa[1] + along * ey].map(|v| (v / self.ground.unit).round() as i32);
                let split = Vertex { fixed: true, ..self.ground.vertex_at(x, y) };
                // Off the line by less than a unit, it must leave two triangles.
                return (area(a, &split, c) > 0 && area(&split, b, c) > 0).then_some((h, split));
            }
        }
        None
    }

    /// After a vertex has come: flips, then looks through the triangles around it.
    fn settle(&mut self, v: u32) {
        let mut star = std::mem::take(&mut self.star);
        self.flat.legalise(v, &mut star);
        self.far.resize(self.flat.triangle_count(), (0.0, NONE));
        self.flat.star(v, &mut star);
        star.iter().for_each(|h| self.look(h / 3));
        self.star = star;
    }
}

/// Triangles that are measured by one thread at a time.
const MEASURED_TRIANGLES: usize = 1 << 14;

/// The largest distance of all triangles from the field, and at how many posts and points of sides it was looked for; in parallel.
pub(super) fn measure(flat: &Flat, ground: &Ground) -> (f64, u64) {
    let some = |first: usize| {
        let (mut error, mut points) = (0.0f64, 0);
        let last = (first + MEASURED_TRIANGLES).min(flat.triangle_count());
        for t in first as u32..last as u32 {
            let at = flat.at(t);
            error = error.max(ground.grid.farthest_post(at).error);
            ground.grid.rows_in(at, |_, west, east| points += (east - west + 1) as u64);
            for h in (t * 3..t * 3 + 3).filter(|h| flat.twin(*h) > *h) {
                let (a, b) = flat.ends(h);
                error = error.max(ground.grid.farthest_on_side(flat.vertex(a), flat.vertex(b)).error);
                points += 2;
            }
        }
        (error, points)
    };
    let parts: Vec<(f64, u64)> =
        (0..flat.triangle_count()).into_par_iter().step_by(MEASURED_TRIANGLES).map(some).collect();
    let at_vertices = flat.vertices.iter().map(|v| (v.z - v.field).abs()).fold(0.0, f64::max);
    let most = (at_vertices, flat.vertices.len() as u64);
    parts.into_iter().fold(most, |(error, points), part| (error.max(part.0), points + part.1))
}
