//! Tiles of every shape and partition, pictures, regions of interest, voids: what an encoder is asked for.

use super::{Threads, ground};
use crate::support::grids::bundled;
use terraquilt_codecs::Error;
use terraquilt_codecs::fractal::{Kind, Options, Partition, Search, Tile, encode_heights, encode_picture};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::{Alone, Workers};

fn near(partition: Partition) -> Options {
    Options { partition: Some(partition), search: Search::Near(8), ..Options::default() }
}

/// The root mean square error of a part of a tile.
fn rms(tile: &Tile, heights: &Heights, inside: impl Fn(usize, usize) -> bool) -> f64 {
    let found = tile.plane(0).unwrap();
    let posts =
        (0..heights.z.len()).filter(|k| inside(k % heights.cols, k / heights.cols) && !heights.is_void(*k));
    let (sum, count) =
        posts.fold((0.0, 0), |(s, n), k| (s + (found.values[k] - f64::from(heights.z[k])).powi(2), n + 1));
    (sum / f64::from(count.max(1))).sqrt()
}

/// The smallest, the longest, the flattest: all are tiles; the head's errors are those of the decoder.
#[test]
fn any_shape_is_a_tile() {
    for (cols, rows) in
        [(1, 1), (1, 2), (2, 1), (3, 2), (1, 300), (300, 1), (1, 9000), (7, 7), (33, 31), (64, 5), (129, 65)]
    {
        for (rough, flat) in [(10.0, false), (0.0, true)] {
            let mut heights = ground(cols, rows, rough, 9);
            if flat {
                heights.z.fill(-77);
            }
            for options in [near(Partition::Slope(2.0)), near(Partition::Const(2)), near(Partition::Const(1))]
            {
                let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
                let tile = Tile::read(&e.bytes).unwrap();
                assert!(tile.complete, "{cols} x {rows}");
                assert_eq!(tile.header, e.header);
                assert_eq!(tile.maps() as u64, e.header.maps);
                let found = rms(&tile, &heights, |_, _| true);
                assert!((found - e.header.error_rms).abs() < 1e-9);
                if flat {
                    assert!(e.header.error_max <= 1e-9, "{}", e.header.error_max);
                    assert!(tile.planes[0].leaves.iter().all(|l| l.scale == 0));
                }
            }
        }
    }
}

/// Ranges of one sample are their means: exact where the step of the means allows it, and what the published form comes to (a grid enlarged by
/// repetition has ranges of four equal samples, whose best s is 0).
#[test]
fn single_samples_are_their_means() {
    let heights = ground(64, 64, 50.0, 3);
    let options = Options { step: Some(1.0), ..near(Partition::Const(1)) };
    let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
    assert_eq!(e.header.error_max, 0.0);
    assert_eq!(e.header.maps, 64 * 64);
    let twice = |k: usize| heights.z[k / 128 / 2 * 64 + k % 128 / 2];
    let enlarged = Heights::new(128, 128, (0..128 * 128).map(twice).collect());
    let options = Options { step: Some(1.0), ..near(Partition::Const(2)) };
    let e = encode_heights(&enlarged, &Place::default(), &[], &options, &Alone).unwrap();
    let tile = Tile::read(&e.bytes).unwrap();
    assert!(tile.planes[0].leaves.iter().all(|l| l.scale == 0));
    assert_eq!((e.header.maps, e.header.error_max), (64 * 64, 0.0));
}

/// More maps, or a smaller tolerance, make smaller errors; counts are kept.
#[test]
fn partitions_do_as_they_are_told() {
    let heights = ground(128, 128, 30.0, 5);
    let encode = |p| encode_heights(&heights, &Place::default(), &[], &near(p), &Alone).unwrap();
    let mut last = f64::INFINITY;
    for n in [64, 200, 800, 3000] {
        let e = encode(Partition::Maps(n));
        assert!(
            e.header.maps as usize <= n && e.header.maps as usize + 3 > n.min(4096),
            "{} maps of {n}",
            e.header.maps
        );
        assert!(e.header.error_rms < last);
        last = e.header.error_rms;
    }
    let sizes: Vec<usize> =
        [1000.0, 100.0, 10.0, 1.0].map(|s| encode(Partition::Slope(s)).bytes.len()).into();
    assert!(sizes.is_sorted(), "{sizes:?}");
    let e = encode(Partition::Tolerance(20.0));
    assert!(e.header.error_rms < 25.0, "{}", e.header.error_rms);
    let few = encode_heights(&heights, &Place::default(), &[], &near(Partition::Maps(3)), &Alone);
    assert!(few.err().unwrap().to_string().contains("16 ranges"));
}

/// A region of interest gets the maps: its error falls, the rest's rises.
#[test]
fn weights_draw_maps() {
    let heights = bundled("survey_2004-10-04_native").cut(0, 0, 128, 128);
    let inside = |x: usize, y: usize| (32..64).contains(&x) && (64..96).contains(&y);
    let weights: Vec<f32> =
        (0..128 * 128).map(|k| if inside(k % 128, k / 128) { 50.0 } else { 1.0 }).collect();
    let errors = |weights: &[f32]| {
        let e = encode_heights(&heights, &Place::default(), weights, &near(Partition::Maps(700)), &Alone)
            .unwrap();
        let tile = Tile::read(&e.bytes).unwrap();
        [rms(&tile, &heights, inside), rms(&tile, &heights, |x, y| !inside(x, y))]
    };
    let (plain, drawn) = (errors(&[]), errors(&weights));
    assert!(drawn[0] < 0.6 * plain[0] && drawn[1] > plain[1], "{plain:?} {drawn:?}");
    for wrong in [vec![1.0; 5], vec![0.5; 128 * 128], vec![f32::NAN; 128 * 128]] {
        let e = encode_heights(&heights, &Place::default(), &wrong, &near(Partition::Maps(700)), &Alone);
        assert!(matches!(e, Err(Error::Invalid { what: "weights", .. })));
    }
}

/// Voids come back as voids; of a tile of nothing but voids nothing else does.
#[test]
fn voids_are_kept() {
    let mut heights = ground(90, 50, 10.0, 8);
    heights.void = (0..90 * 50).map(|k| (k % 90) * (k % 90) + (k / 90) * (k / 90) < 900).collect();
    heights.z.iter_mut().zip(&heights.void).filter(|(_, v)| **v).for_each(|(z, _)| *z = -9999);
    for void in [heights.void.clone(), vec![true; 90 * 50]] {
        heights.void = void;
        for options in
            [near(Partition::Slope(4.0)), Options { bound: Some(2), ..near(Partition::Slope(30.0)) }]
        {
            let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
            let found = Tile::read(&e.bytes).unwrap();
            assert_eq!(found.heights().unwrap().void, heights.void);
            assert!(e.header.error_max < 40.0, "voids are not asked to be met: {}", e.header.error_max);
        }
    }
}

/// The same bytes, whatever the threads; a search that is stopped says so.
#[test]
fn threads_change_nothing() {
    struct Stopped;
    impl Workers for Stopped {
        fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
            (0..parts).for_each(part);
        }
        fn going(&self, _: f64) -> bool {
            false
        }
    }
    let heights = ground(128, 96, 30.0, 11);
    for search in [Search::Exact, Search::Classes, Search::Near(16)] {
        let options = Options { search, ..near(Partition::Maps(900)) };
        let bytes =
            |w: &dyn Workers| encode_heights(&heights, &Place::default(), &[], &options, w).map(|e| e.bytes);
        assert!(bytes(&Alone).unwrap() == bytes(&Threads).unwrap());
        assert!(matches!(bytes(&Stopped), Err(Error::Stopped)));
    }
}

/// Colour: three planes, two of them smaller; the error that is told is that of the bytes.
#[test]
fn pictures_come_back_in_colour() {
    let (cols, rows) = (75, 50);
    let samples: Vec<u8> = (0..cols * rows)
        .flat_map(|k| {
            let (x, y) = (k % cols, k / cols);
            [(x * 3) as u8, (y * 5) as u8, if (x / 9 + y / 7) % 2 == 0 { 40 } else { 200 }]
        })
        .collect();
    let mut last = 0.0;
    for chroma in [1, 2, 4] {
        let options = Options { chroma, ..near(Partition::Maps(1500)) };
        let e = encode_picture([cols, rows], 3, &samples, "colours", &[], &options, &Alone).unwrap();
        let tile = Tile::read(&e.bytes).unwrap();
        assert_eq!((tile.header.kind, tile.header.place.source.as_str()), (Kind::Colour, "colours"));
        assert_eq!(tile.planes[1].shape.size, [cols.div_ceil(chroma), rows.div_ceil(chroma)]);
        let found = tile.picture(1).unwrap();
        let sum: f64 =
            found.samples.iter().zip(&samples).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
        let rms = (sum / samples.len() as f64).sqrt();
        assert!((rms - e.header.error_rms).abs() < 1e-9);
        assert!(rms > last && rms < 40.0, "chroma {chroma}: {rms}");
        last = rms;
        let large = tile.picture(4).unwrap();
        assert_eq!((large.cols, large.rows, large.samples.len()), (300, 200, 180_000));
        assert!(tile.picture(3).is_err() && tile.heights().is_err() && tile.volume().is_err());
    }
    let bounded = Options { bound: Some(1), ..Options::default() };
    assert!(encode_picture([cols, rows], 3, &samples, "", &[], &bounded, &Alone).is_err());
    assert!(encode_picture([cols, rows], 2, &samples, "", &[], &near(Partition::Const(2)), &Alone).is_err());
}

/// What cannot be is refused with a sentence.
#[test]
fn options_are_checked() {
    let heights = ground(64, 64, 3.0, 1);
    let with = |o: Options| {
        encode_heights(&heights, &Place::default(), &[], &o, &Alone).err().map(|e| e.to_string())
    };
    for (options, told) in [
        (near(Partition::Const(3)), "a power of two"),
        (near(Partition::Const(64)), "a power of two"),
        (Options { jump: 3, ..near(Partition::Const(4)) }, "even"),
        (Options { jump: 0, ..near(Partition::Const(4)) }, "even"),
        (Options { isometries: Some(4), ..near(Partition::Const(4)) }, "1 or 8"),
        (Options { range_max: Some(2), range_min: Some(8), ..near(Partition::Slope(1.0)) }, "the smallest"),
        (Options { step: Some(0.0), ..near(Partition::Const(4)) }, "step 0"),
        (Options { scale_bits: Some(9), ..near(Partition::Const(4)) }, "2 to 8"),
        (Options { search: Search::Near(1000), ..near(Partition::Const(4)) }, "1000"),
    ] {
        let found = with(options).unwrap_or_default();
        assert!(found.contains(told), "{found:?} does not tell {told:?}");
    }
    let bound = Options { bound: Some(u32::MAX), ..Options::default() };
    assert!(with(bound).unwrap().contains("bound"));
}
