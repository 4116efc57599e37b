//! Files that surveys come in, read as a [`HeightSource`], and what is written for others: GeoTIFF, GLB, PNG, GeoJSON.
//!
//! [`open`] looks at a file's first bytes, at what lies beside it and at its name, and picks the reader (`kind`).
//! Readers hand out samples in the file's own type, window by window, and mark voids; of files that come in
//! strips, tiles or rows they never hold the whole. `voids` decides which samples are no height. Each outside
//! library has one door here.
//!
//! | format | reader |
//! |---|---|
//! | TIFF, BigTIFF, COG | [`geotiff`] |
//! | SRTM tiles | `hgt` |
//! | DTED levels 0 to 2 | `dted` |
//! | Esri ASCII grid | `ascii` |
//! | Esri `.flt`, `.bil`, `.bip`, `.bsq` with `.hdr` | `esri` |
//! | ENVI with `.hdr` | `envi` |
//! | USGS ASCII DEM | `usgs` |
//! | greyscale PNG | `gray_png` |
//! | one of these in a zip | `archive` |
//!
//! [`picture`] reads GeoTIFF and PNG for their colours, [`solid`] PLY, GLB and glTF for their triangles.

mod archive;
mod ascii;
pub mod colour_map;
mod dted;
mod envi;
mod esri;
pub mod geoid;
pub mod geojson;
pub mod geotiff;
pub mod gltf;
mod gray_png;
mod hgt;
mod input;
mod kind;
pub mod picture;
pub mod ply;
mod raw;
pub mod relief;
mod sidecar;
pub mod solid;
mod usgs;
mod voids;
mod window;

use crate::base::Result;
use crate::height::source::{HeightSource, SourceInfo};
use input::Input;
use sidecar::Beside;
use std::path::Path;

/// Opens a survey file for reading. Its headers are read; of texts (Esri ASCII, USGS DEM) every number is looked at
/// once, and of an archive the one member is unpacked.
///
/// # Errors
/// [`Error::Missing`](crate::base::Error::Missing) if there is no such file, or no header beside a grid that needs
/// one; [`Error::Unsupported`](crate::base::Error::Unsupported) for directories, for other formats and for encodings
/// that are not read, naming the remedy; [`Error::Corrupt`](crate::base::Error::Corrupt) for damaged or empty files;
/// [`Error::Limit`](crate::base::Error::Limit) for headers that ask for more than `base::limits` allows.
pub fn open(path: &Path) -> Result<Box<dyn HeightSource>> {
    kind::open(Input::open(path)?)
}

/// Opens a survey file that lies in memory, with nothing beside it; `name` plays the part of the file name.
///
/// # Errors
/// As [`open`].
pub fn open_bytes(name: &str, bytes: Vec<u8>) -> Result<Box<dyn HeightSource>> {
    kind::open(Input::memory(name, bytes, Beside::Nothing))
}

/// Opens a survey file that lies in memory, among sidecars in memory (name, bytes).
///
/// # Errors
/// As [`open`].
pub fn open_bytes_beside(
    name: &str,
    bytes: Vec<u8>,
    sidecars: Vec<(String, Vec<u8>)>,
) -> Result<Box<dyn HeightSource>> {
    kind::open(Input::memory(name, bytes, Beside::Archive(sidecars.into())))
}

/// Reads samples that stand uncompressed in a file, little-endian, in rows `row_bytes` apart from byte `at` on. `info` says what
/// they are; voids are those of its nodata value.
///
/// # Errors
/// If the file is missing or too short, or there are too many posts.
pub fn open_rows(path: &Path, info: SourceInfo, at: u64, row_bytes: u64) -> Result<Box<dyn HeightSource>> {
    let sample_stride = info.sample_type.bytes() as u64;
    let layout = raw::Layout { at, sample_stride, row_stride: row_bytes, big_endian: false };
    Ok(Box::new(raw::RawGrid::new(info, Input::open(path)?, layout)?))
}
