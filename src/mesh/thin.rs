//! Vertices that greedy insertion needed on its way and the mesh no longer needs.
//!
//! For every vertex inside the region the hole that it would leave is triangulated (Delaunay, by cutting
//! ears with empty circles: O. Devillers, On Deletion in Delaunay Triangulations, 1999), and the error
//! measured there, at the posts first, as most vertices fail at those. Of the vertices that could go, those
//! that leave the least error go, no two of one triangle at a time; then it is tried again.

use rayon::prelude::*;
use spade::Triangulation;

use super::lattice::{Lattice, contains};
use super::tin::{NONE, Plane, Tin, handle};
use super::{Field, FieldSample};
use crate::base::{Error, Result};

/// Vertices looked at between two looks at the caller's wish to stop.
const WAVE_VERTICES: usize = 1 << 16;
/// A vertex with more neighbours stays.
const NEIGHBOURS_MAX: usize = 24;
/// Between the posts the error must be this far below the bound, as crests may hide between the points.
const FINE_SHARE: f64 = 0.97;

/// Takes out the vertices that the bound does not need; returns how many. The holes are not measured yet.
pub(super) fn thin(
    tin: &mut Tin,
    field: &dyn Field,
    lattice: &Lattice,
    progress: &dyn Fn(f64) -> bool,
) -> Result<usize> {
    let count = tin.vertex_count();
    let mut spare: Vec<(f64, u32)> = Vec::new();
    for first in (0..count).step_by(WAVE_VERTICES) {
        if !progress(first as f64 / count as f64) {
            return Err(Error::Stopped);
        }
        let shared: &Tin = tin;
        let last = (first + WAVE_VERTICES).min(count);
        let look = |v: usize| error_without(shared, field, lattice, v as u32).map(|error| (error, v as u32));
        let found: Vec<Option<(f64, u32)>> = (first..last).into_par_iter().map(look).collect();
        spare.extend(found.into_iter().flatten());
    }
    spare.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut touched = vec![false; tin.facets.len()];
    let mut victims = Vec::new();
    for (_, v) in spare {
        let star = || tin.cdt.vertex(handle(v)).out_edges().map(|e| e.face().index());
        if !star().any(|f| touched[f]) {
            star().for_each(|f| touched[f] = true);
            victims.push(v);
        }
    }
    let removed = victims.len();
    if removed > 0 {
        tin.remove(victims);
    }
    Ok(removed)
}

/// The error where the vertex was if it were not, or `None` if that is above the bound or it must stay.
fn error_without(tin: &Tin, field: &dyn Field, lattice: &Lattice, v: u32) -> Option<f64> {
    let mut ring: Vec<[f64; 3]> = Vec::with_capacity(8);
    let mut star: Vec<usize> = Vec::with_capacity(8);
    for edge in tin.cdt.vertex(handle(v)).out_edges() {
        let face = edge.face().index();
        if edge.is_constraint_edge() || face == 0 || !tin.facets[face].inside {
            return None;
        }
        ring.push(tin.position(edge.to().index() as u32));
        star.push(face);
    }
    if ring.len() > NEIGHBOURS_MAX {
        return None;
    }
    if cross(ring[0], ring[1], tin.position(v)) < 0.0 {
        ring.reverse();
    }
    let (triangles, diagonals) = fill(&ring)?;
    let planes: Vec<Plane> = triangles.iter().map(|t| Plane::through(t[0], t[1], t[2])).collect();
    let bound = lattice.bound;
    let mut worst = 0.0f64;
    let mut within = |x: f64, y: f64, z: f64, weight: f64| {
        let i = triangles.iter().position(|t| contains(t, [x, y], 0.0)).unwrap_or(0);
        let error = (planes[i].at(x, y) - z).abs() * weight;
        worst = worst.max(error);
        error <= bound
    };
    let [x, y, z] = tin.position(v);
    if !within(x, y, z, 1.0 / field.share([x, y])) {
        return None;
    }
    let own = Some(tin.site_of[v as usize]).filter(|&s| s != NONE);
    for s in own.into_iter().chain(star.iter().flat_map(|&f| tin.facets[f].sites.iter().copied())) {
        let site = &tin.sites[s as usize];
        if !within(site.x, site.y, site.z, site.weight) {
            return None;
        }
    }

    let (mut points, mut owners) = (Vec::new(), Vec::new());
    for (i, t) in triangles.iter().enumerate() {
        points.push([(t[0][0] + t[1][0] + t[2][0]) / 3.0, (t[0][1] + t[1][1] + t[2][1]) / 3.0]);
        lattice.points(t, lattice.rows(t), &mut points);
        owners.resize(points.len(), i);
    }
    for (a, b, owner) in diagonals {
        lattice.along(a, b, &mut points);
        owners.resize(points.len(), owner);
    }
    let mut heights = Vec::with_capacity(points.len());
    field.heights(&points, &mut heights);
    for ((p, z), i) in points.iter().zip(heights).zip(owners) {
        let Some(FieldSample { z, .. }) = z else { continue };
        let error = (planes[i].at(p[0], p[1]) - z).abs() / field.share(*p);
        worst = worst.max(error);
        if error > bound * FINE_SHARE {
            return None;
        }
    }
    Some(worst)
}

type Triangle = [[f64; 3]; 3];
/// An edge and a triangle on one side of it.
type Diagonal = ([f64; 3], [f64; 3], usize);

/// The Delaunay triangles of a ring that is counter-clockwise and seen whole from a point inside.
fn fill(ring: &[[f64; 3]]) -> Option<(Vec<Triangle>, Vec<Diagonal>)> {
    let mut rest = ring.to_vec();
    let mut triangles = Vec::with_capacity(ring.len() - 2);
    let mut diagonals = Vec::with_capacity(ring.len() - 3);
    while rest.len() > 3 {
        let n = rest.len();
        let ear = (0..n).find(|&i| {
            let (a, b, c) = (rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]);
            let others = (2..n - 1).map(|k| rest[(i + k) % n]);
            cross(a, b, c) > 0.0 && others.into_iter().all(|d| in_circle(a, b, c, d) <= 0.0)
        })?;
        let (a, b, c) = (rest[(ear + n - 1) % n], rest[ear], rest[(ear + 1) % n]);
        diagonals.push((a, c, triangles.len()));
        triangles.push([a, b, c]);
        rest.remove(ear);
    }
    let last = [rest[0], rest[1], rest[2]];
    (cross(last[0], last[1], last[2]) > 0.0).then(|| {
        triangles.push(last);
        (triangles, diagonals)
    })
}

fn cross(a: [f64; 3], b: [f64; 3], c: [f64; 3]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

/// Above zero if `d` lies in the circle through the counter-clockwise `a`, `b`, `c`; rounded.
fn in_circle(a: [f64; 3], b: [f64; 3], c: [f64; 3], d: [f64; 3]) -> f64 {
    let rel = |p: [f64; 3]| (p[0] - d[0], p[1] - d[1]);
    let ((ax, ay), (bx, by), (cx, cy)) = (rel(a), rel(b), rel(c));
    let (aa, bb, cc) = (ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy);
    ax * (by * cc - bb * cy) - ay * (bx * cc - bb * cx) + aa * (bx * cy - by * cx)
}
