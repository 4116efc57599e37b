use crate::support::{Random, gpu, range, tile, tile_above};
use terraquilt_codecs::fractal::{Options, Partition, Search, Tile, Walk, encode_heights, encode_picture};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Alone;
use terraquilt_gpu::Window;

/// The greatest distance between the GPU's values of a window and the CPU's, in shares of the height range.
fn furthest(walk: &Walk<2>, window: &Window, values: &[f64]) -> f64 {
    assert_eq!(values.len(), window.len());
    let mut out: f64 = 0.0;
    for (k, v) in values.iter().enumerate() {
        let (c, r) = (k as u32 % window.cols, k as u32 / window.cols);
        out = out.max((v - walk.value([window.x(c), window.y(r)], window.depth)).abs());
    }
    out / range(walk)
}

fn agrees(walk: &Walk<2>, window: Window) {
    let Some(gpu) = gpu() else { return };
    let values = gpu.decode(walk, &window).unwrap();
    let share = furthest(walk, &window, &values);
    println!("{window:?}: {share:e} of the range");
    assert!(share <= 1e-4, "{window:?}: {share} of the range apart");
}

#[test]
fn whole_tiles_at_every_zoom() {
    for (seed, size, least) in [(1, [100, 75], 1), (2, [64, 160], 0), (3, [32, 32], 2), (4, [33, 5], 0)] {
        let walk = tile(seed, size, least);
        for zoom in [1.0, 2.0, 4.0, 8.0, 1.5, 3.0, 5.0, 7.25, 1.1] {
            agrees(&walk, Window::whole(size, zoom).unwrap());
        }
    }
}

#[test]
fn deep_windows() {
    let walk = tile(5, [200, 140], 0);
    let mut random = Random::new(6);
    for depth in [10, 14, 20, 24] {
        let step = 1.0 / f64::from(1 << depth);
        for _ in 0..4 {
            // On the lattice of the zoom, and anywhere.
            let at = [random.below(199) as f64, random.below(139) as f64];
            agrees(&walk, Window { x0: at[0], y0: at[1], step, cols: 70, rows: 50, depth });
            let part = random.below(1 << 20) as f64 / f64::from(1 << 20) * 0.9;
            agrees(
                &walk,
                Window { x0: at[0] + part, y0: at[1], step: step * 0.77, cols: 50, rows: 70, depth },
            );
        }
    }
}

/// Samples that lie on edges of ranges, where mirrors lead to the other side of them, up to the border of the grid.
#[test]
fn samples_on_edges() {
    for seed in 7..12 {
        let walk = tile(seed, [64, 64], 0);
        for (half, cols) in [(0.5, 64), (0.25, 128)] {
            agrees(&walk, Window { x0: -half, y0: -half, step: 2.0 * half, cols, rows: cols, depth: 9 });
        }
    }
}

#[test]
fn the_depth_is_the_callers() {
    let walk = tile(13, [96, 96], 1);
    for depth in 0..=12 {
        agrees(&walk, Window { depth, ..Window::whole([96, 96], 1.0).unwrap() });
    }
}

/// The zoom theorem: k steps from the zoom-1 grid are the samples of zoom 2^k.
#[test]
fn zoom_by_passes_is_the_walk() {
    let Some(gpu) = gpu() else { return };
    let walk = tile(14, [96, 64], 1);
    let tile = gpu.upload(&walk).unwrap();
    for k in 0..4 {
        let values = tile.decode(&Window::whole([96, 64], f64::from(1 << k)).unwrap()).unwrap();
        let passes = walk.doubled(k).unwrap();
        assert_eq!(passes.values.len(), values.len());
        let furthest = passes.values.iter().zip(&values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(furthest <= 1e-4 * range(&walk), "zoom 2^{k}: {furthest}");
    }
}

/// Float32 alone would leave half a unit of 250 here.
#[test]
fn heights_far_above_their_range() {
    agrees(&tile_above(1e7, 16, [64, 64], 1), Window::whole([64, 64], 8.0).unwrap());
    agrees(&tile_above(-1e12, 17, [64, 64], 1), Window::whole([64, 64], 8.0).unwrap());
}

/// A picture as it comes out of its file: plane by plane.
#[test]
fn colours_plane_by_plane() {
    let samples = include_bytes!("../../codecs/tests/data/landsat_sfbay_128.rgb");
    let options = Options { search: Search::Near(4), ..Options::default() };
    let encoded = encode_picture([128, 128], 3, samples, "Landsat", &[], &options, &Alone).unwrap();
    let tile = Tile::read(&encoded.bytes).unwrap();
    for k in 0..3 {
        let walk = tile.walk(k).unwrap();
        assert_eq!(walk.size(), if k == 0 { [128, 128] } else { [64, 64] });
        assert!(walk.steps().len() > 0);
        agrees(&walk, Window::whole(walk.size(), 4.0).unwrap());
    }
}

/// Nothing but flat ranges: no leaf at all goes to the GPU.
#[test]
fn flat_tiles() {
    let options =
        Options { partition: Some(Partition::Const(1)), search: Search::Near(4), ..Options::default() };
    let z = (0..64 * 48).map(|k| k * 37 % 101).collect();
    let ground = Heights::new(64, 48, z);
    let encoded = encode_heights(&ground, &Place::default(), &[], &options, &Alone).unwrap();
    let walk = Tile::read(&encoded.bytes).unwrap().walk(0).unwrap();
    assert_eq!(walk.steps().len(), 0);
    agrees(&walk, Window::whole([64, 48], 4.0).unwrap());
}

/// More than one block along each axis, the last ones smaller.
#[test]
fn windows_of_several_blocks() {
    let walk = tile(15, [40, 40], 1);
    agrees(&walk, Window { x0: 0.5, y0: 0.25, step: 39.0 / 2060.0, cols: 2060, rows: 2052, depth: 7 });
    agrees(&walk, Window { x0: 0.5, y0: 0.25, step: 39.0 / 4097.0, cols: 4097, rows: 1, depth: 7 });
}
