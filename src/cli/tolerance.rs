//! Reading a raster of tolerances.

use super::output::message;
use crate::base::round::up_f32;
use crate::base::{Error, Result, limits};
use crate::format;
use crate::height::crs::Crs;
use crate::height::lod::cut::ErrorRaster;
use crate::height::source::Window;
use std::path::Path;

/// Reads tolerances in metres from a grid in the CRS of the database. Every post needs one.
pub fn read_raster(path: &Path, database: &Crs) -> Result<ErrorRaster> {
    let name = path.display().to_string();
    let mut source = format::open(path)?;
    let info = source.info().clone();
    let posts = info.cols.saturating_mul(info.rows);
    if posts > limits::TOLERANCE_POSTS_MAX {
        return Err(Error::limit(format!("posts of {name}"), limits::TOLERANCE_POSTS_MAX, posts));
    }
    let Some(affine) = info.affine else {
        return Err(Error::invalid(
            name,
            "has no georeference; say where it lies with gdal_translate -a_ullr",
        ));
    };
    match &info.crs {
        Some(crs) if !crs.same_as(database) => {
            return Err(Error::unsupported(
                name,
                format!("its tolerances are in {}, the database is in {}", crs.code, database.code),
                format!("warp it first: gdalwarp -t_srs {} INPUT OUTPUT.tif", database.code),
            ));
        }
        Some(_) => {}
        None => message(&format!("note: {name} names no CRS and is taken to be in {}", database.code)),
    }
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    let mut values: Vec<f32> = Vec::with_capacity(cols * rows);
    let batch = source.row_batch().min(limits::WINDOW_POSTS_MAX as usize / cols.max(1)).max(1);
    for row in (0..rows).step_by(batch) {
        let window = Window { col: 0, row: row as u64, cols, rows: batch.min(rows - row) };
        let samples = source.read(window)?;
        let each = samples.data.chunks_exact(info.sample_type.bytes()).zip(&samples.valid);
        for (k, (sample, valid)) in each.enumerate() {
            let value = info.sample_type.value(sample) * info.scale + info.offset;
            if *valid == 0 || !(value >= 0.0 && value.is_finite()) {
                let what = if *valid == 0 { "no value".to_string() } else { format!("{value}") };
                let reason = format!(
                    "{what} in column {}, row {}; every post needs an error of 0 or more, in metres (gdal_fillnodata.py \
                     fills voids)",
                    k % cols,
                    row + k / cols
                );
                return Err(Error::invalid(name, reason));
            }
            // Rounded down: never more than the file allows.
            values.push(-up_f32(-value));
        }
    }
    ErrorRaster::new(cols, rows, values, &affine)
}
