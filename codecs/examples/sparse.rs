//! The tables of stream G1 (specification of GTB, sections 3 and 4): `cargo run --release --example sparse -- FILE...`.
//!
//! A file is two little-endian u32 (columns, rows) and columns x rows little-endian i32 heights. First the rules: errors,
//! fictitious posts, posts of strips a triangle. Then the stream: bits a sample of the grid, without and with the head.

use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::select::{Ground, RULES, Rule, Surplus, Until};
use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, bitree, decode, encode};

fn main() {
    let grids: Vec<(String, Heights)> = std::env::args().skip(1).map(|file| read(&file)).collect();
    println!(
        "{:>10} {:>6} {:<20} {:>8} {:>8} {:>10} {:>7}",
        "grid", "posts", "rule", "rms", "max", "fictitious", "strips"
    );
    for (name, heights) in &grids {
        let ground = Ground::new(heights).expect(name);
        for part in [0.01, 0.1, 0.75] {
            for rule in RULES {
                rule_line(name, &ground, rule, part);
            }
        }
    }
    println!(
        "\n{:>10} {:>14} {:>5} {:>8} {:>9} {:>9} {:>10} {:>6}",
        "grid", "part", "step", "posts", "bits", "with head", "bits/post", "error"
    );
    for (name, heights) in &grids {
        let ground = Ground::new(heights).expect(name);
        let samples = heights.cols * heights.rows;
        for (percent, step) in [(1, 1), (1, 8), (10, 1), (75, 1), (75, 8)] {
            stream_line(name, heights, &ground, samples * percent / 100, &format!("{percent} % posts"), step);
        }
        for (percent, step) in [(1, 1), (1, 8), (75, 1), (75, 8)] {
            let posts = of_triangles(&ground, 2 * samples as u64 * percent / 100);
            stream_line(name, heights, &ground, posts, &format!("{percent} % triangles"), step);
        }
    }
}

fn read(file: &str) -> (String, Heights) {
    let bytes = std::fs::read(file).expect(file);
    let number = |k: usize| u32::from_le_bytes([bytes[k], bytes[k + 1], bytes[k + 2], bytes[k + 3]]);
    let (cols, rows) = (number(0) as usize, number(4) as usize);
    let z: Vec<i32> = (0..cols * rows).map(|k| number(8 + 4 * k) as i32).collect();
    let name = std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
    (name, Heights::new(cols, rows, z))
}

fn rule_line(name: &str, ground: &Ground, rule: &dyn Rule, part: f64) {
    let lattice = ground.lattice();
    let samples = ground.z().len() as f64;
    let selected = rule.select(ground, Until::Posts((part * samples).round() as usize));
    let (rms, most) = ground.errors(&ground.surface(&selected));
    let needed = bitree::needed(lattice, &selected);
    let count = |m: &[bool]| m.iter().filter(|m| **m).count() as f64;
    let length: usize = bitree::strips(lattice, &needed).iter().map(Vec::len).sum();
    println!(
        "{name:>10} {:>4} % {:<20} {rms:>8.2} {most:>8.1} {:>8.2} % {:>7.3}",
        part * 100.0,
        rule.name(),
        100.0 * (count(&needed) - 4.0 - count(&selected)) / samples,
        length as f64 / bitree::count(lattice, &needed) as f64,
    );
}

/// The greatest number of posts whose triangles are at most so many.
fn of_triangles(ground: &Ground, triangles: u64) -> usize {
    let fits = |posts: usize| {
        let selected = Surplus.select(ground, Until::Posts(posts));
        bitree::count(ground.lattice(), &bitree::needed(ground.lattice(), &selected)) <= triangles
    };
    let (mut low, mut high) = (0, ground.z().len());
    while high - low > 1 {
        let middle = (low + high) / 2;
        if fits(middle) { low = middle } else { high = middle }
    }
    low
}

fn stream_line(name: &str, heights: &Heights, ground: &Ground, posts: usize, part: &str, step: u32) {
    let samples = (heights.cols * heights.rows) as f64;
    let selected = Surplus.select(ground, Until::Posts(posts));
    let options = Options { selected: Some(&selected), ..Options::new(Profile::Sparse, step) };
    let encoded = encode(heights, &options, &mut Alone, &mut |_| true).expect(name);
    let (mut body, mut going) = (Vec::new(), |_: f64| true);
    let decoded = decode(&encoded.bytes, &mut body, Stop::End, None, &mut Alone, &mut going).expect(name);
    assert!(decoded.complete && decoded.z == encoded.z, "{name}: what came out is not what went in");
    let (bits, all) = (decoded.header.body as f64 * 8.0, encoded.bytes.len() as f64 * 8.0);
    println!(
        "{name:>10} {part:>14} {step:>5} {posts:>8} {:>9.4} {:>9.4} {:>10.2} {:>6}",
        bits / samples,
        all / samples,
        bits / posts as f64,
        encoded.error_max
    );
}
