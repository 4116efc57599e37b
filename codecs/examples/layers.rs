//! What layers cost over one: `cargo run --release --example layers -- PROFILE BOUND,BOUND... FILE...`.
//!
//! A file is two little-endian u32 (columns, rows) and columns x rows little-endian i32 heights; -32768 is a void.

use std::time::Instant;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, decode, encode};

/// What files write where there is no data.
const VOID: i32 = -32_768;

fn main() {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [profile, layers, files @ ..] = args.as_slice() else {
        eprintln!("usage: layers cubic|adaptive BOUND,BOUND... FILE...");
        std::process::exit(2);
    };
    let profile = if profile == "adaptive" { Profile::Adaptive } else { Profile::Cubic };
    let layers: Vec<u32> = layers.split(',').map(|e| e.parse().expect("a bound")).collect();
    println!(
        "{:>12} {:>9} {:>9} {:>7}  bits a sample of each layer; layers decoded per second",
        "grid", "layers", "single", "ratio"
    );
    let mut worst: f64 = 0.0;
    for file in files {
        let bytes = std::fs::read(file).expect(file);
        let number = |k: usize| u32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
        let (cols, rows) = (number(0) as usize, number(4) as usize);
        let samples = (cols * rows) as f64;
        let z: Vec<i32> = (0..cols * rows).map(|k| number(8 + 4 * k) as i32).collect();
        let void = if z.contains(&VOID) { z.iter().map(|z| *z == VOID).collect() } else { Vec::new() };
        let heights = Heights { cols, rows, z, void };
        let coded = |layers: &[u32]| {
            let options = Options { layers: layers.to_vec(), ..Options::new(profile, 0) };
            let encoded = encode(&heights, &options, &mut Alone, &mut |_| true).expect(file);
            let begun = Instant::now();
            let (mut body, mut going) = (Vec::new(), |_: f64| true);
            let decoded =
                decode(&encoded.bytes, &mut body, Stop::End, None, &mut Alone, &mut going).expect(file);
            let time = begun.elapsed().as_secs_f64();
            assert!(decoded.complete && decoded.z == encoded.z, "{file}: what came out is not what went in");
            (encoded, time)
        };
        let (single, single_time) = coded(&layers[layers.len() - 1..]);
        let (all, all_time) = coded(&layers);
        let mut last = 0;
        let mut each = String::new();
        for layer in 0..layers.len() {
            let end = all.passes.iter().rfind(|p| p.layer == layer).map_or(0, |p| p.bytes);
            each += &format!(" {:6.3}", (end - last) as f64 * 8.0 / samples);
            last = end;
        }
        let ratio = all.bytes.len() as f64 / single.bytes.len() as f64;
        worst = worst.max(ratio);
        let name = std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        println!(
            "{name:>12} {:>9} {:>9} {ratio:>7.4} {each}  {:.1} M/s",
            all.bytes.len(),
            single.bytes.len(),
            samples * (layers.len() - 1) as f64 / (all_time - single_time).max(1e-9) / 1e6
        );
    }
    println!("worst ratio {worst:.4}");
}
