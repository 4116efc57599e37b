//! A catalog that was lost or damaged, made again from the version records.

use super::*;

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
fn a_process_that_has_committed_finds_the_catalog_that_was_made_again() {
    let (s, _) = two_tiles();
    let path = s.path();
    std::fs::write(path.join("catalog.sqlite"), b"spoiled").unwrap();
    assert_eq!(terraquilt::db::rebuild(&path, &mut || ()).unwrap().versions, [1, 2]);
    let made = change(&s.db, Change::Ingest(grid("new", 5.0, 40, 2, 6).ingest())).unwrap();
    assert_eq!(made.version, 3);
    assert_eq!(numbers(&Db::open(&path).unwrap()), [1, 2, 3]);
    verify(&s.db);
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
    change(&db, Change::Remove { surveys: vec!["new ground".into()], tile: None }).unwrap();
    let before = state(&db);
    assert_eq!(before.len(), 4);
    drop(db);
    lose_catalog(&path);
    terraquilt::db::rebuild(&path, &mut || ()).unwrap();
    let db = Db::open(&path).unwrap();
    assert_eq!(state(&db), before);
    verify(&db);
}
