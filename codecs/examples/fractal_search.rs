//! Times of the searches for matches, what they lose, and how many pairs they meet:
//! `cargo run --release --example fractal_search -- [--threads N] [--sides R,R...] FILE...`.
//!
//! A file is two little-endian u32 (columns, rows) and columns x rows little-endian i32 heights, or a binary PGM of 8 bits (`.pgm`). It is cut
//! to multiples of 32 samples. The collage is each range by its best map of the grid itself; its PSNR is to the range of values, 255 for a PGM.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;
use terraquilt_codecs::fractal::domains::Domains;
use terraquilt_codecs::fractal::grid::{Grid, points};
use terraquilt_codecs::fractal::isometry::group;
use terraquilt_codecs::fractal::matching::{Level, Search};
use terraquilt_codecs::fractal::scale::Scales;
use terraquilt_codecs::work::Workers;

/// Runs of which the quickest counts.
const RUNS: usize = 3;

/// So many threads, which take the parts as they come.
struct Threads(usize);

impl Workers for Threads {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        let work = || {
            loop {
                let k = next.fetch_add(1, Ordering::Relaxed);
                if k >= parts {
                    break;
                }
                part(k);
            }
        };
        std::thread::scope(|scope| {
            (1..self.0.min(parts)).for_each(|_| drop(scope.spawn(work)));
            work();
        });
    }
}

/// The grid of a file, cut to multiples of 32, and its range of values.
fn read(file: &str) -> (Grid<2>, f64) {
    let bytes = std::fs::read(file).expect(file);
    let (cols, rows, values, peak): (usize, usize, Vec<f64>, Option<f64>) = if file.ends_with(".pgm") {
        // "P5", columns, rows and 255, with white space between, and one more before the samples.
        let mut words = bytes.split(u8::is_ascii_whitespace).take(4);
        let mut word = || std::str::from_utf8(words.next().expect("a header")).expect("a header");
        assert_eq!(word(), "P5", "{file}: no binary PGM");
        let header: Vec<usize> = (0..3).map(|_| word().parse().expect("a number")).collect();
        assert_eq!(header[2], 255, "{file}: not of 8 bits");
        let samples = &bytes[bytes.len() - header[0] * header[1]..];
        (header[0], header[1], samples.iter().map(|v| f64::from(*v)).collect(), Some(255.0))
    } else {
        let words: Vec<i32> =
            bytes.chunks_exact(4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
        (words[0] as usize, words[1] as usize, words[2..].iter().map(|v| f64::from(*v)).collect(), None)
    };
    let size = [cols / 32 * 32, rows / 32 * 32];
    let values: Vec<f64> = points(size).map(|p| values[p[1] * cols + p[0]]).collect();
    let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(*v), h.max(*v)));
    (Grid { size, values }, peak.unwrap_or(high - low))
}

fn main() {
    let mut files: Vec<String> = std::env::args().skip(1).collect();
    let mut option = |name: &str, otherwise: &str| {
        let Some(at) = files.iter().position(|a| a == name) else { return otherwise.to_owned() };
        files.drain(at..(at + 2).min(files.len())).nth(1).expect("a value")
    };
    let threads: usize = option("--threads", "2").parse().expect("a number of threads");
    let sides = option("--sides", "2,4,8,16,32");
    let sides: Vec<usize> = sides.split(',').map(|r| r.parse().expect("a side")).collect();
    if files.is_empty() {
        eprintln!("usage: fractal_search [--threads N] [--sides R,R...] FILE...");
        std::process::exit(2);
    }
    let isometries = group::<2>(8).expect("a group");
    for file in &files {
        let (grid, peak) = read(file);
        let half = grid.half();
        println!("{file}: {} x {}, range of values {peak}, {threads} threads", grid.size[0], grid.size[1]);
        println!(
            "{:>10} {:>4} {:>9} {:>10} {:>9} {:>8}",
            "search", "r", "seconds", "pairs", "PSNR dB", "matched"
        );
        for search in [Search::Exact, Search::Classes, Search::Near(16)] {
            let mut total = 0.0;
            for side in sides.iter().copied() {
                let domains = Domains::new(grid.size, side, 4);
                let level = Level {
                    grid: &grid,
                    half: &half,
                    domains,
                    isometries: &isometries,
                    scales: Scales::of_bits(5),
                };
                let ranges: Vec<[usize; 2]> =
                    points(grid.size.map(|n| n / side)).map(|p| p.map(|v| v * side)).collect();
                let (mut least, mut found) = (f64::MAX, Vec::new());
                for _ in 0..RUNS {
                    let begun = Instant::now();
                    found = level.search(&ranges, search, &Threads(threads)).expect("a search");
                    least = least.min(begun.elapsed().as_secs_f64());
                }
                total += least;
                let pairs = level.pairs(&ranges, search) as f64;
                let mut block = vec![0.0; side * side];
                let mut flat = |range: [usize; 2]| {
                    grid.block(range, side, &mut block);
                    let mean = block.iter().sum::<f64>() / block.len() as f64;
                    block.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>()
                };
                let errors = ranges.iter().zip(&found).map(|(r, m)| m.map_or_else(|| flat(*r), |m| m.error));
                let square = errors.sum::<f64>() / grid.values.len() as f64;
                let psnr = 10.0 * (peak * peak / square).log10();
                let matched = found.iter().flatten().count() as f64 / ranges.len() as f64 * 100.0;
                let name = format!("{search:?}");
                println!("{name:>10} {side:>4} {least:>9.3} {pairs:>10.2e} {psnr:>9.2} {matched:>6.1} %");
            }
            println!("{:>10} {:>4} {total:>9.3}", "", "all");
        }
    }
}
