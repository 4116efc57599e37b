//! Geoid grids from files: GTX (NOAA VDatum, the older format of PROJ) and GeoTIFF in degrees.

use super::geotiff::GeoTiff;
use super::input::Input;
use super::sidecar::Beside;
use crate::base::limits::{GEOID_POSTS_MAX, WINDOW_POSTS_MAX};
use crate::base::{Error, Result};
use crate::height::crs::AxisUnit;
use crate::height::crs::geoid::Geoid;
use crate::height::source::{HeightSource, Window};
use std::path::Path;

/// Bytes before the values of a GTX file: latitude, longitude, their steps (doubles), rows, columns (integers).
const GTX_HEADER: usize = 40;
/// GTX writes this where it has no value.
const GTX_NONE: f32 = -88.8888;

/// Opens a geoid grid: `.gtx`, or GeoTIFF by its first bytes. The whole grid is held in memory.
///
/// # Errors
/// [`Error::Missing`] if there is no such file, [`Error::Corrupt`] if it is damaged, [`Error::Limit`] if it is too
/// large, [`Error::Unsupported`] for other formats and for grids that are not in degrees.
pub fn open(path: &Path) -> Result<Geoid> {
    let name = path.display().to_string();
    let size = match std::fs::metadata(path) {
        Ok(meta) if meta.is_file() => meta.len(),
        Ok(_) => return Err(Error::unsupported(name, "not a regular file", "name a .gtx or .tif file")),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => {
            return Err(Error::missing(format!("geoid grid {name}"), "check the name"));
        }
        Err(e) => return Err(Error::io(path, e)),
    };
    let bytes_max = GTX_HEADER as u64 + 4 * GEOID_POSTS_MAX;
    if size > bytes_max {
        return Err(Error::limit(format!("bytes of geoid grid {name}"), bytes_max, size));
    }
    if is_gtx(&name) {
        return gtx(&name, &std::fs::read(path).map_err(|e| Error::io(path, e))?);
    }
    from_tiff(&name, GeoTiff::open(Input::open(path)?)?)
}

/// Opens a geoid grid that lies in memory; `name` plays the part of the file name.
///
/// # Errors
/// As [`open`].
pub fn open_bytes(name: &str, bytes: Vec<u8>) -> Result<Geoid> {
    if is_gtx(name) {
        return gtx(name, &bytes);
    }
    from_tiff(name, GeoTiff::open(Input::memory(name, bytes, Beside::Nothing))?)
}

fn is_gtx(name: &str) -> bool {
    Path::new(name).extension().is_some_and(|e| e.eq_ignore_ascii_case("gtx"))
}

fn gtx(name: &str, bytes: &[u8]) -> Result<Geoid> {
    let short = || Error::corrupt(name, "header", format!("{} bytes, 40 at least", bytes.len()));
    let (header, body) = bytes.split_at_checked(GTX_HEADER).ok_or_else(short)?;
    let double = |i: usize| f64::from_be_bytes(std::array::from_fn(|k| header[8 * i + k]));
    let int = |i: usize| i32::from_be_bytes(std::array::from_fn(|k| header[32 + 4 * i + k]));
    let (south, west, step_lat, step_lon) = (double(0), double(1), double(2), double(3));
    let (Ok(rows), Ok(cols)) = (u64::try_from(int(0)), u64::try_from(int(1))) else {
        return Err(Error::corrupt(name, "header", format!("{} rows and {} columns", int(0), int(1))));
    };
    let posts = rows * cols;
    if posts > GEOID_POSTS_MAX {
        return Err(Error::limit(format!("posts of {name}"), GEOID_POSTS_MAX, posts));
    }
    if body.len() as u64 != 4 * posts {
        return Err(Error::corrupt(
            name,
            "length",
            format!("{rows} rows of {cols} values take {} bytes, {} are there", 4 * posts, body.len()),
        ));
    }
    let value = |b: &[u8]| {
        let v = f32::from_be_bytes(std::array::from_fn(|k| b[k]));
        if (v - GTX_NONE).abs() < 1e-3 { f32::NAN } else { v }
    };
    let values = body.chunks_exact(4).map(value).collect();
    Geoid::new(name, [west, south], [step_lon, step_lat], [cols as usize, rows as usize], values)
}

fn from_tiff(name: &str, mut source: GeoTiff) -> Result<Geoid> {
    let info = source.info().clone();
    let posts = info.cols.saturating_mul(info.rows);
    if posts > GEOID_POSTS_MAX {
        return Err(Error::limit(format!("posts of {name}"), GEOID_POSTS_MAX, posts));
    }
    let wrong = |what: &str| {
        Error::unsupported(name, format!("a geoid grid {what}"), "give one in degrees (EPSG:4326), north up")
    };
    if info.crs.as_ref().is_some_and(|crs| crs.unit != AxisUnit::Degree) {
        return Err(wrong("in a projected system"));
    }
    let a = info.affine.ok_or_else(|| wrong("without a georeference"))?;
    let upright = a.col_step[1] == 0.0 && a.row_step[0] == 0.0 && a.col_step[0] > 0.0 && a.row_step[1] != 0.0;
    if !upright {
        return Err(wrong("that is rotated or mirrored"));
    }
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    let north_up = a.row_step[1] < 0.0;
    let mut values = vec![f32::NAN; cols * rows];
    let batch = ((WINDOW_POSTS_MAX / info.cols.max(1)).clamp(1, 256)) as usize;
    for row in (0..rows).step_by(batch) {
        let count = batch.min(rows - row);
        let samples = source.read(Window { col: 0, row: row as u64, cols, rows: count })?;
        let bytes = info.sample_type.bytes();
        for (i, (b, valid)) in samples.data.chunks_exact(bytes).zip(&samples.valid).enumerate() {
            if *valid == 1 {
                let from_top = row + i / cols;
                let at = if north_up { rows - 1 - from_top } else { from_top };
                values[at * cols + i % cols] = (info.sample_type.value(b) * info.scale + info.offset) as f32;
            }
        }
    }
    let south = if north_up { a.origin[1] + a.row_step[1] * (rows - 1) as f64 } else { a.origin[1] };
    Geoid::new(name, [a.origin[0], south], [a.col_step[0], a.row_step[1].abs()], [cols, rows], values)
}
