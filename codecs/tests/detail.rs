//! Synthetic detail: cells keep their means, and on real terrain it has the power of the ground (specification, F7).

use crate::support::grids;
use crate::support::random::Random;
use crate::support::reduced::{Way, there_and_back};
use terraquilt_codecs::Error;
use terraquilt_codecs::fractal::detail::{GAIN_MAX, OCTAVES_MAX, detailed};
use terraquilt_codecs::fractal::grid::Grid;
use terraquilt_codecs::fractal::{Options, Partition, Search, Tile, encode_heights};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::lattice::Lattice;
use terraquilt_codecs::work::Alone;

fn tile(cols: usize, rows: usize, z: Vec<i32>, partition: Partition, bound: Option<u32>) -> Tile {
    let options = Options { partition: Some(partition), bound, ..Options::default() };
    let file = encode_heights(&Heights::new(cols, rows, z), &Place::default(), &[], &options, &Alone);
    Tile::read(&file.expect("heights that can be coded").bytes).expect("a file")
}

fn ground(cols: usize, rows: usize, seed: u64) -> Vec<i32> {
    let lattice = Lattice::around(cols, rows).expect("a size that fits");
    let z = Random::new(seed).ground(lattice, 8.0);
    (0..cols * rows).map(|k| z[k / cols * lattice.side() + k % cols]).collect()
}

fn reals(z: &[i32]) -> Vec<f64> {
    z.iter().map(|z| f64::from(*z)).collect()
}

/// Greatest difference.
fn apart(a: &Grid<2>, b: &[f64]) -> f64 {
    assert_eq!(a.values.len(), b.len());
    a.values.iter().zip(b).fold(0.0, |m, (a, b)| m.max((a - b).abs()))
}

/// Whatever the size and the partition: 2^k x 2^k means are the heights, and a result is the half of the one with an octave more.
#[test]
fn cells_keep_their_means() {
    let sizes = [[32, 32], [33, 47], [64, 20], [8, 8], [5, 40], [1, 1], [100, 61]];
    for ([cols, rows], seed) in sizes.into_iter().zip(1..) {
        for partition in [Partition::Const(4), Partition::Maps(60)] {
            let z = ground(cols, rows, seed);
            let tile = tile(cols, rows, z.clone(), partition, Some(0));
            let mut before = reals(&z);
            for k in 1..=3 {
                let fine = tile.detailed(k).expect("few octaves");
                assert_eq!(fine.grid.size, [cols << k, rows << k]);
                let off = apart(&fine.grid.half(), &before);
                assert!(off < 1e-8, "{cols} x {rows}, {k} octaves: means are {off} off");
                assert!(fine.gains.iter().all(|g| (0.0..=GAIN_MAX).contains(g)), "{:?}", fine.gains);
                before = fine.grid.values;
            }
        }
    }
}

/// Detail is there where the ground is rough, and has the power that it is said to have; a plane gets none.
#[test]
fn rough_ground_gets_detail_and_a_plane_gets_none() {
    let rough = tile(64, 64, ground(64, 64, 9), Partition::Const(4), Some(0)).detailed(2).expect("a result");
    assert!(rough.powers.iter().all(|p| *p > 0.0), "{:?}", rough.powers);
    let plane: Vec<i32> = (0..64 * 64).map(|k| 12 * (k % 64) - 7 * (k / 64)).collect();
    let fine = tile(64, 64, plane, Partition::Const(4), Some(0)).detailed(1).expect("a result");
    for (k, v) in fine.grid.values.iter().enumerate() {
        let want = 6.0 * (k % 128) as f64 - 3.0 - (3.5 * (k / 128) as f64 - 1.75);
        assert!((v - want).abs() < 1e-6, "sample {k}: {v}, not {want}");
    }
}

/// The tile's units are of no account: twice the heights, twice the detail.
#[test]
fn gains_do_not_depend_on_the_unit() {
    let z = ground(48, 48, 3);
    let walk = tile(48, 48, z.clone(), Partition::Const(4), None).walk(0).expect("maps");
    let one = Grid { size: [48, 48], values: reals(&z) };
    let two = Grid { size: [48, 48], values: one.values.iter().map(|v| 2.0 * v).collect() };
    let (one, two) = (detailed(&walk, &one, 2).unwrap(), detailed(&walk, &two, 2).unwrap());
    assert_eq!(one.gains, two.gains);
    assert!(apart(&two.grid, &one.grid.values.iter().map(|v| 2.0 * v).collect::<Vec<f64>>()) < 1e-9);
}

#[test]
fn what_cannot_be_is_refused() {
    let tile = tile(40, 40, ground(40, 40, 1), Partition::Const(4), None);
    assert!(matches!(tile.detailed(OCTAVES_MAX + 1), Err(Error::Limit { .. })));
    let small = Grid::filled([39, 40], 0.0);
    assert!(matches!(detailed(&tile.walk(0).unwrap(), &small, 1), Err(Error::Invalid { .. })));
    let large = self::tile(700, 700, vec![0; 490_000], Partition::Const(32), None);
    assert!(matches!(large.detailed(8), Err(Error::Limit { .. })));
}

/// Acceptance F7 on five DEMs. More of them, those that miss it too: `cargo run --example detail`, docs/fractal.md.
#[test]
fn octaves_below_the_sample_distance_have_the_power_of_the_ground() {
    let names = [
        "bigtujunga_srtm30m_utm11",
        "colorado_3dep_10m",
        "sierra_srtm3",
        "oso_landslide_lidar_6ft",
        "slovenia_lidar_dtm1m",
    ];
    for grid in names.into_iter().filter_map(grids::of_shared) {
        let truth = grid.cut(0, 0, 512, 512);
        for k in [1, 2] {
            let back = there_and_back(&reals(&truth.z), 512, k, Search::Classes, Some(0)).expect("heights");
            for Way { name, error, powers, .. } in &back.ways {
                println!("{}, {} times: {name} {error:.2}, powers {powers:.2?}", grid.name, 1 << k);
            }
            let of = |name: &str| back.ways.iter().find(|w| w.name == name).expect("a way");
            assert!(of("controlled").holds(), "{}, {} times", grid.name, 1 << k);
            assert!(!of("plain").holds(), "{}: plain zooming is as good", grid.name);
            assert!(of("doubled").error < 1.0, "{}: bicubic interpolation is better", grid.name);
        }
    }
}
