//! Must show 1: any order of arrival, removal and return gives one fingerprint, computed from the bytes on disk by a new
//! process; a grid whole equals the grid in tiles.

use crate::derivation::{judge_surveys, stored_surveys};
use crate::support::{Random, bundled, printed, seeds, shared};
use std::collections::BTreeSet;
use std::path::PathBuf;
use terraquilt::db::{Db, fingerprint};

/// A survey as the command line brings it.
#[derive(Clone)]
struct Said {
    file: PathBuf,
    name: String,
    accuracy: String,
    date: String,
}

fn said(file: PathBuf, name: &str, accuracy: &str, date: &str) -> Said {
    Said { file, name: name.into(), accuracy: accuracy.into(), date: date.into() }
}

/// Brings surveys into new databases in random orders, takes some out and brings them again; returns the fingerprint
/// that all of them have.
fn one_fingerprint(crs: &str, [policy, patch]: [&str; 2], surveys: &[Said], orders: u64) -> String {
    let mut first: Option<String> = None;
    for seed in seeds(orders) {
        let mut r = Random::new(seed);
        let folder = tempfile::tempdir().unwrap();
        let db = folder.path().join("db");
        let db = db.to_str().unwrap();
        printed(&["init", db, "--crs", crs, "--policy", policy, "--patch", patch]);
        let bring = |s: &Said| {
            let file = s.file.to_str().unwrap();
            printed(&["ingest", db, file, "--name", &s.name, "--accuracy", &s.accuracy, "--date", &s.date]);
        };
        let mut order: Vec<&Said> = surveys.iter().collect();
        r.shuffle(&mut order);
        for (k, s) in order.iter().enumerate() {
            bring(s);
            if r.chance(0.4) {
                let back = order[r.below(k as u64 + 1) as usize];
                printed(&["remove", db, &back.name]);
                bring(back);
            }
        }
        let found = printed(&["fingerprint", db]);
        match &first {
            None => first = Some(found),
            Some(f) => assert_eq!(*f, found, "seed {seed}, {policy}, {patch}"),
        }
    }
    let f = first.expect("there was at least one order");
    println!("{crs} {policy} {patch}: {} surveys, {orders} orders, {f}", surveys.len());
    f
}

#[test]
fn st_helens_in_twenty_orders_has_one_fingerprint() {
    let f = |n: &str| bundled("st_helens").join(n);
    let surveys = [
        said(f("survey_2000-09-25_native.tif"), "a", "2", "2000-09-25"),
        said(f("survey_2004-10-04_native.tif"), "b", "0.5", "2004-10-04"),
        said(f("survey_2004-10-11_native.tif"), "c", "0.5", "2004-10-11"),
        said(f("survey_2004-10-13_native.tif"), "d", "0.5", "2004-10-13"),
        said(f("crater_2005-06-15_10m.tif"), "e", "2", "2005-06-15"),
    ];
    let newest = one_fingerprint("EPSG:26910", ["newest", "bilinear"], &surveys, 20);
    let accuracy = one_fingerprint("EPSG:26910", ["accuracy", "bilinear"], &surveys, 20);
    assert_ne!(newest, accuracy, "the policy is part of the content");
}

/// The eleven grids of the kit, in four systems, as its manifest describes them.
fn kit() -> Option<Vec<Said>> {
    let folder = shared("kit")?;
    let manifest = std::fs::read_to_string(folder.join("kit.json")).unwrap();
    let manifest: serde_json::Value = serde_json::from_str(&manifest).unwrap();
    let surveys: Vec<Said> = manifest["surveys"]
        .as_array()
        .unwrap()
        .iter()
        .map(|s| {
            let file = s["file"].as_str().unwrap();
            let accuracy = s["vertical_accuracy_m"].to_string();
            said(folder.join(file), file.trim_end_matches(".tif"), &accuracy, s["date"].as_str().unwrap())
        })
        .collect();
    assert_eq!(surveys.len(), 11);
    Some(surveys)
}

const MANNERS: [[&str; 2]; 4] =
    [["newest", "bilinear"], ["accuracy", "bilinear"], ["newest", "bicubic"], ["accuracy", "bicubic"]];

#[test]
fn the_kit_in_two_orders_has_one_fingerprint() {
    let Some(surveys) = kit() else { return };
    let prints = MANNERS.map(|m| one_fingerprint("EPSG:32611", m, &surveys, 2));
    assert_eq!(BTreeSet::from(prints).len(), 4, "policy and patches are part of the content");
}

/// `cargo test --release --test main the_kit_in_twenty_orders -- --ignored --nocapture`
#[test]
#[ignore = "minutes; the command is in its comment"]
fn the_kit_in_twenty_orders_has_one_fingerprint() {
    let Some(surveys) = kit() else { return };
    for m in MANNERS {
        one_fingerprint("EPSG:32611", m, &surveys, 20);
    }
}

/// Must-shows of the core on the whole kit: the oracle node by node, verify, certified errors and no gap, for both policies
/// and both kinds of patches. `cargo test --release --test main the_whole_kit_equals -- --ignored --nocapture`
#[test]
#[ignore = "minutes; the command is in its comment"]
fn the_whole_kit_equals_the_oracle_and_keeps_its_errors() {
    let Some(surveys) = kit() else { return };
    for [policy, patch] in MANNERS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("db");
        let db = path.to_str().unwrap();
        printed(&["init", db, "--crs", "EPSG:32611", "--policy", policy, "--patch", patch]);
        for s in &surveys {
            let file = s.file.to_str().unwrap();
            printed(&["ingest", db, file, "--name", &s.name, "--accuracy", &s.accuracy, "--date", &s.date]);
        }
        printed(&["verify", db]);
        let db = Db::open(&path).unwrap();
        let posts = stored_surveys(&db.snapshot(None).unwrap());
        let counts = judge_surveys(&db, &posts);
        println!("{policy} {patch}: {counts:?}");
        crate::certified::whole_kit(db.snapshot(None).unwrap(), posts);
        // A survey goes, the rest is as if it had never come, and comes again.
        let print = || fingerprint(&db.snapshot(None).unwrap()).unwrap();
        let (before, name) = (print(), &surveys[5].name);
        printed(&["remove", path.to_str().unwrap(), name]);
        assert_ne!(print(), before);
        let (s, at) = (&surveys[5], path.to_str().unwrap());
        let file = s.file.to_str().unwrap();
        printed(&["ingest", at, file, "--name", &s.name, "--accuracy", &s.accuracy, "--date", &s.date]);
        assert_eq!(print(), before);
    }
}
