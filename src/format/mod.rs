//! Files that surveys come in, read as a [`HeightSource`], and GeoTIFF written back.
//!
//! [`open`] looks at a file's first bytes and its name and picks the reader: [`geotiff`] (TIFF, BigTIFF, COG)
//! or [`hgt`] (SRTM tiles). Readers hand out samples in the file's own type, window by window, and
//! mark voids; they never hold a whole file that comes in strips or tiles. [`voids`] decides which
//! samples are no height. Each folder is the only door to the library behind it.
//! Written are meshes ([`gltf`]), pictures ([`relief`], [`colour_map`]) and lines and polygons ([`geojson`]).

pub mod colour_map;
pub mod geojson;
pub mod geotiff;
pub mod gltf;
pub mod hgt;
pub mod relief;
mod voids;
mod window;

use crate::base::{Error, Result};
use crate::height::source::HeightSource;
use std::fs::File;
use std::io::{ErrorKind, Read};
use std::path::Path;

/// What is read, for messages.
const READ: &str = "read are GeoTIFF (.tif) and SRTM HGT (.hgt)";

/// Opens a survey file for reading; its header is read, no sample.
///
/// TIFF is recognised by its first bytes under any name, HGT by its name and size.
///
/// # Errors
/// [`Error::Missing`] if there is no such file; [`Error::Unsupported`] for directories, for other formats and
/// for encodings that are not read, naming the remedy; [`Error::Corrupt`] for damaged or empty files;
/// [`Error::Limit`] for headers that ask for more than `base::limits` allows.
pub fn open(path: &Path) -> Result<Box<dyn HeightSource>> {
    let name = path.display().to_string();
    let meta = std::fs::metadata(path).map_err(|e| match e.kind() {
        ErrorKind::NotFound => Error::missing(format!("file {name}"), "check the name"),
        _ => Error::io(path, e),
    })?;
    if meta.is_dir() {
        return Err(Error::unsupported(name, "a directory, not a survey file", "name the files inside it"));
    }
    if !meta.is_file() {
        // A pipe would block for ever.
        return Err(Error::unsupported(name, "not a regular file", "copy it into one"));
    }
    let file = File::open(path).map_err(|e| Error::io(path, e))?;
    let mut head = Vec::new();
    file.take(HEAD_BYTES).read_to_end(&mut head).map_err(|e| Error::io(path, e))?;
    match kind_of(&name, &head)? {
        Kind::Tiff => Ok(Box::new(geotiff::GeoTiff::open(path)?)),
        Kind::Hgt => Ok(Box::new(hgt::Hgt::open(path)?)),
    }
}

/// Opens a survey file that lies in memory; `name` plays the part of the file name.
///
/// # Errors
/// As [`open`].
pub fn open_bytes(name: &str, bytes: Vec<u8>) -> Result<Box<dyn HeightSource>> {
    let head = &bytes[..bytes.len().min(HEAD_BYTES as usize)];
    match kind_of(name, head)? {
        Kind::Tiff => Ok(Box::new(geotiff::GeoTiff::from_bytes(name, bytes)?)),
        Kind::Hgt => Ok(Box::new(hgt::Hgt::from_bytes(name, bytes)?)),
    }
}

enum Kind {
    Tiff,
    Hgt,
}

/// Enough of a file to know its kind.
const HEAD_BYTES: u64 = 16;

fn kind_of(name: &str, head: &[u8]) -> Result<Kind> {
    if head.is_empty() {
        return Err(Error::corrupt(name, "file", "it is empty (0 bytes)"));
    }
    let tiff = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];
    if tiff.iter().any(|magic| head.starts_with(*magic)) {
        return Ok(Kind::Tiff);
    }
    let extension = Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
    if extension == "hgt" {
        return Ok(Kind::Hgt);
    }
    if head.starts_with(b"PK") {
        return Err(Error::unsupported(name, format!("a zip archive; {READ}"), "unzip it first"));
    }
    if head.starts_with(&[0x1f, 0x8b]) {
        return Err(Error::unsupported(name, format!("a gzip file; {READ}"), "gunzip it first"));
    }
    if extension == "tif" || extension == "tiff" {
        let shown: Vec<String> = head.iter().take(4).map(|b| format!("{b:02x}")).collect();
        let reason = format!("a TIFF begins with II or MM, this file with bytes {}", shown.join(" "));
        return Err(Error::corrupt(name, "header at byte 0", reason));
    }
    let found = if head.starts_with(b"\x89PNG") {
        "a PNG picture"
    } else if head.starts_with(&[0xff, 0xd8, 0xff]) {
        "a JPEG picture"
    } else if head.starts_with(b"\x89HDF") || head.starts_with(b"CDF") {
        "netCDF or HDF5"
    } else if head.starts_with(b"UHL1") {
        "DTED"
    } else if head.len() >= 5 && head[..5].eq_ignore_ascii_case(b"ncols") {
        "an Esri ASCII grid"
    } else {
        "a format that is not known by its first bytes"
    };
    Err(Error::unsupported(
        name,
        format!("{found}; {READ}"),
        "convert it with: gdal_translate -of GTiff -co COMPRESS=DEFLATE INPUT OUTPUT.tif",
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(result: Result<Box<dyn HeightSource>>) -> String {
        match result {
            Ok(_) => panic!("opened"),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn what_is_not_read_is_named_with_a_remedy_in_one_line() {
        let cases: [(&str, &[u8], &str); 7] = [
            ("a.zip", b"PK\x03\x04", "zip"),
            ("a.png", b"\x89PNG\r\n", "PNG"),
            ("a.asc", b"NCOLS 4\nnrows", "ASCII"),
            ("a.dt1", b"UHL1086", "DTED"),
            ("a.flt", &[0, 0, 0, 0], "gdal_translate"),
            ("a.tif", b"junk", "6a 75 6e 6b"),
            ("empty.tif", b"", "empty"),
        ];
        for (name, bytes, word) in cases {
            let line = text(open_bytes(name, bytes.to_vec()));
            assert!(line.contains(word) && line.contains(name) && !line.contains('\n'), "{line}");
        }
        assert!(text(open(Path::new("no/such/file.tif"))).contains("not found"));
        assert!(text(open(Path::new("."))).contains("directory"));
    }
}
