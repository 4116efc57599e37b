//! The surface against its definition.

use super::worlds::{Ask, asks};
use super::{heights, random_worlds, scatter};
use rayon::prelude::*;
use std::collections::HashMap;
use terraquilt::db::query::Query;
use terraquilt::height::surface::Blend;

#[test]
fn the_surface_equals_its_definition_evaluated_without_an_index() {
    let (mut asked, mut worst, mut worst_weight) = (0usize, 0.0f64, 0.0f64);
    for (seed, mut r, world) in random_worlds(16, 100) {
        let points = scatter(&world, &mut r, 1200, 200);
        for ask in asks(&world).into_iter().chain([Ask::Metres(0.3), Ask::Metres(2.2), Ask::Metres(1e6)]) {
            let found = heights(&world, &ask, &points);
            let constant = matches!(ask, Ask::Metres(_));
            let ground = constant.then(|| world.snapshot.surface(&ask.query(None)).unwrap());
            let off: Vec<(f64, f64)> = points
                .par_iter()
                .zip(&found)
                .enumerate()
                .map(|(n, (p, e))| {
                    let truth = world.brute(*p, ask.at(*p, world.z), Blend::Exact);
                    let (truth, who) = match (&truth, e) {
                        (Some(t), Some(_)) => t,
                        (None, None) => return (0.0, 0.0),
                        // Weights that vanish at this very point may round to nothing.
                        (Some((_, who)), None) if who.is_empty() => return (0.0, 0.0),
                        _ => panic!("seed {seed} {ask:?} {p:?}: {e:?}, expected {truth:?}"),
                    };
                    let off = (e.as_ref().unwrap().z - truth).abs();
                    if n % 5 != 0 {
                        return (off, 0.0);
                    }
                    // Who contributes, and how much.
                    let mut shares: HashMap<String, f64> =
                        who.iter().map(|(k, w)| (world.patches[*k].id.clone(), *w)).collect();
                    if let Some(g) = &ground {
                        for (k, w) in g.sheet().explain(*p).unwrap().unwrap().1 {
                            *shares.entry(g.surface.patches[k].id.to_string()).or_default() -= w;
                        }
                    } else {
                        for (r, w) in world.snapshot.explain(*p, &ask.tolerance(), Blend::Exact).unwrap() {
                            *shares.entry(r.id.to_string()).or_default() -= w;
                        }
                    }
                    (off, shares.values().fold(0.0, |m: f64, w| m.max(w.abs())))
                })
                .collect();
            asked += points.len();
            for ((off, weight), p) in off.iter().zip(&points) {
                worst = worst.max(off / world.range());
                worst_weight = worst_weight.max(*weight);
                assert!(
                    *off <= 1e-9 * world.range() && *weight < 1e-6,
                    "seed {seed} {ask:?} {p:?}: {off} m and {weight} of weight off, range {}",
                    world.range()
                );
            }
        }
    }
    println!(
        "{asked} heights equal the definition: worst {worst:.1e} of the range, {worst_weight:.1e} of weight"
    );
}

#[test]
fn the_plain_blend_equals_equation_1_and_stays_within_what_it_may() {
    let (mut asked, mut widest) = (0usize, 0.0f64);
    for (seed, mut r, world) in random_worlds(8, 90) {
        let mut points = scatter(&world, &mut r, 800, 50);
        let alone = (world.surveys.len() == 1).then(|| &world.surveys[0]);
        let posts = alone.map_or(Vec::new(), |s| s.guaranteed_posts());
        let from = points.len();
        points.extend(posts.iter().map(|at| alone.unwrap().point(*at, [0.0; 2])));
        // Where a patch is fading in, the two blends differ.
        let fading: Vec<f64> =
            (0..4).map(|_| world.patches[r.below(world.patches.len() as u64) as usize].bot * 1.05).collect();
        for z in fading.into_iter().chain([0.0, 1.0, 5.0, 20.0, 100.0]) {
            let query = Query { how: Blend::Plain.into(), ..Ask::Metres(z).query(None) };
            let plain = world.snapshot.surface(&query).unwrap().heights(&points).unwrap();
            let exact = heights(&world, &Ask::Metres(z), &points);
            for (p, a) in points.iter().zip(&plain).step_by(if posts.is_empty() { 1 } else { 5 }) {
                let truth = world.brute(*p, z, Blend::Plain);
                assert_eq!(truth.is_some(), a.is_some(), "seed {seed}, {z} m, {p:?}");
                let (Some((truth, _)), Some(a)) = (truth, a) else { continue };
                assert!(
                    (truth - a.z).abs() <= 1e-9 * world.range(),
                    "seed {seed}, {z} m, {p:?}: {a:?}, {truth}"
                );
                assert!(a.error_m <= z, "seed {seed}, {z} m, {p:?}: {a:?}");
                asked += 1;
            }
            // One survey alone: at its posts both blends are within their errors of the same sample.
            for ((at, a), b) in posts.iter().zip(&plain[from..]).zip(&exact[from..]) {
                let (Some(a), Some(b)) = (a, b) else { continue };
                let s = alone.unwrap();
                let (apart, most) = ((a.z - b.z).abs(), a.error_m + b.error_m - 2.0 * s.posts.accuracy);
                assert!(
                    apart <= most + 1e-9 * world.range(),
                    "seed {seed}, {z} m, {at:?}: {apart}, {most} allowed"
                );
                let off = (a.z - s.post(*at).unwrap()).abs();
                assert!(
                    off <= z - s.posts.accuracy + 1e-9 * world.range(),
                    "seed {seed}, {z} m, {at:?}: {off}"
                );
                widest = widest.max(apart);
            }
            // Theorem T2: where some patch with bot <= z has p in its kernel, the plain cut covers p.
            for (p, a) in points.iter().zip(&plain) {
                let (best, sure, _) = world.best(*p);
                assert!(!(sure && best <= z) || a.is_some(), "seed {seed}, {z} m, {p:?}: a gap");
            }
        }
    }
    println!("{asked} plain heights equal equation (1); at most {widest:.2} m from the exact blend at posts");
    assert!(widest > 0.0);
}
