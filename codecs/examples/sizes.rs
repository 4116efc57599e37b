//! Bits a sample and speeds of grids: `cargo run --release --example sizes -- PROFILE BOUND[,BOUND...] FILE...`.
//!
//! A file is two little-endian u32 (columns, rows) and columns x rows little-endian i32 heights; -32768 is a void.

use std::time::Instant;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, decode, encode};

/// What files write where there is no data.
const VOID: i32 = -32_768;

/// Runs of which the quickest counts.
const RUNS: usize = 7;

/// What `f` makes, and the least time that it took in [`RUNS`] runs.
fn best<T>(f: impl Fn() -> T) -> (T, f64) {
    let run = || {
        let begun = Instant::now();
        (f(), begun.elapsed().as_secs_f64())
    };
    (1..RUNS).fold(run(), |a, _| {
        let b = run();
        if b.1 < a.1 { b } else { a }
    })
}

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [profile, layers, files @ ..] = args.as_slice() else {
        eprintln!("usage: sizes cubic|adaptive BOUND[,BOUND...] FILE...");
        std::process::exit(2);
    };
    let profile = if profile == "adaptive" { Profile::Adaptive } else { Profile::Cubic };
    let layers: Vec<u32> = layers.split(',').map(|e| e.parse().expect("a bound")).collect();
    println!("{:>12} {:>9} {:>8} {:>6} {:>9} {:>9}", "grid", "bytes", "bits", "error", "encode", "decode");
    for file in files {
        let bytes = std::fs::read(file).expect(file);
        let number = |k: usize| u32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
        let (cols, rows) = (number(0) as usize, number(4) as usize);
        let z: Vec<i32> = (0..cols * rows).map(|k| number(8 + 4 * k) as i32).collect();
        let void = if z.contains(&VOID) { z.iter().map(|z| *z == VOID).collect() } else { Vec::new() };
        let heights = Heights { cols, rows, z, void };
        let options = Options { layers: layers.clone(), ..Options::new(profile, 0) };
        let (encoded, encoding) = best(|| encode(&heights, &options, &mut Alone, &mut |_| true).expect(file));
        let (decoded, decoding) = best(|| {
            let (mut body, mut going) = (Vec::new(), |_: f64| true);
            decode(&encoded.bytes, &mut body, Stop::End, None, &mut Alone, &mut going).expect(file)
        });
        assert!(decoded.complete && decoded.z == encoded.z, "{file}: what came out is not what went in");
        let samples = (cols * rows) as f64;
        let name = std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        println!(
            "{name:>12} {:>9} {:>8.3} {:>6} {:>6.1} M/s {:>6.1} M/s",
            encoded.bytes.len(),
            encoded.bytes.len() as f64 * 8.0 / samples,
            encoded.error_max,
            samples / encoding / 1e6,
            samples / decoding / 1e6
        );
    }
}
