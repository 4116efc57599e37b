//! How high it is: at scattered points and on grids, of a region whose surface is at hand, or anywhere.

use super::database::Snapshot;
use super::query::{Ground, Makers, Tolerance};
use crate::base::lattice::WORLD_HALF;
use crate::base::{Error, Result};
use crate::height::lod::cut::{Region, bounds};
use crate::height::surface::{Evaluation, Hessian, How, Planes, Seams};
use rayon::prelude::*;
use std::ops::Range;

/// Fewer points than this are worked one by one.
const FEW: usize = 16;
/// Points of one piece of work.
const PIECE: usize = 4096;
/// Points that are worked before what was found is put where it belongs: 1.4 MB.
const BATCH: usize = 16 * PIECE;
/// Rows of a grid that are one piece of work: those of a tile.
const ROWS: usize = 64;
/// Points that are brought into order at once.
const ORDERED_MAX: usize = 1 << 24;

impl Ground<'_> {
    /// Heights at points of the region, in parallel; `None` where there is no data. The set of patches was selected for
    /// the region: points outside of it must not be asked here.
    pub fn heights(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        if points.len() < FEW {
            return self.sheet().heights(points);
        }
        let mut out = vec![None; points.len()];
        self.in_order(points, |k, planes, at| out[k] = planes.evaluation(at))?;
        Ok(out)
    }

    /// The same without gradients and structures, for callers that need some numbers of many points.
    pub fn planes(&self, points: &[[f64; 2]]) -> Result<Planes> {
        let mut out = Planes::unfilled(points.len(), self.surface.corrected);
        self.in_order(points, |k, planes, at| out.put_one(k, planes, at))?;
        Ok(out)
    }

    /// Works points in order of place, some at a time so that what is found stays in the processor's caches, and hands it
    /// over: which point, and where it stands.
    fn in_order(&self, points: &[[f64; 2]], mut put: impl FnMut(usize, &Planes, usize)) -> Result<()> {
        let mut planes = Planes::default();
        for (n, points) in points.chunks(ORDERED_MAX).enumerate() {
            let ordered = self.surface.order(points);
            for (points, numbers) in ordered.points.chunks(BATCH).zip(ordered.numbers.chunks(BATCH)) {
                planes.resize(points.len(), self.surface.corrected);
                planes
                    .bands(PIECE)
                    .into_par_iter()
                    .zip(points.par_chunks(PIECE))
                    .try_for_each(|(mut band, points)| self.sheet().scattered(points, &mut band))?;
                for (at, k) in numbers.iter().enumerate() {
                    put(n * ORDERED_MAX + *k as usize, &planes, at);
                }
            }
        }
        Ok(())
    }

    /// Heights on a grid along the axes, in parallel: at `(xs[c], ys[r])`, row by row; in whatever steps, fastest where both
    /// ascend or descend. All points must lie in the region.
    pub fn grid(&self, xs: &[f64], ys: &[f64]) -> Result<Planes> {
        let mut planes = Planes::default();
        self.grid_into(xs, ys, &mut planes)?;
        Ok(planes)
    }

    /// As [`Ground::grid`], in memory that was used before.
    pub fn grid_into(&self, xs: &[f64], ys: &[f64], planes: &mut Planes) -> Result<()> {
        planes.resize(xs.len() * ys.len(), self.surface.corrected);
        planes
            .bands((xs.len() * ROWS).max(1))
            .into_par_iter()
            .zip(ys.par_chunks(ROWS))
            .try_for_each(|(mut band, ys)| self.sheet().grid(xs, ys, &mut band))
    }

    /// Heights with gradients, in parallel, for points of the region.
    pub fn slopes(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        let parts: Vec<Vec<Option<Evaluation>>> =
            points.par_chunks(2048).map(|c| self.sheet().slopes(c)).collect::<Result<_>>()?;
        Ok(parts.into_iter().flatten().collect())
    }

    /// Heights with gradients and second derivatives, in parallel, for points of the region. Refused where patches are
    /// bilinear.
    pub fn curvatures(&self, points: &[[f64; 2]]) -> Result<Vec<Option<(Evaluation, Hessian)>>> {
        let parts: Vec<Vec<Option<(Evaluation, Hessian)>>> =
            points.par_chunks(2048).map(|c| self.sheet().curvatures(c)).collect::<Result<_>>()?;
        Ok(parts.into_iter().flatten().collect())
    }

    /// Who makes the heights at points of the region, in parallel: patches and normalised weights, largest first.
    pub fn explained(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Makers>>> {
        let one = |p: &[f64; 2]| {
            let found = self.sheet().explain(*p)?;
            let named = |(k, w): (usize, f64)| (self.selection.records[k], w);
            Ok(found.map(|(_, who)| who.into_iter().map(named).collect()))
        };
        points.par_iter().map(one).collect()
    }
}

/// What is asked of a surface at points.
type Ask<'a, E> = &'a dyn Fn(&Ground, &[[f64; 2]]) -> Result<Vec<Option<E>>>;

/// What is done with the points of a window: their numbers, and their box.
type Leaf<'a> = &'a mut dyn FnMut(&[usize], [f64; 4]) -> Result<()>;

/// Side of a window whose surface is taken in one piece, in steps of the finest survey: the more is asked, the larger, so
/// that patches are not selected again and again; few points far apart do not select all that lies between.
fn window_steps(points: usize) -> f64 {
    (64.0 * (points as f64).sqrt()).clamp(1024.0, 4096.0)
}

/// The same for grids, whose points fill the window.
const GRID_STEPS: f64 = 2048.0;

impl Snapshot {
    /// Heights at scattered points. Works through the points place by place, so memory stays small however far apart
    /// they lie; the answers do not depend on it.
    pub fn heights(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: impl Into<How>,
    ) -> Result<Vec<Option<Evaluation>>> {
        self.scattered(points, tolerance, how.into(), &|g, p| g.heights(p))
    }

    /// As [`Snapshot::heights`], without structures: a third of the memory.
    pub fn planes(&self, points: &[[f64; 2]], tolerance: &Tolerance, how: impl Into<How>) -> Result<Planes> {
        let how = how.into();
        checked(tolerance)?;
        let corrected = how.seams != Seams::Off;
        let b = bounds(points);
        let reach = WORLD_HALF as f64 * self.unit.size();
        let near = points.iter().all(|p| p.iter().all(|v| v.abs() <= reach))
            && (b[2] - b[0]).max(b[3] - b[1]) <= self.finest() * window_steps(points.len());
        if points.is_empty() || !near || self.near(b).is_empty() {
            return Ok(Planes::of(&self.heights(points, tolerance, how)?, corrected));
        }
        self.ground_around(b, tolerance, how)?.planes(points)
    }

    /// As [`Snapshot::heights`], with the gradients of the surface.
    pub fn slopes(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: impl Into<How>,
    ) -> Result<Vec<Option<Evaluation>>> {
        self.scattered(points, tolerance, how.into(), &|g, p| g.slopes(p))
    }

    /// Who makes the height at each point: as [`Snapshot::explain`].
    pub fn explained(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: impl Into<How>,
    ) -> Result<Vec<Option<Makers>>> {
        self.scattered(points, tolerance, how.into(), &|g, p| g.explained(p))
    }

    /// Heights on a grid along the axes: at `(xs[c], ys[r])`, row by row; as [`Snapshot::heights`] finds them, many times
    /// faster where `xs` and `ys` ascend or descend.
    pub fn grid(&self, xs: &[f64], ys: &[f64], tolerance: &Tolerance, how: impl Into<How>) -> Result<Planes> {
        let how = how.into();
        let reach = WORLD_HALF as f64 * self.unit.size();
        if !xs.iter().chain(ys).all(|v| v.abs() <= reach) {
            // Places where no survey can be, or none at all.
            let points: Vec<[f64; 2]> = ys.iter().flat_map(|y| xs.iter().map(|x| [*x, *y])).collect();
            return Ok(Planes::of(&self.heights(&points, tolerance, how)?, how.seams != Seams::Off));
        }
        checked(tolerance)?;
        let mut out = Planes::new(xs.len() * ys.len(), how.seams != Seams::Off);
        if !out.is_empty() && self.view.tree.is_some() {
            self.grid_within(&Asked { xs, ys, tolerance, how }, 0..xs.len(), 0..ys.len(), &mut out)?;
        }
        Ok(out)
    }

    fn grid_within(
        &self,
        asked: &Asked,
        cols: Range<usize>,
        rows: Range<usize>,
        out: &mut Planes,
    ) -> Result<()> {
        let (xs, ys) = (&asked.xs[cols.clone()], &asked.ys[rows.clone()]);
        let ends = |v: &[f64]| {
            v.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[lo, hi], v| [lo.min(*v), hi.max(*v)])
        };
        let ([x0, x1], [y0, y1]) = (ends(xs), ends(ys));
        let b = [x0, y0, x1, y1];
        if self.near(b).is_empty() {
            return Ok(());
        }
        let (w, h) = (x1 - x0, y1 - y0);
        let side_max = self.finest() * GRID_STEPS;
        if w > side_max && w >= h && cols.len() > 1 {
            let middle = (cols.start + cols.end) / 2;
            self.grid_within(asked, cols.start..middle, rows.clone(), out)?;
            return self.grid_within(asked, middle..cols.end, rows, out);
        }
        if h > side_max && rows.len() > 1 {
            let middle = (rows.start + rows.end) / 2;
            self.grid_within(asked, cols.clone(), rows.start..middle, out)?;
            return self.grid_within(asked, cols, middle..rows.end, out);
        }
        let ground = self.ground_around(b, asked.tolerance, asked.how)?;
        let (all, width) = (asked.xs.len() * asked.ys.len(), asked.xs.len());
        if cols.len() * rows.len() == all {
            return ground.grid_into(xs, ys, out);
        }
        out.put(rows.start * width + cols.start, width, &ground.grid(xs, ys)?, cols.len());
        Ok(())
    }

    /// The surface around points of a box: any region around them gives the same heights.
    fn ground_around(&self, b: [f64; 4], tolerance: &Tolerance, how: How) -> Result<Ground<'_>> {
        let most = b[0].abs().max(b[1].abs()).max(b[2].abs()).max(b[3].abs()).max(1.0);
        let pad = most * 1e-9 + (b[2] - b[0]).max(b[3] - b[1]) * 1e-6;
        let region = Region::from_box([b[0] - pad, b[1] - pad, b[2] + pad, b[3] + pad]);
        // The points were named: a camera sets their tolerance, not what it sees.
        let cut = self.cut(tolerance);
        let selection = self.select_in(region, &*cut, how.blend)?;
        Ok(self.ground(selection, cut, how))
    }

    /// The finest step of all surveys, CRS units.
    fn finest(&self) -> f64 {
        let steps = self.entries().map(|e| e.geometry.steps[0].min(e.geometry.steps[1]));
        steps.fold(f64::INFINITY, f64::min)
    }

    fn scattered<E: Clone>(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: How,
        ask: Ask<E>,
    ) -> Result<Vec<Option<E>>> {
        checked(tolerance)?;
        if points.is_empty() || self.view.tree.is_none() {
            return Ok(vec![None; points.len()]);
        }
        // No survey reaches beyond the world of the lattice.
        let reach = WORLD_HALF as f64 * self.unit.size();
        let inside = |p: &[f64; 2]| p.iter().all(|v| v.abs() <= reach);
        let side_max = self.finest() * window_steps(points.len());
        if points.iter().all(inside) {
            let b = bounds(points);
            if (b[2] - b[0]).max(b[3] - b[1]) <= side_max {
                if self.near(b).is_empty() {
                    return Ok(vec![None; points.len()]);
                }
                return ask(&self.ground_around(b, tolerance, how)?, points);
            }
        }
        let mut out = vec![None; points.len()];
        let mut order: Vec<usize> = (0..points.len()).filter(|k| inside(&points[*k])).collect();
        let mut leaf = |order: &[usize], b: [f64; 4]| {
            let here: Vec<[f64; 2]> = order.iter().map(|k| points[*k]).collect();
            let found = ask(&self.ground_around(b, tolerance, how)?, &here)?;
            for (k, e) in order.iter().zip(found) {
                out[*k] = e;
            }
            Ok(())
        };
        self.windows(points, &mut order, side_max, &mut leaf)?;
        Ok(out)
    }

    /// Hands over the points window by window, each with its box, where there are surveys.
    fn windows(&self, points: &[[f64; 2]], order: &mut [usize], side_max: f64, leaf: Leaf) -> Result<()> {
        let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        for p in order.iter().map(|k| points[*k]) {
            b = [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])];
        }
        if order.is_empty() || self.near(b).is_empty() {
            return Ok(());
        }
        let (w, h) = (b[2] - b[0], b[3] - b[1]);
        if w.max(h) > side_max && order.len() > 1 {
            let axis = usize::from(h > w);
            let middle = (b[axis] + b[axis + 2]) / 2.0;
            let mut split = 0;
            for k in 0..order.len() {
                if points[order[k]][axis] <= middle {
                    order.swap(k, split);
                    split += 1;
                }
            }
            // Far out the middle of two neighbouring floats is one of them: such points stay together.
            if 0 < split && split < order.len() {
                let (left, right) = order.split_at_mut(split);
                self.windows(points, left, side_max, leaf)?;
                return self.windows(points, right, side_max, leaf);
            }
        }
        leaf(order, b)
    }
}

/// A grid that was asked for.
struct Asked<'a> {
    xs: &'a [f64],
    ys: &'a [f64],
    tolerance: &'a Tolerance,
    how: How,
}

fn checked(tolerance: &Tolerance) -> Result<()> {
    match tolerance {
        Tolerance::Constant(c) if c.is_nan() || *c < 0.0 => {
            Err(Error::invalid("tolerance", format!("{c} is no error; give metres, 0 or more")))
        }
        _ => Ok(()),
    }
}
