//! Points a second and core by the inverse walk: `cargo run --release --example fractal_points -- FILE.ifs...`; depth 0 to 4, points along rows as
//! a raster asks them, and points at random.

use std::time::Instant;
use terraquilt_codecs::fractal::Tile;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    for file in std::env::args().skip(1) {
        let walk = Tile::read(&std::fs::read(&file)?)?.walk(0)?;
        let size = walk.size().map(|n| n as f64);
        let mut state = 1_u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let scattered: Vec<[f64; 2]> = (0..1 << 20).map(|_| size.map(|n| n * random())).collect();
        let row = size[0] / 1024.0;
        let along: Vec<[f64; 2]> = (0..1 << 20)
            .map(|k| [(f64::from(k % 1024) + 0.5) * row, (f64::from(k / 1024) + 0.5) * size[1] / 1024.0])
            .collect();
        for depth in 0..=4 {
            for (how, points) in [("along rows", &along), ("at random", &scattered)] {
                let mut best = f64::INFINITY;
                for _ in 0..5 {
                    let started = Instant::now();
                    let sum: f64 = points.iter().map(|p| walk.value(*p, depth)).sum();
                    best = best.min(started.elapsed().as_secs_f64());
                    std::hint::black_box(sum);
                }
                println!(
                    "{file}: depth {depth}, {how}: {:.1} M points a second",
                    points.len() as f64 / best / 1e6
                );
            }
        }
    }
    Ok(())
}
