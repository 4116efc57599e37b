//! Commands that measure the surface: profile, sight, statistics, contours, slope, aspect, hillshade, volume, difference,
//! contradictions.

mod change;
mod contradictions;
mod line;
mod region;
mod shape;

pub use change::{Difference, Volume};
pub use contradictions::Contradictions;
pub use line::{Profile, SightCommand};
pub use region::{ContoursCommand, StatisticsCommand};
pub use shape::{Aspect, Hillshade, Slope};

use super::args::numbers;
use super::export::write_whole;
use super::output::{Meter, bytes, message, stop_flag};
use super::place::Place;
use crate::analysis::{Grid, Ground};
use crate::base::{Error, Result};
use crate::format::colour_map::{ColourMap, Ramp, write_colour_map};
use crate::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use crate::height::crs::Crs;
use crate::height::source::{Affine, SampleType};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;
use std::sync::atomic::Ordering;

/// Cells along the longer side of a picture.
const PICTURE_SIDE: usize = 1600;

/// `--step X` or `X,Y` in CRS units.
fn step(text: Option<&str>) -> Result<Option<[f64; 2]>> {
    match text {
        None => Ok(None),
        Some(t) if t.contains(',') => numbers("--step", t).map(Some),
        Some(t) => {
            let [x] = numbers("--step", t)?;
            Ok(Some([x, x]))
        }
    }
}

/// Says that a raster is not written in the coordinates that the region was given in.
fn stays(place: &Place, s: &dyn Ground) {
    if let Some(c) = &place.coords {
        message(&format!(
            "note: the region is read in {}; the raster is in the database's {}",
            c.crs.code,
            s.crs().code
        ));
    }
}

/// Works with a bar on the terminal, until it is done or stopped.
fn metered<R>(stage: &str, work: impl FnOnce(&dyn Fn(f64) -> bool) -> Result<R>) -> Result<R> {
    let meter = Meter::new();
    let stop = stop_flag();
    let done = work(&|share| {
        meter.report(stage, share);
        !stop.load(Ordering::Relaxed)
    });
    meter.clear();
    done
}

fn ending(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// The ending is none of those that the command writes.
fn no_format(path: &Path, known: &str) -> Error {
    let found = match ending(path).as_str() {
        "" => "has no ending that names a format".to_string(),
        other => format!("ending '.{other}' is no format that is written here"),
    };
    Error::unsupported(path.display(), found, format!("name a {known} file"))
}

/// Size of a file, for people.
fn size_of(path: &Path) -> String {
    bytes(std::fs::metadata(path).map_or(0, |m| m.len()))
}

fn create(path: &Path) -> Result<BufWriter<File>> {
    Ok(BufWriter::new(File::create(path).map_err(|e| Error::io(path, e))?))
}

/// How a raster is written: what its PNG looks like.
struct Picture {
    ramp: Ramp,
    /// `None`: symmetric about 0, by what is there.
    range: Option<[f32; 2]>,
    unit: &'static str,
    legend: bool,
}

/// Writes values over a grid, row by row as `rows` hands them over, as float32 GeoTIFF or as PNG.
fn write_raster(
    path: &Path,
    grid: &Grid,
    crs: &Crs,
    picture: &Picture,
    rows: impl FnOnce(&mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()>,
) -> Result<()> {
    if ending(path) == "png" {
        let mut values = Vec::with_capacity(grid.cols * grid.rows);
        rows(&mut |_, row| {
            values.extend_from_slice(row);
            Ok(())
        })?;
        return write_picture(path, [grid.cols, grid.rows], &values, picture);
    }
    let [sx, sy] = grid.step;
    let spec = GeoTiffSpec {
        cols: grid.cols as u64,
        rows: grid.rows as u64,
        sample_type: SampleType::F32,
        affine: Some(Affine { origin: grid.centre(0, 0), col_step: [sx, 0.0], row_step: [0.0, -sy] }),
        crs: Some(crs.clone()),
        nodata: Some("nan".into()),
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    };
    write_whole(path, |p| {
        let mut out = GeoTiffWriter::create(p, spec)?;
        rows(&mut |row, values| {
            let data: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
            out.write_rows(row as u64, &data)
        })?;
        out.finish().map(|_| ())
    })
}

/// Writes a coloured picture with a legend.
fn write_picture(path: &Path, [cols, rows]: [usize; 2], values: &[f32], picture: &Picture) -> Result<()> {
    let range = picture.range.unwrap_or_else(|| {
        let far = common(values.iter().map(|v| v.abs()));
        [-far, far]
    });
    write_whole(path, |p| {
        let mut out = create(p)?;
        let map = ColourMap {
            cols,
            rows,
            values,
            ramp: picture.ramp,
            range,
            unit: picture.unit,
            legend: picture.legend,
        };
        write_colour_map(&mut out, &map)?;
        out.flush().map_err(|e| Error::io(p, e))
    })
}

/// What all but one in 200 values stay below, rounded up to two digits; 1 if all are 0.
fn common(values: impl Iterator<Item = f32>) -> f32 {
    let mut all: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    all.sort_by(f32::total_cmp);
    let q = all.get(all.len().saturating_sub(1 + all.len() / 200)).copied().unwrap_or(0.0);
    if q <= 0.0 {
        return 1.0;
    }
    let unit = 10f32.powf(q.log10().floor() - 1.0);
    (q / unit).ceil() * unit
}
