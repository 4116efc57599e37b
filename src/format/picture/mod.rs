//! Pictures of the ground, read for their colours: GeoTIFF and PNG of 8 bits, red, green, blue (and alpha), or grey.

mod png;
mod write;

pub use write::write_png;

use self::png::Png;
use super::geotiff::GeoTiff;
use super::input::Input;
use crate::base::{Error, Result};
use crate::height::crs::Crs;
use crate::height::source::{Affine, HeightSource, SourceInfo, Window};
use std::path::Path;

const CONVERT: &str = "convert it with: gdal_translate -ot Byte -of GTiff INPUT OUTPUT.tif";

/// A picture that is open.
pub struct Picture {
    info: PictureInfo,
    kind: Kind,
}

enum Kind {
    Tiff(Box<GeoTiff>),
    Png(Box<Png>),
}

/// What a picture says of itself.
#[derive(Clone, Debug)]
pub struct PictureInfo {
    /// The file, as the user named it.
    pub file: String,
    /// Pixels in a row.
    pub cols: u64,
    /// Rows, the first one on top.
    pub rows: u64,
    /// Where the centres of the pixels lie; `None`: the file does not say.
    pub affine: Option<Affine>,
    /// `None`: the file does not say.
    pub crs: Option<Crs>,
    /// What a user should know.
    pub notes: Vec<String>,
}

/// Pixels of a window, row by row.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Pixels {
    /// Pixels in a row.
    pub cols: usize,
    /// Rows.
    pub rows: usize,
    /// Red, green, blue.
    pub rgb: Vec<[u8; 3]>,
    /// Which are void: transparent, masked, or of the nodata value in all bands.
    pub void: Vec<bool>,
}

impl Picture {
    /// Opens a picture by its first bytes; of a PNG every pixel is read.
    ///
    /// # Errors
    /// As [`open`](super::open()); [`Error::Unsupported`] for other kinds of files and other widths of samples.
    pub fn open(path: &Path) -> Result<Picture> {
        Picture::of(Input::open(path)?)
    }

    fn of(input: Input) -> Result<Picture> {
        let head = input.head(8)?;
        let name = input.file.clone();
        let tiff = [b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"];
        if head.is_empty() {
            return Err(Error::corrupt(name, "file", "it is empty (0 bytes)"));
        }
        if tiff.iter().any(|magic| head.starts_with(*magic)) {
            let tiff = GeoTiff::open_colours(input)?;
            let info = PictureInfo::of(tiff.info());
            return Ok(Picture { info, kind: Kind::Tiff(Box::new(tiff)) });
        }
        if head.starts_with(b"\x89PNG\r\n\x1a\n") {
            let (info, png) = Png::open(input)?;
            return Ok(Picture { info: PictureInfo::of(&info), kind: Kind::Png(Box::new(png)) });
        }
        let what =
            if head.starts_with(&[0xff, 0xd8, 0xff]) { "a JPEG picture" } else { "no picture that is known" };
        Err(Error::unsupported(name, format!("{what}; read are GeoTIFF and PNG of 8 bits"), CONVERT))
    }

    /// What it says of itself.
    pub fn info(&self) -> &PictureInfo {
        &self.info
    }

    /// Reads a window of at most [`WINDOW_POSTS_MAX`](crate::base::limits::WINDOW_POSTS_MAX) pixels.
    ///
    /// # Errors
    /// If the window leaves the picture, or the file cannot be decoded there.
    pub fn read(&mut self, w: Window) -> Result<Pixels> {
        let (rgb, void) = match &mut self.kind {
            Kind::Tiff(tiff) => tiff.read_colours(w)?,
            Kind::Png(png) => png.read(w)?,
        };
        Ok(Pixels { cols: w.cols, rows: w.rows, rgb, void })
    }
}

impl PictureInfo {
    fn of(info: &SourceInfo) -> PictureInfo {
        PictureInfo {
            file: info.file.clone(),
            cols: info.cols,
            rows: info.rows,
            affine: info.affine,
            crs: info.crs.clone(),
            notes: info.notes.clone(),
        }
    }
}
