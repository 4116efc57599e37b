//! The tables of stream G1: `cargo run --release --example sparse -- FILE...`.
//!
//! A file is two little-endian u32 (columns, rows) and columns x rows little-endian i32 heights.

use terraquilt_codecs::gtb::select::{Ground, RULES, Until};
use terraquilt_codecs::gtb::{Heights, bitree};

fn main() {
    let files: Vec<String> = std::env::args().skip(1).collect();
    println!(
        "{:>10} {:>5} {:<20} {:>8} {:>8} {:>10} {:>7}",
        "grid", "part", "rule", "rms", "max", "fictitious", "strips"
    );
    for file in files {
        let bytes = std::fs::read(&file).expect(&file);
        let number = |k: usize| u32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
        let (cols, rows) = (number(0) as usize, number(4) as usize);
        let z: Vec<i32> = (0..cols * rows).map(|k| number(8 + 4 * k) as i32).collect();
        let heights = Heights::new(cols, rows, z);
        let name = std::path::Path::new(&file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let ground = Ground::new(&heights).expect(&file);
        if std::env::var("SIZES").is_ok() {
            sizes(&name, &heights, &ground);
            continue;
        }
        for part in [0.01, 0.1, 0.75] {
            for rule in RULES {
                let posts = (part * (cols * rows) as f64).round() as usize;
                let selected = rule.select(&ground, Until::Posts(posts));
                let (rms, most) = ground.errors(&ground.surface(&selected));
                let needed = bitree::needed(ground.lattice(), &selected);
                let count = |m: &[bool]| m.iter().filter(|m| **m).count() as f64;
                let strips = bitree::strips(ground.lattice(), &needed);
                let length: usize = strips.iter().map(Vec::len).sum();
                println!(
                    "{name:>10} {:>3} % {:<20} {rms:>8.2} {most:>8.1} {:>8.2} % {:>7.3}",
                    part * 100.0,
                    rule.name(),
                    100.0 * (count(&needed) - 4.0 - count(&selected)) / (cols * rows) as f64,
                    length as f64 / bitree::count(ground.lattice(), &needed) as f64,
                );
            }
        }
    }
}

#[allow(dead_code)]
fn sizes(name: &str, heights: &Heights, ground: &Ground) {
    use terraquilt_codecs::gtb::companion::Alone;
    use terraquilt_codecs::gtb::{Options, Profile, Stop, decode, encode};
    let cells = ((heights.cols * heights.rows) as f64).sqrt().floor().powi(2);
    for (part, step) in [(0.01, 1), (0.01, 8), (0.1, 1), (0.75, 1)] {
        let posts = (part * cells).round() as usize;
        let selected = RULES[3].select(ground, Until::Posts(posts));
        let options = Options { selected: Some(&selected), ..Options::new(Profile::Sparse, step) };
        let encoded = encode(heights, &options, &mut Alone, &mut |_| true).unwrap();
        let (mut body, mut going) = (Vec::new(), |_: f64| true);
        let decoded = decode(&encoded.bytes, &mut body, Stop::End, None, &mut Alone, &mut going).unwrap();
        assert!(decoded.complete && decoded.z == encoded.z);
        let bits = encoded.bytes.len() as f64 * 8.0;
        println!(
            "{name} {} % step {step}: {:.4} bpp, {:.2} bits a post",
            part * 100.0,
            bits / cells,
            bits / posts as f64
        );
    }
}
