//! The surface over a raster: for GeoTIFF and PNG.

use super::place::{Coords, Place};
use super::{Going, go_on};
use crate::base::polygon::Polygon;
use crate::base::{Error, Result, limits};
use crate::db::query::Query;
use crate::db::{Snapshot, SurveyEntry, metres_per_unit};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::lod::{Geometry, KERNEL, MARGIN};

/// Rows that are asked at once.
const BAND: usize = 64;

/// A raster over a region: posts are pixel centres, the first row is the northernmost.
pub struct Raster<'a> {
    /// Centre of the first pixel, in the raster's CRS.
    origin: [f64; 2],
    step: [f64; 2],
    pub cols: usize,
    pub rows: usize,
    /// The raster's CRS, if it is not the database's.
    coords: Option<&'a Coords>,
    /// Pixels whose centres lie outside are empty.
    mask: Option<&'a Polygon>,
}

/// Errors that were met at the posts of a raster.
#[derive(Clone, Copy, Debug)]
pub struct Met {
    /// The least certified error in metres; infinite where none was met.
    pub least: f64,
    /// The largest.
    pub most: f64,
    /// Posts with data in the rim outside every survey's core: certified nowhere.
    pub uncertified: u64,
}

impl<'a> Raster<'a> {
    /// Pixels of `step` CRS units; without a step, `side` pixels along the longer side. Over everything if the place has no
    /// bounds.
    pub fn new(s: &Snapshot, place: &'a Place, step: Option<[f64; 2]>, side: usize) -> Result<Raster<'a>> {
        let b = bounds(s, place)?;
        let coords = place.coords.as_ref();
        let scale = metres_per_unit(crs(s, coords).unit, middle(b));
        let (w, h) = (b[2] - b[0], b[3] - b[1]);
        let step = step.unwrap_or_else(|| {
            let m = (w * scale[0]).max(h * scale[1]) / side as f64;
            [m / scale[0], m / scale[1]]
        });
        let (cols, rows) = ((w / step[0] - 1e-9).ceil().max(1.0), (h / step[1] - 1e-9).ceil().max(1.0));
        // Pixels keep their size; the box grows to the south and east by less than one.
        let origin = [b[0] + step[0] / 2.0, b[3] - step[1] / 2.0];
        Raster { origin, step, cols: 1, rows: 1, coords, mask: place.mask.as_deref() }.sized(cols, rows)
    }

    /// Pixels as fine as the finest survey of the place. Without `--coords` they are centred on the posts of the finest
    /// survey there whose columns run north, if there is one: at tolerance 0 its samples come out.
    pub fn as_fine_as_posts(s: &Snapshot, place: &'a Place) -> Result<Raster<'a>> {
        match Raster::on_posts(s, place)? {
            Some((raster, _)) => {
                let (cols, rows) = (raster.cols as f64, raster.rows as f64);
                raster.sized(cols, rows)
            }
            None => Raster::new(s, place, finest_step(s, place)?, 1),
        }
    }

    /// Pixels centred on the posts of the finest survey there whose columns run north, and its name; `None` if there is none,
    /// none of its posts lies in the region, or the place has coordinates of its own. The caller limits their number.
    pub fn on_posts(s: &Snapshot, place: &'a Place) -> Result<Option<(Raster<'a>, String)>> {
        let b = bounds(s, place)?;
        let size = s.unit().size();
        let upright = |g: &Geometry| g.frame.u.y == 0 && g.frame.v.x == 0;
        let met = meets(s, place, b);
        let Some(e) = finest(s, |g| met(g) && upright(g)).filter(|_| place.coords.is_none()) else {
            return Ok(None);
        };
        // Posts at anchor + k step; those within the region.
        let frame = &e.geometry.frame;
        let anchor = [frame.anchor.x as f64 * size, frame.anchor.y as f64 * size];
        let step = [frame.u.x as f64 * size, frame.v.y as f64 * size].map(f64::abs);
        let found = Raster::on_lattice(place, b, anchor, step)?;
        Ok(found.map(|raster| (raster, e.name.clone())))
    }

    /// Pixels centred on whole multiples of a step, those within the region; `None` if there is none. The caller limits their
    /// number.
    pub fn on_multiples(s: &Snapshot, place: &'a Place, step: [f64; 2]) -> Result<Option<Raster<'a>>> {
        Raster::on_lattice(place, bounds(s, place)?, [0.0; 2], step)
    }

    /// Those of the points `anchor + k step` that lie in a box.
    fn on_lattice(
        place: &'a Place,
        b: [f64; 4],
        anchor: [f64; 2],
        step: [f64; 2],
    ) -> Result<Option<Raster<'a>>> {
        let first = [0, 1].map(|k| ((b[k] - anchor[k]) / step[k] - 1e-6).ceil());
        let last = [0, 1].map(|k| ((b[k + 2] - anchor[k]) / step[k] + 1e-6).floor());
        if !(first[0] <= last[0] && first[1] <= last[1]) {
            return Ok(None);
        }
        let origin = [anchor[0] + first[0] * step[0], anchor[1] + last[1] * step[1]];
        let (coords, mask) = (place.coords.as_ref(), place.mask.as_deref());
        let count = |k: usize| (last[k] - first[k] + 1.0) as usize;
        Ok(Some(Raster { origin, step, cols: count(0), rows: count(1), coords, mask }))
    }

    /// As many more columns in the west, rows in the north.
    pub fn grown(self, west: usize, north: usize) -> Raster<'a> {
        let origin =
            [self.origin[0] - west as f64 * self.step[0], self.origin[1] + north as f64 * self.step[1]];
        Raster { origin, cols: self.cols + west, rows: self.rows + north, ..self }
    }

    fn sized(self, cols: f64, rows: f64) -> Result<Raster<'a>> {
        if cols.is_nan() || rows.is_nan() || cols * rows > limits::RASTER_POSTS_MAX as f64 {
            return Err(Error::limit(
                "pixels (give a smaller --bbox or a larger --step)",
                limits::RASTER_POSTS_MAX,
                (cols * rows) as u64,
            ));
        }
        Ok(Raster { cols: cols as usize, rows: rows as usize, ..self })
    }

    pub fn step(&self) -> [f64; 2] {
        self.step
    }

    /// Centre of a pixel, in the raster's CRS.
    pub fn center(&self, col: usize, row: usize) -> [f64; 2] {
        [self.origin[0] + col as f64 * self.step[0], self.origin[1] - row as f64 * self.step[1]]
    }

    /// The raster's CRS.
    pub fn crs<'b>(&'b self, s: &'b Snapshot) -> &'b Crs {
        crs(s, self.coords)
    }

    /// Pixel size in metres.
    pub fn cell_m(&self, s: &Snapshot) -> [f64; 2] {
        let k = metres_per_unit(self.unit(s), self.center(self.cols / 2, self.rows / 2));
        [self.step[0] * k[0], self.step[1] * k[1]]
    }

    fn unit(&self, s: &Snapshot) -> AxisUnit {
        self.crs(s).unit
    }

    /// The pixels of some rows that are not empty by position, row by row: which, and where in the database's CRS.
    fn points(&self, rows: std::ops::Range<usize>) -> (Vec<usize>, Vec<[f64; 2]>) {
        rows.clone()
            .flat_map(|r| (0..self.cols).map(move |c| (c, r)))
            .enumerate()
            .filter_map(|(k, (c, r))| {
                let p = self.center(c, r);
                let p = self.coords.map_or(Some(p), |coords| coords.inward(p))?;
                self.mask.is_none_or(|m| m.contains(p)).then_some((k, p))
            })
            .unzip()
    }

    /// Heights band by band: `f(first row, rows, heights)`, NaN where there is no data. Returns the largest certified
    /// error that was met.
    pub fn heights(
        &self,
        s: &Snapshot,
        query: &Query,
        going: Going,
        mut f: impl FnMut(usize, usize, &[f32]) -> Result<()>,
    ) -> Result<f64> {
        let met = self.doubles(s, query, going, |row0, rows, z, _| {
            f(row0, rows, &z.iter().map(|z| *z as f32).collect::<Vec<f32>>())
        });
        met.map(|m| m.most)
    }

    /// As [`Raster::heights`], as they are computed, and which of a band lie in the rim, where no error is certified.
    pub fn doubles(
        &self,
        s: &Snapshot,
        query: &Query,
        going: Going,
        mut f: impl FnMut(usize, usize, &[f64], &[usize]) -> Result<()>,
    ) -> Result<Met> {
        let mut met = Met { least: f64::INFINITY, most: 0.0, uncertified: 0 };
        for row0 in (0..self.rows).step_by(BAND) {
            go_on(going, "heights", row0 as f64 / self.rows as f64)?;
            let rows = BAND.min(self.rows - row0);
            let (mut z, which, found): (_, Option<Vec<usize>>, _);
            if self.coords.is_none() && self.mask.is_none() {
                let xs: Vec<f64> = (0..self.cols).map(|c| self.center(c, row0)[0]).collect();
                let ys: Vec<f64> = (row0..row0 + rows).map(|r| self.center(0, r)[1]).collect();
                found = s.grid(&xs, &ys, &query.tolerance, query.how)?;
                z = found.z.clone();
                which = None;
            } else {
                let (places, points) = self.points(row0..row0 + rows);
                found = s.planes(&points, &query.tolerance, query.how)?;
                z = vec![f64::NAN; rows * self.cols];
                for (k, height) in places.iter().zip(&found.z) {
                    z[*k] = *height;
                }
                which = Some(places);
            }
            let mut rim = Vec::new();
            for k in (0..found.len()).filter(|k| !found.z[*k].is_nan()) {
                if found.is_certified(k) {
                    met.least = met.least.min(found.error_m[k]);
                    met.most = met.most.max(found.error_m[k]);
                } else {
                    met.uncertified += 1;
                    rim.push(which.as_ref().map_or(k, |w| w[k]));
                }
            }
            f(row0, rows, &z, &rim)?;
        }
        Ok(met)
    }

    /// log2 of the side in metres of the patch that weighs most at each pixel; NaN where there is none.
    pub fn patch_sizes(&self, s: &Snapshot, query: &Query, going: Going) -> Result<Vec<f32>> {
        let mut out = vec![f32::NAN; self.cols * self.rows];
        for row0 in (0..self.rows).step_by(BAND) {
            go_on(going, "patches", row0 as f64 / self.rows as f64)?;
            let (which, points) = self.points(row0..self.rows.min(row0 + BAND));
            let found = s.dominant(&points, &query.tolerance, query.how)?;
            for ((k, p), r) in which.into_iter().zip(&points).zip(found) {
                let Some(r) = r else { continue };
                let Ok(e) = s.survey_by_number(r.survey) else { continue };
                let metres = metres_per_unit(s.crs().unit, *p)[0];
                let cells = ((KERNEL + 2 * MARGIN) << r.place.level) as f64;
                out[row0 * self.cols + k] = (e.geometry.steps[0] * metres * cells).log2() as f32;
            }
        }
        Ok(out)
    }
}

/// Whether a survey's core may lie in a place.
fn meets(s: &Snapshot, place: &Place, b: [f64; 4]) -> impl Fn(&Geometry) -> bool + use<> {
    let near = place.area.bounds().or_else(|| s.bounds()).unwrap_or(b);
    let size = s.unit().size();
    move |g| {
        let c = g.bounds();
        let (low, high) = (c.min, c.max);
        low.x as f64 * size <= near[2]
            && near[0] <= high.x as f64 * size
            && low.y as f64 * size <= near[3]
            && near[1] <= high.y as f64 * size
    }
}

/// The survey with the densest posts.
fn finest(s: &Snapshot, pass: impl Fn(&Geometry) -> bool) -> Option<&SurveyEntry> {
    let area = |g: &Geometry| g.steps[0] * g.steps[1];
    s.entries().filter(|e| pass(&e.geometry)).min_by(|a, b| {
        let (g, h) = (&a.geometry, &b.geometry);
        area(g).total_cmp(&area(h)).then(h.precedence.cmp(&g.precedence))
    })
}

/// The steps of the finest survey of a place, or of all, in the coordinates of the answer.
pub fn finest_step(s: &Snapshot, place: &Place) -> Result<Option<[f64; 2]>> {
    let b = bounds(s, place)?;
    let near = place.area.bounds().or_else(|| s.bounds()).unwrap_or(b);
    let found = finest(s, meets(s, place, b)).or_else(|| finest(s, |_| true));
    Ok(found.map(|e| match &place.coords {
        None => e.geometry.steps,
        Some(c) => {
            let from = metres_per_unit(s.crs().unit, middle(near));
            let to = metres_per_unit(c.crs.unit, middle(b));
            [0, 1].map(|k| e.geometry.steps[k] * from[k] / to[k])
        }
    }))
}

fn crs<'a>(s: &'a Snapshot, coords: Option<&'a Coords>) -> &'a Crs {
    coords.map_or(s.crs(), |c| &c.crs)
}

fn middle(b: [f64; 4]) -> [f64; 2] {
    [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0]
}

/// The box of a place in the coordinates of the answer, of everything if it has none.
fn bounds(s: &Snapshot, place: &Place) -> Result<[f64; 4]> {
    let own = || place.coords.is_none().then(|| s.bounds()).flatten();
    place
        .bounds
        .or_else(own)
        .ok_or_else(|| Error::invalid("region", "the database is empty; `terraquilt ingest` brings a survey"))
}
