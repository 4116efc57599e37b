//! Changes that reach farther than the star of a new vertex: the first triangulation, split border edges,
//! vertices taken out; and finding out afterwards what is inside the region.

use std::collections::{BinaryHeap, HashMap};

use spade::handles::{DirectedEdgeHandle, FixedFaceHandle, InnerTag};
use spade::{CdtEdge, Point2, PositionInTriangulation, Triangulation};

use super::tin::{BorderSplit, Cdt, Facet, Knot, NONE, Tin, handle};
use crate::base::{Error, Result};

/// Points nearer to a long border edge than this (steps) split the edge instead: a vertex next to the edge
/// would leave a sliver along all of it, which needs another vertex, and so on.
const RIM_STEPS: f64 = 0.5;

impl Tin {
    /// Triangulates the rings, given as vertices on the grid with their heights and directed edges that
    /// have the region on their left.
    pub fn new(
        knots: Vec<[f64; 3]>,
        edges: &[[u32; 2]],
        (unit, step, bound): (f64, f64, f64),
    ) -> Result<Tin> {
        let vertices = knots.iter().map(|p| Knot { x: p[0], y: p[1] }).collect::<Vec<_>>();
        let pairs = edges.iter().map(|e| [e[0] as usize, e[1] as usize]).collect();
        let mut crossing = None;
        let cdt = Cdt::try_bulk_load_cdt(vertices, pairs, |edge| crossing = Some(edge))
            .map_err(|e| Error::invalid("outline", e))?;
        if let Some([a, _]) = crossing {
            let [x, y, _] = knots[a];
            return Err(Error::invalid("outline", format!("it crosses itself near {x},{y}")));
        }
        if cdt.num_vertices() != knots.len() {
            return Err(Error::invalid("outline", "vertices coincide"));
        }
        let (near, rim) = ((step * 1e-3).max(unit * 4.0), step * RIM_STEPS);
        let mut tin = Tin {
            cdt,
            z: Vec::with_capacity(knots.len()),
            site_of: Vec::with_capacity(knots.len()),
            facets: Vec::new(),
            sites: Vec::new(),
            splits: Vec::new(),
            rounding: 0.0,
            unit,
            near,
            rim,
            bound,
            winding: HashMap::new(),
            heap: BinaryHeap::new(),
            parked: Vec::new(),
            star: Vec::new(),
            spokes: Vec::new(),
            pool: Vec::new(),
            spare: Vec::new(),
        };
        knots.iter().for_each(|p| tin.push_height(p[2], NONE));
        for &[a, b] in edges {
            tin.add_winding(a, b, 1);
        }
        tin.rebuild();
        Ok(tin)
    }

    /// Counts `amount` for the straight line from `a` to `b`, which may run through other vertices.
    fn add_winding(&mut self, a: u32, b: u32, amount: i32) {
        let direct = self.cdt.get_edge_from_neighbors(handle(a), handle(b)).map(|e| e.fix());
        let mut edges = vec![];
        match direct {
            Some(edge) => edges.push(edge),
            None => edges.extend(self.cdt.try_add_constraint(handle(a), handle(b))),
        }
        for edge in edges {
            let edge = self.cdt.directed_edge(edge);
            let (from, to) = (edge.from().index() as u32, edge.to().index() as u32);
            let signed = if from < to { amount } else { -amount };
            *self.winding.entry((from.min(to), from.max(to))).or_default() += signed;
        }
    }

    /// Splits border edges at the given points and heights, then finds out again what is inside. Returns
    /// how many edges were split.
    pub fn split_borders(&mut self, splits: &[(BorderSplit, f64)]) -> usize {
        let mut done = 0;
        for &(BorderSplit { edge, at }, z) in splits {
            let (a, b) = (handle(edge.0), handle(edge.1));
            let Some(border) = self.cdt.get_edge_from_neighbors(a, b) else { continue };
            let (pa, pb) = (border.from().position(), border.to().position());
            let p = Point2::new(at[0], at[1]);
            let apart = |q: Point2<f64>| (q.x - p.x).hypot(q.y - p.y);
            let occupied = matches!(self.cdt.locate_with_hint(p, a), PositionInTriangulation::OnVertex(_));
            if !border.is_constraint_edge()
                || occupied
                || apart(pa) < self.near
                || apart(pb) < self.near
                || self.cdt.intersects_constraint(pa, p)
                || self.cdt.intersects_constraint(p, pb)
            {
                continue;
            }
            let border = border.as_undirected().fix();
            let Some(amount) = self.winding.remove(&edge) else { continue };
            self.cdt.remove_constraint_edge(border);
            let Ok(v) = self.cdt.insert_with_hint(Knot { x: at[0], y: at[1] }, a) else { continue };
            self.push_height(z, NONE);
            let v = v.index() as u32;
            for (from, to) in [(edge.0, v), (v, edge.1)] {
                self.cdt.try_add_constraint(handle(from), handle(to));
                self.add_winding(from, to, amount);
            }
            done += 1;
        }
        self.rebuild();
        done
    }

    /// Takes vertices inside the region out; the sites that they were inserted for are watched again. The
    /// last vertices get the free indices.
    pub fn remove(&mut self, mut victims: Vec<u32>) {
        victims.sort_unstable_by(|a, b| b.cmp(a));
        let mut old_of_new: Vec<u32> = (0..self.z.len() as u32).collect();
        let mut new_of_old = vec![NONE; self.z.len()];
        for &v in &victims {
            self.cdt.remove(handle(v));
            self.z.swap_remove(v as usize);
            old_of_new.swap_remove(v as usize);
            let site = self.site_of.swap_remove(v as usize);
            self.parked.extend((site != NONE).then_some(site));
        }
        old_of_new.iter().enumerate().for_each(|(new, &old)| new_of_old[old as usize] = new as u32);
        let renamed = |v: u32| new_of_old.get(v as usize).copied().unwrap_or(NONE);
        let mut gone = Vec::new();
        for facet in &mut self.facets {
            let corners = facet.corners.map(renamed);
            if corners.contains(&NONE) {
                gone.append(&mut facet.sites);
                *facet = Facet::default();
            } else {
                facet.corners = corners;
            }
        }
        self.parked.extend(gone);
        let winding = std::mem::take(&mut self.winding).into_iter().map(|((a, b), amount)| {
            let (a, b) = (renamed(a), renamed(b));
            if a < b { ((a, b), amount) } else { ((b, a), -amount) }
        });
        self.winding = winding.collect();
        self.rebuild();
    }

    /// Compares all facets with the faces, finds out which are inside the region by counting border edges
    /// from the outside, and places the sites of changed facets and the parked ones again.
    fn rebuild(&mut self) {
        let faces = self.cdt.num_all_faces();
        let mut depth: Vec<Option<i32>> = vec![None; faces];
        depth[0] = Some(0);
        let mut queue: Vec<FixedFaceHandle<InnerTag>> = Vec::new();
        for edge in self.cdt.convex_hull() {
            let (outer, edge) = if edge.is_outer_edge() { (edge, edge.rev()) } else { (edge.rev(), edge) };
            debug_assert!(outer.is_outer_edge());
            if let Some(face) = edge.face().as_inner()
                && depth[face.index()].is_none()
            {
                depth[face.index()] = Some(self.crossing(edge));
                queue.push(face.fix());
            }
        }
        while let Some(face) = queue.pop() {
            let here = depth[face.index()].unwrap_or(0);
            for edge in self.cdt.face(face).adjacent_edges() {
                if let Some(other) = edge.rev().face().as_inner()
                    && depth[other.index()].is_none()
                {
                    depth[other.index()] = Some(here - self.crossing(edge));
                    queue.push(other.fix());
                }
            }
        }
        // A facet whose face has changed may have moved to another index, or be gone.
        let mut pool = std::mem::take(&mut self.parked);
        let mut moved: HashMap<[u32; 3], Facet> = HashMap::new();
        let mut changed = Vec::new();
        let mut old: Vec<Facet> = self.facets.drain(faces.min(self.facets.len())..).collect();
        self.facets.resize_with(faces, Facet::default);
        for face in self.cdt.inner_faces() {
            let corners = face.vertices().map(|v| v.index() as u32);
            let inside = depth[face.index()].unwrap_or(0) > 0;
            let facet = &mut self.facets[face.index()];
            if sorted(facet.corners) != sorted(corners) || facet.inside != inside {
                old.push(std::mem::take(facet));
                changed.push((face.index(), corners, inside));
            }
        }
        moved.extend(old.into_iter().map(|facet| (sorted(facet.corners), facet)));
        for (face, corners, inside) in changed {
            self.facets[face] = match moved.remove(&sorted(corners)) {
                Some(facet) if facet.inside == inside => facet,
                Some(mut facet) => {
                    pool.append(&mut facet.sites);
                    Facet { corners, inside, worst: NONE, ..Facet::default() }
                }
                None => Facet { corners, inside, worst: NONE, ..Facet::default() },
            };
        }
        moved.into_values().for_each(|mut facet| pool.append(&mut facet.sites));
        self.place(pool);
    }

    /// By how much the depth grows when one steps over the edge to its left.
    fn crossing(&self, edge: DirectedEdgeHandle<Knot, (), CdtEdge<()>, ()>) -> i32 {
        if !edge.is_constraint_edge() {
            return 0;
        }
        let (from, to) = (edge.from().index() as u32, edge.to().index() as u32);
        let amount = self.winding.get(&(from.min(to), from.max(to))).copied().unwrap_or(0);
        if from < to { amount } else { -amount }
    }
}

fn sorted(mut corners: [u32; 3]) -> [u32; 3] {
    corners.sort_unstable();
    corners
}
