//! One state of the ground, as it is asked.

use super::ground::{Ground, Posts};
use crate::base::{Error, Result};
use crate::db::metres_per_unit;
use crate::db::query::{Query, Tolerance};
use crate::height::crs::AxisUnit;
use crate::height::surface::{Evaluation, How};

/// A version (or some of its surveys), how much error is allowed, and how patches are blended.
#[derive(Clone)]
pub struct Terrain<'a> {
    pub ground: &'a dyn Ground,
    pub tolerance: Tolerance,
    pub how: How,
}

impl<'a> Terrain<'a> {
    /// The surface that a query means.
    ///
    /// # Errors
    /// If a camera's tolerance meets a database in degrees.
    pub fn new(ground: &'a dyn Ground, query: &Query) -> Result<Terrain<'a>> {
        if let (Tolerance::Camera(_), AxisUnit::Degree) = (&query.tolerance, ground.crs().unit) {
            return Err(Error::unsupported(
                &ground.crs().code,
                "a camera needs metres, and this database is in degrees",
                "ask with --error M",
            ));
        }
        Ok(Terrain { ground, tolerance: query.tolerance.clone(), how: query.how })
    }

    pub fn heights(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        self.ground.heights(points, &self.tolerance, self.how)
    }

    /// Heights on a grid along the axes: at `(xs[c], ys[r])`, row by row.
    pub fn grid(&self, xs: &[f64], ys: &[f64]) -> Result<Vec<Option<Evaluation>>> {
        self.ground.grid(xs, ys, &self.tolerance, self.how)
    }

    /// Heights with gradients, metres per CRS unit.
    pub fn slopes(&self, points: &[[f64; 2]]) -> Result<Vec<Option<Evaluation>>> {
        self.ground.slopes(points, &self.tolerance, self.how)
    }

    /// Metres of one CRS unit in x and y at a point: a degree is as long as it is there.
    pub fn scale(&self, at: [f64; 2]) -> [f64; 2] {
        metres_per_unit(self.ground.crs().unit, at)
    }

    /// Length in metres of a short step.
    pub fn distance_m(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        distance_m(self.ground.crs().unit, a, b)
    }

    /// The survey with the smallest cells among those whose box meets `bounds`; of equal ones the first.
    pub fn finest(&self, bounds: [f64; 4]) -> Option<Posts<'a>> {
        let size = self.ground.unit().size();
        self.ground
            .posts()
            .filter(|p| {
                let b = p.bounds();
                let (lo, hi) = ([b.min.x, b.min.y], [b.max.x, b.max.y]);
                (0..2).all(|k| lo[k] as f64 * size <= bounds[k + 2] && hi[k] as f64 * size >= bounds[k])
            })
            .min_by(|a, b| {
                let area = |s: [f64; 2]| s[0] * s[1];
                area(a.steps).total_cmp(&area(b.steps)).then(a.number.cmp(&b.number))
            })
    }
}

/// Length in metres of a short step.
pub(super) fn distance_m(unit: AxisUnit, a: [f64; 2], b: [f64; 2]) -> f64 {
    let k = metres_per_unit(unit, [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0]);
    ((b[0] - a[0]) * k[0]).hypot((b[1] - a[1]) * k[1])
}

/// The answer where a line or region meets no survey.
pub(super) fn no_data() -> Error {
    Error::invalid("region", "holds no data; `terraquilt surveys` shows where the surveys are")
}
