//! Solids: a mesh becomes distances in voxels and those a tile; a tile at any zoom and window becomes triangles again.

use super::sender::numbers;
use super::{Opened, Request, Sent, SentTold, Threads, Worth, Zoom, told};
use crate::base::{Error, Result, limits};
use crate::export::grid::name_of;
use crate::export::{Going, go_on};
use crate::format::gltf::write_solid_glb;
use crate::format::ply::write_ply;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::{Map, Value, json};
use std::io::Write;
use terraquilt_codecs::fractal::header::Space;
use terraquilt_codecs::fractal::{Walk, encode_volume};
use terraquilt_codecs::solid::{self, Border, Field, MARGIN, Mesh, Samples, Window};

/// Voxels along the longest side, if nothing else is said.
pub const VOXELS: usize = 64;
/// Fewest voxels along the longest side: margins take four.
const VOXELS_MIN: usize = 8;
/// Sizes are multiples of this, so that large ranges fit.
const WHOLE: usize = 8;

/// Codes a mesh. `voxels`: how many along its longest side.
///
/// # Errors
/// For meshes that bound nothing, and as [`send_heights`](super::send_heights).
pub fn send_solid(mesh: &Mesh, file: &str, voxels: usize, request: &Request, going: Going) -> Result<Sent> {
    let only_heights = [("--bound", request.bound.is_some()), ("--unit", request.unit.is_some())];
    if let Some((option, _)) = only_heights.iter().find(|(_, given)| *given) {
        return Err(Error::invalid(
            option,
            "is for heights; a solid states the error that was measured, in eighths of a voxel",
        ));
    }
    if !request.interest.is_empty() {
        return Err(Error::invalid("--interest", "is for heights and pictures"));
    }
    if !(VOXELS_MIN..=solid::window::SIDE_MAX).contains(&voxels) {
        return Err(Error::invalid(
            "--voxels",
            format!("{voxels}; {VOXELS_MIN} to {} are possible", solid::window::SIDE_MAX),
        ));
    }
    mesh.check().map_err(|e| told(file, e))?;
    let [min, max] = mesh.bounds().ok_or_else(|| Error::invalid(file, "it has no triangles"))?;
    let extent = [0, 1, 2].map(|k| max[k] - min[k]);
    let longest = extent.into_iter().fold(0.0, f64::max);
    let voxel = longest / (voxels as f64 - 2.0 * MARGIN);
    let size = extent.map(|e| match e / voxel {
        n if n.is_finite() => ((n + 2.0 * MARGIN).ceil() as usize).next_multiple_of(WHOLE).min(voxels),
        _ => voxels,
    });
    let samples = size.iter().map(|n| *n as u64).product();
    let options = request.options(samples, 1.0)?;
    let window = Window::around([min, max], size, MARGIN).map_err(|e| told(file, e))?;
    let (field, report) =
        Field::of(mesh, window, &Threads::new("distances", going)).map_err(|e| told(file, e))?;
    let voxel = window.voxel;
    let space = Space { origin: window.from_voxels([0.5; 3]), voxel };
    let workers = Threads::new("maps", going);
    let encoded = encode_volume(size, &field.values, space, &name_of(file), &options, &workers)
        .map_err(|e| told(file, e))?;
    let numbers = SentTold { voxel: Some(voxel), ..numbers(&encoded, options.search) };
    Ok(Sent { bytes: encoded.bytes, told: numbers, notes: report.warning().into_iter().collect() })
}

/// What there is to say of a solid as triangles.
#[derive(Clone, Debug, Serialize)]
pub struct SolidTold {
    /// Corners of triangles.
    pub vertices: u64,
    /// Triangles.
    pub triangles: u64,
    /// Voxels of the window.
    pub voxels: [usize; 3],
    /// Side of a voxel in units of the mesh.
    pub voxel: f64,
    /// Whether the window cuts the solid: it is closed along the cut.
    pub cut: bool,
}

/// The surface of a solid.
pub struct Solid {
    /// Triangles, counter-clockwise seen from outside, in the axes of the mesh that was encoded.
    pub mesh: Mesh,
    /// In numbers.
    pub told: SolidTold,
    worth: Worth,
    zoom: Zoom,
    source: String,
}

impl Solid {
    /// Marching cubes over a tile at a zoom, everywhere or in a box: least and greatest coordinates.
    ///
    /// # Errors
    /// If the tile is no solid, the box does not meet it, for too many voxels; [`Error::Stopped`].
    pub fn of(o: &Opened, zoom: Zoom, window: Option<[[f64; 3]; 2]>, going: Going) -> Result<Solid> {
        let (Some(ifs), Some(space)) = (&o.tile.volume, o.tile.header.space) else {
            return Err(Error::invalid("tile", "it holds no solid"));
        };
        let size = ifs.shape.size;
        let z = zoom.get();
        let whole = size.map(|n| zoom.cells(n));
        let corner = space.origin.map(|v| v - space.voxel / 2.0);
        let step = space.voxel / z;
        let (from, to) = match window {
            None => ([0; 3], whole),
            Some(w) => cells(w, corner, step, whole)?,
        };
        let cells = [0, 1, 2].map(|k| to[k] - from[k]);
        let wanted = cells.iter().fold(1, |n: u64, c| n.saturating_mul(*c as u64));
        if wanted > limits::FRACTAL_SAMPLES_MAX || cells.iter().any(|n| *n > solid::window::SIDE_MAX) {
            let side = cells.into_iter().max().unwrap_or(0) as u64;
            return Err(Error::limit(
                "voxels along a side of the result (take a smaller --zoom, or a --window)",
                solid::window::SIDE_MAX as u64,
                side,
            ));
        }
        go_on(going, "decoding", 0.0)?;
        let values = match z {
            _ if z < 1.0 => means(&o.tile.volume().map_err(|e| o.told(e))?.values, size, z, from, cells),
            _ => {
                let walk = Walk::<3>::new(ifs).map_err(|e| o.told(e))?;
                walked(&walk, zoom, from, cells, going)?
            }
        };
        let window =
            Window { size: cells, origin: [0, 1, 2].map(|k| corner[k] + step * from[k] as f64), voxel: step };
        let samples = Samples { window, values: &values };
        let mesh = solid::surface(&samples, 0.0, Border::Closed, &Threads::new("triangles", going))
            .map_err(|e| o.told(e))?;
        let told = SolidTold {
            vertices: mesh.positions.len() as u64,
            triangles: mesh.triangles.len() as u64,
            voxels: cells,
            voxel: step,
            cut: cells != whole,
        };
        let worth = if zoom.is_synthetic() { o.worth.unknown() } else { o.worth.clone() };
        Ok(Solid { mesh, told, worth, zoom, source: o.tile.header.place.source.clone() })
    }

    /// Writes GLB, in the axes of the mesh that was encoded.
    ///
    /// # Errors
    /// What writing meets.
    pub fn write_glb(&self, out: &mut dyn Write) -> Result<()> {
        let mut extras: Map<String, Value> = Map::new();
        let voxel = self.told.voxel * self.zoom.get();
        extras.insert("source".into(), json!(self.source));
        extras.insert("zoom".into(), json!(self.zoom.get()));
        extras.insert("synthetic".into(), json!(self.zoom.is_synthetic()));
        extras.insert("complete".into(), json!(self.worth.complete));
        extras.insert("distance_error".into(), json!(self.worth.error_max.map(|e| e / 8.0 * voxel)));
        write_solid_glb(out, &self.mesh, &extras)
    }

    /// Writes PLY.
    ///
    /// # Errors
    /// What writing meets.
    pub fn write_ply(&self, out: &mut dyn Write) -> Result<()> {
        let synthetic = if self.zoom.is_synthetic() { "SYNTHETIC: " } else { "" };
        let comment = format!("{synthetic}fractal tile at zoom {}", self.zoom.get());
        write_ply(out, &self.mesh, &comment)
    }
}

/// The cells that a box meets: first, and behind the last.
fn cells(
    [min, max]: [[f64; 3]; 2],
    corner: [f64; 3],
    step: f64,
    whole: [usize; 3],
) -> Result<([usize; 3], [usize; 3])> {
    let (mut from, mut to) = ([0; 3], whole);
    for k in 0..3 {
        let end = corner[k] + step * whole[k] as f64;
        if !(min[k] < max[k] && min[k] < end && max[k] > corner[k]) {
            return Err(Error::invalid(
                "--window",
                format!(
                    "{} to {} on axis {}; the solid's box is from {} to {} there, give x0,y0,z0,x1,y1,z1 that meet it",
                    min[k],
                    max[k],
                    ["x", "y", "z"][k],
                    corner[k],
                    end
                ),
            ));
        }
        from[k] = (((min[k] - corner[k]) / step).max(0.0) as usize).min(whole[k] - 1);
        to[k] = (((max[k] - corner[k]) / step).ceil() as usize).clamp(from[k] + 1, whole[k]);
    }
    Ok((from, to))
}

/// The maps at the middles of cells.
fn walked(walk: &Walk<3>, zoom: Zoom, from: [usize; 3], cells: [usize; 3], going: Going) -> Result<Vec<f64>> {
    let (z, depth) = (zoom.get(), zoom.depth());
    let mut out = vec![0.0; cells.iter().product()];
    let layer = cells[0] * cells[1];
    out.par_chunks_mut(layer).enumerate().try_for_each(|(k, values)| {
        go_on(going, "decoding", k as f64 / cells[2] as f64)?;
        for (n, v) in values.iter_mut().enumerate() {
            let cell = [n % cells[0], n / cells[0], k];
            *v = walk.value([0, 1, 2].map(|a| ((from[a] + cell[a]) as f64 + 0.5) / z), depth);
        }
        Ok::<_, Error>(())
    })?;
    Ok(out)
}

/// Means over cells of 1/z voxels, by the room that they share.
fn means(values: &[f64], size: [usize; 3], z: f64, from: [usize; 3], cells: [usize; 3]) -> Vec<f64> {
    let shares = |cell: usize, count: usize| {
        let (low, high) = (cell as f64 / z, ((cell + 1) as f64 / z).min(count as f64));
        let last = (high.ceil() as usize).min(count);
        (low as usize..last).map(move |k| (k, (high.min((k + 1) as f64) - low.max(k as f64)).max(0.0)))
    };
    (0..cells.iter().product::<usize>())
        .into_par_iter()
        .map(|n| {
            let cell = [n % cells[0], n / cells[0] % cells[1], n / cells[0] / cells[1]];
            let at = |a: usize| shares(from[a] + cell[a], size[a]);
            let (mut sum, mut room) = (0.0, 0.0);
            for (w, deep) in at(2) {
                for (v, high) in at(1) {
                    for (u, wide) in at(0) {
                        let share = deep * high * wide;
                        sum += share * values[(w * size[1] + v) * size[0] + u];
                        room += share;
                    }
                }
            }
            sum / room
        })
        .collect()
}
