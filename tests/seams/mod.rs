//! Must show: seams between surveys that disagree do not show (section 15 of the LOD-space specification).

mod camera;
mod smooth;
mod table;

use crate::certified::reference::{Survey, World};
use crate::certified::worlds::{Ask, asks};
use crate::support::{Grid, Random, Scratch, bundled, printed, random_grid, seeds, shared};
use std::path::Path;
use terraquilt::base::date::Date;
use terraquilt::db::query::Query;
use terraquilt::db::{Db, Policy};
use terraquilt::format;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::{Affine, Window};
use terraquilt::height::surface::{Blend, Evaluation, How, Seams};

/// A file as a grid in memory.
fn read(path: &Path, name: &str, accuracy: f64, date: Option<&str>) -> Grid {
    let mut source = format::open(path).unwrap();
    let (cols, rows) = (source.info().cols as usize, source.info().rows as usize);
    let samples = source.read(Window { col: 0, row: 0, cols, rows }).unwrap();
    let kind = source.info().sample_type;
    let each = samples.data.chunks_exact(kind.bytes()).zip(&samples.valid);
    let z = each.map(|(b, ok)| if *ok == 1 { kind.value(b) as f32 } else { f32::NAN }).collect();
    let affine = source.info().affine.unwrap();
    let date = date.map(|d| Date::parse(d).unwrap());
    Grid { name: name.into(), cols, rows, z, affine, accuracy, precedence: None, date }
}

const HELENS: [(&str, f64, &str); 4] = [
    ("survey_2000-09-25_native.tif", 2.0, "2000-09-25"),
    ("survey_2004-10-04_native.tif", 0.5, "2004-10-04"),
    ("survey_2004-10-11_native.tif", 0.5, "2004-10-11"),
    ("survey_2004-10-13_native.tif", 0.5, "2004-10-13"),
];

/// The crater of 2000 and some of its domes.
fn helens(which: &[usize]) -> Vec<Grid> {
    which
        .iter()
        .map(|k| {
            let (file, accuracy, date) = HELENS[*k];
            read(&bundled("st_helens").join(file), &date[..10], accuracy, Some(date))
        })
        .collect()
}

fn world(grids: &[Grid], policy: Policy) -> World {
    world_of(Kind::Bilinear, grids, policy)
}

fn world_of(kind: Kind, grids: &[Grid], policy: Policy) -> World {
    let s = Scratch::of(policy, kind);
    grids.iter().for_each(|g| {
        s.ingest(g);
    });
    World::new(s.db.snapshot(None).unwrap(), grids, false).at_home(s.folder)
}

fn how(seams: Seams) -> How {
    How { blend: Blend::Exact, seams }
}

fn heights(w: &World, ask: &Ask, seams: Seams, points: &[[f64; 2]]) -> Vec<Option<Evaluation>> {
    w.snapshot.heights(points, &ask.tolerance(), how(seams)).unwrap()
}

/// Middles of sides of core' of a survey, with the step outwards.
fn normals(s: &Survey, count: usize) -> Vec<([f64; 2], [f64; 2])> {
    let mut out = Vec::new();
    for c in &s.rim {
        for (a, b) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            if s.kept.contains([c[0] + a, c[1] + b]) {
                continue;
            }
            let (m, o) = (s.point(*c, [0.5, 0.5]), s.point([c[0] + a, c[1] + b], [0.5, 0.5]));
            out.push(([0, 1].map(|k| (m[k] + o[k]) / 2.0), [0, 1].map(|k| o[k] - m[k])));
        }
    }
    let n = out.len();
    (0..count.min(n)).map(|k| out[k * n / count.min(n)]).collect()
}

/// The steepest slope over one cell within 6 cells of the border, for each normal.
fn slopes(w: &World, ask: &Ask, seams: Seams, normals: &[([f64; 2], [f64; 2])]) -> Vec<f64> {
    const HALVES: i32 = 24;
    let points: Vec<[f64; 2]> = normals
        .iter()
        .flat_map(|(p, d)| {
            (0..=HALVES).map(move |k| {
                let t = f64::from(k) / 2.0 - 6.0;
                [p[0] + t * d[0], p[1] + t * d[1]]
            })
        })
        .collect();
    let z = heights(w, ask, seams, &points);
    let mut found: Vec<f64> = z
        .chunks_exact(HALVES as usize + 1)
        .zip(normals)
        .map(|(z, (_, d))| {
            let cell = d[0].hypot(d[1]);
            (0..z.len() - 2)
                .filter_map(|k| Some((z[k + 2].as_ref()?.z - z[k].as_ref()?.z).abs() / cell))
                .fold(0.0, f64::max)
        })
        .collect();
    found.sort_by(f64::total_cmp);
    found
}

/// Points of a world: in core' of every survey, along the borders, and anywhere.
fn scatter(w: &World, r: &mut Random, count: usize) -> Vec<[f64; 2]> {
    let mut out: Vec<[f64; 2]> = (0..w.surveys.len()).flat_map(|k| w.points(r, k, count)).collect();
    for s in &w.surveys {
        for (p, d) in normals(s, count) {
            let t = r.unit() * 30.0 - 10.0;
            out.push([p[0] + t * d[0], p[1] + t * d[1]]);
        }
    }
    out
}

#[test]
fn what_seams_add_is_told_and_taken_away_again() {
    for kind in Kind::ALL {
        told_and_taken_away(&world_of(kind, &helens(&[0, 1, 3]), Policy::Newest));
    }
}

fn told_and_taken_away(w: &World) {
    let points = scatter(w, &mut Random::new(seeds(1)[0]), 1500);
    let (mut moved, mut most, mut by_who) = (0, 0.0f64, 0);
    for z in [0.0, 1.0, 5.0, 20.0, 100.0] {
        let ask = Ask::Metres(z);
        let off = heights(w, &ask, Seams::Off, &points);
        let on = heights(w, &ask, Seams::All, &points);
        let ground = w.snapshot.surface(&Query { how: how(Seams::All), ..ask.query(None) }).unwrap();
        for (n, (p, (off, on))) in points.iter().zip(off.iter().zip(&on)).enumerate() {
            let (Some(off), Some(on)) = (off, on) else {
                assert!(off.is_none() && on.is_none());
                continue;
            };
            assert_eq!((off.correction_m, off.contradiction), (0.0, false));
            assert_eq!((on.z - on.correction_m).to_bits(), off.z.to_bits(), "{p:?}: {on:?} {off:?}");
            assert_eq!((on.certified, on.accuracy_m), (off.certified, off.accuracy_m));
            assert!(on.error_m >= off.error_m && on.error_m + 1e-9 >= on.correction_m.abs());
            moved += usize::from(on.correction_m != 0.0);
            most = most.max(on.correction_m.abs());
            if n % 7 == 0 && off.certified {
                // The error, by its definition: shares of rounding may be left out.
                let sheet = ground.sheet();
                let (_, who) = sheet.explain(*p).unwrap().unwrap();
                let error = |least: f64| {
                    let who = who.iter().filter(|w| w.1 > least);
                    who.map(|(k, _)| {
                        let patch = &ground.surface.patches[*k];
                        f64::from(patch.bot) + sheet.correction_of(patch.survey, *p).unwrap().abs()
                    })
                    .fold(0.0, f64::max)
                };
                let (lo, hi) = (error(1e-9), error(0.0));
                assert!(lo - 1e-6 <= on.error_m && on.error_m <= hi + 1e-6, "{p:?}: {on:?}, {lo} {hi}");
                by_who += 1;
            }
        }
    }
    println!(
        "{} points, {moved} corrections, largest {most:.2} m; {by_who} errors by contributors",
        points.len()
    );
    assert!(moved > 3000 && most > 10.0);
    // From a region of its own, each point is bent alike.
    let all = heights(w, &Ask::Metres(5.0), Seams::All, &points);
    for (p, e) in points.iter().zip(&all).step_by(97) {
        let alone = heights(w, &Ask::Metres(5.0), Seams::All, &[*p]).remove(0);
        let apart = (alone.as_ref().map_or(0.0, |a| a.z) - e.as_ref().map_or(0.0, |e| e.z)).abs();
        assert!(apart <= 1e-9 * w.range() && alone.is_some() == e.is_some(), "{p:?}: {alone:?} {e:?}");
    }
}

#[test]
fn nothing_moves_inside_the_better_survey() {
    let w = world(&helens(&[0, 3]), Policy::Newest);
    let points = w.points(&mut Random::new(seeds(1)[0]), 1, 6000);
    // Below the error of the crater, 2 m, it is masked wherever the dome is.
    for z in [0.0, 1.0, 1.999] {
        let off = heights(&w, &Ask::Metres(z), Seams::Off, &points);
        for ((p, off), on) in points.iter().zip(off).zip(heights(&w, &Ask::Metres(z), Seams::All, &points)) {
            let (off, on) = (off.unwrap(), on.unwrap());
            // On the very border, rounding may take a point for one outside.
            if w.surveys[1].surely(&w.surveys[1].spot(*p)).0 {
                assert_eq!((on.correction_m, on.z.to_bits()), (0.0, off.z.to_bits()), "{p:?}");
            }
        }
    }
}

#[test]
fn borders_are_no_steeper_than_the_ground() {
    let w = world(&helens(&[0, 3]), Policy::Newest);
    let n = normals(&w.surveys[1], 600);
    for (z, before, after) in [(0.0, 8.0, 2.2), (5.0, 4.0, 2.0), (20.0, 2.5, 2.0)] {
        let at = |s: Seams| slopes(&w, &Ask::Metres(z), s, &n)[n.len() * 99 / 100];
        let (off, all) = (at(Seams::Off), at(Seams::All));
        println!("z = {z}: slope p99 {off:.2} without, {all:.2} with");
        assert!(off > before && all < after, "z = {z}: {off} {all}");
    }
}

#[test]
fn any_order_and_any_removal_gives_the_same_field() {
    let grids = helens(&[0, 1, 2, 3]);
    let points = {
        let w = world(&grids, Policy::Newest);
        scatter(&w, &mut Random::new(seeds(1)[0]), 400)
    };
    let corrected = |s: &Scratch| -> Vec<Option<(u64, bool)>> {
        let now = s.db.snapshot(None).unwrap();
        let found = now.heights(&points, &Ask::Metres(5.0).tolerance(), how(Seams::All)).unwrap();
        found.into_iter().map(|e| e.map(|e| (e.z.to_bits(), e.contradiction))).collect()
    };
    let of = |order: &[usize]| {
        let s = Scratch::new(Policy::Newest);
        order.iter().for_each(|k| {
            s.ingest(&grids[*k]);
        });
        s
    };
    let forward = of(&[0, 1, 2, 3]);
    let all = corrected(&forward);
    assert!(all == corrected(&of(&[3, 1, 0, 2])), "another order, another field");
    let three = corrected(&of(&[0, 1, 3]));
    assert!(all != three);
    forward.remove(&grids[2].name);
    assert!(corrected(&forward) == three, "a survey that left is still felt");
    forward.ingest(&grids[2]);
    assert!(corrected(&forward) == all, "a survey that came back is another one");
}

#[test]
fn corrections_have_no_jump_and_slopes_are_their_derivatives() {
    let (mut lines, mut worst, mut off, mut kinks) = (0, 0.0f64, Vec::new(), 0);
    for seed in seeds(8) {
        let mut r = Random::new(seed + 61_000);
        let grids: Vec<Grid> = (0..3).map(|k| random_grid(&mut r, &format!("s{k}"), 110)).collect();
        let w = world(&grids, Policy::Accuracy);
        for ask in asks(&w) {
            let mut points = Vec::new();
            for (k, s) in w.surveys.iter().enumerate() {
                for p in w.points(&mut r, k, 120) {
                    // Across a line between cells.
                    let at = s.spot(p);
                    let (p, q) = (s.point(at.cell, [at.part[0], 0.0]), s.point(at.cell, [at.part[0], 0.01]));
                    let d = [0, 1].map(|k| (q[k] - p[k]) * 100.0);
                    for h in [1e-6, 1e-7, 1e-8] {
                        points.extend([-h, h].map(|h| [p[0] + h * d[0], p[1] + h * d[1]]));
                    }
                }
            }
            for z in heights(&w, &ask, Seams::All, &points).chunks_exact(6) {
                let z: Option<Vec<f64>> = z.iter().map(|e| e.as_ref().map(|e| e.z)).collect();
                let Some(z) = z else { continue };
                let f = [0, 2, 4].map(|k| (z[k] - z[k + 1]).abs());
                lines += 1;
                worst = worst.max(f[2] / w.range());
                assert!(f[2] <= 0.3 * f[1] + 2e-8 * w.range(), "seed {seed} {ask:?}: {f:?}");
            }
            let Ask::Metres(_) = ask else { continue };
            let ground = w.snapshot.surface(&Query { how: how(Seams::All), ..ask.query(None) }).unwrap();
            let some: Vec<[f64; 2]> = (0..w.surveys.len()).flat_map(|k| w.points(&mut r, k, 200)).collect();
            let h = 1e-5;
            let at = |x: f64, y: f64| {
                let moved: Vec<[f64; 2]> = some.iter().map(|p| [p[0] + x, p[1] + y]).collect();
                ground.heights(&moved).unwrap()
            };
            let (east, west, north, south) = (at(h, 0.0), at(-h, 0.0), at(0.0, h), at(0.0, -h));
            for (k, g) in ground.slopes(&some).unwrap().into_iter().enumerate() {
                if let (Some(g), Some(e), Some(w), Some(n), Some(s)) =
                    (g, &east[k], &west[k], &north[k], &south[k])
                {
                    // Points on lines between cells have two slopes.
                    let kink = (e.z + w.z - 2.0 * g.z).abs().max((n.z + s.z - 2.0 * g.z).abs()) / h;
                    if kink > 1e-3 {
                        kinks += 1;
                        continue;
                    }
                    let d = [(e.z - w.z) / (2.0 * h), (n.z - s.z) / (2.0 * h)];
                    off.push((d[0] - g.gradient[0]).hypot(d[1] - g.gradient[1]) / (1.0 + d[0].hypot(d[1])));
                }
            }
        }
    }
    off.sort_by(f64::total_cmp);
    let at = |q: f64| off[((off.len() - 1) as f64 * q) as usize];
    println!(
        "{lines} lines, largest difference left {worst:.1e} of the range; {} slopes off by {:.1e}, p85 {:.1e}",
        off.len(),
        at(0.5),
        at(0.85)
    );
    println!("{kinks} points on kinks left out");
    assert!(lines > 1000 && off.len() > 8000 && at(0.5) < 1e-4 && at(0.85) < 1e-3);
}

#[test]
fn ground_that_is_invented_says_so() {
    let w = world(&helens(&[0, 3]), Policy::Newest);
    let points = scatter(&w, &mut Random::new(seeds(1)[0]), 1500);
    let all = heights(&w, &Ask::Metres(0.0), Seams::All, &points);
    let held = heights(&w, &Ask::Metres(0.0), Seams::Consistent, &points);
    let (mut flagged, mut large) = (0, 0);
    for (all, held) in all.iter().zip(&held) {
        let (Some(all), Some(held)) = (all, held) else { continue };
        flagged += usize::from(all.contradiction);
        // More than both surveys state, 2.5 m: some gap nearby must be.
        if all.correction_m.abs() > 2.5 {
            large += 1;
            assert!(all.contradiction, "{all:?}");
        }
        assert!(held.correction_m.abs() <= 2.5 * (1.0 + 1e-6), "{held:?}");
    }
    println!("{flagged} of {} heights flagged, {large} moved by more than both accuracies", points.len());
    assert!(flagged > 100 && flagged < points.len() / 2 && large > 50);
}

/// Two flats that differ by 3 m: of any accuracies, with or without a hole in the finer one.
fn flats(fine_accuracy: f64, base_accuracy: f64, hole: bool) -> World {
    let flat = |name: &str, n: usize, step: f64, west: f64, accuracy: f64, z: f32| Grid {
        name: name.into(),
        cols: n,
        rows: n,
        z: vec![z; n * n],
        affine: Affine { origin: [west, 4_001_000.0], col_step: [step, 0.0], row_step: [0.0, -step] },
        accuracy,
        precedence: None,
        date: None,
    };
    let base = flat("base", 150, 10.0, 500_000.0, base_accuracy, 100.0);
    let mut fine = flat("fine", 450, 2.0, 500_900.0, fine_accuracy, 103.0);
    fine.affine.origin[1] -= 300.0;
    if hole {
        for r in 200..260 {
            fine.z[r * 450 + 150..r * 450 + 210].fill(f32::NAN);
        }
    }
    world(&[base, fine], Policy::Accuracy)
}

#[test]
fn holes_are_filled_from_all_sides_and_own_borders_are_seams_too() {
    let steepest = |w: &World, n: &[([f64; 2], [f64; 2])], z: f64| {
        [Seams::Off, Seams::All].map(|s| *slopes(w, &Ask::Metres(z), s, n).last().unwrap())
    };
    // A hole of 124 m in the better survey, 3 m above the base: the base rises to its rim.
    let w = flats(0.5, 5.0, true);
    let rim: Vec<_> = normals(&w.surveys[1], 4000)
        .into_iter()
        .filter(|(p, _)| (501_150.0..501_350.0).contains(&p[0]) && (4_000_150.0..4_000_320.0).contains(&p[1]))
        .collect();
    let [off, all] = steepest(&w, &rim, 0.0);
    println!("hole: {} normals, slope {off:.2} without, {all:.2} with", rim.len());
    assert!(rim.len() > 150 && off > 1.0 && all < 0.3);
    // Ten metres from the rim, where a gap of 3 m is carried for 40 m.
    let beside = [501_206.0, 4_000_240.0];
    let filled = heights(&w, &Ask::Metres(0.0), Seams::All, &[beside])[0].clone().unwrap();
    println!("ten metres inside the base is raised by {:.2} m", filled.correction_m);
    assert!(filled.correction_m > 1.0 && filled.correction_m <= 3.0, "{filled:?}");
    // Equal accuracies: the larger patches are shown, and end inside the finer survey.
    let w = flats(1.0, 1.0, false);
    let own: Vec<_> = normals(&w.surveys[0], 4000)
        .into_iter()
        .filter(|(p, _)| p[0] > 501_400.0 && (3_999_850.0..4_000_650.0).contains(&p[1]))
        .collect();
    let other = normals(&w.surveys[1], 4000);
    let other: Vec<_> = other.into_iter().filter(|(p, _)| p[0] < 500_920.0).collect();
    for z in [0.0, 1.0, 1.5, 4.0] {
        let [off, all] = steepest(&w, &own, z);
        let [there, bent] = steepest(&w, &other, z);
        println!(
            "z = {z}: own border, {} normals, slope {off:.2} without, {all:.2} with; the other's {there:.2}, {bent:.2}",
            own.len()
        );
        assert!(
            own.len() > 50 && all < 0.6 * off && bent < 0.3 * there,
            "z = {z}: {off} {all} {there} {bent}"
        );
    }
}

/// Two surveys of the kit, in degrees: posts of 1/1200 degree over posts four times as far apart.
#[test]
fn seams_in_degrees_do_not_show_either() {
    let (Some(base), Some(fine)) = (shared("kit/k01_base_x4.tif"), shared("kit/k03_native_a.tif")) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db");
    let path = db.to_str().unwrap();
    printed(&["init", path, "--crs", "EPSG:4326", "--policy", "accuracy"]);
    for (file, accuracy) in [(&base, "16"), (&fine, "6")] {
        printed(&["ingest", path, file.to_str().unwrap(), "--accuracy", accuracy]);
    }
    let s = Db::open(&db).unwrap().snapshot(None).unwrap();
    let g = read(&fine, "fine", 6.0, None);
    let a = &g.affine;
    // Across the ring of the western border of the finer survey, where one gives way to the other.
    const STEPS: usize = 60;
    let mut points = Vec::new();
    for k in (10..g.rows - 10).step_by(3) {
        for t in 0..STEPS {
            let t = t as f64 / 50.0;
            points.push([a.origin[0] + t * a.col_step[0], a.origin[1] + k as f64 * a.row_step[1]]);
        }
    }
    let of = |seams: Seams| -> f64 {
        let z = s.heights(&points, &Ask::Metres(0.0).tolerance(), how(seams)).unwrap();
        let rise = |z: &[Option<Evaluation>]| {
            (1..STEPS)
                .filter_map(|k| Some((z[k].as_ref()?.z - z[k - 1].as_ref()?.z).abs()))
                .fold(0.0, f64::max)
        };
        let mut rises: Vec<f64> = z.chunks_exact(STEPS).map(rise).collect();
        rises.sort_by(f64::total_cmp);
        rises[rises.len() / 2]
    };
    let (off, all) = (of(Seams::Off), of(Seams::All));
    println!("rise within a fiftieth of a cell at the border, median: {off:.1} m without, {all:.1} m with");
    assert!(all < 0.7 * off, "{off} {all}");
}

#[test]
fn the_program_says_what_was_bent() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db");
    let db = db.to_str().unwrap();
    printed(&["init", db, "--crs", "EPSG:26910", "--policy", "newest"]);
    for k in [0, 3] {
        let (file, accuracy, date) = HELENS[k];
        let file = bundled("st_helens").join(file);
        let accuracy = accuracy.to_string();
        printed(&["ingest", db, file.to_str().unwrap(), "--accuracy", &accuracy, "--date", date]);
    }
    let ask = |more: &[&str]| -> serde_json::Value {
        let mut args = vec!["heights", db, "562346,5115929", "--error", "0", "--json"];
        args.extend(more);
        serde_json::from_str::<Vec<serde_json::Value>>(&printed(&args)).unwrap().remove(0)
    };
    let (plain, all, held) = (ask(&[]), ask(&["--seams", "all"]), ask(&["--seams", "consistent"]));
    assert_eq!((&plain["correction_m"], &plain["contradiction"]), (&0.0.into(), &false.into()));
    let number = |v: &serde_json::Value, key: &str| v[key].as_f64().unwrap();
    assert!(number(&all, "correction_m") > 5.0 && all["contradiction"] == true, "{all}");
    assert!((0.1..=2.5).contains(&number(&held, "correction_m")), "{held}");
    for bent in [&all, &held] {
        // Numbers read back from text may differ in the last bit.
        let back = number(bent, "z") - number(bent, "correction_m");
        assert!((back - number(&plain, "z")).abs() < 1e-11, "{bent} {plain}");
        assert!(number(bent, "error_m") >= number(&plain, "error_m") + number(bent, "correction_m"));
    }
    // Pictures are corrected unless said otherwise, heights for analysis are not.
    for (file, seams) in [("a.png", "all"), ("a.tif", "off")] {
        let out = folder.path().join(file);
        let told = printed(&["export", db, out.to_str().unwrap(), "--error", "5", "--step", "20", "--json"]);
        let told: serde_json::Value = serde_json::from_str(&told).unwrap();
        assert_eq!(told["seams"], seams);
        assert_eq!(number(&told, "error_m") > 6.0, seams == "all", "{told}");
    }
}
