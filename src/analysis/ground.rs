//! What answers need to know of a state of the ground, wherever it is: in a database, or behind a server.

use crate::base::Result;
use crate::base::lattice::Bounds;
use crate::db::Snapshot;
use crate::db::query::Tolerance;
use crate::height::crs::Crs;
use crate::height::frame::{CellRect, Frame, LatticeUnit};
use crate::height::lod::SurveyNumber;
use crate::height::surface::{Evaluation, How};

/// The posts of a survey.
#[derive(Clone, Copy, Debug)]
pub struct Posts<'a> {
    pub number: SurveyNumber,
    pub name: &'a str,
    pub frame: Frame,
    /// Nominal steps, CRS units.
    pub steps: [f64; 2],
    /// Smallest rectangle of cells that holds measured ground.
    pub core: CellRect,
}

impl Posts<'_> {
    /// The box around the core, lattice units.
    pub fn bounds(&self) -> Bounds {
        self.frame.bounds(&self.core)
    }
}

/// One version of the ground. Every answer of `analysis` asks no more than this.
pub trait Ground {
    fn crs(&self) -> &Crs;
    fn unit(&self) -> LatticeUnit;
    /// xmin, ymin, xmax, ymax of the cores of all surveys, CRS units.
    fn bounds(&self) -> Option<[f64; 4]>;
    /// Surveys, by number.
    fn posts(&self) -> Box<dyn Iterator<Item = Posts<'_>> + '_>;
    /// Heights at points; `None` where there is no data.
    fn heights(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>>;
    /// Heights on a grid along the axes: at `(xs[c], ys[r])`, row by row.
    fn grid(
        &self,
        xs: &[f64],
        ys: &[f64],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>> {
        let points: Vec<[f64; 2]> = ys.iter().flat_map(|y| xs.iter().map(|x| [*x, *y])).collect();
        self.heights(&points, tolerance, how)
    }
    /// Heights at points, with gradients.
    fn slopes(&self, points: &[[f64; 2]], tolerance: &Tolerance, how: How)
    -> Result<Vec<Option<Evaluation>>>;
}

impl Ground for Snapshot {
    fn crs(&self) -> &Crs {
        Snapshot::crs(self)
    }

    fn unit(&self) -> LatticeUnit {
        Snapshot::unit(self)
    }

    fn bounds(&self) -> Option<[f64; 4]> {
        Snapshot::bounds(self)
    }

    fn posts(&self) -> Box<dyn Iterator<Item = Posts<'_>> + '_> {
        Box::new(self.entries().map(|e| Posts {
            number: e.number,
            name: &e.name,
            frame: e.geometry.frame,
            steps: e.geometry.steps,
            core: e.geometry.core,
        }))
    }

    fn heights(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>> {
        Snapshot::heights(self, points, tolerance, how)
    }

    fn slopes(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>> {
        Snapshot::slopes(self, points, tolerance, how)
    }

    fn grid(
        &self,
        xs: &[f64],
        ys: &[f64],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>> {
        Ok(Snapshot::grid(self, xs, ys, tolerance, how)?.evaluations())
    }
}
