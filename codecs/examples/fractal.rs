//! Maps, quality and bytes of fractal tiles: `cargo run --release --example fractal -- quad 5000 picture.pgm ...`
//!
//! `quad N`, `const R`, `slope S`, `bound E`; `STEP` of the means; `BITS` of s; `SEARCH` = exact (default), classes or a number: near. Pictures are binary PGM; heights u32 columns, u32 rows, i32
//! each, little-endian.

use std::time::Instant;
use terraquilt_codecs::fractal::{Encoded, Options, Partition, Search, Tile, encode_heights, encode_picture};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Workers;

/// As many threads as the machine has.
struct Threads;

impl Workers for Threads {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        let next = std::sync::atomic::AtomicUsize::new(0);
        std::thread::scope(|s| {
            for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
                s.spawn(|| {
                    loop {
                        let k = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                        if k >= parts {
                            return;
                        }
                        part(k);
                    }
                });
            }
        });
    }
}

fn encoded(file: &str, options: &Options) -> Result<(Encoded, f64), Box<dyn std::error::Error>> {
    let bytes = std::fs::read(file)?;
    if bytes.starts_with(b"P5") {
        let text = String::from_utf8_lossy(&bytes[..bytes.len().min(64)]).into_owned();
        let fields: Vec<usize> =
            text.split_ascii_whitespace().skip(1).take(3).filter_map(|f| f.parse().ok()).collect();
        let [cols, rows, _] = fields[..] else { return Err("no PGM head".into()) };
        let pixels = &bytes[bytes.len() - cols * rows..];
        return Ok((encode_picture([cols, rows], 1, pixels, file, &[], options, &Threads)?, 255.0));
    }
    let word =
        |k: usize| u32::from_le_bytes([bytes[4 * k], bytes[4 * k + 1], bytes[4 * k + 2], bytes[4 * k + 3]]);
    let (cols, rows) = (word(0) as usize, word(1) as usize);
    let z: Vec<i32> = (0..cols * rows).map(|k| word(k + 2) as i32).collect();
    let peak = f64::from(z.iter().max().unwrap_or(&0) - z.iter().min().unwrap_or(&0));
    Ok((encode_heights(&Heights::new(cols, rows, z), &Place::default(), &[], options, &Threads)?, peak))
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [what, value, files @ ..] = &arguments[..] else {
        return Err("quad|const|slope|bound VALUE FILE...".into());
    };
    let value: f64 = value.parse()?;
    let mut options = Options {
        search: match std::env::var("SEARCH").as_deref() {
            Ok("classes") => Search::Classes,
            Ok("exact") | Err(_) => Search::Exact,
            Ok(n) => Search::Near(n.parse()?),
        },
        step: std::env::var("STEP").ok().map(|s| s.parse()).transpose()?,
        scale_bits: std::env::var("BITS").ok().map(|s| s.parse()).transpose()?,
        ..Options::default()
    };
    match what.as_str() {
        "quad" => options.partition = Some(Partition::Maps(value as usize)),
        "const" => options.partition = Some(Partition::Const(value as usize)),
        "slope" => options.partition = Some(Partition::Slope(value)),
        "bound" => options.bound = Some(value as u32),
        _ => return Err("quad, const, slope or bound".into()),
    }
    for file in files {
        let started = Instant::now();
        let (e, peak) = encoded(file, &options)?;
        let seconds = started.elapsed().as_secs_f64();
        let (started, h) = (Instant::now(), &e.header);
        let tile = Tile::read(&e.bytes)?;
        let read = started.elapsed().as_secs_f64();
        let started = Instant::now();
        let decoded = tile.plane(0)?;
        let psnr = 20.0 * (peak / h.error_rms.max(1e-9)).log10();
        println!(
            "{file}: {} maps, {psnr:.2} dB, error {:.2}, ratio {:.3} of 8 bits, {:.3} bits a sample, {:.1} bits a map; {seconds:.2} s, read {:.1} ms, {} samples decoded in {:.1} ms",
            h.maps,
            h.error_max,
            h.samples() as f64 / e.bytes.len() as f64,
            e.bytes.len() as f64 * 8.0 / h.samples() as f64,
            e.bytes.len() as f64 * 8.0 / h.maps as f64,
            read * 1e3,
            decoded.values.len(),
            started.elapsed().as_secs_f64() * 1e3,
        );
    }
    Ok(())
}
