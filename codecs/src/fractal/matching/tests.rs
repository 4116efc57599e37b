//! The quick form against the plain one.

use super::frame::Frame;
use super::{Level, Match, Search, plain};
use crate::fractal::domains::Domains;
use crate::fractal::grid::{Grid, points};
use crate::fractal::isometry::group;
use crate::fractal::scale::Scales;
use crate::work::{Alone, Workers};
use crate::{Error, Result};
use proptest::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// So many threads, which take the parts as they come.
struct Threads(usize);

impl Workers for Threads {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        let next = AtomicUsize::new(0);
        std::thread::scope(|scope| {
            for _ in 0..self.0 {
                scope.spawn(|| {
                    loop {
                        let k = next.fetch_add(1, Ordering::Relaxed);
                        if k >= parts {
                            break;
                        }
                        part(k);
                    }
                });
            }
        });
    }
}

/// What the samples of a grid are like.
#[derive(Clone, Copy, Debug)]
enum Ground {
    /// Any whole numbers.
    Rough,
    /// A few values only: many pairs are equally good.
    Few(u64),
    /// Slopes with a little on them.
    Smooth,
    /// One value but for a few samples.
    Flat,
    /// Near 2^24, with little variation.
    High,
    /// Not whole.
    Broken,
    /// Magnitudes from 1e-30 to 1e30 beside each other.
    Wild,
}

fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*state ^ *state >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 20
}

fn grid<const D: usize>(size: [usize; D], ground: Ground, mut seed: u64) -> Grid<D> {
    let mut values = Vec::new();
    for p in points(size) {
        let mut below = |n: u64| (random(&mut seed) % n) as f64;
        values.push(match ground {
            Ground::Rough => below(1000),
            Ground::Few(n) => below(n),
            Ground::Smooth => {
                p.iter().enumerate().map(|(a, v)| (a + 1) * v * v / 3).sum::<usize>() as f64 + below(3)
            }
            Ground::Flat => 7.0 + f64::from(below(40) < 1.0),
            Ground::High => 16_777_216.0 - below(5),
            Ground::Broken => below(1000) / 7.0 + 0.1,
            Ground::Wild => (below(2000) - 1000.0) * [1e-30, 1e-20, 1e-9, 1.0, 1e30][below(5) as usize],
        });
    }
    Grid { size, values }
}

/// The ranges of a side, some left out and some twice, in no order.
fn ranges<const D: usize>(size: [usize; D], side: usize, mut seed: u64) -> Vec<[usize; D]> {
    let mut all: Vec<[usize; D]> = points(size.map(|n| n / side)).map(|p| p.map(|v| v * side)).collect();
    for k in 0..all.len() {
        let other = random(&mut seed) as usize % all.len();
        if random(&mut seed).is_multiple_of(4) {
            all[k] = all[other];
        } else {
            all.swap(k, other);
        }
    }
    all
}

/// How a grid is searched.
#[derive(Clone, Copy)]
struct How {
    side: usize,
    jump: usize,
    isometries: usize,
    bits: u32,
    search: Search,
}

fn agree<const D: usize>(grid: &Grid<D>, how: How, seed: u64) {
    let How { side, jump, search, .. } = how;
    let half = grid.half();
    let isometries = group::<D>(how.isometries).unwrap();
    let domains = Domains::new(grid.size, side, jump);
    let level =
        Level { grid, half: &half, domains, isometries: &isometries, scales: Scales::of_bits(how.bits) };
    let ranges = ranges(grid.size, side, seed);
    let frame = Frame::new(&level, search);
    let want: Vec<Option<Match<D>>> = ranges.iter().map(|r| plain::search(&frame, *r, search)).collect();
    for workers in [&Alone as &dyn Workers, &Threads(5)] {
        let got = level.search(&ranges, search, workers).unwrap();
        assert_eq!(got.len(), want.len());
        for ((got, want), range) in got.iter().zip(&want).zip(&ranges) {
            assert_eq!(got, want, "range {range:?} of side {side}, {search:?}");
        }
    }
}

fn ground() -> impl Strategy<Value = Ground> {
    prop_oneof![
        Just(Ground::Rough),
        (2_u64..5).prop_map(Ground::Few),
        Just(Ground::Smooth),
        Just(Ground::Flat),
        Just(Ground::High),
        Just(Ground::Broken),
        Just(Ground::Wild),
    ]
}

fn search() -> impl Strategy<Value = Search> {
    prop_oneof![Just(Search::Exact), Just(Search::Classes), (0_usize..20).prop_map(Search::Near)]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn the_quick_form_is_the_plain_one_in_the_plane(
        ground in ground(),
        search in search(),
        side in prop::sample::select(vec![1_usize, 2, 2, 3, 4, 4, 6, 8]),
        cells in (1_usize..12, 1_usize..12),
        jump in prop::sample::select(vec![2_usize, 4, 6]),
        isometries in prop::sample::select(vec![1_usize, 8, 8]),
        bits in 2_u32..9,
        seed: u64,
    ) {
        let side = if search == Search::Classes { side.next_multiple_of(2) } else { side };
        let most = 48 / side;
        let grid = grid([cells.0.min(most) * side, cells.1.min(most) * side], ground, seed);
        agree(&grid, How { side, jump, isometries, bits, search }, seed);
    }

    #[test]
    fn the_quick_form_is_the_plain_one_in_space(
        ground in ground(),
        near in prop::option::of(0_usize..9),
        side in prop::sample::select(vec![2_usize, 2, 3, 4]),
        cells in (1_usize..6, 1_usize..6, 1_usize..6),
        jump in prop::sample::select(vec![2_usize, 4]),
        isometries in prop::sample::select(vec![1_usize, 16, 24, 48]),
        bits in 2_u32..9,
        seed: u64,
    ) {
        let most = 12 / side;
        let size = [cells.0, cells.1, cells.2].map(|n| n.min(most) * side);
        let search = near.map_or(Search::Exact, Search::Near);
        agree(&grid(size, ground, seed), How { side, jump, isometries, bits, search }, seed);
    }
}

#[test]
fn larger_grids_agree() {
    for (ground, side) in [(Ground::Smooth, 4), (Ground::Rough, 16), (Ground::High, 2), (Ground::Few(2), 4)] {
        for search in [Search::Exact, Search::Classes, Search::Near(16)] {
            agree(&grid([112, 96], ground, 5), How { side, jump: 4, isometries: 8, bits: 5, search }, 3);
        }
    }
    let how = How { side: 4, jump: 2, isometries: 48, bits: 5, search: Search::Exact };
    agree(&grid([24, 16, 24], Ground::Broken, 5), how, 3);
}

#[test]
fn a_constant_grid_has_no_matches() {
    for value in [0.0, 0.1, 16_777_215.0] {
        let how = How { side: 4, jump: 4, isometries: 8, bits: 5, search: Search::Exact };
        agree(&Grid::filled([32, 24], value), how, 1);
    }
    let grid = Grid::filled([32, 32], 5.0);
    let half = grid.half();
    let isometries = group::<2>(8).unwrap();
    let level = Level {
        grid: &grid,
        half: &half,
        domains: Domains::new([32, 32], 4, 4),
        isometries: &isometries,
        scales: Scales::of_bits(5),
    };
    assert!(level.search(&[[0, 0], [4, 8]], Search::Exact, &Alone).unwrap().iter().all(Option::is_none));
    assert!(level.search(&[], Search::Exact, &Alone).unwrap().is_empty());
}

#[test]
fn a_search_can_be_stopped() {
    struct Impatient(AtomicUsize);
    impl Workers for Impatient {
        fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
            (0..parts).for_each(part);
        }
        fn going(&self, share: f64) -> bool {
            assert!((0.0..=1.0).contains(&share));
            self.0.fetch_add(1, Ordering::Relaxed) < 2
        }
    }
    let grid = grid([64, 64], Ground::Rough, 1);
    let half = grid.half();
    let isometries = group::<2>(8).unwrap();
    let level = Level {
        grid: &grid,
        half: &half,
        domains: Domains::new([64, 64], 4, 4),
        isometries: &isometries,
        scales: Scales::of_bits(5),
    };
    let ranges = ranges([64, 64], 4, 1);
    for search in [Search::Exact, Search::Classes, Search::Near(8)] {
        let found: Result<_> = level.search(&ranges, search, &Impatient(AtomicUsize::new(0)));
        assert_eq!(found, Err(Error::Stopped));
    }
}

#[test]
fn classes_are_of_the_plane() {
    let grid = grid([8, 8, 8], Ground::Rough, 1);
    let half = grid.half();
    let isometries = group::<3>(1).unwrap();
    let level = Level {
        grid: &grid,
        half: &half,
        domains: Domains::new([8; 3], 2, 2),
        isometries: &isometries,
        scales: Scales::of_bits(5),
    };
    assert!(level.search(&[[0; 3]], Search::Classes, &Alone).is_err());
}
