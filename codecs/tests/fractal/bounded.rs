//! Maps and residual: the error that was asked for holds at every post (acceptance F6).

use super::ground;
use crate::support::grids::all;
use crate::support::random::Random;
use proptest::prelude::*;
use terraquilt_codecs::fractal::{Options, Partition, Search, Tile, encode_heights};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Alone;

fn off(heights: &Heights, found: &Heights) -> i64 {
    assert_eq!((heights.cols, heights.rows, &heights.void), (found.cols, found.rows, &found.void));
    let posts = (0..heights.z.len()).filter(|k| !heights.is_void(*k));
    posts.map(|k| i64::from(heights.z[k]) - i64::from(found.z[k])).map(i64::abs).max().unwrap_or(0)
}

/// Every bound on every grid; the head says what the decoder does.
#[test]
fn the_bound_holds_on_every_grid() {
    for grid in all() {
        let heights = grid.cut(0, 0, grid.heights.cols.min(160), grid.heights.rows.min(160));
        for bound in [0, 1, 2, 5, 10] {
            let options = Options { bound: Some(bound), search: Search::Near(8), ..Options::default() };
            let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
            let found = Tile::read(&e.bytes).unwrap();
            assert!(found.complete);
            let most = off(&heights, &found.heights().unwrap());
            assert!(most <= i64::from(bound), "{}: {most}, bound {bound}", grid.name);
            assert_eq!(e.header.error_max, most as f64, "{}", grid.name);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Any shape, any ground, voids or none, any partition.
    #[test]
    fn the_bound_holds_on_any_ground(
        (cols, rows) in (1_usize..70, 1_usize..70),
        rough in 0.0..3000.0_f64,
        seed in any::<u64>(),
        bound in 0_u32..40,
        voids in 0_u32..4,
        maps in prop::option::of(16_usize..600),
        base in -8_000_000..8_000_000_i32,
    ) {
        let mut heights = ground(cols, rows, rough, seed);
        heights.z.iter_mut().for_each(|z| *z += base);
        let mut random = Random::new(seed ^ 7);
        if voids > 1 {
            heights.void = (0..cols * rows).map(|_| random.below(u64::from(voids)) > 0).collect();
        }
        let options = Options {
            bound: Some(bound),
            partition: maps.map(|n| Partition::Maps(n.max(cols * rows))),
            search: Search::Near(6),
            ..Options::default()
        };
        let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
        let mut found = Tile::read(&e.bytes).unwrap().heights().unwrap();
        if !heights.void.contains(&true) {
            found.void = heights.void.clone();
        }
        prop_assert!(off(&heights, &found) <= i64::from(bound));
    }
}
