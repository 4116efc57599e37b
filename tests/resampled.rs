//! Surveys delivered in another system than the database's (section 13): every post from the union of the tiles, by the
//! definition; tiles in any order; what was delivered comes back; what is refused.

use crate::support::{Grid, Random, Scratch, change, printed, program, refused, seeds, shared};
use std::collections::BTreeSet;
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Change, Ingest, Policy, boxes, read_tile, surveys};
use terraquilt::height::crs::{Crs, DatumChoice, Transform};
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Blend;

/// A geographic file near the middle of UTM zone 10: hills of a few cells, and holes.
fn geographic(r: &mut Random, cols: usize, rows: usize) -> Grid {
    let step = [1.0 / 3600.0, 1.0 / 10_800.0, 0.0003][r.below(3) as usize];
    let origin = [-122.0 + r.unit() * 0.5, 36.0 + r.unit()];
    let mut z = Vec::with_capacity(cols * rows);
    for j in 0..rows {
        for i in 0..cols {
            let (x, y) = (i as f64, j as f64);
            z.push(
                (800.0 + 40.0 * (x / 7.0).sin() * (y / 9.0).cos() + 5.0 * ((x + 2.0 * y) / 3.0).sin()) as f32,
            );
        }
    }
    for _ in 0..r.below(4) {
        let (a, b) = (r.below(cols as u64) as usize, r.below(rows as u64) as usize);
        for j in b..(b + 5).min(rows) {
            for i in a..(a + 6).min(cols) {
                z[j * cols + i] = f32::NAN;
            }
        }
    }
    let affine = Affine { origin, col_step: [step, 0.0], row_step: [0.0, -step] };
    Grid { name: "g".into(), cols, rows, z, affine, accuracy: 1.0, precedence: None, date: None }
}

fn arrival(g: &Grid, into: Option<&str>, step: Option<[f64; 2]>) -> Change {
    let name = into.is_none().then(|| g.name.clone());
    Change::Ingest(Ingest {
        name,
        into: into.map(String::from),
        step: step.filter(|_| into.is_none()),
        ..g.tiles_of(vec![g.source_in("EPSG:4326")])
    })
}

/// Cubic of Keys with a = -1/2, written as its piecewise polynomial in the distance.
fn keys(t: f64) -> f64 {
    let t = t.abs();
    match t {
        t if t < 1.0 => (1.5 * t - 2.5) * t * t + 1.0,
        t if t < 2.0 => ((-0.5 * t + 2.5) * t - 4.0) * t + 2.0,
        _ => 0.0,
    }
}

/// The height at a place of the file, in cells: cubic, bilinear beside a void, nothing where a corner is void.
fn expected(g: &Grid, at: [f64; 2]) -> Option<f64> {
    let post = |i: i64, j: i64| {
        let inside = (0..g.cols as i64).contains(&i) && (0..g.rows as i64).contains(&j);
        if inside { f64::from(g.z[j as usize * g.cols + i as usize]) } else { f64::NAN }
    };
    let (i, j) = (at[0].floor() as i64, at[1].floor() as i64);
    let sum = |reach: std::ops::RangeInclusive<i64>, w: &dyn Fn(f64) -> f64| {
        let mut s = 0.0;
        for b in reach.clone() {
            for a in reach.clone() {
                s += w(at[0] - (i + a) as f64) * w(at[1] - (j + b) as f64) * post(i + a, j + b);
            }
        }
        (!s.is_nan()).then_some(s)
    };
    sum(-1..=2, &keys).or_else(|| sum(0..=1, &|t: f64| 1.0 - t.abs()))
}

#[test]
fn every_post_is_what_the_definition_says() {
    let way =
        Transform::new(&Crs::from_epsg(4326).unwrap(), &Crs::from_epsg(32610).unwrap(), &DatumChoice::None)
            .unwrap();
    for seed in seeds(6) {
        let mut r = Random::new(seed);
        let (cols, rows) = (60 + r.below(120) as usize, 60 + r.below(120) as usize);
        let g = geographic(&mut r, cols, rows);
        let scratch = Scratch::new(Policy::Accuracy);
        let outcome = scratch.change(arrival(&g, None, None)).unwrap();
        let found = outcome.resampling.expect("the survey is resampled");
        assert!(found.posts > 0 && found.mean_m <= found.p99_m && found.p99_m <= found.max_m, "{found:?}");
        scratch.verify();
        let s = scratch.db.snapshot(None).unwrap();
        let row = &surveys(&s).unwrap()[0];
        assert_eq!(row.delivered.as_ref().unwrap().crs, "EPSG:4326");
        let unit = s.unit().size();
        let mut points = Vec::new();
        for j in row.first_post[1]..row.first_post[1] + row.rows {
            for i in row.first_post[0]..row.first_post[0] + row.cols {
                points
                    .push([0, 1].map(|k| {
                        (row.frame[0][k] + i * row.frame[1][k] + j * row.frame[2][k]) as f64 * unit
                    }));
            }
        }
        let answers = s.heights(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
        let (mut compared, mut worst) = (0, 0.0f64);
        for (p, a) in points.iter().zip(&answers) {
            let q = way.inverse(*p).unwrap();
            let at = [
                (q[0] - g.affine.origin[0]) / g.affine.col_step[0],
                (q[1] - g.affine.origin[1]) / g.affine.row_step[1],
            ];
            let want = expected(&g, at);
            // Where the surface promises something, the four posts around are valid.
            if let Some(a) = a.as_ref().filter(|a| a.certified) {
                let want = want.expect("no height can be certified beside a void");
                compared += 1;
                worst = worst.max((a.z - want).abs());
            }
        }
        // Places are true to 1/256 of a cell, the ground rises by at most 13 m a cell.
        println!("seed {seed}: {compared} posts, worst {worst:.5} m, {found:?}");
        assert!(compared as i64 > row.cols * row.rows / 3, "{compared} of {}", points.len());
        assert!(worst < 13.0 / 256.0, "{worst}");
    }
}

#[test]
fn tiles_come_in_any_order() {
    for seed in seeds(4) {
        let mut r = Random::new(seed);
        let g = geographic(&mut r, 140, 140);
        let (a, b) = (40 + r.below(30) as usize, 90 + r.below(20) as usize);
        let cuts = [(0, a), (a, b), (b, 140)];
        let mut tiles = Vec::new();
        for (j0, j1) in cuts {
            for (i0, i1) in cuts {
                tiles.push(g.cut(i0, j0, i1 - i0, j1 - j0));
            }
        }
        let (mut prints, mut tables) = (BTreeSet::new(), BTreeSet::new());
        for order in 0..3 {
            r.shuffle(&mut tiles);
            let scratch = Scratch::new(Policy::Accuracy);
            for (k, t) in tiles.iter().enumerate() {
                scratch.change(arrival(t, (k > 0).then_some("g"), Some([25.0, 25.0]))).unwrap();
            }
            // One goes and comes again.
            let gone = &tiles[r.below(9) as usize];
            let s = scratch.db.snapshot(None).unwrap();
            let head = s.head(s.survey("g").unwrap().number).unwrap();
            let key = head.tiles.iter().find(|t| t.affine == gone.affine).unwrap().id();
            let remove = Change::Remove { surveys: vec!["g".into()], tile: Some(key) };
            scratch.change(remove).unwrap();
            if order == 0 {
                scratch.verify();
            }
            scratch.change(arrival(gone, Some("g"), None)).unwrap();
            scratch.verify();
            prints.insert(scratch.fingerprint());
            tables.insert(rows(&scratch));
        }
        assert_eq!(prints.len(), 1, "seed {seed}");
        let whole = Scratch::new(Policy::Accuracy);
        whole.change(arrival(&g, None, Some([25.0, 25.0]))).unwrap();
        let (nine, one) = (tables.pop_first().unwrap(), rows(&whole));
        assert!(tables.is_empty(), "seed {seed}: {} states", tables.len() + 1);
        let other: Vec<_> = nine.iter().zip(&one).filter(|(a, b)| a != b).take(2).collect();
        assert!(
            nine.len() == one.len() && other.is_empty(),
            "seed {seed}: nine tiles against the whole grid: {other:#?}"
        );
    }
}

/// Every patch, as JSON.
fn rows(scratch: &Scratch) -> Vec<String> {
    let mut out = Vec::new();
    boxes(&scratch.db.snapshot(None).unwrap(), |b| {
        out.push(serde_json::to_string(&b).unwrap());
        Ok(())
    })
    .unwrap();
    out.sort();
    out
}

#[test]
fn what_was_delivered_comes_back() {
    let mut r = Random::new(5);
    let g = geographic(&mut r, 70, 50);
    let scratch = Scratch::new(Policy::Accuracy);
    scratch.change(arrival(&g, None, None)).unwrap();
    let s = scratch.db.snapshot(None).unwrap();
    let raw = read_tile(&s, s.survey("g").unwrap().number, 0).unwrap();
    let mut back = Vec::new();
    raw.bands(|_, _, samples, _| {
        back.extend_from_slice(samples);
        Ok(())
    })
    .unwrap();
    let sent: Vec<u8> = g.z.iter().flat_map(|v| v.to_le_bytes()).collect();
    assert_eq!(back, sent);
    assert_eq!((raw.declaration.delivered_crs(), raw.tile.affine), ("EPSG:4326", g.affine));
    let out = scratch.folder.path().join("back.tif");
    printed(&["export", scratch.path().to_str().unwrap(), out.to_str().unwrap(), "--survey", "g"]);
    let again = Scratch::new(Policy::Accuracy);
    let (db, file) = (again.path(), out.to_str().unwrap());
    printed(&["ingest", db.to_str().unwrap(), file, "--name", "g", "--accuracy", "1"]);
    assert_eq!(again.fingerprint(), scratch.fingerprint());
}

#[test]
fn two_tiles_of_gabon_join_without_a_gap_in_either_order() {
    let Some(folder) = shared("overlap/gabon") else { return };
    let unpacked = tempfile::tempdir().unwrap();
    let files = ["N00E010", "N00E011"].map(|n| {
        let to = unpacked.path().join(format!("{n}.hgt"));
        let zip = std::fs::read(folder.join(format!("{n}.hgt.zip"))).unwrap();
        std::fs::write(&to, only_member(&zip)).unwrap();
        to
    });
    let mut prints = BTreeSet::new();
    for order in [[0, 1], [1, 0]] {
        let dir = tempfile::tempdir().unwrap();
        let db = dir.path().join("db");
        let db = db.to_str().unwrap();
        printed(&["init", db, "--crs", "EPSG:32632"]);
        let [a, b] = order.map(|k| files[k].to_str().unwrap());
        printed(&["ingest", db, a, "--name", "gabon", "--accuracy", "16", "--step", "92.5"]);
        printed(&["ingest", db, b, "--into", "gabon"]);
        prints.insert(printed(&["fingerprint", db]));
        // Along the shared column, and beside it.
        let way = Transform::new(
            &Crs::from_epsg(4326).unwrap(),
            &Crs::from_epsg(32632).unwrap(),
            &DatumChoice::None,
        )
        .unwrap();
        let points: Vec<[f64; 2]> = (1..2000)
            .flat_map(|k| {
                [-0.002, -0.0004, 0.0, 0.0003, 0.002].map(|d| [11.0 + d, 0.005 + 0.99 * k as f64 / 2000.0])
            })
            .map(|p| way.forward(p).unwrap())
            .collect();
        let opened = terraquilt::db::Db::open(std::path::Path::new(db)).unwrap();
        let s = opened.snapshot(None).unwrap();
        for error in [0.0, 30.0] {
            let found = s.heights(&points, &Tolerance::Constant(error), Blend::Exact).unwrap();
            let missing = found.iter().filter(|e| !e.as_ref().is_some_and(|e| e.certified)).count();
            assert_eq!(missing, 0, "at tolerance {error}");
        }
    }
    assert_eq!(prints.len(), 1);
}

/// The one file in a zip, stored or deflated, by its local header.
fn only_member(zip: &[u8]) -> Vec<u8> {
    let u16_at = |k: usize| u16::from_le_bytes([zip[k], zip[k + 1]]) as usize;
    let start = 30 + u16_at(26) + u16_at(28);
    let mut out = Vec::new();
    match u16_at(8) {
        0 => {
            let n = u32::from_le_bytes(zip[18..22].try_into().unwrap()) as usize;
            out.extend_from_slice(&zip[start..start + n]);
        }
        _ => {
            std::io::Read::read_to_end(&mut flate2::read::DeflateDecoder::new(&zip[start..]), &mut out)
                .unwrap();
        }
    }
    out
}

#[test]
fn what_cannot_be_resampled_is_refused_and_leaves_nothing() {
    let mut r = Random::new(9);
    let g = geographic(&mut r, 40, 40);
    let scratch = Scratch::new(Policy::Accuracy);
    let said = |c: Change| change(&scratch.db, c).unwrap_err().to_string();
    // A quarter of the Earth from the zone, on the equator: no transverse Mercator reaches there.
    let far = Grid { affine: Affine { origin: [-33.002, 0.003], ..g.affine }, ..g.clone() };
    let text = said(arrival(&far, None, None));
    assert!(text.contains("EPSG:4326") && text.contains("EPSG:32610"), "{text}");
    // An old datum and no choice.
    let nad27 = Ingest { crs: Some(Crs::from_epsg(26710).unwrap()), ..g.ingest() };
    let text = said(Change::Ingest(nad27));
    assert!(text.contains("--datum-shift") || text.contains("datum"), "{text}");
    scratch.change(arrival(&g, None, None)).unwrap();
    // A tile in another system than its survey.
    let other = Ingest { into: Some("g".into()), ..g.tiles_of(vec![g.source_in("EPSG:4269")]) };
    let text = said(Change::Ingest(other));
    assert!(text.contains("EPSG:4269") && text.contains("EPSG:4326"), "{text}");
    // Two vertical datums.
    let of = |name: &str, datum: &str| {
        Change::Ingest(Ingest {
            vertical_datum: Some(datum.into()),
            name: Some(name.into()),
            ..g.tiles_of(vec![g.source_in("EPSG:4326")])
        })
    };
    scratch.change(of("navd", "EPSG:5703")).unwrap();
    let text = said(of("egm", "EPSG:3855"));
    assert!(text.contains("EPSG:5703") && text.contains("EPSG:3855"), "{text}");
    assert_eq!(scratch.db.snapshot(None).unwrap().number(), 2);
    scratch.verify();
}

#[test]
fn the_program_says_what_resampling_did() {
    let Some(kit) = shared("kit") else { return };
    let dir = tempfile::tempdir().unwrap();
    let db = dir.path().join("db");
    let db = db.to_str().unwrap();
    printed(&["init", db, "--crs", "EPSG:32611"]);
    let file = kit.join("k03_native_a.tif");
    let out = program(&["ingest", db, file.to_str().unwrap(), "--accuracy", "6", "--json"]);
    let found: serde_json::Value = serde_json::from_slice(&out.stdout).unwrap();
    assert!(found["resampling"]["p99_m"].as_f64().unwrap() > 0.0, "{found}");
    // Stated accuracy and the change by resampling are two things.
    let rows: serde_json::Value = serde_json::from_str(&printed(&["surveys", db, "--json"])).unwrap();
    assert_eq!(rows[0]["accuracy_m"], 6.0);
    let text =
        refused(&["ingest", db, file.to_str().unwrap(), "--name", "x", "--accuracy", "6", "--step", "0"], 1);
    assert!(text.contains("--step"), "{text}");
}

#[test]
fn a_database_in_a_system_without_an_epsg_code_gives_files_that_say_so() {
    let dir = tempfile::tempdir().unwrap();
    let path = |n: &str| dir.path().join(n).to_str().unwrap().to_string();
    let (db, out) = (path("db"), path("out.tif"));
    printed(&["init", &db, "--crs", "ESRI:102003"]);
    let file = crate::support::bundled("st_helens").join("survey_2004-10-04_native.tif");
    let file = file.to_str().unwrap();
    printed(&["ingest", &db, file, "--name", "dome", "--accuracy", "0.5"]);
    printed(&["export", &db, &out, "--error", "0"]);
    let read = terraquilt::format::open(std::path::Path::new(&out)).unwrap();
    assert_eq!(read.info().crs.as_ref().unwrap().code, "ESRI:102003");
    // And the surface goes into another database as it stands.
    let other = path("other");
    printed(&["init", &other, "--crs", "ESRI:102003"]);
    printed(&["ingest", &other, &out, "--accuracy", "0.5"]);
    let rows: serde_json::Value = serde_json::from_str(&printed(&["surveys", &other, "--json"])).unwrap();
    assert!(rows[0]["delivered"].is_null(), "{rows}");
}

#[test]
fn the_first_survey_chooses_the_system() {
    let dir = tempfile::tempdir().unwrap();
    let path = |n: &str| dir.path().join(n).to_str().unwrap().to_string();
    let file = crate::support::bundled("st_helens").join("survey_2004-10-04_native.tif");
    let file = file.to_str().unwrap();
    let crs = |db: &str| {
        let rows: serde_json::Value = serde_json::from_str(&printed(&["surveys", db, "--json"])).unwrap();
        (rows[0]["crs"].as_str().unwrap().to_string(), rows[0]["delivered"]["crs"].clone())
    };
    // Its own, if that is projected.
    let db = path("a");
    printed(&["init", &db, "--policy", "newest", "--patch", "bicubic"]);
    let text = refused(&["surveys", &db], 1);
    assert!(text.contains("first survey"), "{text}");
    let out = program(&["ingest", &db, file, "--accuracy", "0.5", "--date", "2004-10-04", "--dry-run"]);
    assert!(out.status.success() && String::from_utf8_lossy(&out.stderr).contains("EPSG:26910"));
    printed(&["ingest", &db, file, "--accuracy", "0.5", "--date", "2004-10-04"]);
    assert_eq!(crs(&db).0, "EPSG:26910");
    let info: serde_json::Value = serde_json::from_str(&printed(&["info", &db, "--json"])).unwrap();
    assert_eq!(info["policy"], "newest", "{info}");
    // The UTM zone, if it is in degrees.
    let mut r = Random::new(3);
    let g = geographic(&mut r, 60, 60);
    let degrees = Scratch::new(Policy::Accuracy);
    degrees.change(arrival(&g, None, None)).unwrap();
    let tif = path("degrees.tif");
    printed(&["export", degrees.path().to_str().unwrap(), &tif, "--survey", "g"]);
    let db = path("b");
    printed(&["init", &db]);
    printed(&["ingest", &db, &tif, "--accuracy", "1"]);
    assert_eq!(crs(&db), ("EPSG:32610".to_string(), "EPSG:4326".into()));
    // Nothing, if it is wider than that.
    let wide = Grid {
        affine: Affine { origin: [-170.0, 60.0], col_step: [5.0, 0.0], row_step: [0.0, -1.0] },
        ..g.clone()
    };
    let world = Scratch::new(Policy::Accuracy);
    let waiting = terraquilt::db::Awaiting::create(
        &world.folder.path().join("waiting"),
        Policy::Accuracy,
        terraquilt::height::patch::Kind::Bilinear,
    )
    .unwrap();
    let text = waiting.choose(&[wide.source_in("EPSG:4326").info()], None).unwrap_err().to_string();
    assert!(text.contains("degrees wide") && text.contains("--crs"), "{text}");
}
