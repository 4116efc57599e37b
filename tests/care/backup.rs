//! Backups and copies: while a writer commits, of damaged files, cut off, to wrong places.

use super::*;

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
    assert_eq!(state(&Db::open(&to).unwrap()), state(&s.db));
    // A backup that takes its lease just as a version is pruned leaves files for the next writer to sweep.
    let swept = s.db.prune(|_| Vec::new(), &mut || ()).unwrap();
    assert_eq!(swept.pruned, [0; 0]);
    assert_eq!(segments(&to), segments(&s.path()));
}

#[test]
fn what_is_committed_and_pruned_in_the_middle_of_a_backup_is_for_the_next() {
    let (s, _) = two_tiles();
    let to = s.folder.path().join("backup");
    let (before, stop, again) = (state(&s.db), AtomicBool::new(false), AtomicBool::new(false));
    // At the first byte that is copied, a writer removes what is being copied and prunes.
    let meanwhile = |stage: &str, _: f64| {
        if stage == "copying" && !again.swap(true, Ordering::AcqRel) {
            s.remove("pair");
            s.ingest(&grid("next", 10.0, 48, 3, 5));
            let o = prune_to_one(&s.db);
            assert_eq!(
                (o.pruned, o.kept_for_readers),
                (vec![3], vec![1, 2]),
                "the backup holds what it copies"
            );
        }
    };
    let o = s.db.backup(&to, None, &Progress { report: &meanwhile, stop: &stop }).unwrap();
    assert!(again.load(Ordering::Acquire));
    assert_eq!(o.versions, [1, 2]);
    let copy = Db::open(&to).unwrap();
    assert_eq!(state(&copy), before);
    verify(&copy);
    assert_eq!(prune_to_one(&s.db).pruned, [1, 2], "and lets go of it");
    let o = backup(&s.db, &to, None).unwrap();
    assert_eq!((o.versions, o.files_kept > 0, o.files_copied > 0), (vec![4], true, true));
    assert_eq!(state(&copy), state(&s.db));
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
    let others = at("backup-of-another");
    backup(&other.db, &others, None).unwrap();
    refused(&others, &["its constant 'identity' is another"]);
    let newest = Scratch::new(Policy::Newest);
    refused(&newest.path(), &["its constant", "another"]);
    assert_eq!(numbers(&Db::open(&others).unwrap()), [1], "what is refused stays as it was");
    // The two names the wrong way round: the database would become what its backup is.
    let one = at("one");
    backup(&s.db, &one, Some(2)).unwrap();
    let e = backup(&Db::open(&one).unwrap(), &s.path(), None).unwrap_err().to_string();
    assert!(e.contains("is a database, and was not made by `terraquilt backup`"), "{e}");
    assert_eq!(numbers(&s.db), [1, 2]);
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
