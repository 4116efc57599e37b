//! Power cuts: every change is stopped at every write, sync, rename, removal and commit, on a disk in memory that
//! models what survives.
//!
//! The disk promises what [`terraquilt::store::disk`] assumes and no more. After each stop the database is opened
//! on what survived: it is exactly as before or as after, passes `verify`, and the next commit sweeps the leftovers.

use crate::support::{Grid, Random, Scratch, change};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};
use terraquilt::base::{Error, Result};
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Change, Db, Policy, Progress, PruneOutcome};
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Blend;
use terraquilt::store::catalog::{Catalog, Commit, Counters, NamedFile, Sqlite, Version};
use terraquilt::store::disk::{Disk, Finished, Growing};
use terraquilt::store::record::record_name;
use terraquilt::store::segment::file_name;

/// Bytes of a file, and how many of them are durable.
#[derive(Clone, Default)]
struct Inode {
    bytes: Vec<u8>,
    durable: usize,
}

#[derive(Clone, Default)]
struct State {
    inodes: Vec<Inode>,
    /// Names as running programs see them.
    live: BTreeMap<String, usize>,
    /// Names as of the last `sync_names`.
    durable: BTreeMap<String, usize>,
    /// The inode that was written last.
    last: usize,
}

/// What a power cut leaves of that which was not synced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Survives {
    /// Neither names nor bytes.
    Nothing,
    /// Both.
    Everything,
    /// Names, all bytes of other files, and half of those of the file that was written last.
    Half,
    /// Names, but of no file the bytes.
    Names,
    /// Names and lengths, with zeros for bytes.
    Zeros,
}

const CUTS: [Survives; 5] =
    [Survives::Nothing, Survives::Everything, Survives::Half, Survives::Names, Survives::Zeros];

impl State {
    fn after_cut(&self, survives: Survives) -> BTreeMap<String, Vec<u8>> {
        let names = if survives == Survives::Nothing { &self.durable } else { &self.live };
        let bytes = |at: usize| -> Vec<u8> {
            let i = &self.inodes[at];
            let half = i.durable + (i.bytes.len() - i.durable) / 2;
            match survives {
                Survives::Everything => i.bytes.clone(),
                Survives::Half if at == self.last => i.bytes[..half].to_vec(),
                Survives::Half => i.bytes.clone(),
                Survives::Nothing | Survives::Names => i.bytes[..i.durable].to_vec(),
                Survives::Zeros => {
                    let mut b = i.bytes[..i.durable].to_vec();
                    b.resize(i.bytes.len(), 0);
                    b
                }
            }
        };
        names.iter().map(|(n, at)| (n.clone(), bytes(*at))).collect()
    }

    fn holding(files: &BTreeMap<String, Vec<u8>>) -> State {
        let mut s = State::default();
        for (name, bytes) in files {
            s.live.insert(name.clone(), s.inodes.len());
            s.inodes.push(Inode { bytes: bytes.clone(), durable: bytes.len() });
        }
        s.durable = s.live.clone();
        s
    }
}

/// Counts the steps that change something durable, and stops at one.
#[derive(Default)]
struct Cue {
    step: u64,
    /// This step and all later ones fail; 0: none.
    stop_at: u64,
    /// A catalog transaction at `stop_at` is carried out before the power goes.
    done_first: bool,
    stopped: bool,
    /// Steps that were transactions of the catalog.
    transactions: BTreeSet<u64>,
    kinds: BTreeMap<&'static str, u64>,
}

impl Cue {
    /// Whether the next step may be carried out.
    fn go(&mut self, kind: &'static str) -> bool {
        self.step += 1;
        *self.kinds.entry(kind).or_default() += 1;
        self.stopped |= self.stop_at != 0 && self.step >= self.stop_at;
        !self.stopped
    }
}

fn power_cut() -> Error {
    Error::io("the simulated disk", std::io::Error::other("power cut"))
}

/// A disk in memory.
#[derive(Clone, Default)]
struct SimulatedDisk {
    state: Arc<Mutex<State>>,
    cue: Arc<Mutex<Cue>>,
    free: Arc<Mutex<Option<u64>>>,
}

impl SimulatedDisk {
    fn holding(files: &BTreeMap<String, Vec<u8>>) -> SimulatedDisk {
        SimulatedDisk { state: Arc::new(Mutex::new(State::holding(files))), ..SimulatedDisk::default() }
    }
    fn stopping_at(&self, step: u64, done_first: bool) {
        *self.cue.lock().unwrap() = Cue { stop_at: step, done_first, ..Cue::default() };
    }
    fn go(&self, kind: &'static str) -> Result<()> {
        if self.cue.lock().unwrap().go(kind) { Ok(()) } else { Err(power_cut()) }
    }
    fn after_cut(&self, survives: Survives) -> BTreeMap<String, Vec<u8>> {
        self.state.lock().unwrap().after_cut(survives)
    }
    fn total_bytes(&self) -> u64 {
        self.names().unwrap().iter().map(|(_, len)| len).sum()
    }
}

impl Disk for SimulatedDisk {
    fn create(&self, name: &str) -> Result<Box<dyn Growing>> {
        self.go("create")?;
        let mut s = self.state.lock().unwrap();
        let at = s.inodes.len();
        s.inodes.push(Inode::default());
        s.live.insert(name.to_string(), at);
        s.last = at;
        Ok(Box::new(SimulatedFile { disk: self.clone(), at }))
    }

    fn rename(&self, from: &str, to: &str) -> Result<()> {
        self.go("rename")?;
        let mut s = self.state.lock().unwrap();
        let at = s.live.remove(from).ok_or_else(power_cut)?;
        s.live.insert(to.to_string(), at);
        Ok(())
    }

    fn sync_names(&self) -> Result<()> {
        self.go("sync names")?;
        let mut s = self.state.lock().unwrap();
        s.durable = s.live.clone();
        Ok(())
    }

    fn remove(&self, name: &str) -> Result<()> {
        self.go("remove")?;
        let missing = || Error::io(name, std::io::ErrorKind::NotFound.into());
        self.state.lock().unwrap().live.remove(name).map(|_| ()).ok_or_else(missing)
    }

    fn names(&self) -> Result<Vec<(String, u64)>> {
        let s = self.state.lock().unwrap();
        Ok(s.live.iter().map(|(n, at)| (n.clone(), s.inodes[*at].bytes.len() as u64)).collect())
    }

    fn open(&self, name: &str, len: u64) -> Result<Finished> {
        let s = self.state.lock().unwrap();
        let at = s.live.get(name).ok_or_else(|| Error::corrupt(name, "file", "missing"))?;
        let bytes = &s.inodes[*at].bytes;
        if bytes.len() as u64 != len {
            return Err(Error::corrupt(name, "length", format!("{} bytes, {len} expected", bytes.len())));
        }
        Ok(Arc::new(bytes.clone()))
    }

    fn free_bytes(&self) -> Result<Option<u64>> {
        Ok(*self.free.lock().unwrap())
    }

    fn place(&self) -> String {
        "simulated disk".into()
    }
}

struct SimulatedFile {
    disk: SimulatedDisk,
    at: usize,
}

impl Growing for SimulatedFile {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        let go = self.disk.go("append");
        let mut s = self.disk.state.lock().unwrap();
        s.last = self.at;
        // A write that is cut off may have happened in part.
        let written = if go.is_ok() { bytes } else { &bytes[..bytes.len() / 2] };
        s.inodes[self.at].bytes.extend_from_slice(written);
        go
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        let s = self.disk.state.lock().unwrap();
        let from = offset as usize;
        buffer.copy_from_slice(&s.inodes[self.at].bytes[from..from + buffer.len()]);
        Ok(())
    }

    fn sync(&mut self) -> Result<()> {
        self.disk.go("sync")?;
        let mut s = self.disk.state.lock().unwrap();
        let all = s.inodes[self.at].bytes.len();
        s.inodes[self.at].durable = all;
        Ok(())
    }
}

/// The real catalog, whose transactions are steps of the same cue.
struct SteppedCatalog {
    inner: Sqlite,
    disk: SimulatedDisk,
}

impl SteppedCatalog {
    fn transaction(&mut self, kind: &'static str, act: impl FnOnce(&mut Sqlite) -> Result<()>) -> Result<()> {
        let (go, done_first) = {
            let mut cue = self.disk.cue.lock().unwrap();
            let go = cue.go(kind);
            let step = cue.step;
            cue.transactions.insert(step);
            (go, cue.done_first && step == cue.stop_at)
        };
        if go {
            return act(&mut self.inner);
        }
        if done_first {
            act(&mut self.inner)?;
        }
        Err(power_cut())
    }
}

impl Catalog for SteppedCatalog {
    fn constants(&self) -> Result<BTreeMap<String, String>> {
        self.inner.constants()
    }
    fn counters(&self) -> Result<Counters> {
        self.inner.counters()
    }
    fn latest(&self) -> Result<Option<Version>> {
        self.inner.latest()
    }
    fn version(&self, number: u64) -> Result<Option<Version>> {
        self.inner.version(number)
    }
    fn versions(&self) -> Result<Vec<Version>> {
        self.inner.versions()
    }
    fn operation(&self, id: &str) -> Result<Option<u64>> {
        self.inner.operation(id)
    }
    fn operations(&self) -> Result<Vec<(String, u64)>> {
        self.inner.operations()
    }
    fn files(&self, version: u64) -> Result<Vec<NamedFile>> {
        self.inner.files(version)
    }
    fn all_files(&self) -> Result<Vec<(u32, u64)>> {
        self.inner.all_files()
    }
    fn commit(&mut self, commit: &Commit) -> Result<()> {
        self.transaction("commit", |c| c.commit(commit))
    }
    fn prune(&mut self, versions: &[u64]) -> Result<()> {
        self.transaction("prune", |c| c.prune(versions))
    }
    fn check(&self) -> Result<Vec<String>> {
        self.inner.check()
    }
}

fn opened(root: &Path, disk: &SimulatedDisk) -> Db {
    let (path, inner) = (root.join("catalog.sqlite"), disk.clone());
    let opener = move |write: bool| -> Result<Box<dyn Catalog>> {
        let sqlite = if write { Sqlite::open(&path)? } else { Sqlite::open_read_only(&path)? };
        Ok(Box::new(SteppedCatalog { inner: sqlite, disk: inner.clone() }))
    };
    Db::open_with(root, Arc::new(disk.clone()), Arc::new(opener)).unwrap()
}

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
