//! A grid or a picture as a fractal tile.

use super::point::PIXELS;
use super::{Threads, psnr_db, search_name, told};
use crate::base::{Error, Result, limits};
use crate::export::grid::{Grid, Units, name_of, units_within};
use crate::export::{Going, go_on};
use crate::format::picture::Picture;
use crate::height::source::Window;
use rayon::prelude::*;
use serde::Serialize;
use terraquilt_codecs::fractal::header::BOUND_MAX;
use terraquilt_codecs::fractal::{
    Encoded, Kind, Options, Partition, Search, Tile, encode_heights, encode_picture,
};

/// Domains along an axis that a range meets, where only near ones are asked for and nothing else is said.
pub const NEAR: usize = 16;
/// Units that are tried for a bound, each ten times finer.
const FINER: u32 = 6;

/// What is asked of a tile. Errors, steps and slopes are in the file's own unit.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// What the codec is told; its partition, step and bound in the unit of the file.
    pub options: Options,
    /// Which domains are met; `None`: all of small tiles, near ones of others.
    pub search: Option<Search>,
    /// No height is farther from the file's.
    pub bound: Option<f64>,
    /// Unit of the integers of heights; `None`: [`Grid::usual_unit`], finer where a bound needs it.
    pub unit: Option<f64>,
    /// Boxes where errors count more: least x and y, greatest x and y, weight.
    pub interest: Vec<[f64; 5]>,
}

/// A tile, and what is to be said of it.
pub struct Sent {
    /// The file.
    pub bytes: Vec<u8>,
    /// In numbers.
    pub told: SentTold,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// A tile in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct SentTold {
    /// `heights`, `grey`, `colour` or `volume`.
    pub kind: &'static str,
    /// Bytes of the file.
    pub bytes: u64,
    /// Samples along each axis.
    pub size: Vec<usize>,
    /// Samples: posts, pixels, voxels; those without data included.
    pub samples: u64,
    /// 8 bytes / samples.
    pub bits_per_sample: f64,
    /// Leaves of all trees.
    pub maps: u64,
    /// Peak signal to noise; absent where nothing differs.
    pub psnr_db: Option<f64>,
    /// Greatest error of a sample, in the unit of the file (heights), grey levels (pictures), eighths of a voxel (volumes): measured
    /// with the decoder. Of heights rounding to the unit is in it.
    pub error_max: f64,
    /// Root mean square of the same.
    pub error_rms: f64,
    /// What a bounded tile guarantees: no error at a sample is greater.
    pub error_bound: Option<f64>,
    /// Whether there is such a guarantee; else errors are what was measured.
    pub certified: bool,
    /// Unit of the integers of heights.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub unit: Option<f64>,
    /// The most that rounding to it cost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rounding: Option<f64>,
    /// Posts without data.
    pub voids: u64,
    /// Which domains ranges met.
    pub search: &'static str,
    /// Side of a voxel in units of the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub voxel: Option<f64>,
}

impl Request {
    /// The codec's options for samples of a unit. Refuses too many samples before anything is held for them.
    pub(super) fn options(&self, samples: u64, unit: f64) -> Result<Options> {
        let search = self.search.unwrap_or(if samples <= limits::FRACTAL_EXACT_SAMPLES_MAX {
            Search::Exact
        } else {
            Search::Near(NEAR)
        });
        limited(samples, search)?;
        let partition = match self.options.partition {
            Some(Partition::Tolerance(rms)) => Some(Partition::Tolerance(rms / unit)),
            Some(Partition::Slope(slope)) => Some(Partition::Slope(slope / unit / unit)),
            p => p,
        };
        Ok(Options { search, partition, step: self.options.step.map(|s| s / unit), ..self.options.clone() })
    }

    /// A weight a sample; nothing where all are 1. `position`: the place of a column and a row.
    fn weights(
        &self,
        [cols, rows]: [usize; 2],
        position: impl Fn(f64, f64) -> [f64; 2],
        notes: &mut Vec<String>,
    ) -> Vec<f32> {
        if self.interest.is_empty() {
            return Vec::new();
        }
        let mut weights = vec![1.0_f32; cols * rows];
        let mut met = vec![false; self.interest.len()];
        for (k, w) in weights.iter_mut().enumerate() {
            let [x, y] = position((k % cols) as f64, (k / cols) as f64);
            for (b, met) in self.interest.iter().zip(&mut met) {
                if (b[0]..=b[2]).contains(&x) && (b[1]..=b[3]).contains(&y) {
                    *w = w.max(b[4] as f32);
                    *met = true;
                }
            }
        }
        for (b, _) in self.interest.iter().zip(&met).filter(|(_, met)| !**met) {
            notes.push(format!(
                "no sample lies in the box of interest {},{},{},{}; its coordinates are those of the file",
                b[0], b[1], b[2], b[3]
            ));
        }
        weights
    }
}

/// Refuses too many samples.
fn limited(samples: u64, search: Search) -> Result<()> {
    if samples > limits::FRACTAL_POSTS_MAX {
        let what = "samples of a fractal tile (cut the file into tiles)";
        return Err(Error::limit(what, limits::FRACTAL_POSTS_MAX, samples));
    }
    if samples > limits::FRACTAL_FAR_POSTS_MAX && !matches!(search, Search::Near(_)) {
        let what = format!("samples of a fractal tile with --search {} (take near)", search_name(search));
        return Err(Error::limit(what, limits::FRACTAL_FAR_POSTS_MAX, samples));
    }
    Ok(())
}

/// Codes a grid. Memory: some 200 bytes a post.
///
/// # Errors
/// If what is asked cannot be; [`Error::Stopped`] when told not to go on.
pub fn send_heights(grid: &Grid, request: &Request, going: Going) -> Result<Sent> {
    let samples = (grid.cols * grid.rows) as u64;
    limited(samples, request.search.unwrap_or(Search::Near(NEAR)))?;
    let (units, mut notes) = units_of(grid, request)?;
    let Units { heights, mut place, rounding } = units;
    let unit = place.unit;
    let mut options = request.options(samples, unit)?;
    // A float32 comes back as the same one where its unit does. Where the codec errs, its last digits count too.
    let pairs = grid.z.par_iter().zip(&heights.z).filter(|(z, _)| !z.is_nan());
    let off = pairs.map(|(z, k)| (z - place.base - unit * f64::from(*k)).abs()).reduce(|| 0.0, f64::max);
    if let Some(asked) = request.bound {
        options.bound = Some(units_within("--bound", asked, off, unit)?.min(u64::from(BOUND_MAX)) as u32);
    }
    if options.bound != Some(0) {
        place.given_error = place.given_error.max(grid.given_error + off);
    }
    let affine = grid.affine.unwrap_or(PIXELS);
    let at =
        |c: f64, r: f64| [0, 1].map(|k| affine.origin[k] + c * affine.col_step[k] + r * affine.row_step[k]);
    let weights = request.weights([grid.cols, grid.rows], at, &mut notes);
    go_on(going, "maps", 0.0)?;
    let encoded = encode_heights(&heights, &place, &weights, &options, &Threads::new("maps", going))
        .map_err(|e| told("heights", e))?;
    // The decoder says what a receiver gets.
    let tile = Tile::read(&encoded.bytes).map_err(|e| told("the tile", e))?;
    let now: Vec<f64> = match options.bound {
        Some(_) => tile.heights().map_err(|e| told("the tile", e))?.z.into_iter().map(f64::from).collect(),
        None => tile.plane(0).map_err(|e| told("the tile", e))?.values,
    };
    let errors = grid.z.iter().zip(&now).filter(|(z, _)| !z.is_nan());
    let [mut error_max, error_rms] = summed(errors.map(|(z, k)| grid.change(*z, place.base + unit * k)));
    let error_bound = options.bound.map(|e| f64::from(e) * unit + place.given_error);
    if let Some(bound) = error_bound {
        // Heights are sums of doubles: their last digits are not the codec's.
        let high = grid.z.iter().filter(|z| !z.is_nan()).fold(place.base.abs(), |m, z| m.max(z.abs()));
        if error_max > bound + 8.0 * f64::EPSILON * high {
            let reason = format!("the decoder is off by {error_max}, {bound} was promised");
            return Err(Error::invalid("--bound", reason));
        }
        error_max = error_max.min(bound);
    }
    let told = SentTold {
        error_max,
        error_rms,
        error_bound,
        certified: error_bound.is_some(),
        unit: Some(unit),
        rounding: Some(rounding),
        voids: heights.void.iter().filter(|v| **v).count() as u64,
        ..numbers(&encoded, options.search)
    };
    Ok(Sent { bytes: encoded.bytes, told, notes })
}

/// The heights as integers: of the unit asked, or of one that is as fine as the bound needs.
fn units_of(grid: &Grid, request: &Request) -> Result<(Units, Vec<String>)> {
    let mut units = grid.in_units(request.unit.unwrap_or_else(|| grid.usual_unit()))?;
    let bound = request.bound.unwrap_or(f64::INFINITY);
    if request.unit.is_none() && bound > 0.0 {
        for _ in 0..FINER {
            if units.rounding <= bound {
                break;
            }
            let Ok(finer) = grid.in_units(units.place.unit / 10.0) else { break };
            units = finer;
        }
    }
    let mut notes = Vec::new();
    let (unit, rounding) = (units.place.unit, units.rounding);
    if rounding > bound && bound > 0.0 {
        return Err(Error::invalid(
            "--bound",
            format!(
                "{bound}; rounding heights to multiples of {unit} alone changes them by up to {rounding:.3e}; give a finer --unit or a greater bound"
            ),
        ));
    }
    if rounding > 0.0 && request.bound == Some(0.0) {
        notes.push(format!(
            "heights are rounded to multiples of {unit}, which changes them by up to {rounding:.3e}; a finer --unit changes less"
        ));
    }
    Ok((units, notes))
}

/// Codes a picture: grey if red, green and blue are the same everywhere.
///
/// # Errors
/// As [`send_heights`].
pub fn send_picture(picture: &mut Picture, request: &Request, going: Going) -> Result<Sent> {
    let info = picture.info().clone();
    if request.bound.is_some() {
        return Err(Error::invalid(
            "--bound",
            "is for heights; a picture states the error that was measured, give --maps, --const, --tolerance or --slope",
        ));
    }
    if request.unit.is_some() {
        return Err(Error::invalid("--unit", "is for heights; a picture has grey levels of 0 to 255"));
    }
    let samples = info.cols.saturating_mul(info.rows);
    let options = request.options(samples, 1.0)?;
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    go_on(going, "reading", 0.0)?;
    let pixels = picture.read(Window { col: 0, row: 0, cols, rows })?;
    let mut notes = Vec::new();
    let clear = pixels.void.iter().filter(|v| **v).count();
    if clear > 0 {
        notes.push(format!("{clear} transparent pixels are coded by their colours: a tile has no opacity"));
    }
    let grey = pixels.rgb.iter().all(|p| p[0] == p[1] && p[1] == p[2]);
    let bytes: Vec<u8> = match grey {
        true => pixels.rgb.iter().map(|p| p[0]).collect(),
        false => pixels.rgb.into_flattened(),
    };
    // Pixels cover squares: their middles lie half a pixel inside.
    let weights = request.weights([cols, rows], |c, r| [c + 0.5, r + 0.5], &mut notes);
    let workers = Threads::new("maps", going);
    let channels = if grey { 1 } else { 3 };
    let source = name_of(&info.file);
    let encoded = encode_picture([cols, rows], channels, &bytes, &source, &weights, &options, &workers)
        .map_err(|e| told("picture", e))?;
    let told = numbers(&encoded, options.search);
    Ok(Sent { bytes: encoded.bytes, told, notes })
}

/// What the head of a tile says.
pub(super) fn numbers(encoded: &Encoded, search: Search) -> SentTold {
    let h = &encoded.header;
    let bytes = encoded.bytes.len() as u64;
    SentTold {
        kind: kind_name(h.kind),
        bytes,
        size: h.size[..if h.kind == Kind::Volume { 3 } else { 2 }].to_vec(),
        samples: h.samples(),
        bits_per_sample: bytes as f64 * 8.0 / h.samples() as f64,
        maps: h.maps,
        psnr_db: psnr_db(h),
        error_max: h.error_max,
        error_rms: h.error_rms,
        error_bound: None,
        certified: false,
        unit: None,
        rounding: None,
        voids: 0,
        search: search_name(search),
        voxel: None,
    }
}

/// What samples are, in a word.
pub fn kind_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Heights => "heights",
        Kind::Grey => "grey",
        Kind::Colour => "colour",
        Kind::Volume => "volume",
    }
}

/// The greatest and the root mean square.
fn summed(errors: impl Iterator<Item = f64>) -> [f64; 2] {
    let (max, sum, count) =
        errors.fold((0.0_f64, 0.0, 0.0_f64), |(m, s, n), e| (m.max(e), s + e * e, n + 1.0));
    [max, (sum / count.max(1.0)).sqrt()]
}
