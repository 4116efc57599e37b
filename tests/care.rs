//! Care of the data: backups and copies while others write, compaction and prune while others read, a lost catalog made
//! again, bytes that are really gone; what each survey contributes.

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

#[test]
fn backups_while_a_writer_commits_hold_whole_versions() {
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&grid("first", 0.0, 64, 0, 1));
    let to = s.folder.path().join("backup");
    let writing = AtomicBool::new(true);
    let mut taken = Vec::new();
    std::thread::scope(|scope| {
        scope.spawn(|| {
            for k in 0..8 {
                s.ingest(&grid(&format!("next {k}"), 10.0 * k as f64, 48, k, 10 + k as u64));
                if k % 3 == 2 {
                    s.remove(&format!("next {}", k - 1));
                    prune_to_one(&s.db);
                }
            }
            writing.store(false, Ordering::Release);
        });
        loop {
            let last = !writing.load(Ordering::Acquire);
            taken.push(backup(&s.db, &to, None).unwrap());
            let copy = Db::open(&to).unwrap();
            assert_eq!(numbers(&copy), taken.last().unwrap().versions);
            verify(&copy);
            if last {
                break;
            }
        }
    });
    println!("{} backups while 10 commits and 2 prunes were made", taken.len());
    assert!(taken.len() >= 3, "the writer was too fast: {} backups", taken.len());
    assert!(
        taken.iter().any(|o| o.files_kept > 0 && o.files_copied > 0),
        "some copied what was missing only"
    );
    assert_eq!(state(&Db::open(&to).unwrap()), state(&s.db));
    assert_eq!(segments(&to), segments(&s.path()));
}

#[test]
fn a_backup_of_a_running_ingest_restores_by_opening_it() {
    let s = Scratch::new(Policy::Accuracy);
    let file = s.folder.path().join("hill.tif");
    let (db, to) = (s.path(), s.folder.path().join("backup"));
    let (db, to) = (db.to_str().unwrap(), to.to_str().unwrap());
    s.ingest(&grid("first", 0.0, 64, 0, 1));
    printed(&["export", db, file.to_str().unwrap(), "--error", "0", "--step", "0.1"]);
    let before = s.fingerprint();
    let mut ingest = std::process::Command::new(env!("CARGO_BIN_EXE_terraquilt"))
        .args(["ingest", db, file.to_str().unwrap(), "--accuracy", "1", "--name", "second"])
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    let mut beside = 0;
    loop {
        let done = ingest.try_wait().unwrap();
        let o: serde_json::Value = serde_json::from_str(&printed(&["backup", db, to, "--json"])).unwrap();
        let restored = printed(&["fingerprint", to]);
        if o["versions"] == serde_json::json!([1]) {
            assert_eq!(restored.trim(), before);
            beside += 1;
        }
        if let Some(status) = done {
            assert!(status.success());
            break;
        }
    }
    println!("{beside} backups before the ingest was done");
    assert!(beside >= 1);
    assert_eq!(printed(&["fingerprint", to]), printed(&["fingerprint", db]));
    assert_eq!(printed(&["versions", to]), printed(&["versions", db]));
    printed(&["verify", to]);
    // The restored one is written like any other.
    printed(&["remove", to, "second"]);
    assert_eq!(printed(&["fingerprint", to]).trim(), before);
    // And then it is no earlier state of the other, nor when that has gone on.
    let e = refused(&["backup", db, to], 1);
    assert!(e.contains("version 3") && e.contains("give a new directory"), "{e}");
    s.remove("second");
    s.ingest(&grid("third", 5.0, 40, 0, 9));
    prune_to_one(&s.db);
    let e = refused(&["backup", db, to], 1);
    assert!(e.contains("was a backup up to version 2 and holds version 3"), "{e}");
}

#[test]
fn a_backup_is_brought_up_to_date_and_forgets_what_was_pruned() {
    let (s, tiles) = two_tiles();
    let to = s.folder.path().join("backup");
    let first = backup(&s.db, &to, None).unwrap();
    assert_eq!((first.files_copied, first.files_kept), (4, 0));
    let stamp = |n: u32| std::fs::metadata(segment_path(&to, n)).unwrap().modified().unwrap();
    let stamps: Vec<_> = (1..=4).map(stamp).collect();
    let again = backup(&s.db, &to, None).unwrap();
    assert_eq!((again.files_copied, again.files_kept, again.bytes_copied), (0, 4, 0));
    let blocks = block_bytes(&s.db, "pair", &tiles[0]);
    s.remove("pair");
    let third = backup(&s.db, &to, None).unwrap();
    assert_eq!((third.files_copied, third.files_kept), (1, 4));
    assert_eq!((1..=4).map(stamp).collect::<Vec<_>>(), stamps, "immutable files are not written again");
    assert_eq!(state(&Db::open(&to).unwrap()), state(&s.db));
    assert_eq!(found(&to, &blocks), blocks.len());
    prune_to_one(&s.db);
    backup(&s.db, &to, None).unwrap();
    assert_eq!(numbers(&Db::open(&to).unwrap()), [3]);
    assert_eq!(found(&to, &blocks), 0, "what was pruned leaves the backup, too");
    assert_eq!(segments(&to), segments(&s.path()));
    // One version of several.
    s.ingest(&grid("more", 5.0, 40, 0, 9));
    let one = s.folder.path().join("one");
    assert_eq!(backup(&s.db, &one, Some(3)).unwrap().versions, [3]);
    let one = Db::open(&one).unwrap();
    assert_eq!(numbers(&one), [3]);
    assert_eq!(fingerprint(&one, None), fingerprint(&s.db, Some(3)));
    verify(&one);
    let gone = backup(&s.db, &s.folder.path().join("gone"), Some(2)).unwrap_err().to_string();
    assert!(gone.contains("version 2 not found"), "{gone}");
}

#[test]
fn damage_is_found_while_it_is_copied_and_mended_where_it_was_copied_to() {
    let (s, _) = two_tiles();
    let to = s.folder.path().join("backup");
    backup(&s.db, &to, None).unwrap();
    let flip = |path: &Path, at: usize| {
        let mut bytes = std::fs::read(path).unwrap();
        bytes[at] ^= 4;
        std::fs::write(path, bytes).unwrap();
    };
    // In the backup: the file is copied anew.
    flip(&segment_path(&to, 1), 700);
    let o = backup(&s.db, &to, None).unwrap();
    assert_eq!(o.files_mended, ["00000001.tqs"]);
    assert_eq!(segments(&to), segments(&s.path()));
    std::fs::write(segment_path(&to, 2), b"short").unwrap();
    assert_eq!(backup(&s.db, &to, None).unwrap().files_mended, ["00000002.tqs"]);
    // In the database: every page of every file, in a sample block, a table, the tree, the header.
    let good = segments(&s.path());
    for (name, bytes) in &good {
        let path = s.path().join("segments").join(name);
        for at in [3, 40, bytes.len() / 2, bytes.len() - 3] {
            flip(&path, at);
            for target in [s.folder.path().join(format!("{name}-{at}")), to.clone()] {
                let e = backup(&s.db, &target, None);
                if target == to && e.is_ok() {
                    continue;
                }
                let e = e.unwrap_err().to_string();
                assert!(e.contains(name.as_str()) && e.contains("damaged"), "{name} byte {at}: {e}");
            }
            flip(&path, at);
        }
    }
    // What was there before is still whole.
    assert_eq!(state(&Db::open(&to).unwrap()), state(&s.db));
    verify(&Db::open(&to).unwrap());
}

#[test]
fn backups_go_to_new_directories_and_earlier_backups_only() {
    let (s, _) = two_tiles();
    let at = |name: &str| s.folder.path().join(name);
    let refused = |to: &Path, words: &[&str]| {
        let e = backup(&s.db, to, None).unwrap_err().to_string();
        assert!(words.iter().all(|w| e.contains(w)), "{e}: {words:?}");
    };
    std::fs::create_dir(at("full")).unwrap();
    std::fs::write(at("full").join("letter.txt"), "mine").unwrap();
    refused(&at("full"), &["neither empty nor an earlier backup"]);
    refused(&at("full").join("letter.txt"), &["is a file"]);
    refused(&s.path(), &["itself"]);
    refused(&s.path().join("inner"), &["inside of it"]);
    let other = Scratch::new(Policy::Accuracy);
    other.ingest(&grid("elsewhere", 0.0, 40, 0, 5));
    refused(&other.path(), &["its constant 'identity' is another"]);
    let newest = Scratch::new(Policy::Newest);
    refused(&newest.path(), &["its constant", "another"]);
    assert_eq!(numbers(&other.db), [1], "a database that is refused stays as it was");
    // A backup that was cut off is no database yet, and is taken up again.
    let cut = at("cut");
    std::fs::create_dir_all(cut.join("segments")).unwrap();
    std::fs::write(cut.join("backup.unfinished"), "").unwrap();
    std::fs::copy(segment_path(&s.path(), 1), segment_path(&cut, 1)).unwrap();
    std::fs::write(cut.join("segments/00000002.tmp"), "half").unwrap();
    let e = Db::open(&cut).err().unwrap().to_string();
    assert!(e.contains("run `terraquilt backup` again"), "{e}");
    let o = backup(&s.db, &cut, None).unwrap();
    assert_eq!((o.files_copied, o.files_kept), (3, 1));
    assert_eq!(state(&Db::open(&cut).unwrap()), state(&s.db));
    assert!(!cut.join("backup.unfinished").exists() && !cut.join("segments/00000002.tmp").exists());
    // An empty database can be backed up, and the backup brought up to date.
    let (empty, to) = (Scratch::new(Policy::Accuracy), at("of-empty"));
    assert_eq!(backup(&empty.db, &to, None).unwrap().files, 0);
    empty.ingest(&grid("first", 0.0, 40, 0, 1));
    backup(&empty.db, &to, None).unwrap();
    assert_eq!(state(&Db::open(&to).unwrap()), state(&empty.db));
}

#[test]
fn a_copy_is_one_version_and_nothing_else() {
    let (s, _) = two_tiles();
    s.remove("over");
    let live: u64 = terraquilt::db::info(&s.db, &s.db.snapshot(None).unwrap()).unwrap().bytes_live;
    for (name, at, version) in [("latest", None, 3), ("second", Some(2), 2)] {
        let to = s.folder.path().join(name);
        quietly(|p| s.db.copy(&to, at, p)).unwrap();
        let copy = Db::open(&to).unwrap();
        assert_eq!(numbers(&copy), [version]);
        assert_eq!(fingerprint(&copy, None), fingerprint(&s.db, Some(version)));
        assert_eq!(segments(&to).len(), 2);
        if at.is_none() {
            assert_eq!(segments(&to).values().map(|b| b.len() as u64).sum::<u64>(), live + 64);
        }
        verify(&copy);
        // It is a database: numbers go on where they were.
        let o = change(&copy, Change::Ingest(grid("later", 20.0, 40, 2, 4).ingest())).unwrap();
        assert_eq!(o.version, 4);
        verify(&copy);
        let e = quietly(|p| s.db.copy(&to, at, p)).unwrap_err().to_string();
        assert!(e.contains("holds a database already"), "{e}");
    }
}

#[test]
fn a_tile_that_left_is_gone_from_the_disk_after_compact_and_prune() {
    let (s, tiles) = two_tiles();
    let blocks = block_bytes(&s.db, "pair", &tiles[0]);
    let stay = block_bytes(&s.db, "pair", &tiles[1]);
    assert!(blocks.len() >= 2 && blocks.iter().all(|b| b.len() > 100));
    remove_tile(&s.db, "pair", &tiles[0]);
    prune_to_one(&s.db);
    assert_eq!(found(&s.path(), &blocks), blocks.len(), "prune alone gives back whole files only");
    let (print, answers) = (s.fingerprint(), heights(&s.db.snapshot(None).unwrap()));
    let reader = s.db.snapshot(None).unwrap();
    let o = compact(&s.db, 0.5);
    assert!(o.changed && o.files_left > 0 && o.bytes_written < o.bytes_to_prune, "{o:?}");
    assert_eq!((o.version, s.fingerprint()), (4, print.clone()));
    verify(&s.db);
    // The reader keeps the version before, and all its bytes.
    assert_eq!(prune_to_one(&s.db).kept_for_readers, [3]);
    assert_eq!(found(&s.path(), &blocks), blocks.len());
    assert_eq!(heights(&reader), answers);
    assert_eq!(terraquilt::db::fingerprint(&reader).unwrap(), print);
    drop(reader);
    let p = prune_to_one(&s.db);
    assert_eq!(p.pruned, [3]);
    assert!(p.bytes_freed >= o.bytes_to_prune);
    assert_eq!((found(&s.path(), &blocks), found(&s.path(), &stay)), (0, stay.len()));
    assert_eq!((s.fingerprint(), heights(&s.db.snapshot(None).unwrap())), (print, answers));
    verify(&s.db);
    assert!(!compact(&s.db, 0.5).changed, "what was compacted is compact");
    // Down to the last dead byte.
    s.remove("over");
    prune_to_one(&s.db);
    compact(&s.db, 0.0);
    prune_to_one(&s.db);
    let info = terraquilt::db::info(&s.db, &s.db.snapshot(None).unwrap()).unwrap();
    assert_eq!(info.bytes, info.bytes_live + 32 * info.files as u64);
    verify(&s.db);
}

#[test]
fn a_survey_that_was_removed_and_pruned_is_gone_from_the_disk() {
    let (s, tiles) = two_tiles();
    let blocks: Vec<Vec<u8>> = tiles.iter().flat_map(|t| block_bytes(&s.db, "pair", t)).collect();
    assert_eq!(found(&s.path(), &blocks), blocks.len());
    s.remove("pair");
    assert_eq!(found(&s.path(), &blocks), blocks.len(), "--at still shows it");
    prune_to_one(&s.db);
    assert_eq!(found(&s.path(), &blocks), 0);
    // Nor does a rebuild bring it back.
    let print = s.fingerprint();
    lose_catalog(&s.path());
    let o = terraquilt::db::rebuild(&s.path(), &mut || ()).unwrap();
    assert_eq!((o.versions, o.set_aside.len()), (vec![3], 0));
    assert_eq!(fingerprint(&Db::open(&s.path()).unwrap(), None), print);
}

#[test]
fn readers_are_undisturbed_by_compactions_and_prunes() {
    let (s, tiles) = two_tiles();
    let done = AtomicBool::new(false);
    let mut rounds = 0;
    std::thread::scope(|scope| {
        let readers: Vec<_> = (0..2)
            .map(|_| {
                scope.spawn(|| {
                    let mut looks = 0;
                    while !done.load(Ordering::Acquire) {
                        // Held over several commits: first opened, then read, then read again.
                        let held = s.db.snapshot(None).unwrap();
                        std::thread::sleep(std::time::Duration::from_millis(20));
                        let print = terraquilt::db::fingerprint(&held).unwrap();
                        std::thread::sleep(std::time::Duration::from_millis(30));
                        assert_eq!(terraquilt::db::fingerprint(&held).unwrap(), print);
                        assert_eq!(heights(&held).len(), 60);
                        looks += 1;
                    }
                    looks
                })
            })
            .collect();
        let g = grid("pair", 0.0, 120, 0, 1);
        for _ in 0..6 {
            remove_tile(&s.db, "pair", &tiles[1]);
            compact(&s.db, 0.1);
            prune_to_one(&s.db);
            let again = g.cut(90, 0, 30, 120);
            let tile =
                terraquilt::db::Ingest { into: Some("pair".into()), ..g.tiles_of(vec![again.source()]) };
            s.change(Change::Ingest(tile)).unwrap();
            compact(&s.db, 0.0);
            prune_to_one(&s.db);
            rounds += 1;
        }
        done.store(true, Ordering::Release);
        let looks: u64 = readers.into_iter().map(|r| r.join().unwrap()).sum();
        println!("{looks} snapshots read while {rounds} rounds of compactions and prunes went on");
        assert!(looks >= 4);
    });
    verify(&s.db);
    prune_to_one(&s.db);
    assert_eq!(numbers(&s.db).len(), 1);
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

#[test]
fn a_lost_catalog_is_made_again_from_the_files() {
    let (s, tiles) = two_tiles();
    let progress_stop = AtomicBool::new(false);
    let progress = Progress { report: &|_, _| (), stop: &progress_stop };
    let late = || Change::Ingest(grid("late", 20.0, 40, 2, 4).ingest());
    s.db.change(late(), Some("delivery 7"), false, &progress, &mut || ()).unwrap();
    remove_tile(&s.db, "pair", &tiles[1]);
    let (before, rows) = (state(&s.db), s.db.versions().unwrap());
    let survey = s.db.snapshot(None).unwrap().survey("late").unwrap().number;
    let path = s.path();
    let db = path.to_str().unwrap().to_string();
    drop(s.db);
    lose_catalog(&path);
    // Nothing that comes along in between makes it worse.
    assert!(refused(&["info", &db], 1).contains("terraquilt rebuild"));
    assert!(refused(&["init", &db, "--crs", "EPSG:32610"], 1).contains("terraquilt rebuild"));
    let told = printed(&["rebuild", &db]);
    assert!(told.contains("4 versions, the latest is 4"), "{told}");
    let again = Db::open(&path).unwrap();
    assert_eq!(again.versions().unwrap(), rows, "numbers, times, operations, actions, roots");
    assert_eq!(state(&again), before);
    verify(&again);
    assert!(refused(&["rebuild", &db], 1).contains("nothing to rebuild"));
    // Operations are known, and no number is given twice.
    let o = again.change(late(), Some("delivery 7"), false, &progress, &mut || ()).unwrap();
    assert_eq!((o.version, o.changed), (3, false));
    let files_before = segments(&path);
    change(&again, Change::Ingest(grid("new", 5.0, 40, 2, 6).ingest())).unwrap();
    assert_eq!(numbers(&again), [1, 2, 3, 4, 5]);
    assert!(again.snapshot(None).unwrap().survey("new").unwrap().number > survey);
    assert!(files_before.iter().all(|(n, b)| segments(&path)[n] == *b));
    verify(&again);
}

#[test]
fn a_damaged_catalog_is_kept_and_replaced() {
    let (s, _) = two_tiles();
    let before = state(&s.db);
    let path = s.path();
    drop(s.db);
    let catalog = path.join("catalog.sqlite");
    let good = std::fs::read(&catalog).unwrap();
    type Spoil = fn(&mut Vec<u8>);
    let spoils: [Spoil; 4] = [
        |b| b.clear(),
        |b| b.iter_mut().for_each(|x| *x ^= 0x55),
        |b| b[100..4096].fill(0),
        |b| b.truncate(5000),
    ];
    for (n, spoil) in spoils.iter().enumerate() {
        let mut bytes = good.clone();
        spoil(&mut bytes);
        std::fs::write(&catalog, &bytes).unwrap();
        assert_eq!(program(&["verify", path.to_str().unwrap()]).status.code(), Some(1));
        let o = terraquilt::db::rebuild(&path, &mut || ()).unwrap();
        assert_eq!(o.versions, [1, 2]);
        let kept = &o.set_aside[0];
        assert!(kept.starts_with("catalog.damaged"), "{kept}");
        assert_eq!(std::fs::read(path.join(kept)).unwrap(), bytes);
        let db = Db::open(&path).unwrap();
        assert_eq!(state(&db), before, "damage {n}");
        verify(&db);
    }
}

#[test]
fn a_rebuild_says_what_it_cannot_have_and_deletes_nothing() {
    let make = || {
        let (s, _) = two_tiles();
        s.remove("over");
        let before = state(&s.db);
        let path = s.path();
        drop(s.db);
        lose_catalog(&path);
        (s.folder, path, before)
    };
    // A file is missing: the versions that read it are left out; their other files stay, under another name.
    let (_folder, path, before) = make();
    std::fs::remove_file(segment_path(&path, 3)).unwrap();
    let o = terraquilt::db::rebuild(&path, &mut || ()).unwrap();
    assert_eq!(o.versions, [1, 3]);
    assert!(o.notes[0].contains("version 2: 00000003.tqs is not there"), "{:?}", o.notes);
    assert_eq!(o.set_aside, ["segments/00000002.tqv.aside", "segments/00000004.tqs.aside"]);
    let db = Db::open(&path).unwrap();
    assert_eq!(fingerprint(&db, Some(1)), before[&1]);
    assert_eq!(fingerprint(&db, Some(3)), before[&3]);
    verify(&db);
    // The newest record is damaged: the version before it is the latest, and numbers are not given again.
    let (_folder, path, before) = make();
    let record = path.join("segments/00000003.tqv");
    let mut bytes = std::fs::read(&record).unwrap();
    bytes[30] ^= 1;
    std::fs::write(&record, bytes).unwrap();
    let o = terraquilt::db::rebuild(&path, &mut || ()).unwrap();
    assert_eq!(o.versions, [1, 2]);
    assert!(o.notes[0].contains("version 3") && o.notes[0].contains("checksum"), "{:?}", o.notes);
    let db = Db::open(&path).unwrap();
    let c = change(&db, Change::Ingest(grid("new", 5.0, 40, 2, 6).ingest())).unwrap();
    assert_eq!(c.version, 4);
    assert_eq!(fingerprint(&db, Some(2)), before[&2]);
    assert!(path.join("segments/00000003.tqv.aside").exists());
    assert!(!segment_path(&path, 5).exists(), "the number of the file that was set aside is not given again");
    verify(&db);
    // Somebody reads.
    let (_folder, path, _) = make();
    let lease = terraquilt::store::lock::Lease::take(&path, 3).unwrap();
    let e = terraquilt::db::rebuild(&path, &mut || ()).unwrap_err().to_string();
    assert!(e.contains("reading version 3"), "{e}");
    drop(lease);
    terraquilt::db::rebuild(&path, &mut || ()).unwrap();
}

#[test]
fn a_database_of_format_1_gets_its_records_with_the_next_commit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("db");
    let golden = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/v1");
    copy_folder(&golden, &path);
    lose_catalog(&path);
    let e = terraquilt::db::rebuild(&path, &mut || ()).unwrap_err().to_string();
    assert!(e.contains("version records") && e.contains("Restore catalog.sqlite from a backup"), "{e}");
    copy_folder(&golden, &path);
    let db = Db::open(&path).unwrap();
    remove_survey(&db, "new ground");
    let before = state(&db);
    assert_eq!(before.len(), 4);
    drop(db);
    lose_catalog(&path);
    terraquilt::db::rebuild(&path, &mut || ()).unwrap();
    let db = Db::open(&path).unwrap();
    assert_eq!(state(&db), before);
    verify(&db);
}

fn remove_survey(db: &Db, name: &str) {
    change(db, Change::Remove { surveys: vec![name.into()], tile: None }).unwrap();
}

#[test]
fn killed_backups_and_compactions_are_taken_up_again() {
    let mut r = Random::new(crate::support::seeds(1)[0] + 77);
    let (s, tiles) = two_tiles();
    for k in 0..4 {
        s.ingest(&grid(&format!("more {k}"), 15.0 * k as f64, 100, k, 20 + k as u64));
    }
    remove_tile(&s.db, "pair", &tiles[0]);
    let (db, to) = (s.path(), s.folder.path().join("backup"));
    let (db, to) = (db.to_str().unwrap(), to.to_str().unwrap());
    let print = s.fingerprint();
    let mut kills = 0;
    let mut kill = |args: &[&str]| {
        let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_terraquilt"))
            .args(args)
            .stdout(std::process::Stdio::null())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        std::thread::sleep(std::time::Duration::from_micros(2000 + r.below(40_000)));
        child.kill().unwrap();
        kills += u64::from(!child.wait().unwrap().success());
    };
    for _ in 0..12 {
        kill(&["backup", db, to]);
        assert_eq!(s.fingerprint(), print, "a backup changes nothing");
        if let Ok(b) = Db::open(Path::new(to)) {
            assert_eq!(fingerprint(&b, None), print, "what opens is whole");
        }
    }
    for _ in 0..12 {
        kill(&["compact", db, "--dead", "0"]);
        assert_eq!(s.fingerprint(), print);
    }
    println!("{kills} of 24 were killed in time");
    verify(&s.db);
    printed(&["backup", db, to]);
    printed(&["compact", db, "--dead", "0"]);
    printed(&["prune", db, "--keep", "1"]);
    printed(&["backup", db, to]);
    verify(&Db::open(Path::new(to)).unwrap());
    assert_eq!(state(&Db::open(Path::new(to)).unwrap()), state(&s.db));
    assert_eq!(s.fingerprint(), print);
}

#[test]
fn a_redundant_survey_is_named_and_is_not_missed() {
    let s = Scratch::new(Policy::Accuracy);
    // Wholly inside a survey of higher precedence: no cell of it is left.
    s.ingest(&grid("buried", 20.0, 40, 0, 3));
    s.ingest(&grid("wide", 0.0, 100, 1, 1));
    s.ingest(&grid("beside", 80.0, 60, 0, 2));
    let rows: serde_json::Value =
        serde_json::from_str(&printed(&["redundant", s.path().to_str().unwrap(), "--json"])).unwrap();
    let row = |name: &str| rows.as_array().unwrap().iter().find(|r| r["name"] == name).unwrap();
    assert_eq!((&row("buried")["redundant"], &row("buried")["live"]), (&true.into(), &0.into()));
    assert_eq!(row("buried")["cells_kept"], 0);
    assert_eq!((&row("wide")["redundant"], &row("wide")["cells_share"]), (&false.into(), &1.0.into()));
    let share = row("beside")["cells_share"].as_f64().unwrap();
    assert!(share > 0.5 && share < 0.8, "40 of 60 columns are its own: {share}");
    // 40 x 40 posts have 39 x 39 cells, the outermost ring of which is in no core.
    assert_eq!(row("buried")["cells"], 37 * 37);
    let before = heights(&s.db.snapshot(None).unwrap());
    // Its file goes as a whole; beside it there are the pages of its tops, in files of the set.
    let (file, said) = (segments(&s.path())["00000001.tqs"].len() as u64, &row("buried")["bytes"]);
    s.remove("buried");
    prune_to_one(&s.db);
    assert_eq!(heights(&s.db.snapshot(None).unwrap()), before);
    assert!(!segments(&s.path()).contains_key("00000001.tqs"));
    let tops = said.as_u64().unwrap() - (file - 32);
    assert!((12..1000).contains(&tops), "{tops}");
    let after = terraquilt::db::contributions(&s.db.snapshot(None).unwrap()).unwrap();
    for c in &after {
        assert_eq!(row(&c.name)["live"], c.live, "{}", c.name);
    }
}

#[test]
fn provenance_is_shares_by_area() {
    let s = Scratch::new(Policy::Accuracy);
    s.ingest(&grid("west", 0.0, 100, 1, 1));
    s.ingest(&grid("east", 60.0, 100, 0, 2));
    let db = s.path();
    let ask = |more: &[&str]| -> serde_json::Value {
        let args = [&["provenance", db.to_str().unwrap(), "--json"], more].concat();
        serde_json::from_str(&printed(&args)).unwrap()
    };
    // West shows its core, which ends one cell before its posts: x = 98 of 0 to 120; y from 10 to 90.
    let all = ask(&["--error", "0", "--bbox", "500020,4000010,500120,4000090"]);
    let shares = all["surveys"].as_array().unwrap();
    assert_eq!((&shares[0]["name"], &shares[1]["name"]), (&"west".into(), &"east".into()));
    let of = |k: usize, what: &str| shares[k][what].as_f64().unwrap();
    assert!((of(0, "share") - 0.78).abs() < 0.01, "{all}");
    assert!((of(0, "dominant_share") - 0.78).abs() < 0.01, "{all}");
    assert!((of(0, "share") + of(1, "share") - 1.0).abs() < 1e-9);
    assert_eq!(all["points"], all["points_with_data"]);
    assert!((39_000..41_000).contains(&all["points"].as_u64().unwrap()));
    // At the same points the patch that weighs most is the one that `dominant` names.
    let few = ask(&["--error", "0", "--bbox", "500090,4000010,500110,4000030", "--step", "1"]);
    assert_eq!((&few["points"], &few["step"]), (&400.into(), &serde_json::json!([1.0, 1.0])));
    let points: Vec<[f64; 2]> =
        (0..400).map(|k| [500_090.5 + (k % 20) as f64, 4_000_010.5 + (k / 20) as f64]).collect();
    let snapshot = s.db.snapshot(None).unwrap();
    let named = snapshot.dominant(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
    let west = snapshot.survey("west").unwrap().number;
    let n = named.iter().flatten().filter(|r| r.survey == west).count();
    let told = few["surveys"].as_array().unwrap().iter().find(|r| r["name"] == "west").unwrap();
    assert!((told["dominant_share"].as_f64().unwrap() - n as f64 / 400.0).abs() < 1e-12);
    // Nothing there, and nothing asked.
    let none = ask(&["--error", "0", "--bbox", "600000,4000000,600100,4000100"]);
    assert_eq!((&none["points_with_data"], &none["surveys"]), (&0.into(), &serde_json::json!([])));
    let text = printed(&["provenance", db.to_str().unwrap(), "--error", "5"]);
    assert!(text.contains("west") && text.contains("points"), "{text}");
    assert!(
        refused(&["provenance", db.to_str().unwrap(), "--error", "5", "--step", "0"], 1).contains("--step")
    );
    assert!(
        refused(&["provenance", db.to_str().unwrap(), "--error", "5", "--step", "0.001"], 1)
            .contains("at most")
    );
}
