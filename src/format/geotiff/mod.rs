//! GeoTIFF: classic, BigTIFF and COG, read window by window; and written band of rows by band of rows.
//!
//! `GeoTiff` reads the first band of the first image. Its parts: `blocks` holds a file's strips or tiles
//! against its size and the limits before any is decoded; `georef` turns tags and GeoKeys into positions
//! and a CRS, with `projection` where the keys spell one out; `metadata` reads nodata, scale and offset; `stored` widens what no sample type holds; `lzma` decodes
//! the one compression that the library lacks. [`GeoTiffWriter`] writes.
//!
//! This folder is the only door to `tiff-reader` and `lzma-rust2` (decoding), `half`, and `flate2` (encoding). The layout of the bytes
//! is that of TIFF 6.0 (Adobe, 1992), BigTIFF (2007) and GeoTIFF 1.1 (OGC 19-008r4).

mod blocks;
mod georef;
mod lzma;
mod metadata;
mod projection;
mod read;
mod stored;
mod write;

pub(super) use metadata::shorten;
pub(super) use read::GeoTiff;
pub use write::{GeoTiffSpec, GeoTiffWriter};
