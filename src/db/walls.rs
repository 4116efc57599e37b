//! The cells in which surveys give way to each other: where the surface may be a wall.

use super::Snapshot;
use super::query::Ground;
use super::triangles::region_bounds;
use super::view::{Rules, Tables};
use crate::base::Result;
use crate::base::lattice::Point;
use crate::height::frame::Frame;
use crate::height::lod::cover::rects;
use crate::height::lod::{Cells, World};
use std::collections::BTreeSet;

/// Distances from core' in cells, at which a wall is looked at: dense where the weight of a survey ends.
const STATIONS: [f64; 6] = [0.5, 0.85, 0.95, 0.98, 0.99, 1.0];

/// Cells around a survey's core', by its own frame: only there its weight is neither 0 nor 1 (section 9).
pub(super) struct Ring {
    frame: Frame,
    /// CRS units of one lattice unit.
    size: f64,
    cells: BTreeSet<(i64, i64)>,
}

impl Ring {
    /// Whether a place, in CRS units, is in one of the cells.
    pub(super) fn holds(&self, p: [f64; 2]) -> bool {
        let [x, y] = p.map(|v| (v / self.size).round() as i64);
        let (i, j) = self.frame.index(Point::new(x, y));
        self.cells.contains(&(i.floor() as i64, j.floor() as i64))
    }

    fn place(&self, cell: (i64, i64), part: [f64; 2]) -> [f64; 2] {
        place_in_cell(&self.frame, self.size, cell, part)
    }

    /// Corners, middles of sides and middles of the cells: the nodes of corrections there (section 15).
    pub(super) fn nodes(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        const HALVES: [f64; 3] = [0.0, 0.5, 1.0];
        let nodes = HALVES.into_iter().flat_map(|y| HALVES.map(|x| [x, y]));
        self.cells.iter().flat_map(move |c| nodes.clone().map(|t| self.place(*c, t)))
    }
}

/// The place of a point of a cell, by its part of the cell's sides; `size` CRS units are a lattice unit.
pub(super) fn place_in_cell(frame: &Frame, size: f64, (i, j): (i64, i64), [x, y]: [f64; 2]) -> [f64; 2] {
    let (p, u, v) = (frame.post(i, j), frame.u, frame.v);
    [
        (p.x as f64 + x * u.x as f64 + y * v.x as f64) * size,
        (p.y as f64 + x * u.y as f64 + y * v.y as f64) * size,
    ]
}

/// The rings of the surveys in a box, one a survey; none where fewer than two surveys are. Cells that only lie near the box
/// may be among them.
pub(super) fn rings(s: &Snapshot, b: [f64; 4]) -> Result<Vec<Ring>> {
    let rules = Rules(&s.view);
    let bounds = region_bounds(b, s.unit().size());
    let surveys = rules.meeting(&bounds);
    let mut out = Vec::new();
    if surveys.len() < 2 {
        return Ok(out);
    }
    for n in surveys {
        let g = s.view.geometry_of(n);
        // Cells beyond the box too: their ring may reach into it, and the window's edge is no border of theirs.
        let near = g.frame.cells_meeting(&bounds.quad()).grow(1);
        let cores = rects(&rules, n, Cells::CorePrime, &near.grow(1))?;
        let mut edge = std::collections::HashSet::new();
        for r in &cores {
            for j in r.j0..r.j1 {
                let end = j == r.j0 || j == r.j1 - 1;
                for i in if end { (r.i0..r.i1).collect::<Vec<_>>() } else { vec![r.i0, r.i1 - 1] } {
                    edge.insert((i, j));
                }
            }
        }
        let core = |i: i64, j: i64| cores.iter().any(|r| r.i0 <= i && i < r.i1 && r.j0 <= j && j < r.j1);
        let within = |i: i64, j: i64| near.i0 <= i && i < near.i1 && near.j0 <= j && j < near.j1;
        let mut cells = BTreeSet::new();
        for &(i, j) in &edge {
            for (a, c) in [(-1, 0), (1, 0), (0, -1), (0, 1), (-1, -1), (1, -1), (-1, 1), (1, 1)] {
                let (i, j) = (i + a, j + c);
                if within(i, j) && !edge.contains(&(i, j)) && !cells.contains(&(i, j)) && !core(i, j) {
                    cells.insert((i, j));
                }
            }
        }
        out.push(Ring { frame: g.frame, size: s.unit().size(), cells });
    }
    Ok(out)
}

/// The cells of rings that are not flat, and points in them, in CRS units: candidates for vertices that no lattice of posts
/// would hit. A cell is flat where the surface is within `flat_m` of a plane over its corners: where surveys agree, or were
/// bent to agree. A cell that is partly out of the box is never flat.
pub(super) fn steep(
    rings: &[Ring],
    ground: &Ground,
    b: [f64; 4],
    flat_m: &dyn Fn([f64; 2]) -> f64,
) -> Result<(Vec<Ring>, Vec<[f64; 2]>)> {
    // Both ends of each station: the cell may be left towards any side.
    let stations: Vec<f64> = STATIONS.iter().flat_map(|t| [*t, 1.0 - *t]).collect();
    let corners = [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1.0, 1.0]];
    let spots: Vec<[f64; 2]> = corners
        .into_iter()
        .chain(stations.iter().flat_map(|y| stations.iter().map(move |x| [*x, *y])))
        .collect();
    // Outside of the region no patches were selected: no height is asked there.
    let held = |p: &[f64; 2]| p[0] > b[0] && p[0] < b[2] && p[1] > b[1] && p[1] < b[3];
    let (mut out, mut points) = (Vec::new(), Vec::new());
    for ring in rings {
        let cells: Vec<(i64, i64)> = ring.cells.iter().copied().collect();
        let mut kept = BTreeSet::new();
        for some in cells.chunks(1024) {
            let at: Vec<[f64; 2]> =
                some.iter().flat_map(|c| spots.iter().map(|t| ring.place(*c, *t))).collect();
            let asked: Vec<[f64; 2]> = at.iter().filter(|p| held(p)).copied().collect();
            let mut found = ground.heights(&asked)?.into_iter();
            let z: Vec<Option<f64>> =
                at.iter().map(|p| if held(p) { found.next().flatten().map(|e| e.z) } else { None }).collect();
            for (c, (at, z)) in some.iter().zip(at.chunks_exact(spots.len()).zip(z.chunks_exact(spots.len())))
            {
                let flat_m = at[..4].iter().map(|p| flat_m(*p)).fold(f64::INFINITY, f64::min);
                let flat = if let [Some(z00), Some(z10), Some(z01), Some(z11)] = z[..4] {
                    spots.iter().zip(z).all(|([x, y], z)| {
                        let (left, right) = (z00 + (z01 - z00) * y, z10 + (z11 - z10) * y);
                        z.is_some_and(|z| (z - (left + (right - left) * x)).abs() <= flat_m)
                    })
                } else {
                    false
                };
                if !flat {
                    kept.insert(*c);
                    points.extend(at[4..].iter().filter(|p| held(p)));
                }
            }
        }
        if !kept.is_empty() {
            out.push(Ring { frame: ring.frame, size: ring.size, cells: kept });
        }
    }
    Ok((out, points))
}
