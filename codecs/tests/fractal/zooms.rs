//! The zoom theorem, walks, seeds, passes (specification section 4; acceptance F4, F5).

use super::ground;
use crate::support::grids::bundled;
use crate::support::random::Random;
use terraquilt_codecs::fractal::grid::{Grid, points};
use terraquilt_codecs::fractal::iterate::Stop;
use terraquilt_codecs::fractal::{
    Ifs, Options, Partition, Search, Space, Tile, Walk, encode_heights, encode_volume,
};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Alone;

fn tile(heights: &Heights, options: &Options) -> Tile {
    let e = encode_heights(heights, &Place::default(), &[], options, &Alone).unwrap();
    Tile::read(&e.bytes).unwrap()
}

/// Tiles of several partitions, with the span of their heights.
fn tiles() -> Vec<(Tile, f64)> {
    let near = Options { search: Search::Near(16), ..Options::default() };
    let with = |partition| Options { partition: Some(partition), ..near.clone() };
    let crater = bundled("crater_2005-06-15_10m").cut(0, 0, 96, 128);
    let options = [
        (ground(64, 64, 20.0, 1), with(Partition::Const(4))),
        (ground(100, 60, 5.0, 2), with(Partition::Slope(10.0))),
        (ground(64, 64, 60.0, 3), Options { range_min: Some(1), ..with(Partition::Maps(2500)) }),
        (ground(48, 64, 9.0, 4), Options { jump: 2, ..with(Partition::Maps(400)) }),
        (crater, with(Partition::Tolerance(3.0))),
    ];
    options
        .iter()
        .map(|(heights, options)| {
            let range = heights.z.iter().fold((i32::MAX, i32::MIN), |r, z| (r.0.min(*z), r.1.max(*z)));
            (tile(heights, options), f64::from(range.1 - range.0))
        })
        .collect()
}

fn far<const D: usize>(a: &Grid<D>, b: &Grid<D>) -> f64 {
    assert_eq!(a.size, b.size);
    a.values.iter().zip(&b.values).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

/// F4: the mean over 2 x 2 samples at zoom 2z is the sample at zoom z.
#[test]
fn half_of_the_double_is_the_whole() {
    for (tile, range) in tiles() {
        let walk = tile.walk(0).unwrap();
        for k in 0..3 {
            let (whole, double) = (walk.doubled(k).unwrap(), walk.doubled(k + 1).unwrap());
            let off = far(&double.half(), &whole);
            assert!(off <= 1e-6 * range, "zoom {}: {off} of {range}", 1 << k);
        }
    }
}

/// F4: zooms found by passes from nothing are those found by single fetches.
#[test]
fn passes_at_a_zoom_come_to_the_same() {
    for (tile, range) in tiles() {
        let (ifs, walk) = (&tile.planes[0], tile.walk(0).unwrap());
        for zoom in [2, 4] {
            let passes = ifs.iterate([zoom, 1], tile.header.seed(), Stop::TIGHT, &mut || true).unwrap();
            let fetched = walk.doubled(zoom.trailing_zeros()).unwrap();
            assert!(far(&passes.grid, &fetched) <= 1e-6 * range);
        }
        if ifs.zooms([1, 2]) {
            let half = ifs.iterate([1, 2], tile.header.seed(), Stop::TIGHT, &mut || true).unwrap();
            assert!(far(&half.grid, &walk.grid().half()) <= 1e-6 * range);
        }
        if ifs.zooms([3, 2]) {
            let odd = ifs.iterate([3, 2], tile.header.seed(), Stop::TIGHT, &mut || true).unwrap();
            assert_eq!(odd.grid.size, walk.grid().size.map(|n| n * 3 / 2));
        }
    }
}

/// F4: the walk is the discrete zoom, at every cell.
#[test]
fn walks_are_the_discrete_zoom() {
    for (tile, range) in tiles() {
        let walk = tile.walk(0).unwrap();
        for depth in 0..=3 {
            let zoom = f64::from(1 << depth);
            let grid = walk.doubled(depth).unwrap();
            for p in points(walk.size().map(|n| n << depth)) {
                let value = walk.value(p.map(|v| (v as f64 + 0.5) / zoom), depth);
                let off = (value - grid.values[grid.at(p)]).abs();
                assert!(off <= 1e-6 * range, "depth {depth}, {p:?}: {off} of {range}");
            }
        }
        // Points beyond the tile, and no numbers, are answered with the border's.
        let corner = walk.value([0.0, 0.0], 2);
        assert_eq!(walk.value([-9.0, -1e300], 2), corner);
        assert_eq!(walk.value([f64::NAN; 2], 2), corner);
        assert!(walk.value([f64::INFINITY; 2], 9).is_finite());
    }
}

/// F5: whatever the passes begin with, they end in the same.
#[test]
fn seeds_are_forgotten() {
    for (tile, _) in tiles() {
        let [lo, hi] = tile.header.range.map(f64::from);
        let ifs = &tile.planes[0];
        let end = |seed: f64| ifs.iterate([1, 1], seed, Stop::PUBLISHED, &mut || true).unwrap();
        let (a, b) = (end(lo), end(hi));
        assert!(a.change < 0.002 && a.passes <= 20, "{} passes, {}", a.passes, a.change);
        let count = a.grid.values.len() as f64;
        let mean: f64 =
            a.grid.values.iter().zip(&b.grid.values).map(|(a, b)| (a - b).abs()).sum::<f64>() / count;
        let most = far(&a.grid, &b.grid);
        println!("{} passes, seeds apart by {mean:.6} on average, {most:.4} at most", a.passes);
        assert!(mean < 0.01);
    }
}

/// Passes that were stopped go on from where they were; the result is nearer the end the more of them there are.
#[test]
fn what_is_there_is_the_next_seed() {
    for (tile, range) in tiles() {
        let ifs = &tile.planes[0];
        let end = tile.walk(0).unwrap().grid().clone();
        let mut there = Grid::filled(ifs.shape.padded(), tile.header.seed());
        let mut last = f64::INFINITY;
        for _ in 0..6 {
            there = ifs.iterate_on(there, Stop::passes(2), &mut || true).unwrap().grid;
            let off = far(&there, &end);
            assert!(off <= last + 1e-9, "{off} after {last}");
            last = off;
        }
        assert!(last <= 0.05 * range, "{last} of {range}");
        let mut asked = 0;
        let stopped = ifs.iterate([1, 1], 0.0, Stop::TIGHT, &mut || {
            asked += 1;
            asked < 3
        });
        assert!(!stopped.unwrap().finished);
    }
}

/// Depths for views: a sample wanted at least as fine as asked for.
#[test]
fn depths_follow_the_wanted_distance() {
    for (step, wanted, depth) in
        [(10.0, 10.0, 0), (10.0, 20.0, 0), (10.0, 9.9, 1), (10.0, 2.5, 2), (1.0, 1e-30, 24)]
    {
        assert_eq!(Walk::<2>::depth(step, wanted), depth);
    }
}

/// In space it is the same: all groups of isometries.
#[test]
fn volumes_zoom_alike() {
    let size = [16, 24, 16];
    let mut random = Random::new(5);
    let values: Vec<i8> = points(size)
        .map(|p| {
            let d = p.map(|v| (v as f64 - 8.0) * 0.4).iter().map(|v| v * v).sum::<f64>();
            ((3.0 - d.sqrt()) * 20.0 + random.unit() * 6.0).clamp(-127.0, 127.0) as i8
        })
        .collect();
    for isometries in [1, 16, 24, 48] {
        let options = Options {
            partition: Some(Partition::Slope(5.0)),
            isometries: Some(isometries),
            ..Options::default()
        };
        let space = Space { origin: [0.0; 3], voxel: 1.0 };
        let e = encode_volume(size, &values, space, "ball", &options, &Alone).unwrap();
        let tile = Tile::read(&e.bytes).unwrap();
        let ifs: &Ifs<3> = tile.volume.as_ref().unwrap();
        assert!(ifs.leaves.iter().any(|l| l.isometry > 0) || isometries == 1);
        let walk = Walk::new(ifs).unwrap();
        let double = walk.doubled(1).unwrap();
        assert!(far(&double.half(), walk.grid()) <= 1e-6 * 254.0);
        for p in points(walk.size().map(|n| 2 * n)) {
            let value = walk.value(p.map(|v| (v as f64 + 0.5) / 2.0), 1);
            assert!((value - double.values[double.at(p)]).abs() <= 1e-6 * 254.0);
        }
    }
}
