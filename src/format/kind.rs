//! What kind of file it is: by its first bytes, then by a header beside it, then by its name.

use super::archive::Zipped;
use super::ascii::{self, AsciiGrid};
use super::dted::{self, Dted};
use super::geotiff::GeoTiff;
use super::gray_png::GrayPng;
use super::input::Input;
use super::sidecar::{self, Sidecar};
use super::usgs::{self, UsgsDem};
use super::{envi, esri, hgt};
use crate::base::{Error, Result};
use crate::height::source::HeightSource;
use std::path::Path;

/// What is read, for messages.
const READ: &str = "read are GeoTIFF, HGT, DTED, Esri ASCII and float grids, ENVI, USGS DEM, greyscale PNG, and these zipped";
const CONVERT: &str = "convert it with: gdal_translate -of GTiff -co COMPRESS=DEFLATE INPUT OUTPUT.tif";
/// Enough of a file to know its kind: the header of a USGS DEM.
const HEAD_BYTES: usize = 1024;
/// Extensions of grids, in archives and beside a header.
const GRIDS: [&str; 16] = [
    "tif", "tiff", "hgt", "asc", "dt0", "dt1", "dt2", "dem", "png", "flt", "bil", "bip", "bsq", "img", "dat",
    "raw",
];
/// Extensions of raw grids, which are nothing without their header.
const RAW: [&str; 4] = ["flt", "bil", "bip", "bsq"];
/// Extensions of what lies beside grids.
pub const SIDECARS: [&str; 16] = [
    "hdr", "prj", "xml", "wld", "pgw", "pngw", "tfw", "ovr", "msk", "txt", "pdf", "htm", "html", "md", "jpg",
    "stx",
];

/// Opens a survey file or an archive with one.
pub fn open(input: Input) -> Result<Box<dyn HeightSource>> {
    let head = input.head(4)?;
    if head.starts_with(b"PK\x03\x04") || head.starts_with(b"PK\x05\x06") {
        return Ok(Box::new(Zipped::open(input)?));
    }
    open_plain(input)
}

/// Opens a survey file that is no archive.
pub fn open_plain(input: Input) -> Result<Box<dyn HeightSource>> {
    let head = input.head(HEAD_BYTES)?;
    let name = input.file.clone();
    if head.is_empty() {
        return Err(Error::corrupt(name, "file", "it is empty (0 bytes)"));
    }
    let extension = extension_of(&name);
    let tiff = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];
    if tiff.iter().any(|magic| head.starts_with(*magic)) {
        return Ok(Box::new(GeoTiff::open(input)?));
    }
    if head.starts_with(b"\x89PNG\r\n\x1a\n") {
        return Ok(Box::new(GrayPng::open(input)?));
    }
    if dted::begins(&head) {
        return Ok(Box::new(Dted::open(input)?));
    }
    if extension == "hgt" {
        return Ok(Box::new(hgt::open(input)?));
    }
    if let Some(found) = foreign(&head) {
        let remedy = if found.contains("zip") { "unpack it first" } else { CONVERT };
        return Err(Error::unsupported(name, format!("{found}; {READ}"), remedy));
    }
    if extension == "hdr" && is_header(&String::from_utf8_lossy(&head)) {
        return open_by_header(&input);
    }
    if ascii::begins(&head) {
        return Ok(Box::new(AsciiGrid::open(input)?));
    }
    if usgs::begins(&head) {
        return Ok(Box::new(UsgsDem::open(input)?));
    }
    if SIDECARS.contains(&extension.as_str()) {
        return Err(Error::unsupported(name, "no grid, but what lies beside one", "name the grid itself"));
    }
    let headers = sidecar::names(&name, &["hdr"]);
    if let Some(header) = input.beside.find(&headers)?
        && is_header(&header.text)
    {
        return open_raw(input, &header);
    }
    if RAW.contains(&extension.as_str()) {
        return Err(Error::missing(
            format!("the header {} of {name}", headers.join(" or ")),
            "put it beside the grid; without it nothing says how many columns there are",
        ));
    }
    if extension == "tif" || extension == "tiff" {
        let shown: Vec<String> = head.iter().take(4).map(|b| format!("{b:02x}")).collect();
        let reason = format!("a TIFF begins with II or MM, this file with bytes {}", shown.join(" "));
        return Err(Error::corrupt(name, "header at byte 0", reason));
    }
    let what = format!("a format that is not known by its first bytes; {READ}");
    Err(Error::unsupported(name, what, CONVERT))
}

/// Whether a name has the extension of a grid.
pub fn is_grid_name(name: &str) -> bool {
    GRIDS.contains(&extension_of(name).as_str())
}

fn extension_of(name: &str) -> String {
    Path::new(name).extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase()
}

/// Known kinds that are not read.
fn foreign(head: &[u8]) -> Option<&'static str> {
    let kinds: [(&[u8], &'static str); 9] = [
        (b"PK\x03\x04", "a zip archive inside an archive"),
        (&[0x1f, 0x8b], "a gzip file"),
        (b"7z\xbc\xaf", "a 7-zip archive"),
        (&[0xff, 0xd8, 0xff], "a JPEG picture"),
        (b"\x89PNG", "a damaged PNG picture"),
        (b"\x89HDF", "netCDF or HDF5"),
        (b"CDF", "netCDF"),
        (b"EHFA_HEADER_TAG", "an Erdas Imagine grid"),
        (b"LASF", "a LAS point cloud"),
    ];
    kinds.into_iter().find(|k| head.starts_with(k.0)).map(|k| k.1)
}

fn is_header(text: &str) -> bool {
    envi::is_header(text) || esri::is_header(text)
}

fn open_raw(input: Input, header: &Sidecar) -> Result<Box<dyn HeightSource>> {
    if envi::is_header(&header.text) {
        Ok(Box::new(envi::open(input, header)?))
    } else {
        Ok(Box::new(esri::open(input, header)?))
    }
}

/// Opens the one grid that a header, named in its place, lies beside.
fn open_by_header(header: &Input) -> Result<Box<dyn HeightSource>> {
    let path = Path::new(&header.file);
    let stem = path.file_stem().unwrap_or_default().to_ascii_lowercase();
    let stem = stem.to_string_lossy();
    let grids = header.beside.list(|name| {
        let name = name.to_ascii_lowercase();
        let known = is_grid_name(&name) || extension_of(&name).is_empty();
        // `a.hdr` lies beside `a.bil` or `a`, `a.bil.hdr` beside `a.bil`.
        known && (name == stem || Path::new(&name).file_stem().is_some_and(|s| s == &*stem))
    });
    match &grids[..] {
        [one] => open_plain(Input::open(one)?),
        [] => Err(Error::missing(
            format!("the grid of the header {} ({stem}.flt, {stem}.bil, ...)", header.file),
            "put both into one folder and name the grid",
        )),
        several => {
            let names: Vec<String> = several.iter().map(|p| p.display().to_string()).collect();
            Err(Error::invalid(
                &header.file,
                format!("is a header; name the grid itself: {}", names.join(" or ")),
            ))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::sidecar::Beside;
    use super::*;

    fn text(name: &str, bytes: &[u8]) -> String {
        match open(Input::memory(name, bytes.to_vec(), Beside::Nothing)) {
            Ok(_) => panic!("opened"),
            Err(e) => e.to_string(),
        }
    }

    #[test]
    fn what_is_not_read_is_named_with_a_remedy_in_one_line() {
        let cases: [(&str, &[u8], &str); 11] = [
            ("a.zip", b"PK\x03\x04", "zip"),
            ("a.hgt.gz", &[0x1f, 0x8b, 8], "gzip"),
            ("a.png", b"\x89PNG\r\n", "PNG"),
            ("a.nc", b"CDF\x01", "netCDF"),
            ("a.asc", b"NCOLS 4\nnrows", "header"),
            ("a.dt1", b"UHL1086", "header"),
            ("a.flt", &[0, 0, 0, 0], "a.hdr"),
            ("a.xyz", &[0, 0, 0, 0], "gdal_translate"),
            ("a.prj", b"GEOGCS[]", "name the grid"),
            ("a.tif", b"junk", "6a 75 6e 6b"),
            ("empty.tif", b"", "empty"),
        ];
        for (name, bytes, word) in cases {
            let line = text(name, bytes);
            assert!(line.contains(word) && line.contains(name) && !line.contains('\n'), "{line}");
        }
    }
}
