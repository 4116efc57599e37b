//! The same height from any region, no jump, and slopes that are derivatives.

use super::reference::World;
use super::worlds::{self, Ask, asks};
use super::{heights, inside, random_worlds, scatter};
use crate::support::{Grid, Random, Scratch, seeds};
use terraquilt::db::Policy;
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Blend;

#[test]
fn heights_do_not_depend_on_the_region() {
    let (mut asked, mut worst) = (0usize, 0.0f64);
    for (seed, mut r, world) in random_worlds(16, 110) {
        let points = scatter(&world, &mut r, 240, 60);
        for ask in asks(&world).into_iter().chain([Ask::Metres(0.3), Ask::Metres(2.2)]) {
            let ground = world.snapshot.surface(&ask.query(None)).unwrap();
            let seen = |b: &[f64; 4], p: &[f64; 2]| (0..2).all(|k| b[k] <= p[k] && p[k] <= b[k + 2]);
            let whole = heights(&world, &ask, &points);
            let constant = matches!(ask, Ask::Metres(_));
            let step = world.surveys[0].posts.nominal_step[0];
            for (n, (p, e)) in points.iter().zip(&whole).enumerate() {
                // One point alone, a small box, one with the point near its corner, a wide one.
                let beside =
                    |a: f64, b: f64| [p[0] - a * step, p[1] - b * step, p[0] + b * step, p[1] + a * step];
                let mut others =
                    vec![world.snapshot.heights(&[*p], &ask.tolerance(), Blend::Exact).unwrap()[0].clone()];
                for b in [beside(0.01, 0.01), beside(30.0, 0.5), beside(0.001, 9.0)] {
                    assert!(seen(&b, p));
                    if constant {
                        let part = world.snapshot.surface(&ask.query(Some(b))).unwrap();
                        others.push(part.heights(&[*p]).unwrap()[0].clone());
                    }
                }
                if n % 4 == 0 && !constant && inside(&ground.selection.region.polygon, *p) {
                    others.push(ground.heights(&[*p]).unwrap()[0].clone());
                }
                for o in others {
                    asked += 1;
                    match (e, o) {
                        (None, None) => {}
                        (Some(e), Some(o)) => {
                            let off = (e.z - o.z).abs() / world.range();
                            worst = worst.max(off);
                            assert!(
                                off <= 1e-9,
                                "seed {seed} {ask:?} {p:?}: {e:?} from everywhere, {o:?} from a part"
                            );
                        }
                        (e, o) => {
                            panic!("seed {seed} {ask:?} {p:?}: {e:?} from everywhere, {o:?} from a part")
                        }
                    }
                }
            }
        }
    }
    println!("{asked} heights asked through parts: worst {worst:.1e} of the range");
}

#[test]
fn a_survey_whose_rim_alone_reaches_a_region_still_counts() {
    // Accurate, but not shown at 1 m: its patches are covered by those of a coarser survey. Next to its core
    // it masks the poor survey by one cell all the same.
    let s = Scratch::new(Policy::Accuracy);
    let flat = |name: &str, n: usize, step: f64, west: f64, accuracy: f64, z: f32| Grid {
        name: name.into(),
        cols: n,
        rows: n,
        z: vec![z; n * n],
        affine: Affine { origin: [west, 4_000_200.0], col_step: [step, 0.0], row_step: [0.0, -step] },
        accuracy,
        precedence: None,
        date: None,
    };
    let core = |g: &Grid| g.affine.origin[0] + (g.cols - 2) as f64 * g.affine.col_step[0];
    let poor = flat("poor", 120, 10.0, 500_000.0, 3.0, 100.0);
    let wide = flat("wide", 100, 5.0, 500_100.0, 0.6, 120.0);
    // Its core ends 1 m west of that of the wide one.
    let mut fine = flat("fine", 40, 4.0, 0.0, 0.5, 140.0);
    fine.affine.origin[0] = core(&wide) - 1.0 - 38.0 * 4.0;
    fine.affine.origin[1] -= 100.0;
    let grids = [poor, wide, fine];
    grids.iter().for_each(|g| {
        s.ingest(g);
    });
    let world = worlds::of(&s, &grids);
    let ask = Ask::Metres(1.0);
    let p = [core(&grids[1]) + 1.0, 4_000_020.0];
    let (truth, _) = world.brute(p, 1.0, Blend::Exact).unwrap();
    let whole = heights(&world, &ask, &[p])[0].clone().unwrap();
    let alone = world.snapshot.heights(&[p], &ask.tolerance(), Blend::Exact).unwrap()[0].clone().unwrap();
    assert!((whole.z - truth).abs() < 1e-6, "{whole:?}, by the definition {truth}");
    assert!(
        (alone.z - truth).abs() < 1e-6,
        "{alone:?} from a region of one point, by the definition {truth}"
    );
}

/// Points on borders of patches, of core' and of cells, and (under a camera) where a patch begins or ends to
/// fade, with
/// a direction across.
fn borders(world: &World, r: &mut Random, count: usize, ask: &Ask) -> Vec<([f64; 2], [f64; 2])> {
    let mut out = Vec::new();
    while out.len() < count {
        let k = r.below(world.surveys.len() as u64) as usize;
        let s = &world.surveys[k];
        if let Ask::Eye { .. } = ask
            && r.chance(0.4)
        {
            out.extend(fade(world, r, ask, &[1.0, 1.1]));
            continue;
        }
        let Some(p) = world.points(r, k, 1).first().copied() else { continue };
        let at = s.spot(p);
        let axis = r.below(2) as usize;
        let mut part = at.part;
        part[axis] = 0.0;
        let p = s.point(at.cell, part);
        let angle = r.unit() * std::f64::consts::TAU;
        let d = [angle.cos(), angle.sin()].map(|c| c * s.posts.nominal_step[0]);
        if world.best(p).1 {
            out.push((p, d));
        }
    }
    out
}

/// A point of D_K where the tolerance is a multiple of the bottom or the top of a patch, and the direction that
/// found it.
pub fn fade(world: &World, r: &mut Random, ask: &Ask, multiples: &[f64]) -> Option<([f64; 2], [f64; 2])> {
    let k = r.below(world.surveys.len() as u64) as usize;
    let ends = world.points(r, k, 2);
    let (&a, &b) = (ends.first()?, ends.get(1)?);
    let delta = |p: [f64; 2]| ask.at(p, world.z);
    let (low, high) = if delta(a) < delta(b) { (a, b) } else { (b, a) };
    let levels: Vec<f64> = (world.patches.iter())
        .flat_map(|p| multiples.iter().flat_map(|m| [m * p.bot, m * p.top]))
        .filter(|z| delta(low) < *z && *z < delta(high))
        .collect();
    let z = *levels.get(r.below(levels.len() as u64) as usize)?;
    let at = |t: f64| [0, 1].map(|k| low[k] + t * (high[k] - low[k]));
    let (mut from, mut to) = (0.0, 1.0);
    for _ in 0..60 {
        let t = (from + to) / 2.0;
        if delta(at(t)) < z { from = t } else { to = t }
    }
    let length = (high[0] - low[0]).hypot(high[1] - low[1]);
    let d = [0, 1].map(|n| (high[n] - low[n]) / length * world.surveys[k].posts.nominal_step[0]);
    let p = at(from);
    world.best(p).1.then_some((p, d))
}

/// Differences across points, for steps that shrink by ten from 0.1 cells on.
const STEPS: usize = 8;

/// The largest difference left at 1e-8 cells, as a share of the range of heights.
fn jumps(world: &World, r: &mut Random, count: usize, ask: &Ask) -> f64 {
    let lines = borders(world, r, count, ask);
    let mut points = Vec::new();
    for (p, d) in &lines {
        let mut h = 0.1;
        for _ in 0..STEPS {
            points.extend([[p[0] - h * d[0], p[1] - h * d[1]], [p[0] + h * d[0], p[1] + h * d[1]]]);
            h *= 0.1;
        }
    }
    let z = heights(world, ask, &points);
    let mut worst = 0.0f64;
    for (line, e) in lines.iter().zip(z.chunks_exact(2 * STEPS)) {
        let f: Vec<f64> = e
            .chunks_exact(2)
            .map(|pair| match pair {
                [Some(a), Some(b)] => (a.z - b.z).abs(),
                _ => f64::NAN,
            })
            .collect();
        let last = f[STEPS - 1];
        assert!(last.is_finite(), "{ask:?} {line:?}: a gap within 1e-8 cells of core'");
        // Linear at the end: a jump would stay.
        let linear = f[STEPS - 1] <= 0.2 * f[STEPS - 2] + 1e-8 * world.range()
            || f[STEPS - 1] <= 0.02 * f[STEPS - 3] + 1e-8 * world.range();
        assert!(linear && last <= 1e-5 * world.range(), "{ask:?} {line:?}: {f:?}");
        worst = worst.max(last / world.range());
    }
    worst
}

#[test]
fn the_surface_has_no_jump() {
    let mut worst = 0.0f64;
    let mut lines = 0;
    for (_, mut r, world) in random_worlds(16, 110) {
        for ask in asks(&world).into_iter().chain([Ask::Metres(0.3), Ask::Metres(2.2)]) {
            worst = worst.max(jumps(&world, &mut r, 500, &ask));
            lines += 500;
        }
    }
    println!("random: {lines} lines, largest difference left at 1e-8 cells {worst:.1e} of the range");
    let real =
        [worlds::kit(Policy::Newest), worlds::helens(Policy::Newest, 2), worlds::helens(Policy::Accuracy, 2)];
    for world in real.into_iter().flatten() {
        let mut r = Random::new(seeds(1)[0] + 5);
        let all = asks(&world);
        let worst = all.iter().map(|ask| jumps(&world, &mut r, 1500, ask)).fold(0.0, f64::max);
        println!("{}: largest difference left {worst:.1e} of the range", world.surveys[0].name);
    }
}

#[test]
fn slopes_are_the_derivatives_of_heights() {
    let (mut off, mut all, mut faded) = (Vec::new(), 0, Vec::new());
    for (seed, mut r, world) in random_worlds(12, 110) {
        let points = scatter(&world, &mut r, 1500, 0);
        for ask in asks(&world) {
            // Under a camera, also where patches fade with the distance.
            let fading: Vec<[f64; 2]> = (0..600)
                .filter_map(|_| fade(&world, &mut r, &ask, &[1.03, 1.05, 1.08]))
                .map(|f| f.0)
                .collect();
            let ground = world.snapshot.surface(&ask.query(None)).unwrap();
            let region = &ground.selection.region.polygon;
            let points: Vec<[f64; 2]> =
                points.iter().chain(&fading).filter(|p| inside(region, **p)).copied().collect();
            let step = world.surveys.iter().map(|s| s.posts.nominal_step[0]).fold(f64::MAX, f64::min);
            let late_points = fading.iter().filter(|p| inside(region, **p)).count();
            let h = step * 1e-5;
            let slopes = ground.slopes(&points).unwrap();
            let plain = ground.heights(&points).unwrap();
            let at = |dx: f64, dy: f64| {
                let moved: Vec<[f64; 2]> = points.iter().map(|p| [p[0] + dx, p[1] + dy]).collect();
                ground.heights(&moved).unwrap()
            };
            let (east, west, north, south) = (at(h, 0.0), at(-h, 0.0), at(0.0, h), at(0.0, -h));
            for (n, (p, e)) in points.iter().zip(&slopes).enumerate() {
                let flat = plain[n].as_ref().map(|e| e.z.to_bits());
                assert_eq!(e.as_ref().map(|e| e.z.to_bits()), flat, "seed {seed} {ask:?} {p:?}");
                let (Some(e), Some(a), Some(b), Some(c), Some(d)) =
                    (e, &east[n], &west[n], &north[n], &south[n])
                else {
                    continue;
                };
                assert!(e.gradient.iter().all(|g| g.is_finite()), "seed {seed} {ask:?} {p:?}: {e:?}");
                // A kink within the step: the halves differ.
                let kink = ((a.z - e.z) - (e.z - b.z)).abs().max(((c.z - e.z) - (e.z - d.z)).abs());
                let rise = (a.z - b.z).abs().max((c.z - d.z).abs());
                all += 1;
                if kink > 0.01 * rise + 1e-9 * world.range() {
                    continue;
                }
                let central = [(a.z - b.z) / (2.0 * h), (c.z - d.z) / (2.0 * h)];
                let apart = (central[0] - e.gradient[0]).hypot(central[1] - e.gradient[1]);
                let apart = apart / (1.0 + central[0].hypot(central[1]));
                off.push(apart);
                if n >= points.len() - late_points {
                    faded.push(apart);
                }
            }
        }
    }
    off.sort_by(f64::total_cmp);
    faded.sort_by(f64::total_cmp);
    let at = |q: f64| off[((off.len() - 1) as f64 * q) as usize];
    println!(
        "{} slopes of {all} away from kinks: median {:.1e}, p99 {:.1e}, p99.9 {:.1e}, largest {:.1e} off, of 1 + slope",
        off.len(),
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0)
    );
    let late = faded[faded.len() * 97 / 100];
    println!("{} of them where patches fade: p97 {late:.1e}", faded.len());
    assert!(faded.len() > 300 && late < 1e-3);
    assert!(off.len() * 2 > all && at(0.5) < 1e-4 && at(0.99) < 1e-2 && at(0.999) < 0.1);
}
