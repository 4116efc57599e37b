//! Care of the data: backups and copies while others write, compaction and prune while others read, a lost catalog made
//! again, bytes that are really gone; what each survey contributes.

mod backup;
mod compact;
mod origin;
mod rebuild;

use crate::support::{Grid, Random, Scratch, change, ground, printed, program, refused};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use terraquilt::base::Result;
use terraquilt::db::query::Tolerance;
use terraquilt::db::{BackupOutcome, Change, CompactOutcome, Db, Policy, Progress, Snapshot};
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Blend;
use terraquilt::store::segment::PageRef;

/// A square survey on metre posts, its south-west corner moved by `east` metres.
fn grid(name: &str, east: f64, posts: usize, precedence: i64, seed: u64) -> Grid {
    let mut r = Random::new(seed);
    let z = (0..posts * posts)
        .map(|k| (ground(east + (k % posts) as f64, (k / posts) as f64) + r.unit() * 2.0).round() as f32)
        .collect();
    Grid {
        name: name.into(),
        cols: posts,
        rows: posts,
        z,
        affine: Affine {
            origin: [500_000.0 + east, 4_000_000.0 + posts as f64],
            col_step: [1.0, 0.0],
            row_step: [0.0, -1.0],
        },
        accuracy: 0.5,
        precedence: Some(precedence),
        date: None,
    }
}

fn quietly<T>(work: impl FnOnce(&Progress) -> Result<T>) -> Result<T> {
    let stop = AtomicBool::new(false);
    work(&Progress { report: &|_, _| (), stop: &stop })
}

fn backup(db: &Db, to: &Path, at: Option<u64>) -> Result<BackupOutcome> {
    quietly(|p| db.backup(to, at, p))
}

fn compact(db: &Db, dead: f64) -> CompactOutcome {
    quietly(|p| db.compact(dead, p, &mut || ())).unwrap()
}

fn prune_to_one(db: &Db) -> terraquilt::db::PruneOutcome {
    db.prune(|all| all[..all.len() - 1].to_vec(), &mut || ()).unwrap()
}

fn remove_tile(db: &Db, survey: &str, tile: &str) {
    let tile = Some(tile.to_string());
    change(db, Change::Remove { surveys: vec![survey.into()], tile }).unwrap();
}

fn fingerprint(db: &Db, at: Option<u64>) -> String {
    terraquilt::db::fingerprint(&db.snapshot(at).unwrap()).unwrap()
}

fn numbers(db: &Db) -> Vec<u64> {
    db.versions().unwrap().iter().map(|v| v.number).collect()
}

/// Every version that is kept, and its fingerprint.
fn state(db: &Db) -> BTreeMap<u64, String> {
    numbers(db).into_iter().map(|v| (v, fingerprint(db, Some(v)))).collect()
}

fn verify(db: &Db) {
    for v in numbers(db) {
        let s = db.snapshot(Some(v)).unwrap();
        let r = quietly(|p| terraquilt::db::verify(db, &s, p)).unwrap();
        assert!(r.ok, "version {v}: {:#?}", r.problems);
    }
}

fn heights(s: &Snapshot) -> Vec<Option<f64>> {
    let points: Vec<[f64; 2]> = (0..60).map(|k| [500_003.3 + f64::from(k), 4_000_030.7]).collect();
    let found = s.heights(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
    found.into_iter().map(|e| e.map(|e| e.z)).collect()
}

/// Files of a folder and those below: path and bytes.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut out = BTreeMap::new();
    for e in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if e.is_dir() {
            out.extend(files(&e));
        } else {
            out.insert(e.clone(), std::fs::read(&e).unwrap());
        }
    }
    out
}

fn segments(db: &Path) -> BTreeMap<String, Vec<u8>> {
    let name = |p: PathBuf| p.file_name().unwrap().to_str().unwrap().to_string();
    files(&db.join("segments"))
        .into_iter()
        .map(|(p, b)| (name(p), b))
        .filter(|(n, _)| n.ends_with(".tqs"))
        .collect()
}

fn segment_path(db: &Path, number: u32) -> PathBuf {
    db.join(format!("segments/{number:08}.tqs"))
}

/// The encoded sample blocks of a tile, read as docs/format.md says: the references of its tile directory.
fn block_bytes(db: &Db, survey: &str, tile: &str) -> Vec<Vec<u8>> {
    let s = db.snapshot(None).unwrap();
    let head = s.head(s.survey(survey).unwrap().number).unwrap();
    let t = head.tiles.iter().find(|t| t.file == tile).unwrap();
    let page = |at: &PageRef| {
        let bytes = std::fs::read(segment_path(db.path(), at.file)).unwrap();
        bytes[at.offset as usize..][..at.len as usize].to_vec()
    };
    let directory = page(&t.directory);
    assert_eq!(directory[0], b'D');
    let number = |b: &[u8], at: usize| u32::from_le_bytes(b[at..at + 4].try_into().unwrap());
    directory[33..]
        .chunks_exact(24)
        .map(|e| {
            let offset = u64::from_le_bytes(e[8..16].try_into().unwrap());
            page(&PageRef { file: number(e, 0), len: number(e, 4), offset, crc: number(e, 16) })
        })
        .collect()
}

/// How many of the blocks are found in any file of a database, the catalog included.
fn found(db: &Path, blocks: &[Vec<u8>]) -> usize {
    let all = files(db);
    let holds = |b: &Vec<u8>| all.values().any(|f| f.windows(b.len()).any(|w| w == b));
    blocks.iter().filter(|b| holds(b)).count()
}

/// A survey of two tiles that came in one file of pages, and one more survey over it.
fn two_tiles() -> (Scratch, [String; 2]) {
    let s = Scratch::new(Policy::Accuracy);
    let g = grid("pair", 0.0, 120, 0, 1);
    let (a, b) = (g.cut(0, 0, 90, 120), g.cut(90, 0, 30, 120));
    let files = [a.source().info().file.clone(), b.source().info().file.clone()];
    let pair =
        terraquilt::db::Ingest { name: Some("pair".into()), ..g.tiles_of(vec![a.source(), b.source()]) };
    s.change(Change::Ingest(pair)).unwrap();
    s.ingest(&grid("over", 60.0, 64, 1, 2));
    (s, files)
}

/// Deletes the catalog, as if it had never been.
fn lose_catalog(db: &Path) {
    for name in ["catalog.sqlite", "catalog.sqlite-wal", "catalog.sqlite-shm"] {
        let _ = std::fs::remove_file(db.join(name));
    }
}

fn copy_folder(from: &Path, to: &Path) {
    for (path, bytes) in files(from) {
        let target = to.join(path.strip_prefix(from).unwrap());
        std::fs::create_dir_all(target.parent().unwrap()).unwrap();
        std::fs::write(target, bytes).unwrap();
    }
}
