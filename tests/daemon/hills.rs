//! A database of Mount St. Helens, made once: the crater of 2000, surveys of the dome in October 2004, the crater of 2005.

use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use terraquilt::base::date::Date;
use terraquilt::db::{Change, Db, Ingest, Options, Policy, Progress};
use terraquilt::format;
use terraquilt::height::crs::Crs;
use terraquilt::height::patch::Kind;

/// File, name, accuracy in metres, date.
pub const SURVEYS: [(&str, &str, f64, &str); 3] = [
    ("survey_2000-09-25_native.tif", "2000", 1.5, "2000-09-25"),
    ("survey_2004-10-04_native.tif", "2004-10-04", 0.5, "2004-10-04"),
    ("crater_2005-06-15_10m.tif", "2005", 1.0, "2005-06-15"),
];

/// The dome: where the small survey lies.
pub const DOME: [f64; 4] = [562_000.0, 5_115_300.0, 563_300.0, 5_116_600.0];

/// The file of a survey.
pub fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/st_helens").join(name)
}

/// One of [`SURVEYS`] as it is ingested.
pub fn arrival(which: usize) -> Change {
    let (path, name, accuracy, date) = SURVEYS[which];
    Change::Ingest(Ingest {
        name: Some(name.into()),
        accuracy_m: Some(accuracy),
        date: Some(Date::parse(date).unwrap()),
        ..Ingest::new(vec![format::open(&file(path)).unwrap()])
    })
}

/// Carries out a change; returns its version.
pub fn commit(db: &Db, change: Change) -> u64 {
    let progress = Progress { report: &|_, _| {}, stop: &AtomicBool::new(false) };
    db.change(change, None, false, &progress, &mut || {}).unwrap().version
}

/// A copy of the database of all three surveys, one version each, in a folder.
pub fn hills(folder: &Path) -> Db {
    static MADE: OnceLock<tempfile::TempDir> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let made = tempfile::tempdir().unwrap();
        let crs = Crs::from_epsg(26910).unwrap();
        let options = Options { crs, policy: Policy::Newest, patch: Kind::Bilinear };
        let db = Db::create(&made.path().join("db"), &options).unwrap();
        (0..SURVEYS.len()).for_each(|k| {
            commit(&db, arrival(k));
        });
        made
    });
    let to = folder.join("db");
    copied(&made.path().join("db"), &to);
    Db::open(&to).unwrap()
}

fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for e in std::fs::read_dir(from).unwrap().map(|e| e.unwrap()) {
        let to = to.join(e.file_name());
        if e.path().is_dir() {
            copied(&e.path(), &to);
        } else {
            std::fs::copy(e.path(), to).unwrap();
        }
    }
}
