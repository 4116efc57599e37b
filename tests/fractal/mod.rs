//! Fractal tiles from files and to files: bounds, zooms, points, pictures, solids, what is cut or wrong.

mod heights;
mod pictures;
mod refusals;
mod solids;

use crate::support::{ground, printed};
use serde_json::Value;
use std::path::{Path, PathBuf};
use terraquilt::export::gtb::Grid;
use terraquilt::format;
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::height::crs::Crs;
use terraquilt::height::source::{Affine, SampleType};

/// A temporary folder, and names in it.
pub struct Folder(tempfile::TempDir);

impl Folder {
    pub fn new() -> Folder {
        Folder(tempfile::tempdir().unwrap())
    }
    pub fn path(&self, name: &str) -> String {
        self.0.path().join(name).to_str().unwrap().to_string()
    }
    /// What lies in it.
    pub fn files(&self) -> Vec<String> {
        let entries = std::fs::read_dir(self.0.path()).unwrap();
        let mut names: Vec<String> =
            entries.map(|e| e.unwrap().file_name().to_string_lossy().into_owned()).collect();
        names.sort();
        names
    }
}

pub fn json(args: &[&str]) -> Value {
    serde_json::from_str(&printed(&[args, &["--json"]].concat())).unwrap()
}

pub fn grid_of(path: &str) -> Grid {
    Grid::read(format::open(Path::new(path)).unwrap().as_mut(), &|_, _| true).unwrap()
}

/// Steps of posts, and where the first one lies.
pub const PLACE: Affine =
    Affine { origin: [560_000.0, 5_116_000.0], col_step: [10.0, 0.0], row_step: [0.0, -10.0] };

/// Writes ground as float32 GeoTIFF; NaN where `height` says so.
pub fn tif(path: &str, cols: usize, rows: usize, height: impl Fn(usize, usize) -> f64) {
    let spec = GeoTiffSpec {
        cols: cols as u64,
        rows: rows as u64,
        sample_type: SampleType::F32,
        affine: Some(PLACE),
        crs: Some(Crs::parse("EPSG:26910").unwrap()),
        nodata: Some("nan".into()),
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    };
    let mut tiff = GeoTiffWriter::create(Path::new(path), spec).unwrap();
    let heights = (0..cols * rows).map(|k| height(k % cols, k / cols) as f32);
    tiff.write_rows(0, &heights.flat_map(f32::to_le_bytes).collect::<Vec<u8>>()).unwrap();
    tiff.finish().unwrap();
}

/// Hills to the decimetre, with a hole.
pub fn hills(x: usize, y: usize) -> f64 {
    if (x as i64 - 30).pow(2) + (y as i64 - 12).pow(2) < 20 {
        return f64::NAN;
    }
    (ground(x as f64 * 10.0, y as f64 * 10.0) * 10.0).round() / 10.0
}

/// The greatest difference at posts with data; voids must be the same.
pub fn difference(a: &Grid, b: &Grid) -> f64 {
    assert_eq!((a.cols, a.rows), (b.cols, b.rows));
    assert!(a.z.iter().zip(&b.z).all(|(a, b)| a.is_nan() == b.is_nan()), "voids are others");
    a.z.iter().zip(&b.z).filter(|(a, _)| !a.is_nan()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

pub fn png(path: &str, size: [u32; 2], color: png::ColorType, depth: png::BitDepth, data: &[u8]) {
    let file = std::fs::File::create(PathBuf::from(path)).unwrap();
    let mut encoder = png::Encoder::new(file, size[0], size[1]);
    encoder.set_color(color);
    encoder.set_depth(depth);
    encoder.write_header().unwrap().write_image_data(data).unwrap();
}
