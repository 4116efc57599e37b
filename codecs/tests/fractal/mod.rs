//! Fractal tiles.

mod bounded;
mod damage;
mod extremes;
mod golden;
mod planes;
mod published;
mod volumes;
mod zooms;

use crate::support::random::Random;
use crate::support::shared;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use terraquilt_codecs::heights::Heights;
use terraquilt_codecs::work::Workers;

/// As many threads as the machine has.
pub struct Threads;

impl Workers for Threads {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        let work = || {
            loop {
                let k = next.fetch_add(1, Ordering::Relaxed);
                if k >= parts {
                    return;
                }
                part(k);
            }
        };
        std::thread::scope(|scope| {
            let count = std::thread::available_parallelism().map_or(1, usize::from);
            (0..count.min(parts)).for_each(|_| drop(scope.spawn(work)));
        });
    }
}

/// Brightness: columns, rows, samples.
pub type Picture = (usize, usize, Vec<u8>);

/// Ground of sines and noise: `rough` units of noise on hills of some hundred.
pub fn ground(cols: usize, rows: usize, rough: f64, seed: u64) -> Heights {
    let mut random = Random::new(seed);
    let waves: Vec<[f64; 4]> = (0..6)
        .map(|_| [random.unit() * 0.2, random.unit() * 0.2, random.unit() * 6.0, random.unit() * 60.0])
        .collect();
    let z = (0..cols * rows)
        .map(|k| {
            let (x, y) = ((k % cols) as f64, (k / cols) as f64);
            let hills: f64 = waves.iter().map(|[a, b, c, h]| h * (a * x + b * y + c).sin()).sum();
            (hills + rough * (random.unit() - 0.5)).round() as i32
        })
        .collect();
    Heights::new(cols, rows, z)
}

/// The photograph of the specification's tables: 512 x 512, reduced to 256 x 256 by 2 x 2 means.
pub fn photograph() -> Option<Picture> {
    let (cols, rows, samples) = png(&shared("images/camera.png")?);
    let reduced = (0..rows / 2 * (cols / 2))
        .map(|k| {
            let at = k / (cols / 2) * 2 * cols + k % (cols / 2) * 2;
            let sum: u32 =
                [at, at + 1, at + cols, at + cols + 1].iter().map(|k| u32::from(samples[*k])).sum();
            // Halves to the even number.
            let (whole, rest) = (sum / 4, sum % 4);
            (whole + u32::from(rest == 3 || rest == 2 && whole % 2 == 1)) as u8
        })
        .collect();
    Some((cols / 2, rows / 2, reduced))
}

/// Puget Sound in 8 bits, 512 x 512.
pub fn puget() -> Option<Picture> {
    shared("images/puget_dem_512_8bit.png").map(|p| png(&p))
}

/// Mount Fuji in 8 bits, 512 x 512: of terrain-RGB, tenths of a metre from -10,000.
pub fn fuji() -> Option<Picture> {
    let (cols, rows, rgb) = png(&shared("codec/fuji.png")?);
    let pixel = rgb.len() / (cols * rows);
    let metres: Vec<i64> = rgb
        .chunks_exact(pixel)
        .map(|p| (i64::from(p[0]) << 16 | i64::from(p[1]) << 8 | i64::from(p[2])) - 100_000)
        .map(|tenths| (tenths as f64 / 10.0).round_ties_even() as i64)
        .collect();
    let (lo, hi) = (metres.iter().min()?, metres.iter().max()?);
    let eight = |z: &i64| ((z - lo) as f64 / (hi - lo) as f64 * 255.0).round_ties_even() as u8;
    Some((cols, rows, metres.iter().map(eight).collect()))
}

fn png(path: &Path) -> Picture {
    let mut reader = png::Decoder::new(BufReader::new(File::open(path).unwrap())).read_info().unwrap();
    let mut samples = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut samples).unwrap();
    assert_eq!(info.bit_depth, png::BitDepth::Eight);
    samples.truncate(info.buffer_size());
    (info.width as usize, info.height as usize, samples)
}
