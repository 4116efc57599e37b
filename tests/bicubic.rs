//! Databases of bicubic patches: the surface is of class C2 across patches, levels and surveys, and everything that is
//! promised for bilinear databases holds (LOD-space specification, sections 5.4, 7, 8, 9).

use crate::certified::continuity::fade;
use crate::certified::reference::{Spot, World};
use crate::certified::worlds::{self, Ask, asks};
use crate::certified::{heights, inside, random_worlds_of, scatter};
use crate::derivation::judge;
use crate::golden;
use crate::oracle::KERNEL;
use crate::support::{Grid, Random, Scratch, bundled, program, random_grid, refused, seeds};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use terraquilt::base::date::Date;
use terraquilt::db::{Db, Policy};
use terraquilt::height::patch::Kind;
use terraquilt::height::source::Window;
use terraquilt::height::surface::Blend;

/// A bundled survey of Mount St. Helens.
fn helens_grid(date: &str, accuracy: f64) -> Grid {
    let mut source =
        terraquilt::format::open(&bundled(&format!("st_helens/survey_{date}_native.tif"))).unwrap();
    let info = source.info().clone();
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    let samples = source.read(Window { col: 0, row: 0, cols, rows }).unwrap();
    let each = samples.data.chunks_exact(info.sample_type.bytes()).zip(&samples.valid);
    let z = each.map(|(b, ok)| if *ok == 1 { info.sample_type.value(b) as f32 } else { f32::NAN }).collect();
    let affine = info.affine.unwrap();
    let name = date.to_string();
    Grid { name, cols, rows, z, affine, accuracy, precedence: None, date: Some(Date::parse(date).unwrap()) }
}

/// The crater of 2000 at 10 m under two domes of 2004 at 2 m.
fn helens(kind: Kind, policy: Policy) -> World {
    let s = Scratch::of(policy, kind);
    let grids =
        [("2000-09-25", 2.0), ("2004-10-04", 0.5), ("2004-10-13", 0.5)].map(|(d, e)| helens_grid(d, e));
    grids.iter().for_each(|g| {
        s.ingest(g);
    });
    World::new(s.db.snapshot(None).unwrap(), &grids, false).at_home(s.folder)
}

#[test]
fn errors_tops_and_tree_equal_the_oracle_and_a_fresh_build() {
    let mut one_step = 0;
    for seed in seeds(4) {
        println!("seed {seed}");
        let mut r = Random::new(seed + 61_000);
        let s = Scratch::of(Policy::Accuracy, Kind::Bicubic);
        let pool: Vec<Grid> =
            (0..2 + r.below(2)).map(|k| random_grid(&mut r, &format!("s{k}"), 90)).collect();
        let mut present: BTreeMap<String, Grid> = BTreeMap::new();
        for step in 0..5 {
            let g = &pool[r.below(pool.len() as u64) as usize];
            if present.remove(&g.name).is_some() {
                s.remove(&g.name);
            } else {
                s.ingest(g);
                present.insert(g.name.clone(), g.clone());
            }
            if present.is_empty() {
                continue;
            }
            let counts = judge(&s, &present);
            one_step += counts.errors_one_step_off;
            s.verify();
            let fresh = Scratch::of(Policy::Accuracy, Kind::Bicubic);
            let mut order: Vec<&Grid> = present.values().collect();
            r.shuffle(&mut order);
            for g in order {
                fresh.ingest(g);
            }
            assert_eq!(s.fingerprint(), fresh.fingerprint(), "seed {seed}, step {step}");
        }
    }
    println!("{one_step} errors are one step of f32 off");
}

#[test]
fn twenty_orders_of_tiles_have_one_fingerprint() {
    let mut r = Random::new(seeds(1)[0] + 62_000);
    let other = random_grid(&mut r, "other", 60);
    let whole = helens_grid("2004-10-04", 0.5);
    let tiled = Grid { name: "tiled".into(), ..whole.cut(100, 100, 90, 80) };
    let mut prints = BTreeMap::new();
    for _ in 0..20 {
        let s = Scratch::of(Policy::Accuracy, Kind::Bicubic);
        let mut tiles = vec![(0, 45, 0, 40), (45, 45, 0, 40), (0, 45, 40, 40), (45, 45, 40, 40)];
        r.shuffle(&mut tiles);
        let early = r.below(4) as usize;
        for (k, (col, cols, row, rows)) in tiles.into_iter().enumerate() {
            if k == early {
                s.ingest(&other);
            }
            let t = tiled.cut(col, row, cols, rows);
            let mut i = t.tiles_of(vec![t.source()]);
            if k == 0 {
                i.name = Some("tiled".into())
            } else {
                i.into = Some("tiled".into())
            }
            s.change(terraquilt::db::Change::Ingest(i)).unwrap();
        }
        *prints.entry(s.fingerprint()).or_insert(0) += 1;
    }
    assert_eq!(prints.len(), 1, "{prints:?}");
}

#[test]
fn the_surface_equals_its_definition_from_any_region_within_its_certified_error() {
    let (mut asked, mut worst) = (0, 0.0f64);
    for (seed, mut r, world) in random_worlds_of(Kind::Bicubic, 6, 90) {
        let points = scatter(&world, &mut r, 300, 60);
        for ask in asks(&world).into_iter().chain([Ask::Metres(0.3), Ask::Metres(2.2)]) {
            let found = heights(&world, &ask, &points);
            let off: Vec<f64> = (points.par_iter().zip(&found).enumerate())
                .map(|(n, (p, e))| {
                    let delta = ask.at(*p, world.z);
                    let truth = world.brute(*p, delta, Blend::Exact);
                    let (best, sure, _) = world.best(*p);
                    let e = match (&truth, e) {
                        (Some(_), Some(e)) => e,
                        // Far out in the rim weights may round to nothing.
                        (Some(_), None) if !sure => return 0.0,
                        (None, None) => return 0.0,
                        _ => panic!("seed {seed} {ask:?} {p:?}: {e:?}, expected {truth:?}"),
                    };
                    let bound = delta.max(best) * (1.0 + 1e-12);
                    assert!(
                        !sure || e.certified && e.error_m <= bound,
                        "seed {seed} {ask:?} {p:?}: {e:?}, {best}"
                    );
                    if n % 3 > 0 {
                        return if sure { (truth.unwrap().0 - e.z).abs() } else { 0.0 };
                    }
                    // The same from a region of one point.
                    let alone = world.snapshot.heights(&[*p], &ask.tolerance(), Blend::Exact).unwrap();
                    let apart = (alone[0].as_ref().unwrap().z - e.z).abs();
                    // Outside every core' nothing is promised; weights there end with t cubed and their digits with them.
                    if sure { (truth.unwrap().0 - e.z).abs().max(apart) } else { 0.0 }
                })
                .collect();
            asked += points.len();
            for (off, p) in off.iter().zip(&points) {
                worst = worst.max(off / world.range());
                assert!(*off <= 1e-8 * world.range(), "seed {seed} {ask:?} {p:?}: {off} m off");
            }
        }
    }
    println!("{asked} heights equal the definition: worst {worst:.1e} of the range");
}

#[test]
fn at_level_0_the_surface_of_one_survey_meets_every_sample() {
    let s = Scratch::of(Policy::Accuracy, Kind::Bicubic);
    let g = helens_grid("2004-10-13", 0.5);
    s.ingest(&g);
    let world = World::new(s.db.snapshot(None).unwrap(), &[g], false);
    let survey = &world.surveys[0];
    let posts = survey.guaranteed_posts();
    let points: Vec<[f64; 2]> = posts.iter().map(|at| survey.point(*at, [0.0; 2])).collect();
    let found = heights(&world, &Ask::Metres(0.0), &points);
    let off =
        posts.iter().zip(&found).map(|(at, e)| (e.as_ref().unwrap().z - survey.post(*at).unwrap()).abs());
    let worst = off.fold(0.0, f64::max);
    println!("{} posts, largest distance {worst:.1e} m", posts.len());
    assert!(posts.len() > 10_000 && worst < 1e-8, "{worst}");
    // At coarser levels the samples are within the certified error.
    for z in [2.0, 10.0] {
        for (at, e) in posts.iter().zip(heights(&world, &Ask::Metres(z), &points)) {
            let e = e.unwrap();
            let off = (e.z - survey.post(*at).unwrap()).abs();
            assert!(
                e.certified && off + 0.5 <= e.error_m * (1.0 + 1e-6) && e.error_m <= z,
                "{z} m: {e:?}, {off}"
            );
        }
    }
}

#[test]
fn curvature_inside_one_patch_is_that_of_its_spline() {
    let world = helens(Kind::Bicubic, Policy::Newest);
    let mut r = Random::new(seeds(1)[0] + 63_000);
    let (mut alone, mut blended, mut worst) = (0, 0, 0.0f64);
    for ask in [Ask::Metres(0.0), Ask::Metres(4.0), Ask::Metres(15.0)] {
        let ground = world.snapshot.surface(&ask.query(None)).unwrap();
        for (k, survey) in world.surveys.iter().enumerate() {
            let points = world.points(&mut r, k, 300);
            let found = ground.curvatures(&points).unwrap();
            let (plain, slopes) = (ground.heights(&points).unwrap(), ground.slopes(&points).unwrap());
            for (n, (p, e)) in points.iter().zip(&found).enumerate() {
                let (e, hessian) = e.as_ref().unwrap();
                // One formula: the same bits of the height and the slope.
                assert_eq!(e.z.to_bits(), plain[n].as_ref().unwrap().z.to_bits());
                assert_eq!(e.gradient, slopes[n].as_ref().unwrap().gradient);
                let (_, who) = world.brute(*p, ask.at(*p, world.z), Blend::Exact).unwrap();
                let patch = &world.patches[who[0].0];
                if who.len() > 1 || patch.survey != k {
                    blended += 1;
                    continue;
                }
                // Second differences of the oracle's spline, which is a cubic: step by step exact but for rounding.
                let at = |spot: &Spot| {
                    [0, 1].map(|a| {
                        ((spot.cell[a] - patch.first[a]) as f64 + spot.part[a]) / patch.stride as f64
                    })
                };
                let c = at(&survey.spot(*p));
                let h = 1.0 / 64.0;
                if c.iter().any(|c| (c - c.round()).abs() < h) {
                    continue;
                }
                let f = |a: f64, b: f64| patch.at(survey, [c[0] + a * h, c[1] + b * h]);
                let second = [
                    (f(1.0, 0.0) - 2.0 * f(0.0, 0.0) + f(-1.0, 0.0)) / (h * h),
                    (f(1.0, 1.0) - f(1.0, -1.0) - f(-1.0, 1.0) + f(-1.0, -1.0)) / (4.0 * h * h),
                    (f(0.0, 1.0) - 2.0 * f(0.0, 0.0) + f(0.0, -1.0)) / (h * h),
                ];
                // These surveys lie along the axes: x grows with i, y falls with j.
                let step = survey.posts.nominal_step[0] * patch.stride as f64;
                let [xx, xy, yy] = second.map(|d| d / (step * step));
                let sign = if survey.posts.v[1] < 0 { -1.0 } else { 1.0 };
                for (found, truth) in hessian.iter().zip([xx, sign * xy, yy]) {
                    worst = worst.max((found - truth).abs() * step * step);
                }
                alone += 1;
            }
        }
    }
    println!("{alone} points in one patch, {blended} blended: worst {worst:.1e} m per squared cell");
    // A mixed difference of a bicubic has an error of h^2 times its third derivatives.
    assert!(alone > 200 && blended > 200 && worst < 0.05, "{alone} {blended} {worst}");
}

#[test]
fn curvature_is_the_derivative_of_the_slope_also_where_a_camera_fades_patches() {
    let world = helens(Kind::Bicubic, Policy::Newest);
    let mut r = Random::new(seeds(1)[0] + 65_000);
    for ask in asks(&world).into_iter().skip(5).chain([Ask::Metres(3.0)]) {
        let ground = world.snapshot.surface(&ask.query(None)).unwrap();
        let mut points: Vec<[f64; 2]> =
            (0..4000).filter_map(|_| fade(&world, &mut r, &ask, &[1.03, 1.05, 1.08])).map(|f| f.0).collect();
        points.extend((0..3).flat_map(|k| world.points(&mut r, k, 200)));
        points.retain(|p| inside(&ground.selection.region.polygon, *p));
        points.truncate(800);
        let h = 2e-3;
        let slopes = |dx: f64, dy: f64| {
            let moved: Vec<[f64; 2]> = points.iter().map(|p| [p[0] + dx, p[1] + dy]).collect();
            ground.slopes(&moved).unwrap()
        };
        let sides = [[slopes(-h, 0.0), slopes(h, 0.0)], [slopes(0.0, -h), slopes(0.0, h)]];
        let mut off = Vec::new();
        for (n, e) in ground.curvatures(&points).unwrap().iter().enumerate() {
            let Some((_, hessian)) = e else { continue };
            for (axis, [before, after]) in sides.iter().enumerate() {
                let (Some(a), Some(b)) = (&before[n], &after[n]) else { continue };
                for k in 0..2 {
                    let truth = (b.gradient[k] - a.gradient[k]) / (2.0 * h);
                    off.push([(hessian[axis + k] - truth).abs() / (0.01 + truth.abs())]);
                }
            }
        }
        let [p50, p95] = [0.5, 0.95].map(|q| quantile(&off, q)[0]);
        println!("{ask:?}: {} second derivatives, {p50:.1e} off in the median, 95 % by {p95:.1e}", off.len());
        assert!(off.len() > 800 && p50 < 1e-4 && p95 < 0.02, "{ask:?}: {p50} {p95}");
    }
}

/// Points and the directions across: on borders of kernels and domains (of all levels), of core' (of surveys), and where
/// a patch begins or ends to fade in or out with the tolerance.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Across {
    Patches,
    Surveys,
    Fades,
}

type Line = ([f64; 2], [f64; 2]);

fn lines(world: &World, r: &mut Random, ask: &Ask, across: Across, count: usize) -> Vec<Line> {
    let mut out = Vec::new();
    while out.len() < count {
        let s = &world.surveys[r.below(world.surveys.len() as u64) as usize];
        if across == Across::Fades {
            out.extend(fade(world, r, ask, &[1.0, 1.1]));
            continue;
        }
        let list = if across == Across::Surveys { &s.rim } else { &s.cells };
        if list.is_empty() {
            continue;
        }
        let mut cell = list[r.below(list.len() as u64) as usize];
        let axis = r.below(2) as usize;
        let mut part = [r.unit(), r.unit()];
        part[axis] = 0.0;
        if across == Across::Surveys {
            // Either side of the rim, where v begins and where it ends.
            cell[axis] += r.below(4) as i64 - 1;
        } else {
            let level = r.below(4);
            let line = KERNEL << level;
            let shift = [0, -2, 2][r.below(3) as usize] << level;
            cell[axis] = (cell[axis] as f64 / line as f64).round() as i64 * line + shift;
        }
        let p = s.point(cell, part);
        if world.best(p).1 {
            let step = if axis == 0 { s.posts.u } else { s.posts.v };
            out.push((p, step.map(|c| c as f64 / (1u64 << 35) as f64)));
        }
    }
    out
}

/// Steps across a border in cells: each half of the one before.
const STEPS: [f64; 5] = [0.04, 0.02, 0.01, 0.005, 0.0025];

/// How far the second differences before, on and after a border are apart, metres per squared cell, by step. It falls
/// with the step where the second derivative is continuous; a jump of it would stay, a kink grow.
fn jumps(world: &World, ask: &Ask, lines: &[Line]) -> Vec<[f64; 5]> {
    let mut points = Vec::new();
    for (p, d) in lines {
        for h in STEPS {
            points.extend((-2..3).map(|k| [0, 1].map(|a| p[a] + f64::from(k) * h * d[a])));
        }
    }
    let z: Vec<f64> =
        heights(world, ask, &points).iter().map(|e| e.as_ref().map_or(f64::NAN, |e| e.z)).collect();
    let jump = |f: &[f64], h: f64| {
        let bends: Vec<f64> = (0..3).map(|k| (f[k] - 2.0 * f[k + 1] + f[k + 2]) / (h * h)).collect();
        (0..3).map(|k| (bends[k] - bends[(k + 1) % 3]).abs()).fold(0.0, f64::max)
    };
    let all = z.chunks_exact(5 * STEPS.len());
    all.filter(|z| z.iter().all(|z| z.is_finite()))
        .map(|z| std::array::from_fn(|n| jump(&z[5 * n..5 * n + 5], STEPS[n])))
        .collect()
}

/// Heights carry an error of a few 1e-10 cells in the position: in a second difference, this much a squared step.
const ROUNDING: f64 = 2e-8;

/// The second derivatives before and after a border, by the analytic ones: how far apart for ever smaller steps.
fn apart(world: &World, ask: &Ask, lines: &[Line]) -> Vec<[f64; 3]> {
    let Ask::Metres(_) = ask else { return Vec::new() };
    let ground = world.snapshot.surface(&ask.query(None)).unwrap();
    let at = |h: f64| {
        let points: Vec<[f64; 2]> = lines.iter().map(|(p, d)| [0, 1].map(|a| p[a] + h * d[a])).collect();
        ground.curvatures(&points).unwrap()
    };
    let sides = [1e-3, 1e-4, 1e-5].map(|h| (at(-h), at(h)));
    let found = lines.iter().enumerate().map(|(k, (_, d))| {
        sides.each_ref().map(|(before, after)| {
            let (Some(a), Some(b)) = (&before[k], &after[k]) else { return f64::NAN };
            let off = (0..3).map(|n| (a.1[n] - b.1[n]).abs()).fold(0.0, f64::max);
            off * (d[0] * d[0] + d[1] * d[1])
        })
    });
    found.filter(|j| j.iter().all(|j| j.is_finite())).collect()
}

fn quantile<const N: usize>(v: &[[f64; N]], q: f64) -> [f64; N] {
    std::array::from_fn(|n| {
        let mut column: Vec<f64> = v.iter().map(|j| j[n]).collect();
        column.sort_by(f64::total_cmp);
        column[((column.len() - 1) as f64 * q) as usize]
    })
}

/// Second differences across borders fall with the step in the bicubic world; in the bilinear one, of the same surveys,
/// they grow.
fn shrinking(name: &str, smooth: &World, rough: &World) {
    let eyes: Vec<Ask> = asks(smooth).into_iter().skip(5).collect();
    let uniform = [0.0, 3.0, 12.0].map(Ask::Metres);
    for across in [Across::Patches, Across::Surveys, Across::Fades] {
        let asks = if across == Across::Fades { &eyes[..] } else { &uniform[..] };
        let (mut falls, mut grows, mut analytic) = (Vec::new(), Vec::new(), Vec::new());
        for ask in asks {
            let mut r = Random::new(seeds(1)[0] + 64_000);
            let found = lines(smooth, &mut r, ask, across, 300);
            falls.extend(jumps(smooth, ask, &found));
            analytic.extend(apart(smooth, ask, &found));
            grows.extend(jumps(rough, ask, &lines(rough, &mut r, ask, across, 300)));
        }
        for (kind, j) in [("bicubic", &falls), ("bilinear", &grows)] {
            println!("{name} {across:?} {kind}: {} lines", j.len());
            for q in [0.5, 0.9, 1.0] {
                println!("    quantile {q}: {}", quantile(j, q).map(|v| format!("{v:8.1e}")).join(" "));
            }
        }
        let (first, last) = (STEPS[0], STEPS[4]);
        for q in [0.5, 0.9] {
            let j = quantile(&falls, q);
            let most = j[0] * 1.3 * last / first + ROUNDING / (last * last);
            assert!(
                j[4] <= most,
                "{name} {across:?}: quantile {q} falls from {} to {}, at most {most}",
                j[0],
                j[4]
            );
        }
        // Every single line, once the step is within the steep part of a border between surveys.
        for j in &falls {
            let most = 0.7 * j[..4].iter().copied().fold(0.0, f64::max) + ROUNDING / (last * last);
            assert!(j[4] <= most, "{name} {across:?}: {j:?}");
        }
        let worst = quantile(&grows, 1.0);
        assert!(worst[4] > 2.0 * worst[0], "{name} {across:?}: bilinear kinks should grow: {worst:?}");
        for j in &analytic {
            assert!(j[2] <= 0.3 * j[1].max(j[0]) + 1e-5, "{name} {across:?}: {j:?}");
        }
        if !analytic.is_empty() {
            println!("    analytic, largest at 1e-3, 1e-4, 1e-5 cells: {:?}", quantile(&analytic, 1.0));
        }
    }
}

#[test]
fn second_differences_across_borders_of_real_surveys_fall_with_the_step() {
    let [smooth, rough] = [Kind::Bicubic, Kind::Bilinear].map(|k| helens(k, Policy::Newest));
    shrinking("helens", &smooth, &rough);
    if let [Some(smooth), Some(rough)] =
        [Kind::Bicubic, Kind::Bilinear].map(|k| worlds::kit_of(Policy::Accuracy, k))
    {
        shrinking("kit", &smooth, &rough);
    }
}

/// What the golden surveys answer from a bicubic database, and where that is kept.
fn kept_bits() -> (String, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let db = golden::build_of(&folder.path().join("db"), Kind::Bicubic);
    (golden::answers(&db), Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/v1-bicubic.txt"))
}

#[test]
fn the_bits_of_errors_ids_and_heights_are_kept() {
    let (found, kept) = kept_bits();
    assert_eq!(found, std::fs::read_to_string(kept).unwrap());
}

#[test]
#[ignore = "writes tests/golden/v1-bicubic.txt, which is kept as it was released: cargo test --test main bicubic:: -- --ignored"]
fn write_the_kept_bits() {
    let (found, kept) = kept_bits();
    std::fs::write(kept, found).unwrap();
}

#[test]
fn the_surface_does_not_swing_beside_voids() {
    // High ground, tilted: a spline through the zeros of voids would swing by hundreds of metres.
    let mut g = golden::grid("slope", [500_000, 4_000_490], [10, 0], [0, -10], true);
    let plane = |p: [f64; 2]| 3000.0 + (p[0] - 500_000.0) * 0.5 + (p[1] - 4_000_000.0) * 0.25;
    for k in 0..g.z.len() {
        let (i, j) = ((k % g.cols) as f64, (k / g.cols) as f64);
        if g.z[k].is_finite() {
            g.z[k] = plane([500_000.0 + 10.0 * i, 4_000_490.0 - 10.0 * j]) as f32;
        }
    }
    let s = Scratch::of(Policy::Accuracy, Kind::Bicubic);
    s.ingest(&g);
    let world = World::new(s.db.snapshot(None).unwrap(), &[g], false);
    let survey = &world.surveys[0];
    let points: Vec<[f64; 2]> = survey.cells.iter().map(|c| survey.point(*c, [0.5; 2])).collect();
    let found = heights(&world, &Ask::Metres(0.0), &points);
    let off = |p: &[f64; 2], z: f64| (z - plane(*p)).abs();
    let worst = points.iter().zip(&found).map(|(p, e)| off(p, e.as_ref().unwrap().z)).fold(0.0, f64::max);
    println!("{} cells beside and away from voids: largest distance {worst:.3} m", points.len());
    // Cells rise by 5 m.
    assert!(survey.rim.len() > 200 && worst < 0.2, "{worst}");
}

#[test]
fn a_bilinear_database_has_no_curvature_and_says_so() {
    let s = Scratch::new(Policy::Accuracy);
    let g = helens_grid("2004-10-13", 0.5);
    s.ingest(&g);
    let snapshot = s.db.snapshot(None).unwrap();
    let ground = snapshot.surface(&Ask::Metres(0.0).query(None)).unwrap();
    let said = ground.curvatures(&[[0.0; 2]]).unwrap_err().to_string();
    assert!(said.contains("bilinear") && said.contains("--patch bicubic"), "{said}");
}

#[test]
fn the_program_makes_opens_and_checks_bicubic_databases() {
    let folder = tempfile::tempdir().unwrap();
    let path = |n: &str| folder.path().join(n).to_str().unwrap().to_string();
    let (smooth, rough) = (path("smooth"), path("rough"));
    let file = bundled("st_helens/survey_2004-10-13_native.tif");
    let file = file.to_str().unwrap();
    for (db, kind) in [(&smooth, "bicubic"), (&rough, "bilinear")] {
        let made = program(&["init", db, "--crs", "EPSG:26910", "--patch", kind]);
        let said = String::from_utf8_lossy(&made.stderr).to_string();
        assert!(made.status.success() && said.contains(&format!("{kind} patches")), "{said}");
        crate::support::printed(&["ingest", db, file, "--name", "dome", "--accuracy", "0.5"]);
        crate::support::printed(&["verify", db]);
    }
    // Not one patch in common, the exact ones of level 0 included.
    let ids = |db: &str| -> std::collections::BTreeSet<String> {
        let lines = crate::support::printed(&["boxes", db]);
        lines
            .lines()
            .map(|l| serde_json::from_str::<serde_json::Value>(l).unwrap()["id"].to_string())
            .collect()
    };
    let (a, b) = (ids(&smooth), ids(&rough));
    assert!(a.len() == b.len() && a.is_disjoint(&b));
    assert_eq!(Db::open(Path::new(&smooth)).unwrap().kind(), Kind::Bicubic);
    crate::support::printed(&["export", &smooth, &path("dome.glb"), "--error", "3"]);
    let said = refused(&["init", &path("x"), "--crs", "EPSG:26910", "--patch", "quintic"], 2);
    assert!(said.contains("bicubic"), "{said}");
}
