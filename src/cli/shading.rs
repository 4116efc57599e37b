//! The surface over a raster: for GeoTIFF and PNG.

use crate::base::{Error, Result, limits};
use crate::db::query::Query;
use crate::db::{Snapshot, metres_per_unit};
use crate::height::lod::{KERNEL, MARGIN};

/// A raster over a region: posts are pixel centres, the first row is the northernmost.
pub struct Raster {
    /// xmin, ymin, xmax, ymax of the outer edges, CRS units.
    pub bounds: [f64; 4],
    pub cols: usize,
    pub rows: usize,
}

impl Raster {
    /// Pixels of `step` CRS units; without a step, `side` pixels along the longer side.
    pub fn new(
        s: &Snapshot,
        region: Option<[f64; 4]>,
        step: Option<[f64; 2]>,
        side: usize,
    ) -> Result<Raster> {
        let b = match region.or_else(|| s.bounds()) {
            Some(b) => b,
            None => {
                return Err(Error::invalid(
                    "region",
                    "the database is empty; `terraquilt ingest` brings a survey",
                ));
            }
        };
        let scale = metres_per_unit(s.crs().unit, [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0]);
        let (w, h) = (b[2] - b[0], b[3] - b[1]);
        let step = step.unwrap_or_else(|| {
            let m = (w * scale[0]).max(h * scale[1]) / side as f64;
            [m / scale[0], m / scale[1]]
        });
        let (cols, rows) = ((w / step[0] - 1e-9).ceil().max(1.0), (h / step[1] - 1e-9).ceil().max(1.0));
        if cols * rows > limits::RASTER_POSTS_MAX as f64 {
            return Err(Error::limit(
                "pixels (give a smaller --bbox or a larger --step)",
                limits::RASTER_POSTS_MAX,
                (cols * rows) as u64,
            ));
        }
        // Pixels keep their size; the box grows to the south and east by less than one.
        let bounds = [b[0], b[3] - rows * step[1], b[0] + cols * step[0], b[3]];
        Ok(Raster { bounds, cols: cols as usize, rows: rows as usize })
    }

    pub fn step(&self) -> [f64; 2] {
        [
            (self.bounds[2] - self.bounds[0]) / self.cols as f64,
            (self.bounds[3] - self.bounds[1]) / self.rows as f64,
        ]
    }

    pub fn center(&self, col: usize, row: usize) -> [f64; 2] {
        let [sx, sy] = self.step();
        [self.bounds[0] + (col as f64 + 0.5) * sx, self.bounds[3] - (row as f64 + 0.5) * sy]
    }

    /// Pixel size in metres.
    pub fn cell_m(&self, s: &Snapshot) -> [f64; 2] {
        let b = self.bounds;
        let k = metres_per_unit(s.crs().unit, [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0]);
        [self.step()[0] * k[0], self.step()[1] * k[1]]
    }

    /// Heights band by band: `f(first row, rows, heights)`, NaN where there is no data. Returns the largest certified
    /// error that was met.
    pub fn heights(
        &self,
        s: &Snapshot,
        query: &Query,
        mut f: impl FnMut(usize, usize, &[f32]) -> Result<()>,
    ) -> Result<f64> {
        let mut error: f64 = 0.0;
        const BAND: usize = 64;
        for row0 in (0..self.rows).step_by(BAND) {
            let rows = BAND.min(self.rows - row0);
            let points: Vec<[f64; 2]> = (row0..row0 + rows)
                .flat_map(|r| (0..self.cols).map(move |c| (c, r)))
                .map(|(c, r)| self.center(c, r))
                .collect();
            let found = s.heights(&points, &query.tolerance, query.how)?;
            let z: Vec<f32> = found
                .iter()
                .map(|e| match e {
                    Some(e) => {
                        if e.certified {
                            error = error.max(e.error_m);
                        }
                        e.z as f32
                    }
                    None => f32::NAN,
                })
                .collect();
            f(row0, rows, &z)?;
        }
        Ok(error)
    }

    /// log2 of the side in metres of the patch that weighs most at each pixel; NaN where there is none.
    pub fn patch_sizes(&self, s: &Snapshot, query: &Query) -> Result<Vec<f32>> {
        let points: Vec<[f64; 2]> = (0..self.rows)
            .flat_map(|r| (0..self.cols).map(move |c| (c, r)))
            .map(|(c, r)| self.center(c, r))
            .collect();
        let b = self.bounds;
        let k = metres_per_unit(s.crs().unit, [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0]);
        Ok(s.dominant(&points, &query.tolerance, query.how)?
            .into_iter()
            .map(|r| match r {
                Some(r) => {
                    let Ok(e) = s.survey_by_number(r.survey) else { return f32::NAN };
                    let cells = ((KERNEL + 2 * MARGIN) << r.place.level) as f64;
                    (e.geometry.steps[0] * k[0] * cells).log2() as f32
                }
                None => f32::NAN,
            })
            .collect())
    }
}
