//! What nobody in their senses asks: absurd zooms, heads that contradict themselves, options without sense, the highest heights.

use super::ground;
use crate::support::random::Random;
use terraquilt_codecs::Error;
use terraquilt_codecs::fractal::grid::{Grid, points};
use terraquilt_codecs::fractal::iterate::Stop;
use terraquilt_codecs::fractal::{
    Encoded, Options, Partition, Search, Space, Tile, encode_heights, encode_picture, encode_volume,
};
use terraquilt_codecs::heights::{HEIGHT_MAX, Heights, Place};
use terraquilt_codecs::work::Alone;

fn near(partition: Partition) -> Options {
    Options { partition: Some(partition), search: Search::Near(4), ..Options::default() }
}

fn encoded(heights: &Heights, options: &Options) -> Result<Encoded, Error> {
    encode_heights(heights, &Place::default(), &[], options, &Alone)
}

/// A file whose head was changed, with its checksum.
fn sealed(mut file: Vec<u8>) -> Vec<u8> {
    let head = usize::from(u16::from_le_bytes([file[9], file[10]]));
    let crc = crc32c::crc32c(&file[..head - 4]);
    file[head - 4..head].copy_from_slice(&crc.to_le_bytes());
    file
}

/// Heights and brightness have all their samples: a head that says their plane is smaller is refused.
#[test]
fn only_colours_have_smaller_planes() {
    let heights = ground(60, 40, 30.0, 3);
    let bounded = Options { bound: Some(3), ..near(Partition::Slope(2.0)) };
    let samples: Vec<u8> = (0..60 * 40 * 3).map(|k| (k * k / 7) as u8).collect();
    let picture = |channels: usize, chroma: usize| {
        let options = Options { chroma, ..near(Partition::Slope(2.0)) };
        let samples = &samples[..60 * 40 * channels];
        encode_picture([60, 40], channels, samples, "", &[], &options, &Alone).unwrap().bytes
    };
    // A shape: smaller, max, min, jump, isometries, near, bits of s, step, origin; then the length of the body.
    let shape = 23;
    for (file, planes) in
        [(encoded(&heights, &bounded).unwrap().bytes, 1), (picture(1, 2), 1), (picture(3, 1), 3)]
    {
        let head = usize::from(u16::from_le_bytes([file[9], file[10]]));
        let body = Tile::read(&file).unwrap().header.body;
        let at = head - 4 - if body < 128 { 1 } else { 2 } - planes * shape;
        for smaller in [2, 4] {
            let mut wrong = file.clone();
            assert_eq!(wrong[at..at + 3], [1, wrong[at + 1], 1]);
            wrong[at] = smaller;
            let refused = Tile::read(&sealed(wrong)).err();
            assert!(matches!(refused, Some(Error::Damaged { .. })), "{refused:?}");
        }
    }
}

/// Zooms beyond all numbers meet a limit or an error.
#[test]
fn absurd_zooms_are_refused() {
    let heights = ground(64, 48, 10.0, 1);
    for options in [near(Partition::Slope(9.0)), Options { bound: Some(1), ..near(Partition::Const(1)) }] {
        let tile = Tile::read(&encoded(&heights, &options).unwrap().bytes).unwrap();
        let ifs = &tile.planes[0];
        for a in [0, 1 << 16, 1 << 20, (1 << 27) + 1, 1 << 31, usize::MAX / 2, usize::MAX] {
            for b in [0, 1, 2, 3] {
                assert!(ifs.iterate([a, b], 0.0, Stop::PUBLISHED, &mut || true).is_err(), "{a}/{b}");
            }
        }
        for b in [64, 1 << 20, 1 << 31, usize::MAX] {
            assert!(!ifs.zooms([1, b]), "1/{b}");
            // The same zoom in large numbers.
            let once = ifs.iterate([1, 1], 0.0, Stop::PUBLISHED, &mut || true).unwrap();
            assert_eq!(ifs.iterate([b, b], 0.0, Stop::PUBLISHED, &mut || true).unwrap(), once);
        }
        let walk = tile.walk(0).unwrap();
        for k in [13, 31, 32, 33, 63, 64, 1 << 31, (1 << 31) + 1, u32::MAX] {
            assert!(matches!(walk.doubled(k), Err(Error::Limit { .. })), "{k}");
        }
        assert!(walk.value([3.0, 2.0], u32::MAX).is_finite());
        for (col, row) in [(64, 0), (0, 48), (usize::MAX, 0), (0, usize::MAX), (usize::MAX, usize::MAX)] {
            assert_eq!(tile.added(col, row), 0.0);
        }
        let short = Grid { size: ifs.shape.padded(), values: vec![0.0; 9] };
        assert!(ifs.iterate_on(short, Stop::PUBLISHED, &mut || true).is_err());
    }
    let grey = vec![9; 64 * 48];
    let e = encode_picture([64, 48], 1, &grey, "", &[], &near(Partition::Slope(9.0)), &Alone).unwrap();
    let tile = Tile::read(&e.bytes).unwrap();
    for by in [0, 3, 1 << 14, 1 << 31, usize::MAX / 2 + 1] {
        assert!(tile.picture(by).is_err(), "{by}");
    }
}

/// The corners of cells are in their cells: there a walk is the discrete zoom as everywhere else, whatever mirrors do.
#[test]
fn walks_at_corners_of_cells() {
    let heights = ground(64, 64, 40.0, 5);
    for options in [near(Partition::Const(4)), Options { range_min: Some(1), ..near(Partition::Maps(1500)) }]
    {
        let tile = Tile::read(&encoded(&heights, &options).unwrap().bytes).unwrap();
        assert!(tile.planes[0].leaves.iter().any(|l| l.isometry > 0));
        let walk = tile.walk(0).unwrap();
        for depth in 0..=3 {
            let grid = walk.doubled(depth).unwrap();
            for p in points(grid.size) {
                let value = walk.value(p.map(|v| v as f64 / f64::from(1 << depth)), depth);
                let off = (value - grid.values[grid.at(p)]).abs();
                assert!(off < 1e-6, "depth {depth}, {p:?}: {off}");
            }
        }
    }
}

/// Options without sense are refused, not obeyed in some way.
#[test]
fn numbers_without_sense_are_refused() {
    let heights = ground(40, 40, 10.0, 2);
    let with = |o: Options| encoded(&heights, &o).map(|e| e.bytes.len());
    for wrong in [f64::NAN, -1.0, f64::INFINITY, f64::NEG_INFINITY] {
        for partition in [Partition::Slope(wrong), Partition::Tolerance(wrong)] {
            let refused = with(near(partition));
            assert!(
                matches!(refused, Err(Error::Invalid { what: "partition", .. })),
                "{partition:?} {refused:?}"
            );
        }
        let refused = with(Options { step: Some(wrong), ..near(Partition::Slope(1.0)) });
        assert!(refused.is_err(), "step {wrong}: {refused:?}");
    }
    for partition in [Partition::Const(0), Partition::Maps(0), Partition::Const(usize::MAX)] {
        assert!(matches!(with(near(partition)), Err(Error::Invalid { .. })), "{partition:?}");
    }
    for options in [
        Options { range_max: Some(1), ..near(Partition::Slope(1.0)) },
        Options { range_max: Some(0), ..near(Partition::Slope(1.0)) },
        Options { range_min: Some(0), ..near(Partition::Slope(1.0)) },
        Options { jump: usize::MAX, ..near(Partition::Slope(1.0)) },
        Options { jump: 66, ..near(Partition::Slope(1.0)) },
        Options { near: Some(usize::MAX), search: Search::Exact, ..near(Partition::Slope(1.0)) },
        Options { search: Search::Near(0), ..near(Partition::Slope(1.0)) },
        Options { scale_bits: Some(u32::MAX), ..near(Partition::Slope(1.0)) },
        Options { scale_bits: Some(0), ..near(Partition::Slope(1.0)) },
        Options { isometries: Some(0), ..near(Partition::Slope(1.0)) },
    ] {
        let refused = with(options.clone());
        assert!(matches!(refused, Err(Error::Invalid { .. })), "{options:?} {refused:?}");
    }
    for place in [Place { unit: 0.0, ..Place::default() }, Place { base: f64::NAN, ..Place::default() }] {
        let refused = encode_heights(&heights, &place, &[], &near(Partition::Slope(1.0)), &Alone).err();
        assert!(matches!(refused, Some(Error::Invalid { what: "place", .. })), "{refused:?}");
    }
    for (origin, voxel) in [([0.0; 3], 0.0), ([0.0; 3], f64::NAN), ([0.0, f64::INFINITY, 0.0], 1.0)] {
        let space = Space { origin, voxel };
        let refused = encode_volume([8; 3], &[3; 512], space, "", &near(Partition::Slope(1.0)), &Alone).err();
        assert!(matches!(refused, Some(Error::Invalid { what: "place", .. })), "{refused:?}");
    }
}

/// The most extreme options that have sense: what is written is read, and says how wrong it is.
#[test]
fn the_ends_of_options_are_tiles() {
    let heights = ground(40, 33, 10.0, 2);
    let tiny = 5e-324;
    for options in [
        near(Partition::Maps(usize::MAX)),
        near(Partition::Slope(0.0)),
        near(Partition::Slope(1e300)),
        near(Partition::Tolerance(0.0)),
        near(Partition::Tolerance(1e300)),
        near(Partition::Const(32)),
        Options { scale_bits: Some(2), ..near(Partition::Slope(1.0)) },
        Options { scale_bits: Some(8), ..near(Partition::Slope(1.0)) },
        Options { jump: 64, ..near(Partition::Slope(1.0)) },
        Options { jump: 2, range_min: Some(1), ..near(Partition::Slope(1.0)) },
        Options { jump: 6, ..near(Partition::Slope(1.0)) },
        Options { search: Search::Near(64), ..near(Partition::Slope(1.0)) },
        Options { search: Search::Near(1), ..near(Partition::Slope(1.0)) },
        Options { near: Some(0), search: Search::Classes, ..near(Partition::Slope(1.0)) },
        Options { step: Some(tiny), ..near(Partition::Slope(1.0)) },
        Options { step: Some(1e12), ..near(Partition::Slope(1.0)) },
    ] {
        for bound in [None, Some(0), Some(1 << 20)] {
            let options = Options { bound, ..options.clone() };
            let e = encoded(&heights, &options).unwrap_or_else(|e| panic!("{options:?}: {e}"));
            let tile = Tile::read(&e.bytes).unwrap();
            assert!(tile.complete && tile.maps() as u64 == e.header.maps);
            let found = tile.heights().unwrap();
            if let Some(bound) = bound {
                assert!(found.z.iter().zip(&heights.z).all(|(a, b)| a.abs_diff(*b) <= bound));
            }
        }
        let samples: Vec<u8> = heights.z.iter().map(|z| *z as u8).collect();
        let options = Options { bound: None, ..options };
        let e = encode_picture([40, 33], 1, &samples, "", &[], &options, &Alone)
            .unwrap_or_else(|e| panic!("{options:?}: {e}"));
        // Means are no coarser than asked for, or than numbers have room for.
        let fine =
            options.step.is_none_or(|s| s < 1.0) && !matches!(options.partition, Some(Partition::Const(_)));
        assert!(
            !fine
                || options.partition == Some(Partition::Tolerance(1e300))
                || options.partition == Some(Partition::Slope(1e300))
                || e.header.error_rms < 60.0,
            "{options:?}: {}",
            e.header.error_rms
        );
    }
    for chroma in [1, 2, 4] {
        for size in [[1, 1], [1, 2], [2, 1], [3, 3], [1, 9], [5, 2]] {
            let samples: Vec<u8> = (0..size[0] * size[1] * 3).map(|k| (k * 37) as u8).collect();
            let options = Options { chroma, ..near(Partition::Maps(usize::MAX)) };
            let e = encode_picture(size, 3, &samples, "", &[], &options, &Alone).unwrap();
            for by in [1, 2, 8] {
                let p = Tile::read(&e.bytes).unwrap().picture(by).unwrap();
                assert_eq!(p.samples.len(), samples.len() * by * by);
            }
        }
    }
}

/// Long and thin tiles are tiles.
#[test]
fn the_longest_are_tiles() {
    for (cols, rows) in [(16_384, 1), (1, 16_384), (3, 16_383), (16_383, 2), (5463, 1)] {
        let heights = ground(cols, rows, 3.0, 7);
        let options = Options { bound: Some(2), ..near(Partition::Slope(50.0)) };
        let e = encoded(&heights, &options).unwrap();
        let tile = Tile::read(&e.bytes).unwrap();
        let found = tile.heights().unwrap();
        assert!(found.z.iter().zip(&heights.z).all(|(a, b)| a.abs_diff(*b) <= 2));
        let walk = tile.walk(0).unwrap();
        assert!(walk.value([cols as f64, rows as f64], 24).is_finite());
    }
    for size in [[1, 1, 1], [512, 1, 1], [1, 2, 300], [7, 1, 9], [33, 40, 2], [200, 190, 1]] {
        let values: Vec<i8> = (0..size.iter().product()).map(|k: usize| (k % 90) as i8 - 45).collect();
        let space = Space { origin: [0.0; 3], voxel: 1.0 };
        let e = encode_volume(size, &values, space, "", &near(Partition::Slope(5.0)), &Alone).unwrap();
        let tile = Tile::read(&e.bytes).unwrap();
        assert_eq!(tile.volume().unwrap().values.len(), values.len());
    }
}

/// The highest heights beside the lowest, in every bound: it holds.
#[test]
fn the_bound_holds_between_the_ends_of_numbers() {
    let mut random = Random::new(3);
    for round in 0..60 {
        let (cols, rows) = (1 + random.below(40) as usize, 1 + random.below(40) as usize);
        let z = (0..cols * rows)
            .map(|k| match round % 4 {
                0 => [-HEIGHT_MAX, HEIGHT_MAX][random.below(2) as usize],
                1 => random.below(2 * HEIGHT_MAX as u64 + 1) as i32 - HEIGHT_MAX,
                2 => [-HEIGHT_MAX, HEIGHT_MAX][k / 5 % 2],
                _ => [-HEIGHT_MAX, HEIGHT_MAX, 0, 1][(k % cols / 8 + k / cols / 4 * 3) % 4],
            })
            .collect();
        let heights = Heights::new(cols, rows, z);
        let bound = [0, 1, 9, 1 << 20][random.below(4) as usize];
        let partition = [
            None,
            Some(Partition::Slope(random.unit() * 1e12)),
            Some(Partition::Const(2)),
            Some(Partition::Maps(cols * rows)),
        ][random.below(4) as usize];
        let step = [None, Some(1.0), Some(1e-3)][random.below(3) as usize];
        let jump = [2, 4][random.below(2) as usize];
        let options = Options {
            bound: Some(bound),
            partition,
            step,
            jump,
            scale_bits: Some(2 + random.below(7) as u32),
            search: Search::Near(5),
            ..Options::default()
        };
        let e = encoded(&heights, &options).unwrap_or_else(|e| panic!("{options:?}: {e}"));
        let found = Tile::read(&e.bytes).unwrap().heights().unwrap();
        let most = found.z.iter().zip(&heights.z).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
        assert!(most <= bound && e.header.error_max == f64::from(most), "{most} {options:?}");
    }
}
