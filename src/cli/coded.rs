//! What commands on files of the codecs (GTB, fractal tiles) share: reading them, bars, words.

use super::output::{Meter, message, stop_flag};
use crate::base::{Error, Result, limits};
use crate::export::Going;
use std::fs::File;
use std::io::Read;
use std::path::Path;
use std::sync::atomic::Ordering;
use terraquilt_codecs::{fractal, gtb};

/// Whose file is read.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Codec {
    Gtb,
    Fractal,
}

/// Works with a bar on the terminal, until it is done or stopped by Ctrl-C.
pub fn metered<R>(work: impl FnOnce(Going) -> Result<R>) -> Result<R> {
    let (meter, stop) = (Meter::new(), stop_flag());
    let done = work(&|stage, share| {
        meter.report(stage, share);
        !stop.load(Ordering::Relaxed)
    });
    meter.clear();
    done
}

/// Reads what is there of a file, or of standard input (`-`): the first `most` bytes at most. A file of the other codec is sent to its own word.
pub fn bytes_of(path: &Path, codec: Codec, most: Option<u64>) -> Result<(String, Vec<u8>)> {
    let name = if path == Path::new("-") { "standard input".into() } else { path.display().to_string() };
    let limit = match codec {
        Codec::Gtb => limits::GTB_BYTES_MAX,
        Codec::Fractal => limits::FRACTAL_BYTES_MAX,
    };
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
    let (what, wanted, word) = match codec {
        Codec::Gtb if bytes.starts_with(&fractal::header::MAGIC) => ("a fractal tile", "GTB file", "fractal"),
        Codec::Fractal if bytes.starts_with(&gtb::header::MAGIC) => ("a GTB file", "fractal tile", "gtb"),
        _ => return Ok((name, bytes)),
    };
    Err(Error::unsupported(name, format!("{what}, not a {wanted}"), format!("use `terraquilt {word}`")))
}

/// Refuses to write a codec's file under the name of another kind of file: it would be taken for one, or take the place of what was encoded.
pub fn named(out: &Path, codec: Codec) -> Result<()> {
    let (ending, what) = match codec {
        Codec::Gtb => ("gtb", "a GTB file"),
        Codec::Fractal => ("ifs", "a fractal tile"),
    };
    match out.extension() {
        Some(e) if e.eq_ignore_ascii_case(ending) => Ok(()),
        _ => Err(Error::invalid(
            out.display(),
            format!("{what} is written; name a file that ends with .{ending}"),
        )),
    }
}

/// The ending of a file to write, in small letters.
pub fn ending(out: &Path) -> String {
    out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

/// Refuses to write a file by its [`ending`]. `name`: how those are called that are written.
pub fn no_format(out: &Path, name: &'static str) -> Error {
    let found = match ending(out).as_str() {
        "" => "has no ending that names a format".to_string(),
        other => format!("ending '.{other}' is no format that is written"),
    };
    Error::unsupported(out.display(), found, name)
}

/// Lines for the person.
pub fn notes(lines: &[String]) {
    lines.iter().for_each(|n| message(&format!("note: {n}")));
}

/// A height or an error, for people: as many digits as matter.
pub fn short(v: f64) -> String {
    if v == 0.0 || (1e-3..1e6).contains(&v.abs()) {
        let text = format!("{v:.4}");
        text.trim_end_matches('0').trim_end_matches('.').to_string()
    } else {
        format!("{v:.3e}")
    }
}

/// A bound, for people: as [`short`], but not less than it is, to a ten-millionth.
pub fn at_most(v: f64) -> String {
    let scale = if v == 0.0 || (1e-3..1e6).contains(&v.abs()) {
        1e4
    } else {
        10f64.powi(3 - v.abs().log10().floor() as i32)
    };
    let digits = v * scale;
    // What 0.3 is more as a float32 is no step.
    let up = if (digits - digits.round()).abs() < 1e-3 { digits.round() } else { digits.ceil() };
    if up.is_finite() { short(up / scale) } else { short(v) }
}

/// The unit of heights, with a space before it; nothing where it is not known.
pub fn unit_of(vertical: &str) -> String {
    match vertical.split(' ').next().unwrap_or("") {
        "" | "?" => String::new(),
        unit if unit.parse::<f64>().is_ok() => format!(" units of {unit} m"),
        unit => format!(" {unit}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_never_printed_smaller_than_they_are() {
        let shown = [0.095, 0.095_014_6, f64::from(0.3_f32), 1.0, 12.345_61, 0.0, 1.2341e-5, 1.230_1e7];
        let found = shown.map(at_most);
        assert_eq!(found, ["0.095", "0.0951", "0.3", "1", "12.3457", "0", "1.235e-5", "1.231e7"]);
    }
}
