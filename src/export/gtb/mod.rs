//! Heights to GTB and back: what the codec (`terraquilt-codecs`) takes and gives, as grids with a place, and as files.
//!
//! - [`Grid`], [`Units`]: heights as numbers; the same as integers of a unit
//! - [`send`]: a grid, and perhaps a picture, as a GTB file
//! - [`read_prefix`], [`Prefix`]: the surface that a file or the beginning of one gives; [`write_tif`], [`write_picture`],
//!   [`write_mesh`]: the files that are made of it
//! - [`told`]: the codec's errors as ours

mod mesh;
mod prefix;
mod raster;
mod sender;

pub use super::grid::{Grid, MeshRequest, MeshTold, RasterTold, Units, place_of};
pub use mesh::write_mesh;
pub use prefix::{Prefix, Reached, Until, read_prefix};
pub use raster::{write_picture, write_tif};
pub use sender::{Request, Sent, SentTold, send};

use crate::base::Error;

/// An error of the codec about a file (or a stream).
pub fn told(file: &str, e: terraquilt_codecs::Error) -> Error {
    use terraquilt_codecs::Error as E;
    match e {
        E::Short { what, needs, has } => Error::unsupported(
            file,
            format!("too short to show anything: {has} bytes are there, {needs} are needed for {what}"),
            "give a longer prefix",
        ),
        E::Damaged { place, reason } => Error::corrupt(file, place, reason),
        E::Limit { what, limit, wanted } => Error::limit(format!("{what} of {file}"), limit, wanted),
        E::Invalid { what, reason } => Error::invalid(what, reason),
        E::Stopped => Error::Stopped,
    }
}
