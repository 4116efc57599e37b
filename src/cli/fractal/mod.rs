//! `fractal`: heights, pictures and solids as maps of themselves, from files and to files.

mod decode;
mod encode;
mod info;
mod point;

use super::coded::{Codec, at_most, bytes_of, metered, named, notes, short, unit_of};
use crate::base::Result;
use crate::export::fractal::{Opened, Worth};
use clap::{Args, Subcommand};
use terraquilt_codecs::fractal::Kind;

/// Heights, pictures and solids as maps of themselves, asked for any point at any zoom (fractal tiles): encode, decode, point, info
///
/// A tile is a function: it is decoded at any zoom, or asked point by point. It is no smaller than other codecs' files, and what it shows between
/// samples is synthetic: made up, with the look of the ground. Errors are stated for samples: guaranteed with --bound, else as measured.
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt fractal encode crater.tif crater.ifs --bound 0.5\n  terraquilt fractal decode crater.ifs crater.tif\n  terraquilt fractal decode crater.ifs closer.png --zoom 4\n  terraquilt fractal point crater.ifs 562310.5,5116320\n  terraquilt fractal info crater.ifs"
)]
pub struct Fractal {
    #[command(subcommand)]
    word: Word,
}

#[derive(Subcommand)]
enum Word {
    Encode(Box<encode::Encode>),
    Decode(decode::Decode),
    Info(info::Info),
    Point(point::Point),
}

impl Fractal {
    pub fn run(self) -> Result<bool> {
        match self.word {
            Word::Encode(c) => c.run(),
            Word::Decode(c) => c.run(),
            Word::Info(c) => c.run(),
            Word::Point(c) => c.run(),
        }
    }
}

/// The unit of errors of a tile, with a space before it.
fn errors_in(o: &Opened) -> String {
    match o.kind() {
        Kind::Heights => unit_of(&o.tile.header.place.vertical),
        Kind::Grey | Kind::Colour => " grey levels".into(),
        Kind::Volume => " eighths of a voxel".into(),
    }
}

/// What is known of the error of samples.
fn error_of(worth: &Worth, unit: &str) -> String {
    match worth.error_max {
        None => "error unknown".into(),
        Some(e) if worth.certified => format!("error at most {}{unit}, guaranteed", at_most(e)),
        Some(e) => format!("error at most {}{unit}, as measured", at_most(e)),
    }
}
