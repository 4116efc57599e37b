//! Samples of a tile as files: heights as GeoTIFF, relief and triangles, pictures as PNG.

use super::{Detail, Opened, Worth, Zoom};
use crate::base::{Error, Result, limits};
use crate::export::Going;
use crate::export::grid::{self, Grid, MeshRequest, MeshTold, RasterTold, Said, Samples, Surface};
use crate::format::picture::write_png;
use crate::height::source::Affine;
use serde_json::{Map, Value, json};
use std::io::{Seek, Write};
use terraquilt_codecs::fractal::grid::Grid as Plane;
use terraquilt_codecs::lattice::Lattice;

/// Planes of a tile at a zoom, and what they are worth.
pub struct Shown<'a> {
    /// The tile.
    pub opened: &'a Opened,
    /// Heights in units, brightness, or Y, I and Q.
    pub planes: Vec<Plane<2>>,
    /// At which zoom.
    pub zoom: Zoom,
    /// Where what is between samples comes from; says nothing up to zoom 1.
    pub detail: Detail,
    /// What the samples are worth.
    pub worth: Worth,
    /// Whether decoding was stopped before the samples had settled.
    pub stopped: bool,
}

impl Shown<'_> {
    /// In a sentence, what the file must say of itself.
    pub fn said(&self) -> Option<String> {
        let z = self.zoom.get();
        let zoomed = match self.detail {
            _ if !self.zoom.is_synthetic() => None,
            Detail::None => Some(format!("joined smoothly to {z} times as many samples along each axis")),
            d => Some(format!("SYNTHETIC: {} fractal detail below the sample distance, zoom {z}", d.name())),
        };
        let missing = (!self.worth.complete).then(|| "made of a part of its file".to_string());
        let stopped = self.stopped.then(|| "stopped before its samples had settled".to_string());
        let parts: Vec<String> = zoomed.into_iter().chain(missing).chain(stopped).collect();
        (!parts.is_empty()).then(|| format!("fractal tile, {}", parts.join("; ")))
    }

    /// Heights with their place: NaN where there is no data.
    pub fn heights(&self) -> Grid {
        let (o, z) = (self.opened, self.zoom.get());
        let own = o.tile.header.size;
        let plane = &self.planes[0];
        let [cols, rows] = plane.size;
        let sample = |k: usize, n: usize| (((k as f64 + 0.5) / z) as usize).min(n - 1);
        let void = |k: usize| {
            let at = sample(k / cols, own[1]) * own[0] + sample(k % cols, own[0]);
            z >= 1.0 && o.tile.void.get(at).copied().unwrap_or(false)
        };
        let heights = plane.values.iter().enumerate();
        let z_of = |(k, v): (usize, &f64)| if void(k) { f64::NAN } else { o.height(*v) };
        // The middle of the first cell lies half a cell inside of the corner of the first sample.
        let shift = 0.5 / z - 0.5;
        let affine = o.place.affine.map(|a| Affine {
            origin: [0, 1].map(|k| a.origin[k] + shift * (a.col_step[k] + a.row_step[k])),
            col_step: a.col_step.map(|s| s / z),
            row_step: a.row_step.map(|s| s / z),
        });
        Grid { cols, rows, z: heights.map(z_of).collect(), affine, ..o.place.clone() }
    }

    /// Writes heights as GeoTIFF.
    ///
    /// # Errors
    /// What writing meets.
    pub fn write_tif(&self, out: &mut (impl Write + Seek), going: Going) -> Result<RasterTold> {
        let place = &self.opened.tile.header.place;
        let exact = self.worth.complete && self.zoom.get() == 1.0 && self.worth.certified;
        // Float32 may add a hundredth to what is guaranteed; more, and it takes float64.
        let guaranteed = self.worth.error_max.filter(|e| self.worth.certified && *e > 0.0);
        let samples = Samples {
            whole: exact && place.unit == 1.0 && place.base.fract() == 0.0,
            single: exact && self.worth.error_max == Some(0.0),
            unit: guaranteed.map_or(place.unit, |e| place.unit.min(8.0 * e / 100.0)),
            description: self.said(),
        };
        grid::write_tif(out, &self.heights(), &samples, going)
    }

    /// Draws heights as a shaded relief.
    ///
    /// # Errors
    /// What writing meets.
    pub fn write_relief(&self, out: &mut dyn Write, going: Going) -> Result<RasterTold> {
        grid::write_relief(out, &self.heights(), None, self.said().as_deref(), going)
    }

    /// Writes a picture as PNG.
    ///
    /// # Errors
    /// What writing meets.
    pub fn write_picture(&self, out: &mut dyn Write) -> Result<RasterTold> {
        let size = self.planes[0].size;
        let p = self.opened.tile.picture_of(&self.planes, size).map_err(|e| self.opened.told(e))?;
        write_png(out, size, p.channels, &p.samples, self.said().as_deref())?;
        let samples = if p.channels == 1 { "grey" } else { "colour" };
        Ok(RasterTold { cols: p.cols as u64, rows: p.rows as u64, samples, rounding: 0.0 })
    }

    /// Writes heights as triangles, the samples their vertices.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond the posts of a lattice or the vertices of a mesh.
    pub fn write_terrain(&self, out: &mut dyn Write, request: MeshRequest, going: Going) -> Result<MeshTold> {
        let grid = self.heights();
        let longest = grid.cols.max(grid.rows) as u64;
        let lattice = Lattice::around(grid.cols, grid.rows).ok_or_else(|| {
            Error::limit(
                "posts along a side of a mesh (take a smaller --zoom)",
                limits::LATTICE_SIDE_MAX,
                longest,
            )
        })?;
        let (z, free) = spread(&grid, lattice);
        let base = self.opened.tile.header.place.base;
        let surface = Surface { lattice, z: &z, free: &free, grid: &grid, base };
        let mut extras = self.extras();
        extras.insert("source".into(), json!(self.opened.tile.header.place.source));
        let crs = &self.opened.tile.header.place.crs;
        grid::write_mesh(
            out,
            &surface,
            request,
            Said { crs, error: self.worth.error_max, extras },
            None,
            going,
        )
    }

    fn extras(&self) -> Map<String, Value> {
        let mut extras = Map::new();
        extras.insert("zoom".into(), json!(self.zoom.get()));
        extras.insert("certified".into(), json!(self.worth.certified));
        extras.insert("complete".into(), json!(self.worth.complete));
        extras.insert("finished".into(), json!(!self.stopped));
        extras.insert("synthetic".into(), json!(self.zoom.is_synthetic()));
        if self.zoom.is_synthetic() {
            extras.insert("detail".into(), json!(self.detail.name()));
        }
        extras
    }
}

/// Heights at every post of a lattice, and which have no data: beyond the grid its border goes on; voids have the mean.
fn spread(grid: &Grid, lattice: Lattice) -> (Vec<f64>, Vec<bool>) {
    let side = lattice.side();
    let (sum, count) =
        grid.z.iter().filter(|z| !z.is_nan()).fold((0.0, 0.0_f64), |(s, n), z| (s + z, n + 1.0));
    let mean = sum / count.max(1.0);
    let mut z = Vec::with_capacity(side * side);
    let mut free = Vec::with_capacity(side * side);
    for k in 0..side * side {
        let (row, col) = (k / side, k % side);
        let own = grid.z[row.min(grid.rows - 1) * grid.cols + col.min(grid.cols - 1)];
        z.push(if own.is_nan() { mean } else { own });
        free.push(own.is_nan() || row >= grid.rows || col >= grid.cols);
    }
    (z, free)
}
