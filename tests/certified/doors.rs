//! One function for measuring and drawing, through whatever door it is asked: points in order of place and grids have the bits of
//! the plain definition, which takes point after point.

use super::reference::World;
use super::worlds::{self, Ask, asks};
use super::{inside, scatter};
use crate::support::{Random, seeds};
use terraquilt::db::Policy;
use terraquilt::db::query::{Query, Tolerance};
use terraquilt::height::lod::cut::{Foci, Focus};
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::{Blend, Evaluation, How, Seams};

/// Everything that is said of a point, as bits.
fn bits(e: &Option<Evaluation>) -> Option<[u64; 7]> {
    e.as_ref().map(|e| {
        let numbers = [e.z, e.error_m, e.accuracy_m, e.correction_m, e.gradient[0]].map(f64::to_bits);
        let [z, error, accuracy, correction, gradient] = numbers;
        [z, error, accuracy, correction, gradient, u64::from(e.certified), u64::from(e.contradiction)]
    })
}

fn same(
    found: &[Option<Evaluation>],
    plain: &[Option<Evaluation>],
    at: impl Fn(usize) -> [f64; 2],
    what: &str,
) {
    assert_eq!(found.len(), plain.len(), "{what}");
    for (k, (f, p)) in found.iter().zip(plain).enumerate() {
        assert_eq!(bits(f), bits(p), "{what}: at {:?}\n{f:?}\n{p:?}", at(k));
    }
}

/// Columns and rows of a grid over a box, and a bit beyond: from far apart to close together, one way or the other, or
/// in no order; some at whole posts.
fn axes(r: &mut Random, b: [f64; 4], step: f64) -> [Vec<f64>; 2] {
    [0, 1].map(|k| {
        let (lo, hi) = (b[k], b[k + 2]);
        let count = 1 + r.below(150) as usize;
        let span = (hi - lo) * [1.2, 0.3, 0.05][r.below(3) as usize];
        let first = lo - (hi - lo) * 0.1 + r.unit() * ((hi - lo) * 1.2 - span);
        let by = if r.chance(0.3) { step } else { span / count as f64 };
        let first = if r.chance(0.5) { (first / step).round() * step } else { first };
        let mut v: Vec<f64> = (0..count).map(|n| first + n as f64 * by).collect();
        match r.below(5) {
            0 | 1 => v.reverse(),
            2 => r.shuffle(&mut v),
            _ => {}
        }
        v
    })
}

/// Holds all doors of the surface of a question against the definition.
fn hold(world: &World, r: &mut Random, tolerance: &Tolerance, how: How, what: &str) -> usize {
    let query = Query { area: None.into(), tolerance: tolerance.clone(), how };
    let ground = world.snapshot.surface(&query).unwrap();
    let everywhere = !matches!(tolerance, Tolerance::Camera(_));
    let mut points = scatter(world, r, 300, 100);
    points.retain(|p| everywhere || inside(&ground.selection.region.polygon, *p));
    // In places, many near each other.
    for k in 0..points.len().min(10) {
        let (p, s) = (points[k * points.len() / 10], world.surveys[0].posts.nominal_step[0]);
        let near = (0..80).map(|_| [0, 1].map(|k| p[k] + (r.unit() - 0.5) * s * 12.0));
        points.extend(near.filter(|p| everywhere || inside(&ground.selection.region.polygon, *p)));
    }
    let plain = ground.sheet().heights(&points).unwrap();
    same(&ground.heights(&points).unwrap(), &plain, |k| points[k], &format!("{what}, points"));
    same(&ground.planes(&points).unwrap().evaluations(), &plain, |k| points[k], &format!("{what}, planes"));
    let mut asked = points.len();
    if everywhere {
        let b = world.snapshot.bounds().unwrap();
        for n in 0..4 {
            let step = world.surveys[r.below(world.surveys.len() as u64) as usize].posts.nominal_step[0];
            let [xs, ys] = axes(r, b, step);
            let at = |k: usize| [xs[k % xs.len()], ys[k / xs.len()]];
            let points: Vec<[f64; 2]> = (0..xs.len() * ys.len()).map(at).collect();
            asked += points.len();
            let plain = ground.sheet().heights(&points).unwrap();
            let what = format!("{what}, grid {n} of {} x {}", xs.len(), ys.len());
            same(&ground.grid(&xs, &ys).unwrap().evaluations(), &plain, at, &what);
            let turned: Vec<[f64; 2]> = points
                .iter()
                .map(|p| [b[0] + 0.9 * (p[0] - b[0]) + 0.3 * (p[1] - b[1]), p[1] - 0.2 * (p[0] - b[0])])
                .collect();
            let plain = ground.sheet().heights(&turned).unwrap();
            same(&ground.heights(&turned).unwrap(), &plain, |k| turned[k], &format!("{what}, turned"));
        }
    }
    asked
}

fn tolerances(world: &World, r: &mut Random) -> Vec<Tolerance> {
    let b = world.snapshot.bounds().unwrap();
    let focus = |r: &mut Random| Focus {
        center: [b[0] + r.unit() * (b[2] - b[0]), b[1] + r.unit() * (b[3] - b[1])],
        radius: (b[2] - b[0]) * 0.1 * r.unit(),
        error: r.unit(),
        growth: 0.1 * r.unit(),
    };
    let foci = Foci::new(vec![focus(r), focus(r)]).unwrap();
    let metres = [0.55, 2.2, 1e6, f64::MAX].map(Tolerance::Constant);
    asks(world).iter().map(Ask::tolerance).chain(metres).chain([Tolerance::Foci(foci)]).collect()
}

fn hold_all(world: &World, r: &mut Random, what: &str) -> usize {
    let mut asked = 0;
    for tolerance in tolerances(world, r) {
        let seams = [Seams::Off, Seams::All, Seams::Consistent][r.below(3) as usize];
        for how in [Blend::Exact.into(), Blend::Plain.into(), How { blend: Blend::Exact, seams }] {
            asked += hold(world, r, &tolerance, how, &format!("{what} {tolerance:?} {how:?}"));
        }
    }
    asked
}

#[test]
fn every_door_has_the_bits_of_the_definition_over_random_worlds() {
    for kind in Kind::ALL {
        let mut asked = 0;
        for seed in seeds(8) {
            let mut r = Random::new(seed + 77_000);
            // Now and then more surveys than fit what is held for a few.
            let surveys = if seed % 8 == 7 { 10 } else { 1 + seed as usize % 4 };
            let world = worlds::random(&mut r, surveys, 90, kind);
            asked += hold_all(&world, &mut r, &format!("{kind:?} seed {seed}"));
        }
        println!("{kind:?}: {asked} heights");
    }
}

#[test]
fn every_door_has_the_bits_of_the_definition_over_real_surveys() {
    let mut r = Random::new(seeds(1)[0]);
    let kit = Kind::ALL.map(|kind| worlds::kit_of(Policy::Accuracy, kind));
    let real =
        kit.into_iter().chain([worlds::helens(Policy::Newest, 0), worlds::helens(Policy::Accuracy, 2)]);
    for (n, world) in real.flatten().enumerate() {
        println!("world {n}: {} heights", hold_all(&world, &mut r, &format!("world {n}")));
    }
}

/// Points and grids that leave every survey and the world itself: no height there, the same heights elsewhere.
#[test]
fn grids_of_a_version_say_what_its_points_say() {
    for kind in Kind::ALL {
        let mut r = Random::new(seeds(1)[0] + 5);
        let world = worlds::random(&mut r, 2, 90, kind);
        let b = world.snapshot.bounds().unwrap();
        for far in [false, true] {
            let [mut xs, mut ys] = axes(&mut r, b, 1.0);
            if far {
                xs.extend([1e9, -1e300, f64::NAN, f64::INFINITY]);
                ys.extend([b[3] + 1e6, 1e15]);
            }
            let at = |k: usize| [xs[k % xs.len()], ys[k / xs.len()]];
            let points: Vec<[f64; 2]> = (0..xs.len() * ys.len()).map(at).collect();
            for metres in [0.0, 3.0] {
                let tolerance = Tolerance::Constant(metres);
                let found = world.snapshot.grid(&xs, &ys, &tolerance, Blend::Exact).unwrap();
                let plain = world.snapshot.heights(&points, &tolerance, Blend::Exact).unwrap();
                same(&found.evaluations(), &plain, at, &format!("{kind:?} far {far} within {metres} m"));
                let found = world.snapshot.planes(&points, &tolerance, Blend::Exact).unwrap();
                same(
                    &found.evaluations(),
                    &plain,
                    at,
                    &format!("{kind:?} far {far} within {metres} m, planes"),
                );
            }
        }
        assert!(
            world.snapshot.grid(&[], &[0.0], &Tolerance::Constant(0.0), Blend::Exact).unwrap().is_empty()
        );
        assert!(world.snapshot.grid(&[0.0], &[0.0], &Tolerance::Constant(-1.0), Blend::Exact).is_err());
    }
}
