//! Cells over a region, at whose centres or corners the surface is asked.

use super::Going;
use super::terrain::Terrain;
use crate::base::{Error, Result, limits};
use crate::db::metres_per_unit;
use crate::db::query::Area;
use crate::height::crs::AxisUnit;
use crate::height::surface::Evaluation;

/// Equal cells with sides along the axes of the CRS; the first row is the northernmost.
///
/// Without a step its lines are the post lines of the finest survey that meets the region, if that survey's rows run
/// along an axis (else they begin at the region's north-west corner). A bilinear surface is then given exactly by the
/// corners of a cell, its mean over a cell by the centre, and its gradient is not asked where it jumps. With a
/// step, lines begin at the north-west corner of the region, as in `export`.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    area: Area,
    unit: AxisUnit,
    /// North-west corner, CRS units.
    pub west: f64,
    pub north: f64,
    /// Sides of a cell, CRS units.
    pub step: [f64; 2],
    pub cols: usize,
    pub rows: usize,
}

/// What a grid asks for at its points.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Spot {
    Centres,
    /// One more row and column than cells.
    Corners,
    /// Heights with gradients at the centres.
    Slopes,
}

impl Grid {
    /// A grid over `area` (everything: the surveys of all `terrains`). Without a step, `side_max` makes cells of several
    /// cells, so that no side of the grid has more than so many: for pictures.
    ///
    /// # Errors
    /// [`Error::Limit`] above [`limits::RASTER_POSTS_MAX`] cells; [`Error::Invalid`] if there is no survey at all, the
    /// region is empty, or the step is not positive.
    pub fn new(
        terrains: &[&Terrain],
        area: &Area,
        step: Option<[f64; 2]>,
        side_max: Option<usize>,
    ) -> Result<Grid> {
        let all = terrains.iter().filter_map(|t| t.ground.bounds());
        let b = match area.bounds() {
            Some(b) => b,
            None => all
                .reduce(|a, b| [a[0].min(b[0]), a[1].min(b[1]), a[2].max(b[2]), a[3].max(b[3])])
                .ok_or_else(|| {
                    Error::invalid("region", "the database is empty; `terraquilt ingest` brings a survey")
                })?,
        };
        if !(b.iter().all(|v| v.is_finite()) && b[0] < b[2] && b[1] < b[3]) {
            return Err(Error::invalid("region", format!("{b:?} is empty; give xmin,ymin,xmax,ymax")));
        }
        let unit = terrains[0].ground.crs().unit;
        let (corner, step) = match step {
            Some(s) if s.iter().all(|v| v.is_finite() && *v > 0.0) => ([b[0], b[3]], s),
            Some(s) => return Err(Error::invalid("--step", format!("{s:?}; it must be positive"))),
            None => {
                let (corner, step) = natural(terrains, b).ok_or_else(super::terrain::no_data)?;
                let side = ((b[2] - b[0]) / step[0]).max((b[3] - b[1]) / step[1]);
                let times = side_max.map_or(1.0, |m| (side / m as f64 - 1e-6).ceil().max(1.0));
                (corner, step.map(|s| s * times))
            }
        };
        // From the line at or before the region's edge to the one at or behind it.
        const ON: f64 = 1e-6;
        let skip = [((b[0] - corner[0]) / step[0] + ON).floor(), ((corner[1] - b[3]) / step[1] + ON).floor()];
        let end = [((b[2] - corner[0]) / step[0] - ON).ceil(), ((corner[1] - b[1]) / step[1] - ON).ceil()];
        let [cols, rows] = [0, 1].map(|k| (end[k] - skip[k]).max(1.0));
        if cols * rows > limits::RASTER_POSTS_MAX as f64 {
            return Err(Error::limit(
                "cells (give a smaller region or a larger --step)",
                limits::RASTER_POSTS_MAX,
                (cols * rows) as u64,
            ));
        }
        Ok(Grid {
            area: area.clone(),
            unit,
            west: corner[0] + skip[0] * step[0],
            north: corner[1] - skip[1] * step[1],
            step,
            cols: cols as usize,
            rows: rows as usize,
        })
    }

    pub fn corner(&self, col: usize, row: usize) -> [f64; 2] {
        [self.west + col as f64 * self.step[0], self.north - row as f64 * self.step[1]]
    }

    pub fn centre(&self, col: usize, row: usize) -> [f64; 2] {
        [self.west + (col as f64 + 0.5) * self.step[0], self.north - (row as f64 + 0.5) * self.step[1]]
    }

    /// Sides of the cells of a row, metres.
    pub fn cell_m(&self, row: usize) -> [f64; 2] {
        let k = metres_per_unit(self.unit, self.centre(self.cols / 2, row));
        [self.step[0] * k[0], self.step[1] * k[1]]
    }

    /// Area of a cell of a row, square metres.
    pub fn cell_m2(&self, row: usize) -> f64 {
        let [x, y] = self.cell_m(row);
        x * y
    }

    /// Whether a point belongs to the region that was asked for.
    pub fn contains(&self, p: [f64; 2]) -> bool {
        // A hair to the north-east: of two regions that share an edge, one has the cells whose centres lie on it.
        let p = [0, 1].map(|k| p[k] + self.step[k] * 1e-6);
        match &self.area {
            Area::Everything => true,
            Area::Polygon(polygon) => polygon.contains(p),
            Area::Box(b) => (0..2).all(|k| p[k] >= b[k] && p[k] < b[k + 2]),
        }
    }

    /// Columns and rows of points at such spots.
    pub fn size(&self, spot: Spot) -> [usize; 2] {
        let more = usize::from(spot == Spot::Corners);
        [self.cols + more, self.rows + more]
    }

    /// Asks the surface in some rows: `None` outside the region and where there is no data.
    pub fn band(
        &self,
        terrain: &Terrain,
        spot: Spot,
        rows: std::ops::Range<usize>,
    ) -> Result<Vec<Option<Evaluation>>> {
        let cols = self.size(spot)[0];
        let at = |col: usize, row: usize| {
            if spot == Spot::Corners { self.corner(col, row) } else { self.centre(col, row) }
        };
        if spot != Spot::Slopes && !matches!(self.area, Area::Polygon(_)) {
            let xs: Vec<f64> = (0..cols).map(|col| at(col, rows.start)[0]).collect();
            let ys: Vec<f64> = rows.map(|row| at(0, row)[1]).collect();
            let mut found = terrain.grid(&xs, &ys)?;
            for (k, e) in found.iter_mut().enumerate() {
                if !self.contains([xs[k % cols], ys[k / cols]]) {
                    *e = None;
                }
            }
            return Ok(found);
        }
        let mut inside = Vec::with_capacity(rows.len() * cols);
        let mut points = Vec::with_capacity(rows.len() * cols);
        for row in rows {
            for col in 0..cols {
                let p = at(col, row);
                inside.push(self.contains(p));
                if self.contains(p) {
                    points.push(p);
                }
            }
        }
        let found = match spot {
            Spot::Slopes => terrain.slopes(&points)?,
            _ => terrain.heights(&points)?,
        };
        let mut found = found.into_iter();
        Ok(inside.iter().map(|i| if *i { found.next().flatten() } else { None }).collect())
    }

    /// Bands of rows, with the share of the work that lies before each.
    pub fn bands(&self, spot: Spot) -> impl Iterator<Item = (std::ops::Range<usize>, f64)> {
        /// Rows asked at once.
        const BAND: usize = 64;
        let rows = self.size(spot)[1];
        (0..rows)
            .step_by(BAND)
            .map(move |first| (first..(first + BAND).min(rows), first as f64 / rows as f64))
    }

    /// Asks the surface row by row: `f(row, what is there)`.
    pub fn ask(
        &self,
        terrain: &Terrain,
        spot: Spot,
        going: Going,
        mut f: impl FnMut(usize, &[Option<Evaluation>]) -> Result<()>,
    ) -> Result<()> {
        for (rows, share) in self.bands(spot) {
            if !going(share) {
                return Err(Error::Stopped);
            }
            let found = self.band(terrain, spot, rows.clone())?;
            for (row, line) in rows.zip(found.chunks(self.size(spot)[0])) {
                f(row, line)?;
            }
        }
        Ok(())
    }
}

/// A post and the steps of the finest survey in the box.
fn natural(terrains: &[&Terrain], b: [f64; 4]) -> Option<([f64; 2], [f64; 2])> {
    let found = terrains.iter().filter_map(|t| Some((t, t.finest(b)?)));
    let (t, g) = found.min_by(|(_, m), (_, n)| {
        let area = |s: [f64; 2]| s[0] * s[1];
        area(m.steps).total_cmp(&area(n.steps))
    })?;
    let size = t.ground.unit().size();
    let f = &g.frame;
    let upright = f.u.y == 0 && f.v.x == 0;
    let turned = f.u.x == 0 && f.v.y == 0;
    let step = if turned { [g.steps[1], g.steps[0]] } else { g.steps };
    if !upright && !turned {
        return Some(([b[0], b[3]], step));
    }
    // The post nearest to the north-west corner: counting from the CRS origin would lose digits.
    let unit = t.ground.unit();
    let near = crate::base::lattice::Point::new(unit.round(b[0])?, unit.round(b[3])?);
    let (i, j) = f.index(near);
    let post = f.post(i.round() as i64, j.round() as i64);
    Some(([post.x as f64 * size, post.y as f64 * size], step))
}
