//! `gtb`: terrain and its texture in one stream that can stop at any byte, from files and to files.

mod decode;
mod encode;
mod info;

use super::output::{Meter, message, stop_flag};
use crate::base::{Error, Result, limits};
use crate::export::Going;
use clap::{Args, Subcommand};
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::atomic::Ordering;

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

/// Works with a bar on the terminal, until it is done or stopped by Ctrl-C.
fn metered<R>(work: impl FnOnce(Going) -> Result<R>) -> Result<R> {
    let (meter, stop) = (Meter::new(), stop_flag());
    let done = work(&|stage, share| {
        meter.report(stage, share);
        !stop.load(Ordering::Relaxed)
    });
    meter.clear();
    done
}

/// Reads what is there of a file, or of standard input (`-`): the first `most` bytes at most.
fn bytes_of(path: &Path, most: Option<u64>) -> Result<(String, Vec<u8>)> {
    let name = if path == Path::new("-") { "standard input".into() } else { path.display().to_string() };
    let limit = limits::GTB_BYTES_MAX;
    let take = most.unwrap_or(u64::MAX).min(limit + 1);
    let mut bytes = Vec::new();
    let read = if path == Path::new("-") {
        std::io::stdin().lock().take(take).read_to_end(&mut bytes)
    } else {
        let file = File::open(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => Error::missing(format!("file {name}"), "check the name"),
            _ => Error::io(path, e),
        })?;
        file.take(take).read_to_end(&mut bytes)
    };
    read.map_err(|e| Error::io(path, e))?;
    if bytes.len() as u64 > limit {
        return Err(Error::limit(format!("bytes of {name}"), limit, bytes.len() as u64));
    }
    Ok((name, bytes))
}

/// Lines for the person.
fn notes(lines: &[String]) {
    lines.iter().for_each(|n| message(&format!("note: {n}")));
}

/// A height or an error, for people: as many digits as matter.
fn short(v: f64) -> String {
    if v == 0.0 || (1e-3..1e6).contains(&v.abs()) {
        let text = format!("{v:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        format!("{v:.3e}")
    }
}

/// The unit of heights, with a space before it; nothing where it is not known.
fn unit_of(vertical: &str) -> String {
    match vertical.split(' ').next().unwrap_or("") {
        "" | "?" => String::new(),
        unit if unit.parse::<f64>().is_ok() => format!(" units of {unit} m"),
        unit => format!(" {unit}"),
    }
}
