//! The program killed at random moments: what was acknowledged is never lost, what was not is there whole or not
//! at all, and nobody is in the way of those who come after.

use crate::support::{Random, ground, printed};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::height::crs::Crs;
use terraquilt::height::source::{Affine, SampleType};
use terraquilt::store::catalog::{Catalog, Sqlite};
use terraquilt::store::record::record_name;
use terraquilt::store::segment::file_name;

/// Noisy hills in whole metres on 10 m posts, written as an int16 GeoTIFF.
fn write_hills(path: &Path, side: usize, east: f64, seed: u64) {
    let mut r = Random::new(seed);
    let affine =
        Affine { origin: [500_000.0 + east, 4_100_000.0], col_step: [10.0, 0.0], row_step: [0.0, -10.0] };
    let spec = GeoTiffSpec {
        cols: side as u64,
        rows: side as u64,
        sample_type: SampleType::I16,
        affine: Some(affine),
        crs: Some(Crs::from_epsg(32610).unwrap()),
        nodata: Some("-32768".into()),
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    };
    let mut out = GeoTiffWriter::create(path, spec).unwrap();
    for j in 0..side {
        let row: Vec<u8> = (0..side)
            .flat_map(|i| {
                let z = ground(east + i as f64 * 3.0, j as f64 * 3.0) + r.unit() * 4.0;
                (z as i16).to_le_bytes()
            })
            .collect();
        out.write_rows(j as u64, &row).unwrap();
    }
    out.finish().unwrap();
}

fn start(args: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_terraquilt"))
        .args(args)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts")
}

fn timed(args: &[&str]) -> Duration {
    let started = Instant::now();
    printed(args);
    started.elapsed()
}

fn fingerprint(db: &str) -> String {
    printed(&["fingerprint", db]).trim().to_string()
}

fn versions(db: &str) -> Vec<u64> {
    let rows: serde_json::Value = serde_json::from_str(&printed(&["versions", db, "--json"])).unwrap();
    rows.as_array().unwrap().iter().map(|r| r["version"].as_u64().unwrap()).collect()
}

/// Files that no version names, as they are now: what a stopped writer leaves.
fn leftovers(db: &str) -> BTreeSet<(String, u64, std::time::SystemTime)> {
    let catalog = Sqlite::open_read_only(&Path::new(db).join("catalog.sqlite")).unwrap();
    let segments = catalog.all_files().unwrap().into_iter().map(|(n, _)| file_name(n));
    let records = catalog.versions().unwrap().into_iter().map(|v| record_name(v.number));
    let named: BTreeSet<String> = segments.chain(records).collect();
    std::fs::read_dir(Path::new(db).join("segments"))
        .unwrap()
        .map(|e| e.unwrap())
        .map(|e| (e.file_name().into_string().unwrap(), e.metadata().unwrap()))
        .filter(|(n, _)| !named.contains(n))
        .map(|(n, m)| (n, m.len(), m.modified().unwrap()))
        .collect()
}

/// Which surveys there are beside the first: none, the second, or its corrected delivery.
type World = usize;

struct Trial {
    db: String,
    first: PathBuf,
    second: PathBuf,
    corrected: PathBuf,
    folder: tempfile::TempDir,
}

impl Trial {
    fn new(side: usize) -> Trial {
        let folder = tempfile::tempdir().unwrap();
        let at = |n: &str| folder.path().join(n);
        let (first, second, corrected) = (at("first.tif"), at("second.tif"), at("corrected.tif"));
        write_hills(&first, side, 0.0, 1);
        write_hills(&second, side, side as f64 * 5.0, 2);
        write_hills(&corrected, side, side as f64 * 5.0, 3);
        let db = at("db").to_str().unwrap().to_string();
        printed(&["init", &db, "--crs", "EPSG:32610"]);
        let t = Trial { db, first, second, corrected, folder };
        printed(&["ingest", &t.db, t.first.to_str().unwrap(), "--accuracy", "1"]);
        t
    }

    fn ingest(&self) -> Vec<&str> {
        vec![
            "ingest",
            &self.db,
            self.second.to_str().unwrap(),
            "--accuracy",
            "1",
            "--name",
            "second",
            "--precedence",
            "1",
        ]
    }
    fn replace(&self, to: World) -> Vec<&str> {
        let file = if to == 2 { &self.corrected } else { &self.second };
        vec!["replace", &self.db, "second", file.to_str().unwrap()]
    }
    fn remove(&self) -> Vec<&str> {
        vec!["remove", &self.db, "second"]
    }
}

#[test]
fn two_hundred_kills_lose_nothing_that_was_acknowledged() {
    let started = Instant::now();
    let seed = crate::support::seeds(1)[0];
    println!("seed {seed}");
    let mut r = Random::new(seed + 4000);
    let t = Trial::new(1100);
    let db = t.db.as_str();

    // Each operation once, undisturbed: how long it takes, and the fingerprint of every world.
    let mut worlds = vec![fingerprint(db)];
    let mut durations: BTreeMap<&str, Duration> = BTreeMap::new();
    durations.insert("ingest", timed(&t.ingest()));
    worlds.push(fingerprint(db));
    durations.insert("replace", timed(&t.replace(2)));
    worlds.push(fingerprint(db));
    durations.insert("remove", timed(&t.remove()));
    assert_eq!(fingerprint(db), worlds[0]);
    assert!(worlds[0] != worlds[1] && worlds[1] != worlds[2]);
    durations.insert("prune", timed(&["prune", db, "--keep", "1"]));
    println!("undisturbed: {durations:?}");

    let mut world: World = 0;
    let mut phases: BTreeMap<&str, u64> = BTreeMap::new();
    let mut by_operation: BTreeMap<(&str, &str), u64> = BTreeMap::new();
    let (mut kills, mut tries, mut alone) = (0, 0, 0);
    while kills < 200 {
        // Most ingests are stopped; now and then one is let through, so that there is something to take out.
        alone = if world == 0 { alone + 1 } else { 0 };
        if alone > 4 {
            printed(&t.ingest());
            world = 1;
        }
        tries += 1;
        assert!(tries < 1000, "only {kills} of {tries} came in time");
        let before = versions(db);
        let old_leftovers = leftovers(db);
        let keep = (1 + r.below(2)) as usize;
        let keep_text = keep.to_string();
        let (name, args, then): (&str, Vec<&str>, World) = match (world, r.below(10)) {
            (_, 0) if before.len() > keep => ("prune", vec!["prune", db, "--keep", &keep_text], world),
            (0, _) => ("ingest", t.ingest(), 1),
            (_, 1..=5) => ("remove", t.remove(), 0),
            (w, _) => ("replace", t.replace(3 - w), 3 - w),
        };
        let mut child = start(&args);
        std::thread::sleep(durations[name].mul_f64(r.unit() * 1.05));
        child.kill().unwrap();
        let status = child.wait().unwrap();
        let mut told = String::new();
        child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
        assert!(status.success() || status.signal() == Some(9), "try {tries}, {args:?}: {status} {told}");
        kills += u64::from(!status.success());

        let left = leftovers(db);
        let after = versions(db);
        let expected: Vec<u64> = match name {
            "prune" => before[before.len() - keep..].to_vec(),
            _ => before.iter().copied().chain([before.last().unwrap() + 1]).collect(),
        };
        let place =
            format!("seed {seed}, try {tries}: {args:?}, {status}: versions {before:?} became {after:?}");
        assert!(after == before || after == expected, "{place}");
        let done = after == expected;
        assert!(done || !status.success(), "{place}: acknowledged, and lost");
        world = if done { then } else { world };
        assert_eq!(fingerprint(db), worlds[world], "{place}");
        let began = left.difference(&old_leftovers).next().is_some();
        let phase = match (status.success(), done, began) {
            (true, _, _) => "finished before the kill",
            (_, true, _) => "after the commit",
            (_, _, true) => "between the first write and the commit",
            _ => "before the first write",
        };
        *phases.entry(phase).or_default() += 1;
        *by_operation.entry((name, phase)).or_default() += 1;
        if tries % 20 == 0 {
            printed(&["verify", db]);
        }
    }
    // The next commit sweeps what the stopped ones left.
    let ended = if world == 0 { t.ingest() } else { t.remove() };
    printed(&ended);
    assert!(leftovers(db).is_empty(), "{:?}", leftovers(db));
    printed(&["verify", db]);
    println!("{kills} kills in {tries} tries: {phases:#?}");
    by_operation.iter().for_each(|((name, phase), n)| println!("  {name}, {phase}: {n}"));
    println!("{:.1} s", started.elapsed().as_secs_f64());
    let between = phases.get("between the first write and the commit").copied().unwrap_or(0);
    assert!(between >= 20, "only {between} kills between the first write and the commit");
}

#[test]
fn a_killed_reader_no_longer_keeps_its_version() {
    let t = Trial::new(400);
    let db = t.db.as_str();
    printed(&t.ingest());
    // A reader that nobody reads from: it waits with its snapshot open.
    let mut reader = Command::new(env!("CARGO_BIN_EXE_terraquilt"))
        .args(["boxes", db, "--at", "1"])
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let readers = Path::new(db).join("readers");
    let waiting_since = Instant::now();
    while std::fs::read_dir(&readers).unwrap().next().is_none() {
        assert!(waiting_since.elapsed() < Duration::from_secs(20), "no lease appears");
        std::thread::sleep(Duration::from_millis(2));
    }
    // The lease is there before its lock is: wait for the first bytes of the answer.
    let mut first = [0; 1];
    reader.stdout.as_mut().unwrap().read_exact(&mut first).unwrap();
    let prune = || -> serde_json::Value {
        serde_json::from_str(&printed(&["prune", db, "--keep", "1", "--json"])).unwrap()
    };
    let o = prune();
    assert_eq!((&o["pruned"], &o["kept_for_readers"]), (&serde_json::json!([]), &serde_json::json!([1])));
    assert_eq!(versions(db), [1, 2]);
    reader.kill().unwrap();
    reader.wait().unwrap();
    let o = prune();
    assert_eq!((&o["pruned"], &o["kept_for_readers"]), (&serde_json::json!([1]), &serde_json::json!([])));
    assert_eq!(std::fs::read_dir(&readers).unwrap().count(), 0, "its lease is swept");
    assert_eq!(versions(db), [2]);
    drop(t.folder);
}

#[test]
fn ctrl_c_stops_an_ingest_and_changes_nothing() {
    let t = Trial::new(1100);
    let db = t.db.as_str();
    let before = (fingerprint(db), versions(db));
    let old = leftovers(db);
    let mut child = start(&t.ingest());
    let waiting_since = Instant::now();
    while leftovers(db) == old {
        assert!(waiting_since.elapsed() < Duration::from_secs(20), "no write begins");
    }
    let interrupted = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    if !interrupted.is_ok_and(|s| s.success()) {
        println!("no `kill` program here: skipped");
        child.wait().unwrap();
        return;
    }
    let status = child.wait().unwrap();
    let mut told = String::new();
    child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
    if status.success() {
        println!("the ingest was too fast: skipped");
        return;
    }
    assert_eq!(status.code(), Some(1), "{told}");
    assert!(told.contains("error: stopped; nothing was changed"), "{told}");
    assert_eq!((fingerprint(db), versions(db)), before);
    assert!(leftovers(db).is_empty(), "{:?}", leftovers(db));
    printed(&t.ingest());
}
