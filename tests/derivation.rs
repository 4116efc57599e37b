//! The database against the independent oracle and against fresh builds.

use crate::oracle::{self, OracleSurvey, PatchBox};
use crate::support::{Grid, Random, Scratch, bundled, printed, random_grid, seeds};
use std::collections::BTreeMap;
use terraquilt::db::{Change, Db, Policy, Snapshot, TreeNode, boxes, own_posts, surveys};
use terraquilt::height::patch::Kind;
use terraquilt::height::source::Window;

/// What the oracle needs to know of a survey: its frame as printed, its samples as delivered.
fn oracle_survey(row: &serde_json::Value, grid: &Grid) -> OracleSurvey {
    let pair = |v: &serde_json::Value| [v[0].as_i64().unwrap(), v[1].as_i64().unwrap()];
    let f = &row["frame"];
    OracleSurvey {
        id: row["id"].as_str().unwrap().to_string(),
        anchor: pair(&f[0]),
        u: pair(&f[1]),
        v: pair(&f[2]),
        first: pair(&row["first_post"]),
        cols: grid.cols,
        rows: grid.rows,
        heights: grid.z.iter().map(|z| z.is_finite().then_some(f64::from(*z))).collect(),
        nominal_step: [row["step"][0].as_f64().unwrap(), row["step"][1].as_f64().unwrap()],
        accuracy: grid.accuracy,
        precedence: row["precedence"].as_i64().unwrap(),
    }
}

/// Compares the database with the oracle, tree included.
pub fn judge(s: &Scratch, present: &BTreeMap<String, Grid>) -> oracle::check::Counts {
    let snapshot = s.db.snapshot(None).unwrap();
    let rows = serde_json::to_value(surveys(&snapshot).unwrap()).unwrap();
    let worlds: Vec<OracleSurvey> = rows
        .as_array()
        .unwrap()
        .iter()
        .map(|r| oracle_survey(r, &present[r["name"].as_str().unwrap()]))
        .collect();
    judge_surveys(&s.db, &worlds)
}

/// The surveys of a database as the oracle takes them, by the posts that they have there: also of resampled ones.
pub fn stored_surveys(snapshot: &Snapshot) -> Vec<OracleSurvey> {
    let rows = surveys(snapshot).unwrap();
    rows.iter()
        .zip(snapshot.entries())
        .map(|(r, e)| {
            let posts = own_posts(snapshot, e.number).unwrap();
            OracleSurvey {
                id: r.id.clone(),
                anchor: r.frame[0],
                u: r.frame[1],
                v: r.frame[2],
                first: posts.first,
                cols: posts.cols,
                rows: posts.rows,
                heights: posts.z.iter().map(|z| z.is_finite().then_some(*z)).collect(),
                nominal_step: r.step,
                accuracy: r.accuracy_m,
                precedence: r.precedence,
            }
        })
        .collect()
}

/// The same for surveys of any kind.
pub fn judge_surveys(db: &Db, worlds: &[OracleSurvey]) -> oracle::check::Counts {
    let snapshot = db.snapshot(None).unwrap();
    let mut text = String::new();
    boxes(&snapshot, |b| {
        text.push_str(&serde_json::to_string(&b).unwrap());
        text.push('\n');
        Ok(())
    })
    .unwrap();
    let found: Vec<PatchBox> = oracle::parse_boxes(&text).unwrap();
    let report = match db.kind() {
        Kind::Bilinear => oracle::check(worlds, &found),
        Kind::Bicubic => oracle::check_splines(worlds, &found),
    };
    assert!(report.problems.is_empty(), "{:#?}", report.problems);
    let expected = oracle::expected_tree(&found, ([-(1 << 60); 2], [1 << 60; 2]), 64, 32);
    let stored = terraquilt::db::tree(&snapshot).unwrap().expect("a version has a tree");
    same_tree(&expected, &stored);
    report.counts
}

/// The stored tree node by node against the one that the oracle builds from the definition.
fn same_tree(expected: &oracle::Node, stored: &TreeNode) {
    assert_eq!(expected.ids, stored.ids);
    for (e, s) in expected.children.iter().zip(&stored.children) {
        assert_eq!(e.is_some(), s.is_some(), "a child is there in one tree only");
        if let (Some(e), Some(s)) = (e, s) {
            same_tree(e, s);
        }
    }
}

#[test]
fn tops_floors_kernels_and_errors_equal_the_oracle_over_random_histories() {
    let mut total = (0, 0);
    let mut seen = [0usize; 6];
    for seed in seeds(12) {
        println!("seed {seed}");
        let mut r = Random::new(seed);
        let s = Scratch::new(Policy::Accuracy);
        let pool: Vec<Grid> =
            (0..2 + r.below(3)).map(|k| random_grid(&mut r, &format!("s{k}"), 100)).collect();
        let mut present: BTreeMap<String, Grid> = BTreeMap::new();
        for step in 0..6 {
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
            if step >= 2 {
                let c = judge(&s, &present);
                for (n, k) in seen.iter_mut().zip([
                    c.patches,
                    c.dormant,
                    c.empty,
                    c.floors,
                    c.finite_tops,
                    c.replaced_cells,
                ]) {
                    *n += k;
                }
                total.0 += 1;
            }
            s.verify();
            // The same set, brought in another order into a new database.
            let fresh = Scratch::new(Policy::Accuracy);
            let mut order: Vec<&Grid> = present.values().collect();
            r.shuffle(&mut order);
            for g in order {
                fresh.ingest(g);
            }
            assert_eq!(s.fingerprint(), fresh.fingerprint(), "seed {seed}, step {step}");
            total.1 += 1;
        }
    }
    println!("patches, dormant, emptied, floors, finite tops, replaced cells: {seen:?}");
    println!("{} states equal the oracle, {} equal a fresh build", total.0, total.1);
}

#[test]
fn precedence_changed_later_equals_precedence_given_at_once() {
    for seed in seeds(6) {
        println!("seed {seed}");
        let mut r = Random::new(seed + 1000);
        let s = Scratch::new(Policy::Accuracy);
        let mut grids: Vec<Grid> = (0..3).map(|k| random_grid(&mut r, &format!("s{k}"), 90)).collect();
        grids.iter().for_each(|g| {
            s.ingest(g);
        });
        for _ in 0..3 {
            let k = r.below(3) as usize;
            grids[k].precedence = Some(r.below(5) as i64);
            let survey = grids[k].name.clone();
            s.change(Change::Set { survey, date: None, precedence: grids[k].precedence }).unwrap();
            let fresh = Scratch::new(Policy::Accuracy);
            grids.iter().rev().for_each(|g| {
                fresh.ingest(g);
            });
            assert_eq!(s.fingerprint(), fresh.fingerprint(), "seed {seed}");
            s.verify();
        }
        judge(&s, &grids.iter().map(|g| (g.name.clone(), g.clone())).collect());
    }
}

#[test]
fn tiles_in_and_out_equal_the_whole() {
    for seed in seeds(6) {
        println!("seed {seed}");
        let mut r = Random::new(seed + 2000);
        let other = random_grid(&mut r, "other", 90);
        let mut g = random_grid(&mut r, "tiled", 110);
        g.cols = g.cols.max(60);
        g.rows = g.rows.max(60);
        g.z = (0..g.cols * g.rows)
            .map(|k| if r.chance(0.003) { f32::NAN } else { ((k * 7) % 113) as f32 })
            .collect();
        let whole = Scratch::new(Policy::Accuracy);
        whole.ingest(&other);
        whole.ingest(&g);
        // 3 x 3 abutting tiles, in random order, in one survey; some leave and come back.
        let (xs, ys) = ([0, g.cols / 3, 2 * g.cols / 3, g.cols], [0, g.rows / 3, 2 * g.rows / 3, g.rows]);
        let mut tiles: Vec<Grid> = Vec::new();
        for b in 0..3 {
            for a in 0..3 {
                tiles.push(g.cut(xs[a], ys[b], xs[a + 1] - xs[a], ys[b + 1] - ys[b]));
            }
        }
        r.shuffle(&mut tiles);
        let s = Scratch::new(Policy::Accuracy);
        s.ingest(&tiles[0]);
        s.ingest(&other);
        for t in &tiles[1..] {
            let mut i = t.tiles_of(vec![t.source()]);
            i.into = Some("tiled".into());
            s.change(Change::Ingest(i)).unwrap();
        }
        assert_eq!(content_but_tiles(&s), content_but_tiles(&whole), "seed {seed}");
        s.verify();
        judge(&s, &[("tiled".to_string(), g.clone()), ("other".to_string(), other.clone())].into());
        // A tile leaves: equal to a fresh survey of the other eight.
        let gone = &tiles[4];
        let name = gone.source().info().file.clone();
        s.change(Change::Remove { surveys: vec!["tiled".into()], tile: Some(name) }).unwrap();
        let eight = Scratch::new(Policy::Accuracy);
        eight.ingest(&other);
        let rest: Vec<_> = tiles.iter().filter(|t| t.affine != gone.affine).map(Grid::source).collect();
        let mut i = g.tiles_of(rest);
        i.name = Some("tiled".into());
        eight.change(Change::Ingest(i)).unwrap();
        assert_eq!(s.fingerprint(), eight.fingerprint(), "seed {seed}: eight tiles");
        s.verify();
        // And returns, by `replace` with wrong heights first, then right ones.
        let mut wrong = gone.clone();
        wrong.z.iter_mut().for_each(|z| *z += 3.0);
        for t in [&wrong, gone] {
            let mut i = t.tiles_of(vec![t.source()]);
            i.into = Some("tiled".into());
            let survey = "tiled".to_string();
            s.change(Change::Replace { survey, ingest: i }).unwrap();
        }
        assert_eq!(content_but_tiles(&s), content_but_tiles(&whole), "seed {seed}: corrected");
    }
}

/// Every box and the shape of the tree: what a fingerprint holds besides the keys of tiles.
fn content_but_tiles(s: &Scratch) -> Vec<String> {
    let snapshot = s.db.snapshot(None).unwrap();
    let mut lines = Vec::new();
    boxes(&snapshot, |b| {
        lines.push(serde_json::to_string(&b).unwrap());
        Ok(())
    })
    .unwrap();
    lines.sort();
    let i = terraquilt::db::info(&s.db, &snapshot).unwrap();
    lines.push(format!("tree {} {} {}", i.tree_nodes, i.tree_records, i.tree_depth));
    lines
}

#[test]
fn the_real_crater_whole_equals_it_in_nine_tiles() {
    let mut source = terraquilt::format::open(&bundled("st_helens/survey_2000-09-25_native.tif")).unwrap();
    let info = source.info().clone();
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    let samples = source.read(Window { col: 0, row: 0, cols, rows }).unwrap();
    let z: Vec<f32> =
        samples.data.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let z: Vec<f32> =
        z.iter().zip(&samples.valid).map(|(z, v)| if *v == 1 { *z } else { f32::NAN }).collect();
    let affine = info.affine.unwrap();
    let g =
        Grid { name: "crater".into(), cols, rows, z, affine, accuracy: 2.0, precedence: None, date: None };
    let whole = Scratch::new(Policy::Accuracy);
    whole.ingest(&g);
    for seed in seeds(3) {
        let mut r = Random::new(seed);
        let mut tiles: Vec<Grid> = (0..9)
            .map(|k| g.cut(101 * (k % 3), 147 * (k / 3), 101, if k / 3 == 2 { 148 } else { 147 }))
            .collect();
        r.shuffle(&mut tiles);
        let s = Scratch::new(Policy::Accuracy);
        s.ingest(&tiles[0]);
        for t in &tiles[1..] {
            let mut i = t.tiles_of(vec![t.source()]);
            i.into = Some("crater".into());
            s.change(Change::Ingest(i)).unwrap();
        }
        assert_eq!(content_but_tiles(&s), content_but_tiles(&whole), "seed {seed}");
    }
}

#[test]
fn the_program_prints_boxes_that_the_oracle_reads() {
    let mut r = Random::new(77);
    let s = Scratch::new(Policy::Accuracy);
    let g = random_grid(&mut r, "one", 60);
    s.ingest(&g);
    let text = printed(&["boxes", s.path().to_str().unwrap()]);
    assert!(!oracle::parse_boxes(&text).unwrap().is_empty());
}
