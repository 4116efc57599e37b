//! No gap between tiles or around holes, nothing outside, and no old ground under new.

use super::worlds::{self, Ask};
use super::{every_tolerance, heights, random_worlds, scatter};
use crate::support::{Grid, Random, Scratch, random_grid, seeds};
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Change, Policy};
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Blend;

#[test]
fn tiles_and_holes_leave_no_gap() {
    let mut asked = 0;
    for seed in seeds(8) {
        println!("seed {seed}");
        let mut r = Random::new(seed + 51_000);
        let other = random_grid(&mut r, "other", 80);
        let mut g = random_grid(&mut r, "tiled", 130);
        while g.cols < 60 || g.rows < 60 {
            g = random_grid(&mut r, "tiled", 130);
        }
        let (xs, ys) = ([0, g.cols / 3, 2 * g.cols / 3, g.cols], [0, g.rows / 3, 2 * g.rows / 3, g.rows]);
        let cuts = (0..9).map(|n| (n % 3, n / 3));
        let tiles: Vec<Grid> =
            cuts.map(|(a, b)| g.cut(xs[a], ys[b], xs[a + 1] - xs[a], ys[b + 1] - ys[b])).collect();
        let s = Scratch::new(Policy::Accuracy);
        s.ingest(&other);
        let mut ingest = g.tiles_of(tiles.iter().map(Grid::source).collect());
        ingest.name = Some("tiled".into());
        s.change(Change::Ingest(ingest)).unwrap();
        let world = worlds::of(&s, &[other.clone(), g.clone()]);
        let whole = Scratch::new(Policy::Accuracy);
        whole.ingest(&other);
        whole.ingest(&g);
        let whole = worlds::of(&whole, &[other, g.clone()]);

        // Cells between tiles and posts beside them, and everything else.
        let t = world.surveys.iter().position(|s| s.name == "tiled").unwrap();
        let t = &world.surveys[t];
        let seams: Vec<[i64; 2]> = (t.cells.iter())
            .filter(|c| {
                let at = [0, 1].map(|k| c[k] - t.posts.first[k] + 1);
                xs[1..3].contains(&(at[0] as usize)) || ys[1..3].contains(&(at[1] as usize))
            })
            .copied()
            .collect();
        let mut points: Vec<[f64; 2]> = Vec::new();
        for c in &seams {
            points.extend([[0.0, 0.0], [0.5, 0.5], [r.unit(), r.unit()]].map(|part| t.point(*c, part)));
        }
        for k in 0..2 {
            points.extend(world.points(&mut r, k, 2000));
        }
        for ask in every_tolerance(&world) {
            let (a, b) = (heights(&world, &ask, &points), heights(&whole, &ask, &points));
            for ((p, a), b) in points.iter().zip(&a).zip(&b) {
                let e = a.as_ref().unwrap_or_else(|| panic!("seed {seed} {ask:?}: a gap at {p:?}"));
                assert!(e.certified || !world.best(*p).1, "seed {seed} {ask:?} {p:?}: {e:?}");
                assert_eq!(a, b, "seed {seed} {ask:?} {p:?}: tiles and the whole differ");
            }
            asked += points.len();
        }
    }
    println!("{asked} heights, no gap; tiles equal the whole bit for bit");
}

#[test]
fn nothing_outside_and_no_promise_beyond_core() {
    let (mut none, mut rim) = (0, 0);
    for (seed, mut r, world) in random_worlds(8, 100) {
        let points = scatter(&world, &mut r, 300, 800);
        for ask in every_tolerance(&world) {
            for (p, e) in points.iter().zip(heights(&world, &ask, &points)) {
                let (_, _, maybe) = world.best(*p);
                let reached = world.surveys.iter().any(|s| s.v(&s.spot(*p)).0 > 0.0);
                match e {
                    Some(e) if !maybe => {
                        assert!(!e.certified, "seed {seed} {ask:?} {p:?}: {e:?} outside every core'");
                        assert!(reached, "seed {seed} {ask:?} {p:?}: {e:?} where v is 0");
                        rim += 1;
                    }
                    Some(_) => {}
                    None => {
                        assert!(!maybe, "seed {seed} {ask:?} {p:?}: a gap");
                        none += 1;
                    }
                }
            }
        }
    }
    println!("{none} points without data, {rim} in rims: none certified");
    assert!(none > 1000 && rim > 1000);
}

#[test]
fn deep_inside_a_replacing_survey_no_replaced_one_contributes() {
    let (mut asked, mut shallow) = (0usize, 0usize);
    for seed in seeds(10) {
        println!("seed {seed}");
        let mut r = Random::new(seed + 61_000);
        let s = Scratch::new(Policy::Accuracy);
        let mut old = random_grid(&mut r, "old", 120);
        old.precedence = Some(0);
        old.accuracy = [0.0, 0.5][r.below(2) as usize];
        // A newer survey over the middle of the old one, higher, turned, without holes, less accurate.
        let middle = [0, 1].map(|k| {
            let a = &old.affine;
            a.origin[k] + old.cols as f64 / 2.0 * a.col_step[k] + old.rows as f64 / 2.0 * a.row_step[k]
        });
        let across = old.affine.col_step[0].hypot(old.affine.col_step[1]);
        let step = across * [0.4, 1.0, 2.5][r.below(3) as usize];
        let n = (40.0 * across / step).max(20.0) as usize;
        let (sin, cos) = (r.unit() * 7.0).sin_cos();
        let (u, v) = ([step * cos, step * sin], [step * sin, -step * cos]);
        let origin = [0, 1].map(|k| ((middle[k] - n as f64 / 2.0 * (u[k] + v[k])) * 64.0).round() / 64.0);
        let new = Grid {
            name: "new".into(),
            cols: n,
            rows: n,
            z: (0..n * n).map(|k| 700.0 + ((k * 31) % 17) as f32).collect(),
            affine: Affine { origin, col_step: u, row_step: v },
            accuracy: 3.0,
            precedence: Some(1),
            date: None,
        };
        s.ingest(&old);
        s.ingest(&new);
        let world = worlds::of(&s, &[old.clone(), new]);
        let (h, g) = (
            world.surveys.iter().find(|s| s.name == "new").unwrap(),
            world.surveys.iter().find(|s| s.name == "old").unwrap(),
        );
        let diagonal = [1.0, -1.0].map(|sign| {
            let (u, v) = (old.affine.col_step, old.affine.row_step);
            (u[0] + sign * v[0]).hypot(u[1] + sign * v[1])
        });
        // Core of the new one: cells 1 .. n - 2, whose sides are straight.
        let deep = 2.0 * diagonal[0].max(diagonal[1]) / step;
        let points: Vec<[f64; 2]> = (0..1500)
            .filter_map(|_| {
                let at = [0, 1].map(|_| 1.0 + deep + r.unit() * (n as f64 - 3.0 - 2.0 * deep));
                let fits = n as f64 - 3.0 > 2.0 * deep;
                let cell = [0, 1].map(|k| h.posts.first[k] + at[k].floor() as i64);
                fits.then(|| h.point(cell, at.map(f64::fract)))
            })
            .collect();
        for ask in every_tolerance(&world) {
            if let Ask::Metres(_) = ask {
                let ground = world.snapshot.surface(&ask.query(None)).unwrap();
                for p in &points {
                    let (e, who) = ground.sheet().explain(*p).unwrap().unwrap();
                    let wrong = who.iter().find(|(k, _)| ground.survey_of(*k).0 == g.number);
                    assert!(wrong.is_none() && e.z > 699.0, "seed {seed} {ask:?} {p:?}: {e:?} {wrong:?}");
                }
            } else {
                for p in &points[..points.len().min(300)] {
                    let who = world.snapshot.explain(*p, &ask.tolerance(), Blend::Exact).unwrap();
                    assert!(
                        who.iter().all(|(r, _)| r.survey.0 == h.number),
                        "seed {seed} {ask:?} {p:?}: {who:?}"
                    );
                }
            }
            asked += points.len();
        }
        // The band at the border does show both, so the test above can fail.
        let ground = world.snapshot.surface(&Ask::Metres(0.0).query(None)).unwrap();
        for c in &h.rim {
            let p = h.point(*c, [0.5; 2]);
            let who = ground.sheet().explain(p).unwrap().unwrap().1;
            shallow += usize::from(who.iter().any(|(k, _)| ground.survey_of(*k).0 == g.number));
        }
    }
    println!(
        "{asked} points deeper than two diagonals: none shows old ground; {shallow} cells of the rim do"
    );
    assert!(asked > 1000 && shallow > 100);
}

#[test]
fn an_old_crater_shows_nowhere_under_a_new_one() {
    let Some(world) = worlds::helens(Policy::Newest, 0) else { return };
    let new = world.surveys.iter().find(|s| s.name == "2005-06-15").unwrap();
    let mut r = Random::new(seeds(1)[0]);
    // Ten metres everywhere: five cells of core around a cell are deeper than two diagonals.
    let deep = |c: &&[i64; 2]| (-4..5).all(|b| (-4..5).all(|a| new.kept.contains([c[0] + a, c[1] + b])));
    let cells: Vec<[i64; 2]> = new.cells.iter().filter(deep).copied().collect();
    let points: Vec<[f64; 2]> = (0..3000)
        .map(|_| new.point(cells[r.below(cells.len() as u64) as usize], [r.unit(), r.unit()]))
        .collect();
    let mut asked = 0;
    for z in [0.0, 1.0, 5.0, 20.0, 100.0, 1e6] {
        let tolerance = Tolerance::Constant(z);
        let query = Query { area: Area::Everything, tolerance, how: Blend::Exact.into() };
        let ground = world.snapshot.surface(&query).unwrap();
        for p in &points {
            let (_, who) = ground.sheet().explain(*p).unwrap().unwrap();
            let old = who.iter().find(|(k, _)| ground.survey_of(*k).0 != new.number);
            assert!(old.is_none(), "{z} m, {p:?}: {old:?}");
            asked += 1;
        }
    }
    println!("{asked} points over {} cells: only the survey of June 2005", cells.len());
}

#[test]
fn an_infinite_tolerance_shows_the_coarsest_surface() {
    for (seed, mut r, world) in random_worlds(4, 80) {
        let points = scatter(&world, &mut r, 300, 0);
        let largest = heights(&world, &Ask::Metres(f64::MAX), &points);
        let without_end = heights(&world, &Ask::Metres(f64::INFINITY), &points);
        assert!(largest.iter().zip(&points).all(|(e, p)| e.is_some() || !world.best(*p).2));
        assert_eq!(largest, without_end, "seed {seed}");
    }
}
