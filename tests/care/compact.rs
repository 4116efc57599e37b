//! Bytes that are really gone, and readers that notice nothing.

use super::*;

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

#[test]
fn prune_before_a_version_leaves_it_and_what_readers_hold() {
    let (s, _) = two_tiles();
    s.remove("over");
    s.ingest(&grid("more", 5.0, 40, 0, 9));
    let path = s.path();
    let prune = |before: &str| -> serde_json::Value {
        serde_json::from_str(&printed(&["prune", path.to_str().unwrap(), "--before", before, "--json"]))
            .unwrap()
    };
    let records = || -> Vec<u64> {
        let names = s.db.disk().names().unwrap();
        names.iter().filter_map(|(n, _)| n.strip_suffix(".tqv")?.parse().ok()).collect()
    };
    let kept = state(&s.db);
    let reader = s.db.snapshot(Some(1)).unwrap();
    let o = prune("3");
    assert_eq!((&o["pruned"], &o["kept_for_readers"]), (&serde_json::json!([2]), &serde_json::json!([1])));
    assert_eq!((numbers(&s.db), records()), (vec![1, 3, 4], vec![1, 3, 4]), "a record goes with its version");
    assert_eq!(terraquilt::db::fingerprint(&reader).unwrap(), kept[&1]);
    drop(reader);
    assert_eq!(prune("3")["pruned"], serde_json::json!([1]));
    assert_eq!((numbers(&s.db), records()), (vec![3, 4], vec![3, 4]));
    assert_eq!(prune("99")["pruned"], serde_json::json!([3]), "the latest stays");
    assert_eq!((numbers(&s.db), records()), (vec![4], vec![4]));
    verify(&s.db);
}
