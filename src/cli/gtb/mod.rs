//! `gtb`: terrain and its texture in one stream that can stop at any byte, from files and to files.

mod decode;
mod encode;
mod info;

use super::coded::{Codec, at_most, bytes_of, metered, named, notes, short, unit_of};
use crate::base::Result;
use clap::{Args, Subcommand};

/// Terrain and its texture in one stream that can stop at any byte (GTB): encode, decode, info
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt gtb encode crater.tif crater.gtb\n  terraquilt gtb decode crater.gtb crater.png --bytes 10000\n  terraquilt gtb info crater.gtb"
)]
pub struct Gtb {
    #[command(subcommand)]
    word: Word,
}

#[derive(Subcommand)]
enum Word {
    Encode(encode::Encode),
    Decode(decode::Decode),
    Info(info::Info),
}

impl Gtb {
    pub fn run(self) -> Result<bool> {
        match self.word {
            Word::Encode(c) => c.run(),
            Word::Decode(c) => c.run(),
            Word::Info(c) => c.run(),
        }
    }
}
