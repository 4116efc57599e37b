//! Certified errors: theorem T7 at points and posts of D_K.

use super::reference::World;
use super::worlds::{self, Ask, asks};
use super::{heights, random_worlds};
use crate::support::{Random, seeds};
use rayon::prelude::*;
use terraquilt::db::Policy;
use terraquilt::db::query::Query;
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::{Blend, How, Seams};

#[derive(Default)]
struct Figures {
    points: usize,
    asked: usize,
    near: usize,
    worst: f64,
    explained: usize,
    bent: usize,
}

/// T7 at points inside D_K: a height, certified, and no contributor above max(delta, best).
fn certify(world: &World, points: &[[f64; 2]], asks: &[Ask], every: usize, total: &mut Figures) {
    let best: Vec<(f64, bool, bool)> = points.par_iter().map(|p| world.best(*p)).collect();
    total.points += points.len();
    total.near += best.iter().filter(|b| !b.1).count();
    for ask in asks {
        let found = heights(world, ask, points);
        let ground = matches!(ask, Ask::Metres(_)).then(|| world.snapshot.surface(&ask.query(None)).unwrap());
        let ratios: Vec<(f64, usize)> = points
            .par_iter()
            .zip(&best)
            .zip(&found)
            .enumerate()
            .map(|(n, ((p, (best, sure, maybe)), e))| {
                let delta = ask.at(*p, world.z);
                let Some(e) = e else { panic!("{ask:?}: no height at {p:?}") };
                assert!(e.z.is_finite() && *maybe, "{ask:?} {p:?}: {e:?}");
                if !sure {
                    return (0.0, 0);
                }
                let bound = delta.max(*best) * (1.0 + 1e-12);
                assert!(
                    e.certified && e.error_m <= bound,
                    "{ask:?} {p:?}: {e:?}, {delta} m allowed, best {best}"
                );
                assert!(e.accuracy_m <= *best, "{ask:?} {p:?}: {e:?}, best {best}");
                assert!(world.z[0] - bound <= e.z && e.z <= world.z[1] + bound, "{ask:?} {p:?}: {e:?}");
                let mut explained = 0;
                if n % every == 0 {
                    // The same, by name.
                    let who: Vec<(f64, f64)> = match &ground {
                        Some(g) => {
                            let (_, who) = g.sheet().explain(*p).unwrap().unwrap();
                            who.iter().map(|(k, w)| (f64::from(g.surface.patches[*k].bot), *w)).collect()
                        }
                        None => {
                            let who = world.snapshot.explain(*p, &ask.tolerance(), Blend::Exact).unwrap();
                            who.iter().map(|(r, w)| (f64::from(r.bot), *w)).collect()
                        }
                    };
                    let most = |least: f64| {
                        let who = who.iter().filter(|w| w.1 > least);
                        who.map(|w| w.0).fold(0.0, f64::max)
                    };
                    let sum: f64 = who.iter().map(|w| w.1).sum();
                    assert!((sum - 1.0).abs() < 1e-9, "{ask:?} {p:?}: {who:?}");
                    // From another region, weights that vanish here may round to nothing.
                    assert!(
                        most(1e-9) <= e.error_m && most(0.0) <= bound,
                        "{ask:?} {p:?}: {e:?}, {bound} m allowed: {who:?}"
                    );
                    explained = 1;
                }
                (if bound > 0.0 { e.error_m / bound } else { 0.0 }, explained)
            })
            .collect();
        total.asked += points.len();
        total.worst = ratios.iter().fold(total.worst, |m, r| m.max(r.0));
        total.explained += ratios.iter().map(|r| r.1).sum::<usize>();
    }
}

/// Seams corrected: the same contributors, each with its bottom and what it was bent by; nothing else changes.
fn certify_bent(world: &World, points: &[[f64; 2]], every: usize, total: &mut Figures) {
    for delta in [0.0, 1.0, 5.0, 20.0] {
        let ask = Ask::Metres(delta);
        let plain = heights(world, &ask, points);
        let how = How { blend: Blend::Exact, seams: Seams::All };
        let ground = world.snapshot.surface(&Query { how, ..ask.query(None) }).unwrap();
        let found = ground.heights(points).unwrap();
        let bent = points.par_iter().zip(&plain).zip(&found).enumerate().map(|(n, ((p, plain), e))| {
            let (Some(plain), Some(e)) = (plain, e) else { panic!("{p:?}: {plain:?} {e:?}") };
            assert_eq!((e.z - e.correction_m).to_bits(), plain.z.to_bits(), "{p:?}: {e:?} {plain:?}");
            assert_eq!((e.certified, e.accuracy_m), (plain.certified, plain.accuracy_m));
            // What weighs a rounding error may be left out of the error, not of the sum.
            assert!(
                plain.error_m <= e.error_m && e.correction_m.abs() <= e.error_m + 1e-9,
                "{p:?}: {e:?} {plain:?}"
            );
            if n % every == 0 {
                let sheet = ground.sheet();
                let (_, who) = sheet.explain(*p).unwrap().unwrap();
                let most = |least: f64| {
                    let who = who.iter().filter(|w| w.1 > least);
                    who.map(|(k, _)| {
                        let patch = &ground.surface.patches[*k];
                        f64::from(patch.bot) + sheet.correction_of(patch.survey, *p).unwrap().abs()
                    })
                    .fold(0.0, f64::max)
                };
                let room = 1e-6 * (1.0 + e.error_m);
                assert!(most(1e-9) <= e.error_m + room && e.error_m <= most(0.0) + room, "{p:?}: {e:?}");
            }
            usize::from(e.correction_m != 0.0)
        });
        total.bent += bent.sum::<usize>();
    }
}

/// Random points of every survey, and every post.
fn certify_world(world: &World, r: &mut Random, count: usize, posts_at: &[f64], total: &mut Figures) {
    let asks = asks(world);
    for (k, s) in world.surveys.iter().enumerate() {
        let points = world.points(r, k, count / world.surveys.len());
        certify(world, &points, &asks, 50, total);
        certify_bent(world, &points, 50, total);
        let posts: Vec<[f64; 2]> = s.guaranteed_posts().into_iter().map(|at| s.point(at, [0.0; 2])).collect();
        let at_posts: Vec<Ask> = posts_at.iter().map(|z| Ask::Metres(*z)).collect();
        certify(world, &posts, &at_posts, 500, total);
        println!(
            "  {}: {} points, {} posts, {} cells of core'",
            s.name,
            points.len(),
            posts.len(),
            s.cells.len()
        );
    }
}

/// What is certified of a kit: random points, every post at two tolerances.
pub fn certify_kit(world: &World, r: &mut Random, count: usize) {
    let mut total = Figures::default();
    certify_world(world, r, count, &[5.0, 20.0], &mut total);
    report(&total);
}

fn report(total: &Figures) {
    println!(
        "{} points, {} heights, {} points near a border, {} explained, {} bent; largest error / max(delta, best) {:.6}",
        total.points, total.asked, total.near, total.explained, total.bent, total.worst
    );
}

#[test]
fn errors_are_certified_over_random_worlds() {
    let mut total = Figures::default();
    for (_, mut r, world) in random_worlds(40, 130) {
        certify_world(&world, &mut r, 6000, &[0.0, 1.0, 5.0, 20.0, 100.0], &mut total);
    }
    report(&total);
    assert!(total.near * 4 < total.points && total.worst > 0.9 && total.bent > total.points / 20);
}

#[test]
fn errors_are_certified_over_the_survey_kit() {
    for policy in [Policy::Accuracy, Policy::Newest] {
        let Some(world) = worlds::kit(policy) else { return };
        println!("{}", policy.name());
        let mut total = Figures::default();
        certify_world(&world, &mut Random::new(seeds(1)[0]), 300_000, &[5.0, 20.0], &mut total);
        report(&total);
    }
}

#[test]
fn errors_are_certified_over_a_growing_dome() {
    for (policy, leave_out) in [(Policy::Accuracy, 2), (Policy::Newest, 2), (Policy::Newest, 0)] {
        let Some(world) = worlds::helens(policy, leave_out) else { return };
        println!("{}, {} surveys", policy.name(), world.surveys.len());
        let mut total = Figures::default();
        certify_world(&world, &mut Random::new(seeds(1)[0]), 100_000, &[0.0, 1.0, 5.0, 20.0], &mut total);
        report(&total);
    }
}

#[test]
fn one_survey_alone_is_within_the_tolerance_at_every_post() {
    let judge = |world: &World| -> (usize, f64) {
        let s = &world.surveys[0];
        let at = s.guaranteed_posts();
        let points: Vec<[f64; 2]> = at.iter().map(|at| s.point(*at, [0.0; 2])).collect();
        let mut worst = 0.0f64;
        for ask in asks(world) {
            for ((p, at), e) in points.iter().zip(&at).zip(heights(world, &ask, &points)) {
                let e = e.unwrap_or_else(|| panic!("{ask:?}: no height at {p:?}"));
                let off = (e.z - s.post(*at).unwrap()).abs();
                let bound = ask.at(*p, world.z).max(s.e) - s.posts.accuracy;
                assert!(off <= bound + 1e-9 * world.range(), "{ask:?} {p:?}: {off} m off, {bound} allowed");
                worst = worst.max(if bound > 1e-3 { off / bound } else { 0.0 });
            }
        }
        (points.len(), worst)
    };
    let (mut posts, mut worst) = (0, 0.0f64);
    for seed in seeds(12) {
        println!("seed {seed}");
        let world = worlds::random(&mut Random::new(seed + 41_000), 1, 150, Kind::Bilinear);
        let found = judge(&world);
        (posts, worst) = (posts + found.0, worst.max(found.1));
    }
    println!("random: {posts} posts, largest deviation / allowed {worst:.4}");
    assert!(worst > 0.5);
    for world in worlds::holes_alone().into_iter().chain(worlds::helens(Policy::Accuracy, 5)) {
        let found = judge(&world);
        println!("{}: {} posts, largest deviation / allowed {:.4}", world.surveys[0].name, found.0, found.1);
    }
}
