//! Measuring the error between the posts.
//!
//! Each facet that changed is measured at the points of a lattice 4 times finer than the posts, every
//! quarter of a step (and in the middle) of its edges, and at its centroid. The edges matter: where a
//! bilinear cell is cut by an edge, the error is largest on the cut. Where a point comes near to the bound
//! its neighbourhood is searched down to an eighth of the lattice, as the field may have a crest there.

use rayon::prelude::*;

use super::border::sample_along;
use super::lattice::{Lattice, contains};
use super::tin::{Site, Tin};
use super::{Field, FieldSample};
use crate::base::{Error, Result};

/// Points asked of the field at a time.
const JOB_POINTS: f64 = 16_384.0;
/// Jobs between two looks at the caller's wish to stop.
const WAVE_JOBS: usize = 64;
/// At most so many points of a facet and job become sites, the worst first.
const SITES_MAX: usize = 256;

/// Points with an error above this part of the bound are searched around.
const HOT_SHARE: f64 = 0.75;
/// Distances of the search, in parts of the lattice.
const SEARCH: [f64; 3] = [0.5, 0.25, 0.125];
/// At most so many searches in a facet and job.
const SEARCHES_MAX: usize = 64;

/// Part of a facet: the rows of the lattice from `rows.0` to before `rows.1`.
struct Item {
    facet: u32,
    rows: (i64, i64),
    edges: bool,
}

struct Found {
    facet: u32,
    error: f64,
    points: u64,
    sites: Vec<(f64, [f64; 2], f64)>,
}

/// Measures every facet that was not, and adds the points above the bound as sites. Returns how many.
pub(super) fn measure(
    tin: &mut Tin,
    field: &dyn Field,
    lattice: &Lattice,
    progress: &dyn Fn(f64) -> bool,
) -> Result<usize> {
    let jobs = jobs(tin, lattice);
    let mut added = 0;
    let count = jobs.len().max(1) as f64;
    for facet in tin.facets.iter_mut().filter(|f| f.inside && !f.measured) {
        (facet.fine_error, facet.fine_points) = (0.0, 0);
    }
    let mut sites: Vec<(u32, Site)> = Vec::new();
    for (wave, jobs) in jobs.chunks(WAVE_JOBS).enumerate() {
        if !progress((wave * WAVE_JOBS) as f64 / count) {
            return Err(Error::Stopped);
        }
        let shared: &Tin = tin;
        let found: Vec<Vec<Found>> =
            jobs.par_iter().map(|job| measure_job(shared, field, lattice, job)).collect();
        for found in found.into_iter().flatten() {
            let facet = &mut tin.facets[found.facet as usize];
            facet.fine_error = facet.fine_error.max(found.error);
            facet.fine_points += found.points;
            let site = |(_, [x, y], z): (f64, [f64; 2], f64)| {
                (found.facet, Site { x, y, z, z_snapped: z, weight: 1.0 / field.share([x, y]) })
            };
            sites.extend(found.sites.into_iter().map(site));
        }
    }
    tin.facets.iter_mut().filter(|f| f.inside).for_each(|f| f.measured = true);
    snap_heights(tin, field, sites.iter_mut().map(|(_, s)| s).collect());
    added += sites.len();
    tin.add_sites(&sites);
    Ok(added)
}

/// Asks the field at the grid point next to each site, where a vertex would come.
pub(super) fn snap_heights(tin: &Tin, field: &dyn Field, mut sites: Vec<&mut Site>) {
    sites.retain(|s| tin.snap(s.x) != s.x || tin.snap(s.y) != s.y);
    let points: Vec<[f64; 2]> = sites.iter().map(|s| [tin.snap(s.x), tin.snap(s.y)]).collect();
    let mut heights: Vec<Option<FieldSample>> = Vec::new();
    if !points.is_empty() {
        field.heights(&points, &mut heights);
    }
    for (site, height) in sites.into_iter().zip(heights) {
        site.z_snapped = height.map_or(site.z, |h| h.z);
    }
}

fn jobs(tin: &Tin, lattice: &Lattice) -> Vec<Vec<Item>> {
    let h = lattice.step / 4.0;
    let (mut jobs, mut job, mut load) = (Vec::new(), Vec::new(), 0.0);
    for (f, facet) in tin.facets.iter().enumerate() {
        if !facet.inside || facet.measured {
            continue;
        }
        let at = facet.corners.map(|v| tin.position(v));
        let (first, end) = lattice.rows(&at);
        let doubled =
            (at[1][0] - at[0][0]) * (at[2][1] - at[0][1]) - (at[2][0] - at[0][0]) * (at[1][1] - at[0][1]);
        let points = doubled / 2.0 / (h * h);
        let pieces = (points / JOB_POINTS).ceil().max(1.0) as i64;
        let rows = ((end - first).max(0) + pieces - 1) / pieces;
        for piece in 0..pieces {
            let from = first + piece * rows;
            job.push(Item { facet: f as u32, rows: (from, (from + rows).min(end)), edges: piece == 0 });
            load += points / pieces as f64 + 16.0;
            if load >= JOB_POINTS {
                jobs.push(std::mem::take(&mut job));
                load = 0.0;
            }
        }
    }
    jobs.push(job);
    jobs
}

fn measure_job(tin: &Tin, field: &dyn Field, lattice: &Lattice, job: &[Item]) -> Vec<Found> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    let mut spans = Vec::with_capacity(job.len());
    let (mut rim, mut inward) = (Vec::new(), Vec::new());
    for item in job {
        let start = (points.len(), rim.len());
        let at = tin.facets[item.facet as usize].corners.map(|v| tin.position(v));
        lattice.points(&at, item.rows, &mut points);
        if item.edges {
            edge_points(tin, lattice, item.facet, &mut points, &mut rim, &mut inward);
        }
        spans.push((start.0..points.len(), start.1..rim.len()));
    }
    let mut heights = Vec::with_capacity(points.len());
    field.heights(&points, &mut heights);
    let rim_heights = if rim.is_empty() {
        Vec::new()
    } else {
        sample_along(field, &rim, &inward, lattice.unit, lattice.step)
    };
    let mut out = Vec::new();
    let mut hot: Vec<Hot> = Vec::new();
    for (index, (item, (inner, outer))) in job.iter().zip(spans).enumerate() {
        let plane = tin.plane(tin.facets[item.facet as usize].corners);
        let mut found = Found { facet: item.facet, error: 0.0, points: 0, sites: Vec::new() };
        let first = hot.len();
        let inner = points[inner.clone()].iter().zip(heights[inner].iter().map(|h| h.map(|h| h.z)));
        let outer = rim[outer.clone()].iter().zip(rim_heights[outer].iter().copied());
        let mut probes: Vec<Probe> = inner
            .chain(outer)
            .filter_map(|(p, z)| z.map(|z| Probe { at: *p, z, mesh: plane.at(p[0], p[1]), error: 0.0 }))
            .collect();
        distances(field, lattice, &mut probes);
        for p in probes {
            found.take(&p, lattice.bound);
            if p.error > lattice.bound * HOT_SHARE {
                hot.push(Hot { item: index, error: p.error, at: p.at });
            }
        }
        thin_out(&mut hot, first, lattice.step / 2.0);
        out.push(found);
    }
    for share in SEARCH {
        search(tin, field, lattice, (&mut hot, &mut out), share * lattice.step / 4.0);
    }
    for found in &mut out {
        if found.sites.len() > SITES_MAX {
            found.sites.sort_by(|a, b| b.0.total_cmp(&a.0));
            found.sites.truncate(SITES_MAX);
        }
    }
    out
}

/// A point whose error is near to the bound or above it.
struct Hot {
    item: usize,
    error: f64,
    at: [f64; 2],
}

impl Found {
    fn take(&mut self, p: &Probe, bound: f64) {
        self.points += 1;
        self.error = self.error.max(p.error);
        if p.error > bound {
            self.sites.push((p.error, p.at, p.z));
        }
    }
}

/// A point at which mesh and field are compared.
struct Probe {
    at: [f64; 2],
    /// Height of the field, and of the mesh.
    z: f64,
    mesh: f64,
    /// Vertical distance over the field's share of the bound.
    error: f64,
}

/// Vertical distances of mesh and field. Where that is above the bound [at a wall](Field::at_wall), the mesh is
/// right if the field takes its height within [`MeshOptions::wall_m`](super::MeshOptions) of the point, and the
/// distance is to the span of heights there.
fn distances(field: &dyn Field, lattice: &Lattice, probes: &mut [Probe]) {
    const WAYS: [[f64; 2]; 8] = [
        [1.0, 0.0],
        [-1.0, 0.0],
        [0.0, 1.0],
        [0.0, -1.0],
        [0.7, 0.7],
        [-0.7, 0.7],
        [0.7, -0.7],
        [-0.7, -0.7],
    ];
    for p in probes.iter_mut() {
        p.error = (p.mesh - p.z).abs() / field.share(p.at);
    }
    if lattice.wall <= 0.0 {
        return;
    }
    let far = |p: &Probe| p.error > lattice.bound && field.at_wall(p.at);
    let far: Vec<usize> = (0..probes.len()).filter(|k| far(&probes[*k])).collect();
    let around = far.iter().flat_map(|k| {
        let at = probes[*k].at;
        WAYS.map(|w| [at[0] + w[0] * lattice.wall, at[1] + w[1] * lattice.wall])
    });
    let around: Vec<[f64; 2]> = around.collect();
    let mut heights = Vec::with_capacity(around.len());
    if !around.is_empty() {
        field.heights(&around, &mut heights);
    }
    for (k, beside) in far.into_iter().zip(heights.chunks(WAYS.len())) {
        let p = &mut probes[k];
        let (lo, hi) = beside.iter().flatten().fold((p.z, p.z), |(lo, hi), h| (lo.min(h.z), hi.max(h.z)));
        p.error = (lo - p.mesh).max(p.mesh - hi).max(0.0) / field.share(p.at);
    }
}

/// Of the hot points from `first` on keeps the hottest, none nearer than `apart` to a hotter one.
fn thin_out(hot: &mut Vec<Hot>, first: usize, apart: f64) {
    hot[first..].sort_by(|a, b| b.error.total_cmp(&a.error));
    let mut kept = first;
    for i in first..hot.len() {
        let [x, y] = hot[i].at;
        let near = |h: &Hot| (h.at[0] - x).abs() < apart && (h.at[1] - y).abs() < apart;
        if kept - first < SEARCHES_MAX && !hot[first..kept].iter().any(near) {
            hot.swap(kept, i);
            kept += 1;
        }
    }
    hot.truncate(kept);
}

/// Looks around each hot point, at `reach` along the axes and the edges of its facet, and moves it to the
/// worst point found.
fn search(
    tin: &Tin,
    field: &dyn Field,
    lattice: &Lattice,
    (hot, found): (&mut [Hot], &mut [Found]),
    reach: f64,
) {
    let (mut points, mut spans) = (Vec::new(), Vec::with_capacity(hot.len()));
    for h in hot.iter() {
        let at = tin.facets[found[h.item].facet as usize].corners.map(|v| tin.position(v));
        let edge = |k: usize| {
            let (dx, dy) = (at[(k + 1) % 3][0] - at[k][0], at[(k + 1) % 3][1] - at[k][1]);
            let length = dx.hypot(dy);
            [dx / length, dy / length]
        };
        let start = points.len();
        for way in [[1.0, 0.0], [0.0, 1.0], edge(0), edge(1), edge(2)] {
            for reach in [reach, -reach] {
                let p = [h.at[0] + reach * way[0], h.at[1] + reach * way[1]];
                if contains(&at, p, lattice.unit) {
                    points.push(p);
                }
            }
        }
        spans.push(start..points.len());
    }
    let mut heights = Vec::with_capacity(points.len());
    field.heights(&points, &mut heights);
    for (h, span) in hot.iter_mut().zip(spans) {
        let found = &mut found[h.item];
        let plane = tin.plane(tin.facets[found.facet as usize].corners);
        let mut probes: Vec<Probe> = points[span.clone()]
            .iter()
            .zip(&heights[span])
            .filter_map(|(p, z)| {
                z.map(|FieldSample { z, .. }| Probe { at: *p, z, mesh: plane.at(p[0], p[1]), error: 0.0 })
            })
            .collect();
        distances(field, lattice, &mut probes);
        for p in probes {
            found.take(&p, lattice.bound);
            if p.error > h.error {
                (h.error, h.at) = (p.error, p.at);
            }
        }
    }
}

/// The centroid, and the points along the edges: those of the border apart, with the direction inwards.
/// An edge between two facets that are both measured now is left to the one with the smaller index.
fn edge_points(
    tin: &Tin,
    lattice: &Lattice,
    facet: u32,
    out: &mut Vec<[f64; 2]>,
    rim: &mut Vec<[f64; 2]>,
    inward: &mut Vec<[f64; 2]>,
) {
    let corners = tin.facets[facet as usize].corners;
    let at = corners.map(|v| tin.position(v));
    let middle = |k: usize| (at[0][k] + at[1][k] + at[2][k]) / 3.0;
    out.push([middle(0), middle(1)]);
    for k in 0..3 {
        let (border, other) = tin.across(corners[k], corners[(k + 1) % 3]);
        if !border && other < facet as usize && !tin.facets[other].measured {
            continue;
        }
        let (a, b) = (at[k], at[(k + 1) % 3]);
        if border {
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            lattice.along(a, b, rim);
            inward.resize(rim.len(), [-dy / dx.hypot(dy), dx / dx.hypot(dy)]);
        } else {
            lattice.along(a, b, out);
        }
    }
}
