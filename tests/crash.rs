//! Power cuts: every change is stopped at every write, sync, rename, removal and commit, on a disk in memory that
//! models what survives.
//!
//! The disk promises what [`terraquilt::store::disk`] assumes and no more. After each stop the database is opened
//! on what survived: it is exactly as before or as after, passes `verify`, and the next commit sweeps the leftovers.

use crate::support::power::{CUTS, SimulatedDisk, Survives, opened};
use crate::support::{Grid, Random, Scratch, change};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use terraquilt::base::{Error, Result};
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Change, Db, Policy, Progress, PruneOutcome};
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Blend;
use terraquilt::store::catalog::{Catalog, Sqlite};
use terraquilt::store::disk::Disk;
use terraquilt::store::record::record_name;
use terraquilt::store::segment::file_name;

/// What a database says of itself: every version with its fingerprint, ascending.
fn state(db: &Db) -> BTreeMap<u64, String> {
    let versions = db.versions().unwrap();
    versions
        .iter()
        .map(|v| {
            let s = db.snapshot(Some(v.number)).unwrap();
            (v.number, format!("{}, {}", v.action, terraquilt::db::fingerprint(&s).unwrap()))
        })
        .collect()
}

fn verify(db: &Db) {
    let stop = AtomicBool::new(false);
    let s = db.snapshot(None).unwrap();
    let r = terraquilt::db::verify(db, &s, &Progress { report: &|_, _| (), stop: &stop }).unwrap();
    assert!(r.ok, "{:#?}", r.problems);
}

fn keep_newest(n: usize) -> impl Fn(&[u64]) -> Vec<u64> {
    move |all| all[..all.len().saturating_sub(n)].to_vec()
}

fn prune(db: &Db, keep: usize) -> Result<PruneOutcome> {
    db.prune(keep_newest(keep), &mut || ())
}

/// A square survey on metre posts with its south-west corner moved by `east` metres.
fn grid(name: &str, east: f64, posts: usize, precedence: i64, seed: u64) -> Grid {
    let mut r = Random::new(seed);
    let affine = Affine {
        origin: [500_000.0 + east, 4_000_000.0 + posts as f64],
        col_step: [1.0, 0.0],
        row_step: [0.0, -1.0],
    };
    let mut z: Vec<f32> = Vec::with_capacity(posts * posts);
    for j in 0..posts {
        for i in 0..posts {
            let h = crate::support::ground(east + i as f64, j as f64) + r.unit() * 2.0;
            z.push(h.round() as f32);
        }
    }
    (0..7).for_each(|k| z[posts * 9 + 12 + k] = f32::NAN);
    Grid {
        name: name.into(),
        cols: posts,
        rows: posts,
        z,
        affine,
        accuracy: 0.5,
        precedence: Some(precedence),
        date: None,
    }
}

/// A database at rest: its catalog's folder and its segment files.
struct Rest {
    root: PathBuf,
    files: BTreeMap<String, Vec<u8>>,
    folder: tempfile::TempDir,
    copies: u64,
}

impl Rest {
    /// A database made by `make` on a healthy disk.
    fn new(make: impl Fn(&Db)) -> Rest {
        let s = Scratch::new(Policy::Accuracy);
        let (root, folder) = (s.path(), s.folder);
        let disk = SimulatedDisk::default();
        make(&opened(&root, &disk));
        Rest { root, files: disk.after_cut(Survives::Nothing), folder, copies: 0 }
    }

    /// The folder of a database whose catalog is gone.
    fn copy_without_catalog(&mut self) -> PathBuf {
        self.copy(Path::new("no catalog"))
    }

    /// The folder of a database with this catalog in it.
    fn copy(&mut self, from: &Path) -> PathBuf {
        self.copies += 1;
        let to = self.folder.path().join(format!("copy-{}", self.copies));
        for d in ["segments", "readers"] {
            std::fs::create_dir_all(to.join(d)).unwrap();
        }
        for name in ["catalog.sqlite", "catalog.sqlite-wal"] {
            if from.join(name).exists() {
                std::fs::copy(from.join(name), to.join(name)).unwrap();
            }
        }
        to
    }
}

/// What a rebuild makes of these segment files; nothing if there is no record among them.
fn rebuilt(root: &Path, files: &BTreeMap<String, Vec<u8>>) -> BTreeMap<u64, String> {
    let disk = SimulatedDisk::holding(files);
    let found = match terraquilt::db::rebuild_on(root, Arc::new(disk.clone()), &mut || ()) {
        Ok(_) => state(&opened(root, &disk)),
        Err(Error::Missing { .. }) => BTreeMap::new(),
        Err(e) => panic!("{e}"),
    };
    std::fs::remove_dir_all(root).unwrap();
    found
}

/// Stops `act` at every step and judges what survives each stop.
fn stop_everywhere(what: &str, mut rest: Rest, act: impl Fn(&Db) -> Result<()>) {
    let base = rest.root.clone();
    let healthy = SimulatedDisk::holding(&rest.files);
    let root = rest.copy(&base);
    let db = opened(&root, &healthy);
    let before = state(&db);
    healthy.stopping_at(0, false);
    act(&db).unwrap_or_else(|e| panic!("{what}: {e}"));
    let after = state(&db);
    assert_ne!(before, after, "{what} changes something");
    let (steps, transactions, kinds) = {
        let cue = healthy.cue.lock().unwrap();
        (cue.step, cue.transactions.clone(), cue.kinds.clone())
    };
    verify(&db);
    drop(db);

    let mut cues: Vec<(u64, bool)> = (1..=steps + 1).map(|n| (n, false)).collect();
    cues.extend(transactions.iter().map(|n| (*n, true)));
    let (mut judged, mut old, mut new) = (0, 0, 0);
    let mut made_again: BTreeMap<BTreeMap<String, Vec<u8>>, BTreeMap<u64, String>> = BTreeMap::new();
    for (n, done_first) in &cues {
        let disk = SimulatedDisk::holding(&rest.files);
        disk.stopping_at(*n, *done_first);
        let root = rest.copy(&base);
        let returned = act(&opened(&root, &disk));
        assert_eq!(returned.is_ok(), *n == steps + 1, "{what}, stop {n}: {returned:?}");
        let mut seen: BTreeSet<BTreeMap<String, Vec<u8>>> = BTreeSet::new();
        for survives in CUTS {
            let files = disk.after_cut(survives);
            // Cuts that leave the same bytes need one look.
            if !seen.insert(files.clone()) {
                continue;
            }
            judged += 1;
            let place =
                format!("{what}, stop {n} of {steps} (done first: {done_first}), {survives:?} survives");
            let root = rest.copy(&root);
            let left = SimulatedDisk::holding(&files);
            let db = opened(&root, &left);
            let found = state(&db);
            if returned.is_ok() {
                assert_eq!(found, after, "{place}: what was acknowledged is there");
            }
            let done = found == after;
            assert!(done || found == before, "{place}: {found:#?} is neither {before:#?} nor {after:#?}");
            (old, new) = if done { (old, new + 1) } else { (old + 1, new) };
            verify(&db);
            // Were the catalog lost in the same moment, nothing that was acknowledged would be lost with it.
            let again = made_again
                .entry(files.clone())
                .or_insert_with(|| rebuilt(&rest.copy_without_catalog(), &files));
            let known = |v: &(&u64, &String)| before.get(v.0) == Some(v.1) || after.get(v.0) == Some(v.1);
            assert!(again.iter().all(|v| known(&v)), "{place}: rebuilt {again:#?}");
            assert!(found.iter().all(|(v, f)| again.get(v) == Some(f)), "{place}: rebuilt {again:#?}");
            if returned.is_ok() {
                assert_eq!(*again, after, "{place}: rebuilt");
            }
            // Life goes on, and nothing is left lying about.
            let next = grid("next", 150.0, 24, 5, 99);
            change(&db, Change::Ingest(next.ingest())).unwrap_or_else(|e| panic!("{place}: {e}"));
            let catalog = Sqlite::open_read_only(&root.join("catalog.sqlite")).unwrap();
            let segments = catalog.all_files().unwrap().into_iter().map(|(f, _)| file_name(f));
            let records = catalog.versions().unwrap().into_iter().map(|v| record_name(v.number));
            let named: BTreeSet<String> = segments.chain(records).collect();
            let there: BTreeSet<String> = left.names().unwrap().into_iter().map(|(n, _)| n).collect();
            assert_eq!(there, named, "{place}: leftovers");
            drop(db);
            std::fs::remove_dir_all(&root).unwrap();
        }
        std::fs::remove_dir_all(&root).unwrap();
    }
    println!(
        "{what}: {steps} steps {kinds:?}, {} stops tried, {judged} survivals judged: {old} before, {new} after",
        cues.len()
    );
}

/// One survey of two versions' making, and a second that ranks below it until `set`.
fn one(db: &Db) {
    change(db, Change::Ingest(grid("old", 0.0, 64, 0, 1).ingest())).unwrap();
}

fn two(db: &Db) {
    one(db);
    change(db, Change::Ingest(grid("new", 30.0, 56, 1, 2).ingest())).unwrap();
}

#[test]
fn an_ingest_over_another_survey_is_whole_or_absent() {
    let new = grid("new", 30.0, 56, 1, 2);
    stop_everywhere("ingest", Rest::new(one), |db| {
        let o = change(db, Change::Ingest(new.ingest()))?;
        assert!(o.flipped_cells["old"] > 0, "cells flip");
        Ok(())
    });
}

#[test]
fn the_first_ingest_is_whole_or_absent() {
    stop_everywhere("first ingest", Rest::new(|_| ()), |db| {
        change(db, Change::Ingest(grid("old", 0.0, 40, 0, 1).ingest())).map(|_| ())
    });
}

#[test]
fn a_removal_is_whole_or_absent() {
    stop_everywhere("remove", Rest::new(two), |db| {
        change(db, Change::Remove { surveys: vec!["new".into()], tile: None }).map(|_| ())
    });
}

#[test]
fn a_replacement_is_whole_or_absent() {
    let corrected = grid("new", 30.0, 56, 1, 3);
    stop_everywhere("replace", Rest::new(two), |db| {
        let ingest = corrected.tiles_of(vec![corrected.source()]);
        change(db, Change::Replace { survey: "new".into(), ingest }).map(|_| ())
    });
}

#[test]
fn a_change_of_rank_is_whole_or_absent() {
    stop_everywhere("set", Rest::new(two), |db| {
        change(db, Change::Set { survey: "old".into(), date: None, precedence: Some(7) }).map(|_| ())
    });
}

#[test]
fn a_prune_is_whole_or_absent() {
    let make = |db: &Db| {
        two(db);
        change(db, Change::Remove { surveys: vec!["old".into()], tile: None }).unwrap();
        change(db, Change::Ingest(grid("old", 5.0, 48, 0, 4).ingest())).unwrap();
    };
    stop_everywhere("prune", Rest::new(make), |db| {
        let o = prune(db, 1)?;
        assert_eq!((o.pruned.len(), o.kept_for_readers.len()), (3, 0));
        assert!(o.bytes_freed > 0);
        Ok(())
    });
}

#[test]
fn a_compaction_is_whole_or_absent() {
    let make = |db: &Db| {
        let g = grid("old", 0.0, 64, 0, 1);
        let tiles = vec![g.cut(0, 0, 40, 64).source(), g.cut(40, 0, 24, 64).source()];
        let gone = tiles[0].info().file.clone();
        let pair = terraquilt::db::Ingest { name: Some("old".into()), ..g.tiles_of(tiles) };
        change(db, Change::Ingest(pair)).unwrap();
        change(db, Change::Ingest(grid("new", 30.0, 56, 1, 2).ingest())).unwrap();
        change(db, Change::Remove { surveys: vec!["old".into()], tile: Some(gone) }).unwrap();
    };
    let stop = AtomicBool::new(false);
    for dead in [0.0, 0.5] {
        stop_everywhere(&format!("compact {dead}"), Rest::new(make), |db| {
            let progress = Progress { report: &|_, _| (), stop: &stop };
            let o = db.compact(dead, &progress, &mut || ())?;
            assert!(o.changed && o.pages_moved > 0);
            Ok(())
        });
    }
}

#[test]
fn a_rebuild_that_was_stopped_is_done_again() {
    let mut rest = Rest::new(two);
    let base = rest.root.clone();
    let healthy = SimulatedDisk::holding(&rest.files);
    let root = rest.copy(&base);
    let before = state(&opened(&root, &healthy));
    // Beside the versions: a record that is damaged, and segments that no version names.
    let mut files = rest.files.clone();
    files.insert("00000003.tqv".into(), b"TQUILTVR and no more".to_vec());
    files.insert("00000077.tqs".into(), b"what a dead writer left".to_vec());
    let rebuild = |root: &Path, disk: &SimulatedDisk| {
        terraquilt::db::rebuild_on(root, Arc::new(disk.clone()), &mut || ())
    };
    let counted = SimulatedDisk::holding(&files);
    let o = rebuild(&rest.copy_without_catalog(), &counted).unwrap();
    assert_eq!((o.versions.as_slice(), o.set_aside.len(), o.notes.len()), (&[1, 2][..], 2, 1));
    let steps = counted.cue.lock().unwrap().step;
    assert!(steps >= 3, "two files are set aside, and their names synced: {steps}");
    for n in 1..=steps {
        let disk = SimulatedDisk::holding(&files);
        disk.stopping_at(n, false);
        let root = rest.copy_without_catalog();
        rebuild(&root, &disk).unwrap_err();
        assert!(!root.join("catalog.sqlite").exists(), "stop {n}: there is no catalog before it is right");
        // What creating the catalog leaves if it is cut off.
        std::fs::write(root.join("catalog.new"), "cut off").unwrap();
        for survives in CUTS {
            let left = SimulatedDisk::holding(&disk.after_cut(survives));
            let root = rest.copy(&root);
            rebuild(&root, &left).unwrap();
            let db = opened(&root, &left);
            assert_eq!(state(&db), before, "stop {n}, {survives:?}");
            let o = change(&db, Change::Ingest(grid("next", 150.0, 24, 5, 99).ingest())).unwrap();
            assert_eq!(o.version, 4, "the number of the damaged record is not given again");
            let names: Vec<String> = left.names().unwrap().into_iter().map(|(n, _)| n).collect();
            let aside = names.iter().filter(|n| n.ends_with(".aside")).count();
            assert_eq!(aside, 2, "stop {n}, {survives:?}: {names:?}");
        }
    }
}

/// Heights along a line over both surveys.
fn heights(s: &terraquilt::db::Snapshot) -> Vec<Option<f64>> {
    let points: Vec<[f64; 2]> = (0..60).map(|k| [500_003.3 + f64::from(k), 4_000_030.7]).collect();
    let found = s.heights(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
    found.into_iter().map(|e| e.map(|e| e.z)).collect()
}

#[test]
fn a_reader_keeps_its_version_from_prune_until_it_leaves() {
    let s = Scratch::new(Policy::Accuracy);
    let disk = SimulatedDisk::default();
    let db = opened(&s.path(), &disk);
    two(&db);
    change(&db, Change::Remove { surveys: vec!["old".into()], tile: None }).unwrap();
    // Opened, but nothing read yet: the files must be there when they are first touched.
    let (lazy, reader) = (db.snapshot(Some(1)).unwrap(), db.snapshot(Some(1)).unwrap());
    let answers = heights(&reader);
    let o = prune(&db, 1).unwrap();
    assert_eq!((o.pruned, o.kept_for_readers), (vec![2], vec![1]));
    assert_eq!(heights(&lazy), answers);
    assert_eq!(db.versions().unwrap().iter().map(|v| v.number).collect::<Vec<_>>(), [1, 3]);
    drop(reader);
    assert_eq!(prune(&db, 1).unwrap().kept_for_readers, [1], "the other reader is still there");
    let held = disk.total_bytes();
    drop(lazy);
    let o = prune(&db, 1).unwrap();
    assert_eq!((o.pruned, o.kept_for_readers), (vec![1], vec![]));
    assert!(o.bytes_freed > 0);
    assert_eq!(disk.total_bytes(), held - o.bytes_freed);
    verify(&db);
}

#[test]
fn no_file_goes_while_a_reader_holds_a_forgotten_version() {
    let s = Scratch::new(Policy::Accuracy);
    let disk = SimulatedDisk::default();
    let db = opened(&s.path(), &disk);
    two(&db);
    let reader = db.snapshot(Some(1)).unwrap();
    let answers = heights(&reader);
    change(&db, Change::Remove { surveys: vec!["old".into()], tile: None }).unwrap();
    // A writer that looked for leases just before the reader came.
    Sqlite::open(&s.path().join("catalog.sqlite")).unwrap().prune(&[1, 2]).unwrap();
    let segments =
        || -> Vec<_> { disk.names().unwrap().into_iter().filter(|(n, _)| n.ends_with(".tqs")).collect() };
    let before = segments();
    prune(&db, 1).unwrap();
    assert_eq!(segments(), before, "records may go, segments not");
    let held = disk.total_bytes();
    assert_eq!(heights(&reader), answers);
    drop(reader);
    let o = prune(&db, 1).unwrap();
    assert!(disk.total_bytes() < held);
    assert_eq!(o.bytes_freed, held - disk.total_bytes(), "what prune says it gave back");
    verify(&db);
}

#[test]
fn an_operation_named_by_its_caller_is_done_once_across_a_power_cut() {
    let mut rest = Rest::new(one);
    let base = rest.root.clone();
    let new = grid("new", 30.0, 56, 1, 2);
    let stop = AtomicBool::new(false);
    let act = |db: &Db| {
        let progress = Progress { report: &|_, _| (), stop: &stop };
        db.change(Change::Ingest(new.ingest()), Some("delivery 7"), false, &progress, &mut || ())
    };
    let counted = SimulatedDisk::holding(&rest.files);
    let root = rest.copy(&base);
    act(&opened(&root, &counted)).unwrap();
    let commit = *counted.cue.lock().unwrap().transactions.first().unwrap();
    for done_first in [false, true] {
        let disk = SimulatedDisk::holding(&rest.files);
        disk.stopping_at(commit, done_first);
        let root = rest.copy(&base);
        act(&opened(&root, &disk)).unwrap_err();
        let left = SimulatedDisk::holding(&disk.after_cut(Survives::Nothing));
        let db = opened(&root, &left);
        let again = act(&db).unwrap();
        assert_eq!((again.version, again.changed), (2, !done_first));
        assert_eq!(db.versions().unwrap().len(), 2);
    }
}

#[test]
fn too_little_room_is_said_before_anything_is_written() {
    let s = Scratch::new(Policy::Accuracy);
    let disk = SimulatedDisk::default();
    let db = opened(&s.path(), &disk);
    one(&db);
    *disk.free.lock().unwrap() = Some(1_000_000);
    disk.stopping_at(0, false);
    let e = change(&db, Change::Ingest(grid("new", 30.0, 56, 1, 2).ingest())).unwrap_err();
    assert!(matches!(e, Error::NoSpace { free: 1_000_000, .. }), "{e}");
    assert_eq!(disk.cue.lock().unwrap().step, 0, "nothing was touched");
}
