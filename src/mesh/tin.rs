//! The growing triangulation and who is worst in it.
//!
//! Invariants:
//! - vertices lie on the grid of [`grid_unit`](super::grid_unit), so cross products of them are exact;
//! - `facets[f]` describes the face with index `f` of the triangulation, or is stale until [`Tin::rebuild`];
//! - each site (a point where the error is watched) is in the list of the one facet that it lies in, or
//!   parked: too near to a vertex or border to be inserted;
//! - the heap holds the worst site of every facet whose error exceeds the bound. Entries of facets that
//!   have changed since are recognised by their site no longer being the facet's worst.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashMap};

use spade::handles::{FixedDirectedEdgeHandle, FixedVertexHandle};
use spade::{ConstrainedDelaunayTriangulation, HasPosition, Point2, PositionInTriangulation, Triangulation};

/// A vertex in the plane.
#[derive(Debug, Clone, Copy)]
pub(super) struct Knot {
    pub x: f64,
    pub y: f64,
}

impl HasPosition for Knot {
    type Scalar = f64;
    fn position(&self) -> Point2<f64> {
        Point2::new(self.x, self.y)
    }
}

pub(super) type Cdt = ConstrainedDelaunayTriangulation<Knot>;

/// A point where the field is known.
#[derive(Debug, Clone, Copy)]
pub(super) struct Site {
    pub x: f64,
    pub y: f64,
    /// The field here.
    pub z: f64,
    /// The field at the nearest point of the grid, where a vertex would be.
    pub z_snapped: f64,
    /// By how much errors count here: 1 over the field's share of the bound.
    pub weight: f64,
}

/// A face with the sites in it.
#[derive(Debug, Clone, Default)]
pub(super) struct Facet {
    /// Counter-clockwise.
    pub corners: [u32; 3],
    /// In the region.
    pub inside: bool,
    /// The fine lattice in it has been measured.
    pub measured: bool,
    /// Largest error on the fine lattice, and how many points that was.
    pub fine_error: f64,
    pub fine_points: u64,
    pub sites: Vec<u32>,
    pub worst: u32,
    pub worst_error: f64,
}

pub(super) const NONE: u32 = u32::MAX;

/// z over the plane through three corners.
#[derive(Debug, Clone, Copy)]
pub(super) struct Plane {
    x: f64,
    y: f64,
    z: f64,
    gx: f64,
    gy: f64,
}

impl Plane {
    pub fn through(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> Plane {
        let (bx, by, bz) = (b[0] - a[0], b[1] - a[1], b[2] - a[2]);
        let (cx, cy, cz) = (c[0] - a[0], c[1] - a[1], c[2] - a[2]);
        let cross = bx * cy - cx * by;
        Plane { x: a[0], y: a[1], z: a[2], gx: (bz * cy - cz * by) / cross, gy: (bx * cz - cx * bz) / cross }
    }
    pub fn at(&self, x: f64, y: f64) -> f64 {
        self.z + self.gx * (x - self.x) + self.gy * (y - self.y)
    }
}

/// A border edge and the point on it where it shall be split.
#[derive(Debug, Clone, Copy)]
pub(super) struct BorderSplit {
    pub edge: (u32, u32),
    pub at: [f64; 2],
}

pub(super) struct Tin {
    pub cdt: Cdt,
    /// Height of each vertex; a 32-bit float.
    pub z: Vec<f64>,
    /// The site that each vertex was inserted for, unless that is still watched.
    pub site_of: Vec<u32>,
    pub facets: Vec<Facet>,
    pub sites: Vec<Site>,
    /// Border splits that the sites which were too near to a border asked for.
    pub splits: Vec<BorderSplit>,
    /// What a vertex lost by its height being rounded to 32 bits, at most.
    pub rounding: f64,
    pub(super) unit: f64,
    pub(super) near: f64,
    pub(super) rim: f64,
    pub(super) bound: f64,
    /// By how much being inside grows when the edge (smaller index first) is crossed from right to left.
    pub(super) winding: HashMap<(u32, u32), i32>,
    pub(super) heap: BinaryHeap<(u64, Reverse<u32>, u32)>,
    pub(super) parked: Vec<u32>,
    pub(super) star: Vec<(u32, u32)>,
    pub(super) spokes: Vec<[f64; 2]>,
    pub(super) pool: Vec<u32>,
    pub(super) spare: Vec<Vec<u32>>,
}

impl Tin {
    /// A vertex has come; `site` is the one that it was inserted for, or [`NONE`].
    pub(super) fn push_height(&mut self, z: f64, site: u32) {
        let rounded = f64::from(z as f32);
        let weight = self.sites.get(site as usize).map_or(1.0, |s| s.weight);
        self.rounding = self.rounding.max((z - rounded).abs() * weight);
        self.z.push(rounded);
        self.site_of.push(if self.is_exact(site) { site } else { NONE });
    }

    /// Whether the site lies on the grid, so that a vertex comes to the very place.
    fn is_exact(&self, site: u32) -> bool {
        self.sites.get(site as usize).is_some_and(|s| s.x == self.snap(s.x) && s.y == self.snap(s.y))
    }

    pub fn vertex_count(&self) -> usize {
        self.z.len()
    }

    pub fn snap(&self, x: f64) -> f64 {
        (x / self.unit).round() * self.unit
    }

    pub fn position(&self, v: u32) -> [f64; 3] {
        let at = self.cdt.vertex(handle(v)).position();
        [at.x, at.y, self.z[v as usize]]
    }

    pub fn plane(&self, corners: [u32; 3]) -> Plane {
        let [a, b, c] = corners.map(|v| self.position(v));
        Plane::through(a, b, c)
    }

    /// Whether the edge is on the border of the region, and the index of the face on its other side.
    pub fn across(&self, a: u32, b: u32) -> (bool, usize) {
        match self.cdt.get_edge_from_neighbors(handle(a), handle(b)) {
            None => (true, 0),
            Some(edge) => {
                let other = edge.rev().face().index();
                (!self.facets.get(other).is_some_and(|f| f.inside && other > 0), other)
            }
        }
    }

    /// The largest error of the worst sites that are still to be inserted.
    pub fn worst_error(&self) -> Option<f64> {
        self.heap.peek().map(|(bits, ..)| f64::from_bits(*bits))
    }

    /// Inserts the worst site, if it is still the worst of its facet. False when no site is above the
    /// bound any more.
    pub fn insert_worst(&mut self) -> bool {
        let Some((bits, Reverse(site), facet)) = self.heap.pop() else { return false };
        // Entries may be older than the facet that they speak of, or than its end.
        let still = |f: &Facet| f.worst == site && f.worst_error.to_bits() == bits;
        if self.facets.get(facet as usize).is_some_and(still) {
            self.insert_site(site, facet);
        }
        true
    }

    fn insert_site(&mut self, site: u32, facet: u32) {
        let Site { x, y, z_snapped, .. } = self.sites[site as usize];
        let (x, y) = (self.snap(x), self.snap(y));
        let hint = handle(self.facets[facet as usize].corners[0]);
        let place = self.cdt.locate_with_hint(Point2::new(x, y), hint);
        let allowed = match place {
            PositionInTriangulation::OnFace(face) => self.is_clear(face.index(), [x, y]),
            PositionInTriangulation::OnEdge(edge) => {
                let edge = self.cdt.directed_edge(edge);
                let (a, b) = (edge.from().index() as u32, edge.to().index() as u32);
                let (left, right) = (edge.face().index(), edge.rev().face().index());
                if edge.is_constraint_edge() {
                    // On the border itself: an insertion would split an edge whose sides are counted.
                    self.splits.push(BorderSplit { edge: (a.min(b), a.max(b)), at: [x, y] });
                    false
                } else {
                    self.is_clear(left, [x, y]) && self.is_clear(right, [x, y])
                }
            }
            _ => false,
        };
        if !allowed {
            self.park(site, facet);
            return;
        }
        let Ok(v) = self.cdt.insert_with_hint(Knot { x, y }, hint) else {
            self.park(site, facet);
            return;
        };
        debug_assert_eq!(v.index(), self.z.len());
        self.push_height(z_snapped, site);
        self.refill_star(v.index() as u32, site);
    }

    /// Whether a vertex may come to `p` in this face: not too near to its corners, nor to a border edge,
    /// which is asked to be split instead.
    fn is_clear(&mut self, face: usize, p: [f64; 2]) -> bool {
        let Some(facet) = self.facets.get(face) else { return false };
        if face == 0 || !facet.inside {
            return false;
        }
        let corners = facet.corners;
        let at = corners.map(|v| self.position(v));
        if at.iter().any(|c| (c[0] - p[0]).hypot(c[1] - p[1]) < self.near) {
            return false;
        }
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let edge = self.cdt.get_edge_from_neighbors(handle(a), handle(b));
            if !edge.is_some_and(|e| e.is_constraint_edge()) {
                continue;
            }
            let (pa, pb) = (at[k], at[(k + 1) % 3]);
            let (ex, ey) = (pb[0] - pa[0], pb[1] - pa[1]);
            let squared = ex * ex + ey * ey;
            let distance = (ex * (p[1] - pa[1]) - ey * (p[0] - pa[0])).abs() / squared.sqrt();
            let t = (ex * (p[0] - pa[0]) + ey * (p[1] - pa[1])) / squared;
            let from_end = t.min(1.0 - t) * squared.sqrt();
            if distance < self.near || (distance < self.rim && from_end > distance) {
                let at = [self.snap(pa[0] + t * ex), self.snap(pa[1] + t * ey)];
                self.splits.push(BorderSplit { edge: (a.min(b), a.max(b)), at });
                return false;
            }
        }
        true
    }

    fn park(&mut self, site: u32, facet: u32) {
        self.parked.push(site);
        self.facets[facet as usize].sites.retain(|&s| s != site);
        self.rescan(facet);
    }

    /// Finds the worst site of a facet again.
    fn rescan(&mut self, facet: u32) {
        let f = &self.facets[facet as usize];
        let plane = self.plane(f.corners);
        let (mut worst, mut worst_error) = (NONE, 0.0);
        for &s in &f.sites {
            let site = &self.sites[s as usize];
            let error = (plane.at(site.x, site.y) - site.z).abs() * site.weight;
            if error > worst_error || (error == worst_error && s < worst) {
                (worst, worst_error) = (s, error);
            }
        }
        let f = &mut self.facets[facet as usize];
        (f.worst, f.worst_error) = (worst, worst_error);
        if worst_error > self.bound {
            self.heap.push((worst_error.to_bits(), Reverse(worst), facet));
        }
    }

    /// After an insertion all changed faces are those around the new vertex: shares the sites of the old
    /// ones among them.
    fn refill_star(&mut self, v: u32, inserted: u32) {
        let mut star = std::mem::take(&mut self.star);
        let mut spokes = std::mem::take(&mut self.spokes);
        let mut pool = std::mem::take(&mut self.pool);
        star.clear();
        spokes.clear();
        pool.clear();
        let centre = self.position(v);
        if let Some(first) = self.cdt.vertex(handle(v)).out_edge() {
            let mut edge = first;
            loop {
                let to = edge.to();
                star.push((edge.face().index() as u32, to.index() as u32));
                spokes.push([to.data().x - centre[0], to.data().y - centre[1]]);
                edge = edge.ccw();
                if edge == first {
                    break;
                }
            }
        }
        let faces = self.cdt.num_all_faces();
        if self.facets.len() < faces {
            self.facets.resize_with(faces, Facet::default);
        }
        let keep_inserted = !self.is_exact(inserted);
        for &(f, _) in &star {
            let sites = &mut self.facets[f as usize].sites;
            pool.extend(sites.iter().filter(|&&s| keep_inserted || s != inserted));
            let mut sites = std::mem::take(sites);
            sites.clear();
            self.spare.push(sites);
        }
        let n = star.len();
        let mut planes: [Plane; 16] = [Plane { x: 0.0, y: 0.0, z: 0.0, gx: 0.0, gy: 0.0 }; 16];
        let mut many = Vec::new();
        let planes: &mut [Plane] = if n <= 16 {
            &mut planes[..n]
        } else {
            many.resize(n, planes[0]);
            &mut many
        };
        for i in 0..n {
            let (f, a) = star[i];
            let b = star[(i + 1) % n].1;
            planes[i] = Plane::through(centre, self.position(a), self.position(b));
            let sites = self.spare.pop().unwrap_or_default();
            self.facets[f as usize] =
                Facet { corners: [v, a, b], inside: true, sites, worst: NONE, ..Facet::default() };
        }
        for &s in &pool {
            let site = &self.sites[s as usize];
            let (x, y) = (site.x - centre[0], site.y - centre[1]);
            let i = wedge(&spokes, x, y);
            let error = (planes[i].at(site.x, site.y) - site.z).abs() * site.weight;
            let facet = &mut self.facets[star[i].0 as usize];
            facet.sites.push(s);
            if error > facet.worst_error || (error == facet.worst_error && s < facet.worst) {
                (facet.worst, facet.worst_error) = (s, error);
            }
        }
        for &(f, _) in &star {
            let facet = &self.facets[f as usize];
            if facet.worst_error > self.bound {
                self.heap.push((facet.worst_error.to_bits(), Reverse(facet.worst), f));
            }
        }
        (self.star, self.spokes, self.pool) = (star, spokes, pool);
    }

    /// Adds sites to the facets that they were found in; facets must not have changed since.
    pub fn add_sites(&mut self, found: &[(u32, Site)]) {
        let mut touched = Vec::new();
        for &(facet, site) in found {
            let index = self.sites.len() as u32;
            self.sites.push(site);
            self.facets[facet as usize].sites.push(index);
            if touched.last() != Some(&facet) {
                touched.push(facet);
            }
        }
        touched.sort_unstable();
        touched.dedup();
        touched.into_iter().for_each(|f| self.rescan(f));
    }

    /// Adds sites wherever they lie; those outside the region are forgotten. Returns how many stayed.
    pub fn scatter(&mut self, sites: &[Site]) -> usize {
        let first = self.sites.len() as u32;
        self.sites.extend_from_slice(sites);
        self.place((first..self.sites.len() as u32).collect())
    }

    /// Puts sites into the facets that they lie in, walking from one to the next in strips.
    pub(super) fn place(&mut self, mut pool: Vec<u32>) -> usize {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for &s in &pool {
            (low, high) = (low.min(self.sites[s as usize].y), high.max(self.sites[s as usize].y));
        }
        let strips = (pool.len() as f64).sqrt().ceil().max(1.0);
        let per_metre = if high > low { strips / (high - low) } else { 0.0 };
        pool.sort_by_cached_key(|&s| {
            let Site { x, y, .. } = self.sites[s as usize];
            let strip = ((y - low) * per_metre) as u32;
            // Every other strip backwards; the bits of a number order like the number after this.
            let bits = (if strip.is_multiple_of(2) { x } else { -x }).to_bits() as i64;
            (strip, bits ^ (((bits >> 63) as u64) >> 1) as i64, s)
        });
        let mut last = NONE;
        let mut hint = 0;
        let mut touched = Vec::new();
        let mut placed = 0;
        for s in pool {
            let Site { x, y, .. } = self.sites[s as usize];
            if last == NONE || !self.contains(last, x, y) {
                last = self.face_at(x, y, hint).unwrap_or(NONE);
            }
            if last != NONE {
                placed += 1;
                hint = self.facets[last as usize].corners[0];
                self.facets[last as usize].sites.push(s);
                if touched.last() != Some(&last) {
                    touched.push(last);
                }
            }
        }
        touched.sort_unstable();
        touched.dedup();
        touched.into_iter().for_each(|f| self.rescan(f));
        placed
    }

    fn contains(&self, facet: u32, x: f64, y: f64) -> bool {
        let [a, b, c] = self.facets[facet as usize].corners.map(|v| self.position(v));
        let left = |p: [f64; 3], q: [f64; 3]| (q[0] - p[0]) * (y - p[1]) - (x - p[0]) * (q[1] - p[1]) >= 0.0;
        left(a, b) && left(b, c) && left(c, a)
    }

    /// The facet of the region at a point, found by walking from the vertex `hint`.
    fn face_at(&self, x: f64, y: f64, hint: u32) -> Option<u32> {
        let inside = |f: usize| f > 0 && self.facets.get(f).is_some_and(|f| f.inside);
        let of_edge = |edge: FixedDirectedEdgeHandle| {
            let edge = self.cdt.directed_edge(edge);
            [edge.face().index(), edge.rev().face().index()].into_iter().find(|&f| inside(f))
        };
        let found = match self.cdt.locate_with_hint(Point2::new(x, y), handle(hint)) {
            PositionInTriangulation::OnFace(face) => Some(face.index()).filter(|&f| inside(f)),
            PositionInTriangulation::OnEdge(edge) => of_edge(edge),
            PositionInTriangulation::OutsideOfConvexHull(edge) => of_edge(edge).filter(|_| {
                let [a, b] = self.cdt.directed_edge(edge).positions();
                let (ex, ey) = (b.x - a.x, b.y - a.y);
                (ex * (y - a.y) - ey * (x - a.x)).abs() <= 2.0 * self.unit * ex.hypot(ey)
            }),
            PositionInTriangulation::OnVertex(v) => {
                self.cdt.vertex(v).out_edges().map(|e| e.face().index()).find(|&f| inside(f))
            }
            PositionInTriangulation::NoTriangulation => None,
        };
        found.map(|f| f as u32)
    }

    /// The largest error at any site and on the fine lattice, and at how many points it was measured.
    pub fn error(&self) -> (f64, u64) {
        let (mut error, mut count) = (self.rounding, self.z.len() as u64);
        for facet in self.facets.iter().filter(|f| f.inside) {
            error = error.max(facet.worst_error).max(facet.fine_error);
            count += facet.sites.len() as u64 + facet.fine_points;
        }
        let mut hint = 0;
        for &s in &self.parked {
            let Site { x, y, z, weight, .. } = self.sites[s as usize];
            if let Some(f) = self.face_at(x, y, hint) {
                let corners = self.facets[f as usize].corners;
                hint = corners[0];
                error = error.max((self.plane(corners).at(x, y) - z).abs() * weight);
                count += 1;
            }
        }
        (error, count)
    }
}

pub(super) fn handle(v: u32) -> FixedVertexHandle {
    FixedVertexHandle::from_index(v as usize)
}

/// The spoke that a direction lies on or left of, the next spoke being right of it.
fn wedge(spokes: &[[f64; 2]], x: f64, y: f64) -> usize {
    let side = |s: &[f64; 2]| s[0] * y - s[1] * x;
    let mut best = (f64::NEG_INFINITY, 0);
    let mut here = side(&spokes[0]);
    for i in 0..spokes.len() {
        let next = side(&spokes[(i + 1) % spokes.len()]);
        if here >= 0.0 && next < 0.0 {
            return i;
        }
        // A rounding error may leave a point in no wedge: take the one that it misses least.
        let miss = here.min(-next);
        if miss > best.0 {
            best = (miss, i);
        }
        here = next;
    }
    best.1
}
