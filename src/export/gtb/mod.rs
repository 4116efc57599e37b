//! Heights to GTB and back: what the codec (`terraquilt-codecs`) takes and gives, as grids with a place, and as files.
//!
//! - [`Grid`], [`Units`]: heights as numbers; the same as integers of a unit
//! - [`told`]: the codec's errors as ours

mod grid;

pub use grid::{Grid, Units, place_of};

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
