//! The surface of a prefix as GeoTIFF, bit for bit where it is whole, and as a shaded picture.

use super::prefix::Prefix;
use crate::base::Result;
use crate::db::metres_per_unit;
use crate::export::{Going, go_on};
use crate::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use crate::format::relief::{Relief, write_painted_relief};
use crate::height::crs::AxisUnit;
use crate::height::source::SampleType;
use serde::Serialize;
use std::io::{Seek, Write};

/// Rows between two looks at whether to go on.
const BAND: usize = 256;

/// What there is to say of a raster.
#[derive(Clone, Debug, Serialize)]
pub struct RasterTold {
    /// Posts in a row.
    pub cols: u64,
    /// Rows.
    pub rows: u64,
    /// Type of the samples.
    pub samples: &'static str,
    /// What rounding to that type adds to the error, in the unit of heights.
    pub rounding: f64,
}

/// Writes heights, at the posts of the source: int16 or int32 if they are whole, else float32, or float64 where float32 would round
/// by more than an eighth of the unit.
///
/// # Errors
/// What writing meets.
pub fn write_tif(out: &mut (impl Write + Seek), p: &Prefix, going: Going) -> Result<RasterTold> {
    let z = &p.grid.z;
    let rounded = |z: &f64| if z.is_nan() { 0.0 } else { (f64::from(*z as f32) - z).abs() };
    let single = z.iter().map(rounded).fold(0.0, f64::max);
    let data = || z.iter().filter(|z| !z.is_nan());
    let (low, high) = data().fold((0.0f64, 0.0f64), |(l, h), z| (l.min(*z), h.max(*z)));
    let place = &p.header.place;
    let exact = p.reached.complete && p.reached.error_bound == 0.0;
    let (sample_type, nodata) = match (p.reached.complete && p.is_whole(), z.iter().any(|z| z.is_nan())) {
        (true, false) if low >= -32768.0 && high <= 32767.0 => (SampleType::I16, None),
        (true, true) if low > -32768.0 && high <= 32767.0 => (SampleType::I16, Some(-32768.0)),
        (true, false) if low >= -2147483648.0 && high <= 2147483647.0 => (SampleType::I32, None),
        (true, true) if low > -2147483648.0 && high <= 2147483647.0 => (SampleType::I32, Some(-2147483648.0)),
        _ if single > place.unit / 8.0 => (SampleType::F64, Some(f64::NAN)),
        _ => (SampleType::F32, Some(f64::NAN)),
    };
    let spec = GeoTiffSpec {
        cols: p.grid.cols as u64,
        rows: p.grid.rows as u64,
        sample_type,
        affine: p.grid.affine,
        crs: p.grid.crs.clone(),
        nodata: nodata.map(|v: f64| if v.is_nan() { "nan".into() } else { format!("{v}") }),
        scale: 1.0,
        offset: 0.0,
        // The file can say what metres count from.
        vertical_datum: p
            .grid
            .vertical_datum
            .clone()
            .filter(|_| p.grid.vertical_unit_m.is_none_or(|m| m == 1.0)),
    };
    let void = nodata.unwrap_or(0.0);
    let mut tiff = GeoTiffWriter::new(out, "the file to write".into(), spec)?;
    let mut bytes = Vec::new();
    for (k, band) in z.chunks(BAND * p.grid.cols).enumerate() {
        go_on(going, "writing", (k * BAND) as f64 / p.grid.rows as f64)?;
        bytes.clear();
        for z in band.iter().map(|z| if z.is_nan() { void } else { *z }) {
            match sample_type {
                SampleType::I16 => bytes.extend((z as i16).to_le_bytes()),
                SampleType::I32 => bytes.extend((z as i32).to_le_bytes()),
                SampleType::F64 => bytes.extend(z.to_le_bytes()),
                _ => bytes.extend((z as f32).to_le_bytes()),
            }
        }
        tiff.write_rows((k * BAND) as u64, &bytes)?;
    }
    tiff.finish()?;
    // The sender saw that heights without an error come back as the same float32.
    let rounding = if sample_type == SampleType::F32 && !exact { single } else { 0.0 };
    let samples = sample_type.name();
    Ok(RasterTold { cols: p.grid.cols as u64, rows: p.grid.rows as u64, samples, rounding })
}

/// Draws a shaded relief, north up as far as rows and columns allow, in the colours of the picture if there is one.
///
/// # Errors
/// What writing meets.
pub fn write_picture(out: &mut dyn Write, p: &Prefix, going: Going) -> Result<RasterTold> {
    go_on(going, "picture", 0.0)?;
    let (cols, rows) = (p.grid.cols, p.grid.rows);
    let (flip, mirror) = p.grid.affine.map_or((false, false), |a| (a.row_step[1] > 0.0, a.col_step[0] < 0.0));
    let source = |k: usize| {
        let (row, col) = (k / cols, k % cols);
        let row = if flip { rows - 1 - row } else { row };
        row * cols + if mirror { cols - 1 - col } else { col }
    };
    let unit_m = p.grid.vertical_unit_m.unwrap_or(1.0);
    let z: Vec<f32> = (0..cols * rows).map(|k| (p.grid.z[source(k)] * unit_m) as f32).collect();
    let paint = p.picture.as_ref().map(|cells| {
        let side = 1usize << cells.n;
        let last = p.header.lattice.last();
        let of = |k: usize| {
            let cell = |post: usize| (post * side / last).min(side - 1);
            let at = cell(source(k) / cols) * side + cell(source(k) % cols);
            (!cells.void.get(at).copied().unwrap_or(false)).then(|| cells.rgb[at])
        };
        (0..cols * rows).map(of).collect::<Vec<Option<[u8; 3]>>>()
    });
    let cell_m = match p.grid.affine {
        None => [1.0; 2],
        Some(a) => {
            let at = [0, 1]
                .map(|k| a.origin[k] + (cols / 2) as f64 * a.col_step[k] + (rows / 2) as f64 * a.row_step[k]);
            let unit = p.grid.crs.as_ref().map_or(AxisUnit::Metre(1.0), |c| c.unit);
            let m = metres_per_unit(unit, at);
            let length = |s: [f64; 2]| (s[0] * m[0]).hypot(s[1] * m[1]);
            [length(a.col_step), length(a.row_step)]
        }
    };
    let relief = Relief { cols, rows, z: &z, cell_m, class: None, class_range: None };
    write_painted_relief(out, &relief, paint.as_deref())?;
    Ok(RasterTold { cols: cols as u64, rows: rows as u64, samples: "picture", rounding: 0.0 })
}
