//! What the surface promises, held against its definitions (LOD-space specification, sections 5.4, 7, 9, 12,
//! and items 7 and 8 of section 10): errors certified at every post and at a million points, no gap, no jump,
//! the same height from any region, and equality with an evaluation that knows no index.
//!
//! Points nearer than 1e-6 cells to a border of core' may be taken for points beyond it, as coordinates are
//! `f64`: there only what both sides promise is asked.

pub mod continuity;
mod doors;
mod equality;
mod errors;
mod gaps;
pub mod reference;
pub mod worlds;

use crate::support::{Random, seeds};
use reference::World;
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::{Blend, Evaluation};
use worlds::{Ask, asks};

/// Heights of points for a tolerance, wherever a camera looks.
pub fn heights(world: &World, ask: &Ask, points: &[[f64; 2]]) -> Vec<Option<Evaluation>> {
    match ask {
        Ask::Metres(_) => world.snapshot.surface(&ask.query(None)).unwrap().heights(points).unwrap(),
        Ask::Eye { .. } => world.snapshot.heights(points, &ask.tolerance(), Blend::Exact).unwrap(),
    }
}

/// Random worlds: one to four surveys, holes, rotations, replacement.
pub fn random_worlds(count: u64, posts: usize) -> impl Iterator<Item = (u64, Random, World)> {
    random_worlds_of(Kind::Bilinear, count, posts)
}

pub fn random_worlds_of(kind: Kind, count: u64, posts: usize) -> impl Iterator<Item = (u64, Random, World)> {
    seeds(count).into_iter().map(move |seed| {
        let mut r = Random::new(seed + 31_000);
        let surveys = 1 + (seed as usize) % 4;
        println!("seed {seed}: {surveys} surveys");
        let world = worlds::random(&mut r, surveys, posts, kind);
        (seed, r, world)
    })
}

/// Points of D_K of all surveys in turn, and some around them.
pub fn scatter(world: &World, r: &mut Random, inside: usize, anywhere: usize) -> Vec<[f64; 2]> {
    let mut points: Vec<[f64; 2]> =
        (0..world.surveys.len()).flat_map(|k| world.points(r, k, inside / world.surveys.len())).collect();
    let Some(b) = world.snapshot.bounds() else { return points };
    let pad = [(b[2] - b[0]) * 0.05, (b[3] - b[1]) * 0.05];
    points.extend((0..anywhere).map(|_| {
        let at = |k: usize, t: f64| b[k] - pad[k] + t * (b[k + 2] - b[k] + 2.0 * pad[k]);
        [at(0, r.unit()), at(1, r.unit())]
    }));
    // Just outside core', where only weights and masks of borders count.
    for s in world.surveys.iter().filter(|s| !s.rim.is_empty()) {
        points.extend((0..anywhere).map(|_| {
            let cell = s.rim[r.below(s.rim.len() as u64) as usize];
            s.point(cell, [r.unit() * 4.0 - 1.5, r.unit() * 4.0 - 1.5])
        }));
    }
    points
}

/// Whether a counter-clockwise polygon holds a point with room to spare.
pub fn inside(polygon: &[[f64; 2]], p: [f64; 2]) -> bool {
    polygon.len() > 2
        && (0..polygon.len()).all(|k| {
            let (a, b) = (polygon[k], polygon[(k + 1) % polygon.len()]);
            let e = [b[0] - a[0], b[1] - a[1]];
            e[0] * (p[1] - a[1]) - e[1] * (p[0] - a[0]) > 1e-6 * (e[0] * e[0] + e[1] * e[1]).sqrt()
        })
}

/// Errors certified, also with seams corrected, and no point of D_K without a height, over surveys of any kind.
pub fn whole_kit(snapshot: terraquilt::db::Snapshot, posts: Vec<crate::oracle::OracleSurvey>) {
    let world = World::of_posts(snapshot, posts, false);
    let mut r = Random::new(seeds(1)[0]);
    errors::certify_kit(&world, &mut r, 60_000);
    let points: Vec<[f64; 2]> =
        (0..world.surveys.len()).flat_map(|k| world.points(&mut r, k, 3000)).collect();
    for ask in every_tolerance(&world) {
        for (p, e) in points.iter().zip(heights(&world, &ask, &points)) {
            let e = e.unwrap_or_else(|| panic!("{ask:?}: a gap at {p:?}"));
            assert!(e.certified || !world.best(*p).1, "{ask:?} {p:?}: {e:?}");
        }
    }
}

/// Every tolerance that could leave a gap.
fn every_tolerance(world: &World) -> Vec<Ask> {
    [0.5, 1e6, f64::MAX].into_iter().map(Ask::Metres).chain(asks(world)).collect()
}
