//! Values a second on this GPU and on one core of the CPU, a window of 2048 x 2048 samples at each zoom:
//!
//! `cargo run --release -p terraquilt-gpu --example decode [FILE.ifs]`
//!
//! Without a file the brightness of a small satellite picture.
use std::hint::black_box;
use std::time::Instant;
use terraquilt_codecs::fractal::{Options, Search, Tile, encode_picture};
use terraquilt_codecs::work::Alone;
use terraquilt_gpu::{Gpu, Window};

const SIDE: u32 = 2048;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let bytes = match std::env::args().nth(1) {
        Some(file) => std::fs::read(file)?,
        None => {
            let samples = include_bytes!("../../codecs/tests/data/landsat_sfbay_128.rgb");
            let options = Options { search: Search::Near(16), ..Options::default() };
            encode_picture([128, 128], 3, samples, "Landsat", &[], &options, &Alone)?.bytes
        }
    };
    let walk = Tile::read(&bytes)?.walk(0)?;
    let gpu = Gpu::open()?;
    let tile = gpu.upload(&walk)?;
    let [cols, rows] = walk.size();
    println!("{cols} x {rows} samples, {} maps; {}", walk.steps().len(), gpu.name());
    println!("| zoom | steps | GPU, M values/s | CPU, one core |");
    println!("|---|---|---|---|");
    for depth in [0, 1, 2, 3, 4, 6, 8, 10] {
        let step = cols.min(rows) as f64 / f64::from(SIDE);
        let step = step.min(1.0 / f64::from(1 << depth));
        let window = Window { x0: 0.0, y0: 0.0, step, cols: SIDE, rows: SIDE, depth };
        let gpu_s = fastest(|| tile.decode(&window).map(|v| v.len()))?;
        let cpu_s = fastest(|| {
            for row in 0..SIDE {
                for col in 0..SIDE {
                    black_box(walk.value([window.x(col), window.y(row)], depth));
                }
            }
            Ok(window.len())
        })?;
        let rate = |s: f64| window.len() as f64 / s / 1e6;
        println!("| {} | {depth} | {:.1} | {:.1} |", 1 << depth, rate(gpu_s), rate(cpu_s));
    }
    Ok(())
}

/// Seconds of the fastest of five.
fn fastest(mut work: impl FnMut() -> terraquilt_gpu::Result<usize>) -> terraquilt_gpu::Result<f64> {
    let mut best = f64::INFINITY;
    for _ in 0..5 {
        let start = Instant::now();
        black_box(work()?);
        best = best.min(start.elapsed().as_secs_f64());
    }
    Ok(best)
}
