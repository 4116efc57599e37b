//! Surveys where systems end: the antimeridian, the poles, beyond a zone; and what makes one survey of several files.

use crate::support::{Grid, Random, change, program};
use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use terraquilt::base::Result;
use terraquilt::db::{
    Awaiting, Change, Db, Ingest, Options, Outcome, Policy, Progress, fingerprint, surveys,
};
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::Affine;

struct Room {
    db: Db,
    folder: tempfile::TempDir,
}

fn room(crs: &str) -> Room {
    let folder = tempfile::tempdir().unwrap();
    let options = Options { crs: Crs::parse(crs).unwrap(), policy: Policy::Accuracy, patch: Kind::Bilinear };
    let db = Db::create(&folder.path().join("db"), &options).unwrap();
    Room { db, folder }
}

impl Room {
    fn bring(&self, files: &[(&Grid, &str)], step: Option<f64>, into: Option<&str>) -> Result<Outcome> {
        let sources = files.iter().map(|(g, crs)| g.source_in(crs)).collect();
        let ingest = Ingest {
            name: into.is_none().then(|| "g".to_string()),
            into: into.map(String::from),
            step: step.filter(|_| into.is_none()).map(|s| [s, s]),
            ..files[0].0.tiles_of(sources)
        };
        change(&self.db, Change::Ingest(ingest))
    }

    fn sound(&self) -> String {
        let stop = AtomicBool::new(false);
        let s = self.db.snapshot(None).unwrap();
        let r = terraquilt::db::verify(&self.db, &s, &Progress { report: &|_, _| (), stop: &stop }).unwrap();
        assert!(r.ok, "{:#?}", r.problems);
        fingerprint(&s).unwrap()
    }
}

/// Rough ground; the same for every grid of one seed.
fn rough(origin: [f64; 2], step: [f64; 2], cols: usize, rows: usize) -> Grid {
    let z = (0..cols * rows).map(|k| ((k * 7919 + k / cols * 31) % 97) as f32).collect();
    let affine = Affine { origin, col_step: [step[0], 0.0], row_step: [0.0, -step[1]] };
    Grid { name: "g".into(), cols, rows, z, affine, accuracy: 1.0, precedence: None, date: None }
}

/// Brings two files in both orders and both at once: one state each time, and it is sound.
fn one_state(db: &str, files: [(&Grid, &str); 2], step: f64) -> Room {
    let mut prints = BTreeSet::new();
    let mut last = None;
    for order in [vec![vec![0], vec![1]], vec![vec![1], vec![0]], vec![vec![0, 1]]] {
        let room = room(db);
        for (k, call) in order.iter().enumerate() {
            let some: Vec<(&Grid, &str)> = call.iter().map(|n| files[*n]).collect();
            room.bring(&some, Some(step), (k > 0).then_some("g")).unwrap();
        }
        prints.insert(room.sound());
        last = Some(room);
    }
    assert_eq!(prints.len(), 1, "{db}");
    last.expect("there was an order")
}

#[test]
fn a_projected_survey_across_the_antimeridian_is_one_piece_in_degrees() {
    // UTM zone 60 ends at 180 E; these lie on both sides, at 5 S.
    let a = rough([820_000.0, 9_440_000.0], [100.0, 100.0], 60, 60);
    let b = rough([826_000.0, 9_440_000.0], [100.0, 100.0], 120, 60);
    let room = one_state("EPSG:4326", [(&a, "EPSG:32760"), (&b, "EPSG:32760")], 0.001);
    let s = room.db.snapshot(None).unwrap();
    let row = &surveys(&s).unwrap()[0];
    let width = row.bounds[2] - row.bounds[0];
    assert!(row.bounds[0] < 180.0 && row.bounds[2] > 180.0 && width < 0.3, "{:?}", row.bounds);
}

#[test]
fn tiles_on_both_sides_of_a_multiple_of_45_degrees_make_one_survey_in_any_order() {
    let a = rough([44.98, 10.0], [0.0005, 0.0005], 40, 40);
    let b = rough([45.0, 10.0], [0.0005, 0.0005], 40, 40);
    one_state("EPSG:32638", [(&a, "EPSG:4326"), (&b, "EPSG:4326")], 50.0);
}

#[test]
fn tiles_far_apart_are_judged_one_by_one() {
    let room = room("EPSG:32610");
    for (k, origin) in [[-123.0, 5.0], [-63.0, 75.0], [-43.0, 82.0]].into_iter().enumerate() {
        let g = rough(origin, [0.0125, 0.0125], 8, 8);
        room.bring(&[(&g, "EPSG:4326")], Some(1000.0), (k > 0).then_some("g")).unwrap();
    }
    room.sound();
}

#[test]
fn the_rows_of_a_pole_are_places() {
    // A full ring down from the pole, in degrees, into the polar system that it asks for.
    let ring = rough([-180.0, 90.0], [0.5, 0.25], 720, 60);
    let waiting = tempfile::tempdir().unwrap();
    let awaiting = Awaiting::create(&waiting.path().join("db"), Policy::Accuracy, Kind::Bilinear).unwrap();
    let crs = awaiting.choose(&[ring.source_in("EPSG:4326").info()], None).unwrap();
    assert_eq!(crs.code, "EPSG:32661");
    let room = room(&crs.code);
    room.bring(&[(&ring, "EPSG:4326")], Some(25_000.0), None).unwrap();
    room.sound();
}

#[test]
fn nad83_degrees_in_a_wgs84_database_are_not_resampled() {
    let room = room("EPSG:4326");
    let g = rough([-107.0, 39.0], [1.0 / 10_800.0, 1.0 / 10_800.0], 50, 40);
    let told = room.bring(&[(&g, "EPSG:4269")], None, None).unwrap();
    assert!(told.resampling.is_none(), "{told:?}");
    assert!(told.warnings.iter().any(|w| w.contains("nothing is resampled")), "{:?}", told.warnings);
    // Nor are its further tiles strangers.
    let beside = rough([-107.0 + 50.0 / 10_800.0, 39.0], [1.0 / 10_800.0, 1.0 / 10_800.0], 50, 40);
    room.bring(&[(&beside, "EPSG:4269")], None, Some("g")).unwrap();
    room.sound();
}

#[test]
fn one_survey_has_one_vertical_datum() {
    let g = rough([500_000.0, 4_000_000.0], [10.0, 10.0], 30, 30);
    let said = |datum: Option<&str>, name: Option<&str>, into: Option<&str>| {
        let beside = Grid { affine: Affine { origin: [500_300.0, 4_000_000.0], ..g.affine }, ..g.clone() };
        let file = if into.is_some() { &beside } else { &g };
        Change::Ingest(Ingest {
            vertical_datum: datum.map(String::from),
            name: name.map(String::from),
            into: into.map(String::from),
            ..file.tiles_of(vec![file.source_in("EPSG:32610")])
        })
    };
    let room = room("EPSG:32610");
    change(&room.db, said(None, Some("unsaid"), None)).unwrap();
    let text = change(&room.db, said(Some("EPSG:5703"), None, Some("unsaid"))).unwrap_err().to_string();
    assert!(text.contains("EPSG:5703") && text.contains("nobody stated"), "{text}");
    change(&room.db, said(Some("EPSG:5703"), Some("said"), None)).unwrap();
    let text = change(&room.db, said(Some("EPSG:5773"), None, Some("said"))).unwrap_err().to_string();
    assert!(text.contains("EPSG:5703") && text.contains("EPSG:5773"), "{text}");
    change(&room.db, said(None, None, Some("said"))).unwrap();
}

#[test]
fn heights_that_are_none_are_refused() {
    let mut g = rough([500_000.0, 4_000_000.0], [10.0, 10.0], 30, 30);
    g.z[77] = 3.3e38;
    let room = room("EPSG:32610");
    for crs in ["EPSG:32610", "EPSG:32611"] {
        let text = room.bring(&[(&g, crs)], None, None).unwrap_err().to_string();
        assert!(text.contains("--nodata") && text.contains("1000000 m"), "{text}");
    }
}

#[test]
fn a_first_survey_that_does_not_come_chooses_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let db = dir.path().join("db");
    let db = db.to_str().unwrap();
    assert!(program(&["init", db]).status.success());
    let file = crate::support::bundled("st_helens").join("survey_2004-10-04_native.tif");
    let out = program(&["ingest", db, file.to_str().unwrap()]);
    assert_eq!(out.status.code(), Some(1), "the accuracy is missing");
    assert!(Awaiting::read(std::path::Path::new(db)).unwrap().is_some());
    assert!(program(&["ingest", db, file.to_str().unwrap(), "--accuracy", "1"]).status.success());
}

#[test]
fn random_places_come_back_from_every_common_system() {
    // Resampled and looked at again: the middle of a survey is where it was.
    let mut r = Random::new(11);
    for (db, file, origin, step) in [
        ("EPSG:32633", "EPSG:3035", [4_600_000.0, 2_900_000.0], 25.0),
        ("EPSG:3857", "EPSG:25832", [500_000.0, 5_600_000.0], 10.0),
        ("EPSG:5070", "EPSG:2229", [6_500_000.0, 1_850_000.0], 30.0),
        ("EPSG:4326", "EPSG:32719", [500_000.0, 7_500_000.0], 30.0),
        ("EPSG:3031", "EPSG:4326", [78.0, -68.5], 0.001),
    ] {
        let mut g = rough(origin, [step, step], 40, 40);
        let plane = [r.unit(), r.unit()];
        for (k, z) in g.z.iter_mut().enumerate() {
            *z = (100.0 + plane[0] * (k % 40) as f64 + plane[1] * (k / 40) as f64) as f32;
        }
        let room = room(db);
        let told = room.bring(&[(&g, file)], None, None).unwrap();
        let found = told.resampling.expect("another system");
        assert!(found.posts > 1000 && found.max_m < 0.01, "{db} from {file}: {found:?}");
        room.sound();
        drop(room.folder);
    }
}
