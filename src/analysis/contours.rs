//! Contour lines: marching squares over the corners of a grid.
//!
//! A corner is high if its height is at least that of the line. A line crosses an edge between a high and a low corner
//! where the straight line between the two heights meets it: on the default grid over one survey that is where the
//! bilinear surface crosses it. Between two edges of a cell the line is straight, where the surface's own is a hyperbola.
//!
//! **Saddle.** Two high corners across a diagonal are joined if the bilinear surface is high at its saddle point (the
//! asymptotic decider of Nielson and Hamann, 1991), that is if the product of their heights above the line is at least
//! that of the low ones below it. So lines never cross, and the choice is the surface's own.
//!
//! **Voids.** A cell with a corner without data is not crossed: lines end there, as at the edge of the region.
//!
//! **Order.** Lines ascend by height; of one height the open ones come first, then the closed ones, each by its first
//! cell, row by row from the north. High ground is to the left of a line.

use super::Going;
use super::grid::{Grid, Spot};
use super::terrain::{Terrain, no_data};
use crate::base::{Error, Result, limits};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Which heights get a line: `base` plus every multiple of `interval`, metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Levels {
    pub interval: f64,
    pub base: f64,
}

/// One contour line.
#[derive(Clone, Debug, PartialEq)]
pub struct Contour {
    pub elevation: f64,
    /// Largest error of the surface at the grid points beside the line; `None` if it touches the rim, where none is
    /// promised. It is vertical: on a slope s the line may lie error / s to the side.
    pub error_m: Option<f64>,
    /// A ring: the first point is repeated at the end.
    pub closed: bool,
    pub points: Vec<[f64; 2]>,
}

/// The contour lines of a region.
#[derive(Clone, Debug, PartialEq)]
pub struct Contours {
    pub lines: Vec<Contour>,
    /// Lowest and highest height that was met.
    pub z: [f64; 2],
    /// Largest certified error that was met, metres.
    pub error_m: f64,
}

/// Heights and errors at the corners of a grid.
struct Field<'a> {
    grid: &'a Grid,
    cols: usize,
    rows: usize,
    /// NaN: no data.
    z: Vec<f64>,
    /// Infinite: not promised.
    error: Vec<f32>,
}

/// An edge of the grid: twice the index of its first corner, plus 1 if it runs south instead of east.
type Edge = u32;

/// Draws the contour lines of a region.
///
/// # Errors
/// [`Error::Invalid`] for an interval that is not positive, or a region without data; [`Error::Limit`] above
/// [`limits::CONTOUR_POSTS_MAX`] corners or [`limits::LINE_VERTICES_MAX`] vertices.
pub fn contours(terrain: &Terrain, grid: &Grid, levels: Levels, going: Going) -> Result<Contours> {
    if !(levels.interval.is_finite() && levels.interval > 0.0 && levels.base.is_finite()) {
        return Err(Error::invalid(
            "--interval",
            format!("{} m from {} m; the interval must be positive", levels.interval, levels.base),
        ));
    }
    let [cols, rows] = grid.size(Spot::Corners);
    let count = cols as u64 * rows as u64;
    if count > limits::CONTOUR_POSTS_MAX {
        return Err(Error::limit(
            "grid points of contour lines (give a smaller region or a larger --step)",
            limits::CONTOUR_POSTS_MAX,
            count,
        ));
    }
    let mut field = Field { grid, cols, rows, z: Vec::new(), error: Vec::new() };
    let mut out = Contours { lines: Vec::new(), z: [f64::INFINITY, f64::NEG_INFINITY], error_m: 0.0 };
    grid.ask(terrain, Spot::Corners, going, |_, found| {
        for e in found {
            field.z.push(e.as_ref().map_or(f64::NAN, |e| e.z));
            field.error.push(match e {
                Some(e) if e.certified => {
                    out.error_m = out.error_m.max(e.error_m);
                    e.error_m as f32
                }
                _ => f32::INFINITY,
            });
            if let Some(e) = e {
                out.z = [out.z[0].min(e.z), out.z[1].max(e.z)];
            }
        }
        Ok(())
    })?;
    if out.z[0] > out.z[1] {
        return Err(no_data());
    }
    for (k, segments) in field.march(levels)? {
        field.join(levels.base + k as f64 * levels.interval, &segments, &mut out.lines);
    }
    Ok(out)
}

impl Field<'_> {
    /// Pieces of lines by multiple of the interval: from edge to edge, high ground to the left.
    fn march(&self, levels: Levels) -> Result<BTreeMap<i64, Vec<(Edge, Edge)>>> {
        let mut out: BTreeMap<i64, Vec<(Edge, Edge)>> = BTreeMap::new();
        let mut count = 0u64;
        for row in 0..self.rows - 1 {
            for col in 0..self.cols - 1 {
                let nw = row * self.cols + col;
                // Clockwise from the north-west, and the edge that leads from each corner to the next.
                let z = [nw, nw + 1, nw + 1 + self.cols, nw + self.cols].map(|k| self.z[k]);
                let edges = [2 * nw, 2 * (nw + 1) + 1, 2 * (nw + self.cols), 2 * nw + 1].map(|e| e as Edge);
                if z.iter().any(|z| z.is_nan()) {
                    continue;
                }
                let lo = z.iter().copied().fold(f64::INFINITY, f64::min);
                let hi = z.iter().copied().fold(f64::NEG_INFINITY, f64::max);
                let multiple = |z: f64| ((z - levels.base) / levels.interval).floor();
                let (first, last) = (multiple(lo), multiple(hi) + 1.0);
                if last - first > limits::LINE_VERTICES_MAX as f64 {
                    return Err(too_many(last - first));
                }
                for k in first as i64..=last as i64 {
                    let level = levels.base + k as f64 * levels.interval;
                    if !(lo < level && level <= hi) {
                        continue;
                    }
                    let pieces = out.entry(k).or_default();
                    let before = pieces.len();
                    cross(z.map(|z| z - level), edges, pieces);
                    count += (pieces.len() - before) as u64;
                }
                if count > limits::LINE_VERTICES_MAX {
                    return Err(too_many(count as f64));
                }
            }
        }
        Ok(out)
    }

    /// Joins pieces into lines.
    fn join(&self, level: f64, pieces: &[(Edge, Edge)], out: &mut Vec<Contour>) {
        // An edge is the beginning of one piece at most and the end of one at most: its two cells see it from two sides.
        let from: HashMap<Edge, usize> = pieces.iter().enumerate().map(|(k, p)| (p.0, k)).collect();
        let ends: HashSet<Edge> = pieces.iter().map(|p| p.1).collect();
        let mut used = vec![false; pieces.len()];
        let open = (0..pieces.len()).filter(|k| !ends.contains(&pieces[*k].0));
        for first in open.chain(0..pieces.len()) {
            if used[first] {
                continue;
            }
            let mut edges = vec![pieces[first].0];
            let mut at = Some(first);
            while let Some(k) = at.filter(|k| !used[*k]) {
                used[k] = true;
                edges.push(pieces[k].1);
                at = from.get(&pieces[k].1).copied();
            }
            out.extend(self.line(level, &edges));
        }
    }

    /// The line through edges; `None` if it shrinks to a point (a summit of just this height).
    fn line(&self, level: f64, edges: &[Edge]) -> Option<Contour> {
        let closed = edges.len() > 2 && edges[0] == edges[edges.len() - 1];
        let mut error = 0f32;
        let mut points: Vec<[f64; 2]> = Vec::with_capacity(edges.len());
        for &e in edges {
            let a = (e / 2) as usize;
            let b = if e % 2 == 0 { a + 1 } else { a + self.cols };
            error = error.max(self.error[a]).max(self.error[b]);
            // Always from the first corner, so that both cells of the edge get the same point.
            let t = (level - self.z[a]) / (self.z[b] - self.z[a]);
            let (p, q) = (self.corner(a), self.corner(b));
            let p = [p[0] + (q[0] - p[0]) * t, p[1] + (q[1] - p[1]) * t];
            if points.last() != Some(&p) {
                points.push(p);
            }
        }
        let enough = if closed { points.len() >= 4 } else { points.len() >= 2 };
        let error_m = error.is_finite().then_some(f64::from(error));
        enough.then_some(Contour { elevation: level, error_m, closed, points })
    }

    fn corner(&self, k: usize) -> [f64; 2] {
        self.grid.corner(k % self.cols, k / self.cols)
    }
}

fn too_many(wanted: f64) -> Error {
    Error::limit(
        "vertices of contour lines (give a smaller region, a larger --step or a larger --interval)",
        limits::LINE_VERTICES_MAX,
        wanted as u64,
    )
}

/// The pieces of a line in one cell. `z`: heights above the line, clockwise from the north-west; `edges[k]` leads from
/// corner k to the next one.
fn cross(z: [f64; 4], edges: [Edge; 4], out: &mut Vec<(Edge, Edge)>) {
    let high = z.map(|z| z >= 0.0);
    // Clockwise, the line enters the cell where low ground becomes high, and leaves it where high becomes low: then the
    // high corners between lie to its left.
    let enters: Vec<usize> = (0..4).filter(|&k| !high[k] && high[(k + 1) % 4]).collect();
    match enters[..] {
        [a] => {
            let b = (1..4).map(|n| (a + n) % 4).find(|&k| high[k] && !high[(k + 1) % 4]);
            out.extend(b.map(|b| (edges[a], edges[b])));
        }
        [a, b] => {
            let joined = if high[0] { z[0] * z[2] >= z[1] * z[3] } else { z[1] * z[3] >= z[0] * z[2] };
            // Each entry leaves behind its own high corner, or in front of its own low one.
            let leave = |k: usize| if joined { (k + 3) % 4 } else { (k + 1) % 4 };
            out.push((edges[a], edges[leave(a)]));
            out.push((edges[b], edges[leave(b)]));
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_case_of_a_cell_has_high_ground_on_the_left() {
        // Middles of the edges north, east, south, west; corners clockwise from the north-west.
        let middle: [[f64; 2]; 4] = [[0.0, 0.5], [0.5, 0.0], [0.0, -0.5], [-0.5, 0.0]];
        let corner: [[f64; 2]; 4] = [[-0.5, 0.5], [0.5, 0.5], [0.5, -0.5], [-0.5, -0.5]];
        for case in 0..16 {
            let z: [f64; 4] = std::array::from_fn(|k| if case >> k & 1 == 1 { 1.0 } else { -1.5 });
            let mut pieces = Vec::new();
            cross(z, [0, 1, 2, 3], &mut pieces);
            let saddle = case == 5 || case == 10;
            assert_eq!(pieces.len(), if case == 0 || case == 15 { 0 } else { 1 + usize::from(saddle) });
            for (a, b) in pieces {
                let (a, b) = (middle[a as usize], middle[b as usize]);
                for k in 0..4 {
                    let side = (b[0] - a[0]) * (corner[k][1] - a[1]) - (b[1] - a[1]) * (corner[k][0] - a[0]);
                    if !saddle && side.abs() > 0.0 {
                        assert_eq!(side > 0.0, z[k] > 0.0, "case {case}, corner {k}");
                    }
                }
            }
        }
    }

    #[test]
    fn a_saddle_is_joined_where_the_bilinear_surface_is_high() {
        // 3 x 3 above against 1 x 1 below: high in the middle, so the low corners are cut off.
        let mut joined = Vec::new();
        cross([3.0, -1.0, 3.0, -1.0], [0, 1, 2, 3], &mut joined);
        assert_eq!(joined, [(1, 0), (3, 2)]);
        let mut apart = Vec::new();
        cross([1.0, -3.0, 1.0, -3.0], [0, 1, 2, 3], &mut apart);
        assert_eq!(apart, [(1, 2), (3, 0)]);
    }
}
