//! How long fractal tiles take to decode: `cargo run --release --example fractal_times -- FILE.ifs...`
//!
//! One line of JSON for each file and each zoom of 50, 100 and 200 %: seconds for all samples, the median of some runs on one core, of
//!
//! - `discrete`: all leaves applied until nothing changes, and beyond 100 % one pass more
//! - `real`: point by point at the centres of the samples, ten steps of the inverse walk, as the paper does it
//! - `seeded`: the same from the samples at zoom 1, with as many steps as the zoom asks for
//!
//! Reading the file and preparing the walk, once for each file, are told apart: `read` and `prepare`.

use std::time::Instant;
use terraquilt_codecs::fractal::grid::points;
use terraquilt_codecs::fractal::{Ifs, Stop, Tile, Walk};

type Any<T> = Result<T, Box<dyn std::error::Error>>;

/// Steps of the inverse walk in the paper.
const PUBLISHED: u32 = 10;

/// The median time of some runs: five, or as many as two seconds hold; one at least.
fn median(mut run: impl FnMut() -> Any<()>) -> Any<f64> {
    let begun = Instant::now();
    let mut times = Vec::new();
    while times.is_empty() || times.len() < 5 && begun.elapsed().as_secs_f64() < 2.0 {
        let started = Instant::now();
        run()?;
        times.push(started.elapsed().as_secs_f64());
    }
    times.sort_by(f64::total_cmp);
    Ok(times[times.len() / 2])
}

fn discrete<const D: usize>(ifs: &Ifs<D>, zoom: [usize; 2], seed: f64) -> Any<f64> {
    median(|| {
        if zoom == [2, 1] {
            std::hint::black_box(Walk::new(ifs)?.doubled(1)?);
        } else {
            std::hint::black_box(ifs.iterate(zoom, seed, Stop::PUBLISHED, &mut || true)?);
        }
        Ok(())
    })
}

/// The sum of the values, which nobody needs, keeps them from being left out.
fn pointwise<const D: usize>(walk: &Walk<D>, [a, b]: [usize; 2], depth: u32) -> Any<f64> {
    let step = b as f64 / a as f64;
    median(|| {
        let sum: f64 = points(walk.size().map(|n| n * a / b))
            .map(|p| walk.value(p.map(|v| (v as f64 + 0.5) * step), depth))
            .sum();
        std::hint::black_box(sum);
        Ok(())
    })
}

fn all<const D: usize>(file: &str, read: f64, planes: &[Ifs<D>], seed: f64) -> Any<()> {
    let mut walks = Vec::new();
    let prepare = median(|| {
        walks = planes.iter().map(Walk::new).collect::<Result<_, _>>()?;
        Ok(())
    })?;
    for (zoom, depth) in [([1, 2], 0), ([1, 1], 0), ([2, 1], 1)] {
        let (mut whole, mut real, mut seeded) = (0.0, 0.0, 0.0);
        for (ifs, walk) in planes.iter().zip(&walks) {
            whole += discrete(ifs, zoom, seed)?;
            real += pointwise(walk, zoom, PUBLISHED)?;
            seeded += pointwise(walk, zoom, depth)?;
        }
        println!(
            "{{\"file\": \"{file}\", \"zoom\": {}, \"discrete\": {whole}, \"real\": {real}, \"seeded\": {seeded}, \"read\": {read}, \"prepare\": {prepare}}}",
            100 * zoom[0] / zoom[1]
        );
    }
    Ok(())
}

fn main() -> Any<()> {
    for file in std::env::args().skip(1) {
        let bytes = std::fs::read(&file)?;
        let read = median(|| {
            std::hint::black_box(Tile::read(&bytes)?);
            Ok(())
        })?;
        let tile = Tile::read(&bytes)?;
        // Seeds are of no account: the midpoint, as published.
        let seed = f64::from(tile.header.range[0] + tile.header.range[1]) / 2.0;
        match &tile.volume {
            Some(volume) => all(&file, read, std::slice::from_ref(volume), seed)?,
            None => all(&file, read, &tile.planes, seed)?,
        }
    }
    Ok(())
}
