//! A grid as GeoTIFF, bit for bit where it can be.

use super::Grid;
use crate::base::Result;
use crate::export::{Going, go_on};
use crate::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
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

/// What samples of a file may be.
#[derive(Clone, Debug, Default)]
pub struct Samples {
    /// All are whole numbers, and may be written as such.
    pub whole: bool,
    /// Heights come back as the same float32 that they were.
    pub single: bool,
    /// Float32 may round by an eighth of this: the unit of the heights, or less.
    pub unit: f64,
    /// What the file says of them, if anything.
    pub description: Option<String>,
}

/// Writes heights, at the posts of the grid: int16 or int32 if they are whole, else float32, or float64 where float32 would round
/// by more than an eighth of the unit.
///
/// # Errors
/// What writing meets.
pub fn write_tif(
    out: &mut (impl Write + Seek),
    grid: &Grid,
    samples: &Samples,
    going: Going,
) -> Result<RasterTold> {
    let z = &grid.z;
    let rounded = |z: &f64| if z.is_nan() { 0.0 } else { (f64::from(*z as f32) - z).abs() };
    let single = z.iter().map(rounded).fold(0.0, f64::max);
    let data = || z.iter().filter(|z| !z.is_nan());
    let (low, high) = data().fold((0.0f64, 0.0f64), |(l, h), z| (l.min(*z), h.max(*z)));
    let (sample_type, nodata) = match (samples.whole, z.iter().any(|z| z.is_nan())) {
        (true, false) if low >= -32768.0 && high <= 32767.0 => (SampleType::I16, None),
        (true, true) if low > -32768.0 && high <= 32767.0 => (SampleType::I16, Some(-32768.0)),
        (true, false) if low >= -2147483648.0 && high <= 2147483647.0 => (SampleType::I32, None),
        (true, true) if low > -2147483648.0 && high <= 2147483647.0 => (SampleType::I32, Some(-2147483648.0)),
        _ if single > samples.unit / 8.0 => (SampleType::F64, Some(f64::NAN)),
        _ => (SampleType::F32, Some(f64::NAN)),
    };
    let spec = GeoTiffSpec {
        cols: grid.cols as u64,
        rows: grid.rows as u64,
        sample_type,
        affine: grid.affine,
        crs: grid.crs.clone(),
        nodata: nodata.map(|v: f64| if v.is_nan() { "nan".into() } else { format!("{v}") }),
        scale: 1.0,
        offset: 0.0,
        // The file can say what metres count from.
        vertical_datum: grid.vertical_datum.clone().filter(|_| grid.vertical_unit_m.is_none_or(|m| m == 1.0)),
    };
    let void = nodata.unwrap_or(0.0);
    let mut tiff = GeoTiffWriter::new(out, "the file to write".into(), spec)?;
    let mut bytes = Vec::new();
    for (k, band) in z.chunks(BAND * grid.cols).enumerate() {
        go_on(going, "writing", (k * BAND) as f64 / grid.rows as f64)?;
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
    if let Some(text) = &samples.description {
        tiff.describe(text);
    }
    tiff.finish()?;
    // The sender saw that heights without an error come back as the same float32.
    let rounding = if sample_type == SampleType::F32 && !samples.single { single } else { 0.0 };
    let (cols, rows) = (grid.cols as u64, grid.rows as u64);
    Ok(RasterTold { cols, rows, samples: sample_type.name(), rounding })
}
