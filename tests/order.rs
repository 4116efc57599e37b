//! Must show 1: any order of arrival, removal and return gives one fingerprint, computed from the bytes on disk by a new
//! process; a grid whole equals the grid in tiles.

use crate::support::{Random, bundled, printed, seeds, shared};
use std::path::PathBuf;

/// A survey as the command line brings it.
#[derive(Clone)]
struct Said {
    file: PathBuf,
    name: &'static str,
    accuracy: &'static str,
    date: &'static str,
}

fn said(file: PathBuf, name: &'static str, accuracy: &'static str, date: &'static str) -> Said {
    Said { file, name, accuracy, date }
}

/// Brings surveys into new databases in random orders, takes some out and brings them again; returns the fingerprint
/// that all of them have.
fn one_fingerprint(crs: &str, policy: &str, surveys: &[Said], orders: u64) -> String {
    let mut first: Option<String> = None;
    for seed in seeds(orders) {
        let mut r = Random::new(seed);
        let folder = tempfile::tempdir().unwrap();
        let db = folder.path().join("db");
        let db = db.to_str().unwrap();
        printed(&["init", db, "--crs", crs, "--policy", policy]);
        let bring = |s: &Said| {
            let file = s.file.to_str().unwrap();
            printed(&["ingest", db, file, "--name", s.name, "--accuracy", s.accuracy, "--date", s.date]);
        };
        let mut order: Vec<&Said> = surveys.iter().collect();
        r.shuffle(&mut order);
        for (k, s) in order.iter().enumerate() {
            bring(s);
            if r.chance(0.4) {
                let back = order[r.below(k as u64 + 1) as usize];
                printed(&["remove", db, back.name]);
                bring(back);
            }
        }
        let found = printed(&["fingerprint", db]);
        match &first {
            None => first = Some(found),
            Some(f) => assert_eq!(*f, found, "seed {seed}, {policy}"),
        }
    }
    let f = first.expect("there was at least one order");
    println!("{crs} {policy}: {orders} orders, {f}");
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
    let newest = one_fingerprint("EPSG:26910", "newest", &surveys, 20);
    let accuracy = one_fingerprint("EPSG:26910", "accuracy", &surveys, 20);
    assert_ne!(newest, accuracy, "the policy is part of the content");
}

#[test]
fn the_utm_grids_of_the_kit_in_twenty_orders_have_one_fingerprint() {
    let Some(kit) = shared("kit") else { return };
    let surveys = [
        said(kit.join("k05_rot17_utm11.tif"), "k05", "5", "2008-08-01"),
        said(kit.join("k06_utm11_holes.tif"), "k06", "5", "2010-09-01"),
        said(kit.join("k09_flight_strip.tif"), "k09", "2", "2016-06-15"),
    ];
    one_fingerprint("EPSG:32611", "newest", &surveys, 20);
    one_fingerprint("EPSG:32611", "accuracy", &surveys, 20);
}
