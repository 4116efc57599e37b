//! Must show 6: policy `newest`, 20 m error. The dome of the latest survey stands, the floor of 2000 is gone beneath it;
//! after `remove` of the latest the fingerprint is that of a database which never saw it.

use crate::support::{bundled, printed};
use serde_json::Value;

const SURVEYS: [(&str, &str, &str, &str); 4] = [
    ("survey_2000-09-25_native.tif", "crater", "2", "2000-09-25"),
    ("survey_2004-10-04_native.tif", "dome-1", "0.5", "2004-10-04"),
    ("survey_2004-10-11_native.tif", "dome-2", "0.5", "2004-10-11"),
    ("survey_2004-10-13_native.tif", "dome-3", "0.5", "2004-10-13"),
];

fn make(folder: &std::path::Path, count: usize) -> String {
    let db = folder.join(format!("db{count}")).to_str().unwrap().to_string();
    printed(&["init", &db, "--crs", "EPSG:26910", "--policy", "newest"]);
    for (file, name, accuracy, date) in &SURVEYS[..count] {
        let path = bundled("st_helens").join(file);
        printed(&[
            "ingest",
            &db,
            path.to_str().unwrap(),
            "--name",
            name,
            "--accuracy",
            accuracy,
            "--date",
            date,
        ]);
    }
    db
}

fn height(db: &str, at: &str, error: &str) -> Value {
    let text = printed(&["heights", db, at, "--error", error, "--explain", "--json"]);
    serde_json::from_str::<Vec<Value>>(&text).unwrap().remove(0)
}

#[test]
fn the_latest_dome_stands_and_leaves_without_a_trace() {
    let folder = tempfile::tempdir().unwrap();
    let (three, four) = (make(folder.path(), 3), make(folder.path(), 4));
    // Points well inside the last survey's footprint, where the dome grew by tens of metres.
    let mut grown: f64 = 0.0;
    for at in ["562660,5116000", "562600,5115950", "562700,5115900", "562750,5116050"] {
        let now = height(&four, at, "20");
        let exact = height(&four, at, "0");
        let then = height(&make_once(folder.path()), at, "0");
        let z = |v: &Value| v["z"].as_f64().unwrap();
        assert!((z(&now) - z(&exact)).abs() <= 20.0, "{at}: {now} {exact}");
        grown = grown.max((z(&exact) - z(&then)).abs());
        for s in now["sources"].as_array().unwrap() {
            assert_eq!(s["survey"], "dome-3", "{at}: old ground contributes: {now}");
        }
        assert!(now["certified"].as_bool().unwrap());
    }
    println!("largest change since 2000 at the points: {grown:.1} m");
    assert!(grown > 25.0, "the points lie where the ground changed by more than the tolerance");
    assert_ne!(printed(&["fingerprint", &three]), printed(&["fingerprint", &four]));
    printed(&["remove", &four, "dome-3"]);
    assert_eq!(printed(&["fingerprint", &three]), printed(&["fingerprint", &four]));
    printed(&["verify", &four]);
}

/// The crater of 2000 alone.
fn make_once(folder: &std::path::Path) -> String {
    let db = folder.join("db1");
    if db.exists() { db.to_str().unwrap().to_string() } else { make(folder, 1) }
}
