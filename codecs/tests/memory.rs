//! Bytes that decoding a fractal tile takes, counted. In a program of its own: the count is of the whole process.

use peak_alloc::PeakAlloc;
use terraquilt_codecs::fractal::{Options, Partition, Search, Tile, encode_heights};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Alone;

#[global_allocator]
static COUNTED: PeakAlloc = PeakAlloc;

/// What models and tables take, whatever the tile.
const FIXED: f64 = 128.0 * 1024.0;

/// Bytes that `what` has at most, beyond what there was before.
fn peak<T>(what: impl FnOnce() -> T) -> (f64, T) {
    let before = COUNTED.current_usage();
    COUNTED.reset_peak_usage();
    let out = what();
    ((COUNTED.peak_usage() - before) as f64, out)
}

/// Hills, and a hash for noise.
fn ground(cols: usize, rows: usize, rough: i32) -> Heights {
    let z = (0..cols * rows).map(|k| {
        let (x, y) = ((k % cols) as f64, (k / cols) as f64);
        let noise = (k as u32).wrapping_mul(0x9e37_79b9) >> 16;
        (300.0 * (0.013 * x).sin() * (0.017 * y).cos()) as i32 + (noise as i32 % rough.max(1))
    });
    Heights::new(cols, rows, z.collect())
}

/// Acceptance F9: at most 16 bytes a declared sample to read a tile and to decode it.
#[test]
fn a_sample_is_decoded_in_sixteen_bytes() {
    let near = Options { search: Search::Near(4), ..Options::default() };
    let single = Options { range_min: Some(1), ..near.clone() };
    let cases = [
        (
            "maps and flat ranges",
            [512, 512],
            Options { partition: Some(Partition::Slope(100.0)), ..near.clone() },
        ),
        ("ranges of 2", [512, 512], Options { partition: Some(Partition::Const(2)), ..near.clone() }),
        (
            "ranges of 2, bound",
            [512, 512],
            Options { partition: Some(Partition::Const(2)), bound: Some(0), ..near.clone() },
        ),
        ("single samples", [512, 512], Options { partition: Some(Partition::Const(1)), ..single.clone() }),
        (
            "single samples, bound",
            [512, 512],
            Options { partition: Some(Partition::Const(1)), bound: Some(1), ..single.clone() },
        ),
        (
            "whole ranges add a quarter",
            [130, 2048],
            Options { partition: Some(Partition::Const(1)), bound: Some(0), ..single.clone() },
        ),
        (
            "jump of 2",
            [512, 512],
            Options { partition: Some(Partition::Const(2)), bound: Some(0), jump: 2, ..near.clone() },
        ),
        (
            "jump of 6, single samples, bound",
            [512, 512],
            Options { partition: Some(Partition::Const(1)), bound: Some(0), jump: 6, ..single },
        ),
    ];
    for (name, [cols, rows], options) in cases {
        for voids in [false, true] {
            let mut heights = ground(cols, rows, 40);
            if voids {
                heights.void = (0..cols * rows).map(|k| k % 1009 == 0).collect();
            }
            let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
            let (reading, tile) = peak(|| Tile::read(&e.bytes).unwrap());
            let maps = tile.maps();
            drop(tile);
            let (all, found) = peak(|| Tile::read(&e.bytes).unwrap().into_heights().unwrap());
            assert_eq!(found.z.len(), cols * rows);
            let samples = (cols * rows) as f64;
            // What `Tile::read` holds of the file is counted; the file itself is the caller's.
            let [reading, all] = [reading, all].map(|b| (b - FIXED) / samples);
            println!(
                "{name}, voids {voids}: {maps} maps, {reading:.1} bytes a sample to read, {all:.1} in all"
            );
            assert!(all <= 16.0, "{name}: {all}");
        }
    }
}
