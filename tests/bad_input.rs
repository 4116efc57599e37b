//! What people get wrong and what disks do: a clear line that names the file and says what to do, exit 1, and the
//! database as it was.

use crate::support::{Random, change, ground, printed, program, refused, seeds, shared};
use std::collections::BTreeSet;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Change, Db, Progress, Snapshot};
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::height::crs::Crs;
use terraquilt::height::source::{Affine, SampleType, Window};
use terraquilt::height::surface::Blend;
use terraquilt::store::lock::WriterLock;

/// A GeoTIFF to write: 1 m posts in UTM 10 unless said otherwise.
struct Picture {
    side: usize,
    east: f64,
    epsg: Option<u32>,
    placed: bool,
    z: Box<dyn Fn(usize, usize) -> f32>,
}

impl Default for Picture {
    fn default() -> Picture {
        let z = |i: usize, j: usize| ground(i as f64, j as f64).round() as f32;
        Picture { side: 40, east: 0.0, epsg: Some(32610), placed: true, z: Box::new(z) }
    }
}

impl Picture {
    fn write(&self, path: &Path) {
        let affine = Affine {
            origin: [500_000.0 + self.east, 4_000_000.0],
            col_step: [1.0, 0.0],
            row_step: [0.0, -1.0],
        };
        let spec = GeoTiffSpec {
            cols: self.side as u64,
            rows: self.side as u64,
            sample_type: SampleType::F32,
            affine: self.placed.then_some(affine),
            crs: self.epsg.map(|c| Crs::from_epsg(c).unwrap()),
            nodata: None,
            scale: 1.0,
            offset: 0.0,
            vertical_datum: None,
        };
        let mut out = GeoTiffWriter::create(path, spec).unwrap();
        for j in 0..self.side {
            let row: Vec<u8> = (0..self.side).flat_map(|i| (self.z)(i, j).to_le_bytes()).collect();
            out.write_rows(j as u64, &row).unwrap();
        }
        out.finish().unwrap();
    }
}

/// A folder with a database in it that holds one survey, `hill`.
struct Room {
    folder: tempfile::TempDir,
    db: String,
}

impl Room {
    fn new() -> Room {
        Room::with(&["--crs", "EPSG:32610"])
    }

    fn with(init: &[&str]) -> Room {
        let folder = tempfile::tempdir().unwrap();
        let db = folder.path().join("db").to_str().unwrap().to_string();
        printed(&[&["init", &db], init].concat());
        Room { folder, db }
    }

    fn with_hill() -> Room {
        let r = Room::new();
        let hill = r.picture("hill.tif", Picture::default());
        printed(&["ingest", &r.db, &hill, "--accuracy", "1"]);
        r
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn text_path(&self, name: &str) -> String {
        self.path(name).to_str().unwrap().to_string()
    }

    fn picture(&self, name: &str, p: Picture) -> String {
        p.write(&self.path(name));
        self.text_path(name)
    }

    fn file(&self, name: &str, bytes: impl AsRef<[u8]>) -> String {
        std::fs::write(self.path(name), bytes).unwrap();
        self.text_path(name)
    }

    /// What must not change.
    fn state(&self) -> (String, String) {
        (printed(&["fingerprint", &self.db]), printed(&["versions", &self.db, "--json"]))
    }

    /// The call is refused in one line that holds these words; the database is as before. Gives the line.
    fn complaint(&self, args: &[&str], words: &[&str]) -> String {
        let before = self.state();
        let line = complaint(args, words);
        assert_eq!(self.state(), before, "{args:?} changed something");
        line
    }
}

/// One `error:` line with these words, exit 1, nothing on stdout. Printed, so that a person can read them all.
fn complaint(args: &[&str], words: &[&str]) -> String {
    let text = refused(args, 1);
    println!("{}", text.trim_end());
    let lines: Vec<&str> = text.lines().filter(|l| !l.starts_with("note: ")).collect();
    assert!(lines.len() == 1 && lines[0].starts_with("error: "), "{args:?}: not one line: {text}");
    for w in words {
        assert!(lines[0].contains(w), "{args:?}: no '{w}' in: {text}");
    }
    lines[0].to_string()
}

/// The program neither crashed nor was killed.
fn lived(out: &Output) -> i32 {
    let told = String::from_utf8_lossy(&out.stderr);
    assert!(!told.contains("panicked"), "{told}");
    let code = out.status.code().unwrap_or_else(|| panic!("ended by a signal: {} {told}", out.status));
    assert!(code == 0 || code == 1, "exit {code}: {told}");
    assert!(code == 0 || told.contains("error:") || !out.stdout.is_empty(), "exit 1 without a word");
    code
}

#[test]
fn malformed_files_of_other_projects_are_refused_by_name() {
    if shared("difficult").is_none() {
        return;
    }
    let room = Room::with(&["--crs", "EPSG:4326"]);
    for name in [
        "corrupt_zstd_block.tif",
        "empty.tif",
        "huge_dimensions.tif",
        "ifd_loop.tif",
        "real_corrupt_jpeg.tif",
        "real_fuzz_graydepth.tif",
        "strip_offset_past_end.tif",
        "truncated_half.tif",
        "truncated_header.tif",
    ] {
        let file = shared(&format!("difficult/{name}")).expect("the folder is there");
        room.complaint(&["ingest", &room.db, file.to_str().unwrap(), "--accuracy", "5"], &[name]);
    }
}

/// A good file cut short at random places is refused, or is still whole where it matters.
fn cut_anywhere(room: &Room, good: &Path, accept: &str, seed: u64) -> (u64, u64) {
    let whole = Room::with(&["--crs", accept]);
    printed(&["ingest", &whole.db, good.to_str().unwrap(), "--accuracy", "5", "--name", "cut"]);
    let bytes = std::fs::read(good).unwrap();
    let name = good.file_name().unwrap().to_str().unwrap();
    let mut r = Random::new(seed);
    let (mut refusals, mut whole_ones) = (0, 0);
    for _ in 0..50 {
        let file = room.file(name, &bytes[..r.below(bytes.len() as u64) as usize]);
        let args = ["ingest", &room.db, &file, "--accuracy", "5", "--name", "cut"];
        let out = program(&args);
        if lived(&out) == 0 {
            assert_eq!(room.state().0, whole.state().0, "accepted, so it holds what the whole file holds");
            printed(&["remove", &room.db, "cut"]);
            whole_ones += 1;
        } else {
            let told = String::from_utf8_lossy(&out.stderr);
            assert!(told.starts_with("error: ") && told.contains(name), "{told}");
            refusals += 1;
        }
    }
    (refusals, whole_ones)
}

#[test]
fn files_cut_short_anywhere_are_refused_or_whole() {
    for seed in seeds(1) {
        let room = Room::new();
        let own = room.picture("own.tif", Picture { side: 300, ..Picture::default() });
        let own = PathBuf::from(own);
        let (refused, whole) = cut_anywhere(&room, &own, "EPSG:32610", seed);
        println!("seed {seed}: own.tif: {refused} cuts refused, {whole} whole");
        for name in ["reference_int16.tif", "int16_bigendian_stripped_lzw_p2.tif", "cog_overviews.tif"] {
            let Some(file) = shared(&format!("difficult/{name}")) else { return };
            let room = Room::with(&["--crs", "EPSG:4326"]);
            let (refused, whole) = cut_anywhere(&room, &file, "EPSG:4326", seed);
            println!("seed {seed}: {name}: {refused} cuts refused, {whole} whole");
        }
    }
}

#[test]
fn an_hgt_tile_of_no_known_size_or_place_is_refused() {
    let room = Room::with(&["--crs", "EPSG:4326"]);
    let file = room.file("N10W110.hgt", vec![0; 1201 * 1201 * 2 - 2]);
    room.complaint(&["ingest", &room.db, &file], &["N10W110.hgt", "2884802"]);
    let file = room.file("nowhere.hgt", vec![0; 1201 * 1201 * 2]);
    room.complaint(&["ingest", &room.db, &file], &["nowhere.hgt", "rename"]);
    let file = room.file("N10W111.hgt", [0x80, 0].repeat(1201 * 1201));
    room.complaint(&["ingest", &room.db, &file], &["N10W111.hgt", "no valid sample"]);
}

#[test]
fn samples_that_are_no_numbers_are_voids_and_counted() {
    let room = Room::new();
    let z = |i: usize, j: usize| match (i, j) {
        (3, 3..=5) => f32::NAN,
        (20, 7) | (21, 7) => f32::INFINITY,
        (30, 30) => f32::NEG_INFINITY,
        _ => 100.0,
    };
    let file = room.picture("odd.tif", Picture { z: Box::new(z), ..Picture::default() });
    let told = printed(&["ingest", &room.db, &file, "--accuracy", "1", "--json"]);
    let told: serde_json::Value = serde_json::from_str(&told).unwrap();
    assert_eq!((&told["posts"], &told["voids"]), (&1600.into(), &6.into()));
    printed(&["verify", &room.db]);

    let file = room.picture("void.tif", Picture { z: Box::new(|_, _| f32::NAN), ..Picture::default() });
    room.complaint(
        &["ingest", &room.db, &file, "--accuracy", "1"],
        &["void.tif", "no valid sample", "--nodata"],
    );
}

/// Overwrites the value of a field of the first directory of a little-endian classic TIFF.
fn set_tag(tiff: &mut [u8], tag: u16, value: u32) {
    let u16_at = |b: &[u8], at: usize| u16::from_le_bytes(b[at..at + 2].try_into().unwrap());
    let ifd = u32::from_le_bytes(tiff[4..8].try_into().unwrap()) as usize;
    let entry = (0..usize::from(u16_at(tiff, ifd)))
        .map(|k| ifd + 2 + 12 * k)
        .find(|at| u16_at(tiff, *at) == tag)
        .expect("the field is there");
    tiff[entry + 2..entry + 4].copy_from_slice(&4u16.to_le_bytes());
    tiff[entry + 4..entry + 8].copy_from_slice(&1u32.to_le_bytes());
    tiff[entry + 8..entry + 12].copy_from_slice(&value.to_le_bytes());
}

#[test]
fn a_header_that_promises_billions_of_pixels_costs_nothing() {
    let room = Room::with_hill();
    let mut bytes = std::fs::read(room.path("hill.tif")).unwrap();
    set_tag(&mut bytes, 256, 63_246);
    set_tag(&mut bytes, 257, 63_246);
    let file = room.file("huge.tif", &bytes);
    let before = room.state();
    let started = Instant::now();
    // In 4 GiB of address space: 16 GB of samples would not fit.
    let out = Command::new("sh")
        .args(["-c", "ulimit -v 4194304; exec \"$0\" \"$@\"", env!("CARGO_BIN_EXE_terraquilt")])
        .args(["ingest", &room.db, &file, "--accuracy", "1"])
        .output()
        .unwrap();
    let told = String::from_utf8_lossy(&out.stderr);
    println!("{}", told.trim_end());
    assert_eq!(out.status.code(), Some(1), "{told}");
    assert!(told.starts_with("error: ") && told.contains("huge.tif"), "{told}");
    assert!(started.elapsed() < Duration::from_secs(5));
    assert_eq!(room.state(), before);
}

#[test]
fn what_a_file_does_not_say_is_asked_for() {
    let room = Room::with_hill();
    let db = room.db.as_str();
    let plain = room.picture("plain.tif", Picture { east: 100.0, ..Picture::default() });
    let nowhere = room.picture("nowhere.tif", Picture { placed: false, ..Picture::default() });
    let no_crs = room.picture("nocrs.tif", Picture { epsg: None, ..Picture::default() });
    let other = room.picture("other.tif", Picture { epsg: Some(26710), ..Picture::default() });
    let small = room.picture("small.tif", Picture { side: 3, ..Picture::default() });
    for (args, words) in [
        (vec![&nowhere[..], "--accuracy", "1"], vec!["nowhere.tif", "georeference", "gdal_translate"]),
        (vec![&no_crs, "--accuracy", "1"], vec!["nocrs.tif", "--crs EPSG:32610"]),
        (vec![&other, "--accuracy", "1"], vec!["EPSG:26710", "EPSG:32610", "datum"]),
        (vec![&other, "--accuracy", "1", "--datum-shift", "1,2"], vec!["datum shift", "1,2"]),
        (vec![&plain, "--accuracy", "1", "--crs", "EPSG:99999"], vec!["EPSG:99999"]),
        (vec![&plain, "--accuracy", "1", "--crs", "WGS84"], vec!["WGS84", "EPSG:n"]),
        (vec![&plain, "--accuracy", "1", "--crs", "EPSG:26711"], vec!["EPSG:26711", "datum"]),
        (vec![&plain], vec!["plain.tif", "--accuracy"]),
        (vec![&plain, "--accuracy", "-1"], vec!["--accuracy", "-1"]),
        (vec![&plain, "--accuracy", "nan"], vec!["--accuracy"]),
        (vec![&plain, "--accuracy", "inf"], vec!["--accuracy"]),
        (vec![&plain, "--accuracy", "1", "--date", "2026-02-30"], vec!["2026-02-30", "YYYY-MM-DD"]),
        (vec![&plain, "--accuracy", "1", "--date", "yesterday"], vec!["yesterday", "YYYY-MM-DD"]),
        (vec![&plain, "--accuracy", "1", "--lattice", "1,2"], vec!["--lattice", "1,2"]),
        (vec![&plain, "--accuracy", "1", "--lattice", "0,1,0,0"], vec!["--lattice"]),
        (vec![&plain, "--accuracy", "1", "--name", ""], vec!["--name"]),
        (vec![&plain, "--accuracy", "1", "--name", "hill"], vec!["hill", "--into"]),
        (vec![&plain, "--into", "nobody"], vec!["nobody", "terraquilt surveys"]),
        (vec![&plain, "--into", "hill", "--accuracy", "2"], vec!["hill", "--accuracy"]),
        (vec![&small, "--accuracy", "1"], vec!["small.tif", "4 x 4"]),
        (vec![room.folder.path().to_str().unwrap(), "--accuracy", "1"], vec!["directory"]),
        (vec!["no/such/file.tif", "--accuracy", "1"], vec!["no/such/file.tif", "not found"]),
        (vec![&plain, "no/such/other.tif", "--accuracy", "1"], vec!["no/such/other.tif", "not found"]),
        (vec!["/dev/null", "--accuracy", "1"], vec!["/dev/null"]),
    ] {
        room.complaint(&[&["ingest", db], &args[..]].concat(), &words);
    }
    let newest = Room::with(&["--crs", "EPSG:32610", "--policy", "newest"]);
    newest.complaint(&["ingest", &newest.db, &plain, "--accuracy", "1"], &["plain", "--date"]);
}

#[test]
fn bad_text_files_and_questions_are_refused() {
    let room = Room::with_hill();
    let db = room.db.as_str();
    let ask = |points: &str| ["heights", db, "--error", "1", "--points", points].map(str::to_string);
    for (name, text, words) in [
        ("words.csv", "1,2\nthree,four\n", vec!["words.csv", "line 2", "three,four"]),
        ("header.csv", "a,b\n1,2\n", vec!["header.csv", "line 1", "a,b"]),
        ("short.csv", "x,y\n\n# a comment\n500000\n", vec!["short.csv", "line 4"]),
        ("nan.csv", "x,y\nnan,4\n", vec!["nan.csv", "line 2"]),
    ] {
        let file = room.file(name, text);
        let args = ask(&file);
        room.complaint(&args.each_ref().map(String::as_str), &words);
    }
    let binary = room.file("binary.csv", [0xff, 0xfe, 0, 1]);
    room.complaint(&ask(&binary).each_ref().map(String::as_str), &["binary.csv"]);
    room.complaint(&ask("no.csv").each_ref().map(String::as_str), &["no.csv"]);
    let out = room.text_path("out.xyz");
    let plain = room.text_path("out");
    let glb = room.text_path("out.glb");
    let below = room.text_path("none/out.tif");
    for (args, words) in [
        (vec!["heights", db, "--error", "1"], vec!["points", "--points"]),
        (vec!["heights", db, "--error", "1", "5"], vec!["'5'"]),
        (vec!["heights", db, "--error", "1", "5,inf"], vec!["finite"]),
        (vec!["heights", db, "--error", "-1", "5,5"], vec!["--error", "-1"]),
        (vec!["heights", db, "--error", "nan", "5,5"], vec!["--error"]),
        (vec!["heights", db, "--error", "1", "5,5", "--at", "9"], vec!["version 9", "terraquilt versions"]),
        (vec!["patches", db, "--error", "1", "--bbox", "5,5,5,9"], vec!["--bbox", "empty"]),
        (vec!["patches", db, "--error", "1", "--bbox", "9,5,5,9"], vec!["--bbox", "empty"]),
        (vec!["patches", db, "--error", "1", "--bbox", "1,2,3"], vec!["--bbox", "3 found"]),
        (vec!["patches", db, "--error", "1", "--bbox", "a,b,c,d"], vec!["--bbox", "a,b,c,d"]),
        (vec!["patches", db, "--error", "1", "--since", "7"], vec!["version 7"]),
        (vec!["patches", db, "--eye", "1,2", "--look-at", "1,2,3"], vec!["--eye"]),
        (vec!["patches", db, "--eye", "1,2,3", "--look-at", "1,2,3"], vec!["eye"]),
        (
            vec!["patches", db, "--eye", "1,2,9", "--look-at", "5,2,3", "--viewport", "wide"],
            vec!["--viewport"],
        ),
        (vec!["patches", db, "--eye", "1,2,9", "--look-at", "5,2,3", "--fov", "0"], vec!["fov"]),
        (vec!["patches", db, "--eye", "1,2,9", "--look-at", "5,2,3", "--pixels", "0"], vec!["pixels"]),
        (vec!["export", db, &out, "--error", "1"], vec!["out.xyz", ".glb", ".tif", ".png"]),
        (vec!["export", db, &plain, "--error", "1"], vec!["out", ".glb"]),
        (vec!["export", db, &glb, "--error", "1", "--bbox", "0,0,1,1"], vec!["region", "no data"]),
        (vec!["export", db, &glb, "--survey", "hill", "--error", "1"], vec![".tif"]),
        (vec!["export", db, &below, "--error", "1"], vec!["none"]),
        (vec!["export", db, &room.text_path("a.tif"), "--error", "1", "--step", "0"], vec!["--step"]),
        (vec!["export", db, &room.text_path("a.tif"), "--error", "1", "--step", "1e-9"], vec!["--step"]),
        (vec!["tiles", db, "nobody"], vec!["nobody", "terraquilt surveys"]),
        (vec!["remove", db, "nobody"], vec!["nobody", "terraquilt surveys"]),
        (vec!["remove", db, "hill", "nobody"], vec!["nobody"]),
        (vec!["set", db, "nobody", "--precedence", "1"], vec!["nobody"]),
        (vec!["set", db, "hill", "--date", "1-2-3"], vec!["1-2-3", "YYYY-MM-DD"]),
        (vec!["replace", db, "nobody", &room.text_path("hill.tif")], vec!["nobody"]),
        (vec!["remove", db, "hill", "--tile", "nothing.tif"], vec!["nothing.tif", "terraquilt tiles"]),
        (vec!["prune", db, "--keep", "0"], vec!["--keep", "at least 1"]),
        (vec!["init", db, "--crs", "EPSG:32610"], vec!["database already"]),
        (vec!["init", &room.text_path("hill.tif"), "--crs", "EPSG:32610"], vec!["hill.tif"]),
        (vec!["init", &room.text_path("new"), "--crs", "EPSG:1"], vec!["EPSG:1"]),
        (vec!["init", room.folder.path().to_str().unwrap(), "--crs", "EPSG:32610"], vec!["not empty"]),
    ] {
        room.complaint(&args, &words);
    }
    let names: BTreeSet<String> = std::fs::read_dir(room.folder.path())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|n| n.starts_with("out") || n.starts_with('.') || n == "new")
        .collect();
    assert!(names.is_empty(), "half a file stays: {names:?}");
}

#[test]
fn a_tile_that_is_not_named_clearly_is_not_guessed() {
    let room = Room::new();
    let db = room.db.as_str();
    let (a, b) = (room.path("a"), room.path("b"));
    for (folder, east) in [(&a, 0.0), (&b, 40.0)] {
        std::fs::create_dir(folder).unwrap();
        Picture { east, ..Picture::default() }.write(&folder.join("same.tif"));
    }
    let files = [a.join("same.tif"), b.join("same.tif")];
    let files = files.each_ref().map(|f| f.to_str().unwrap());
    printed(&["ingest", db, files[0], files[1], "--accuracy", "1", "--name", "pair"]);
    let out = room.text_path("pair.tif");
    room.complaint(&["export", db, &out, "--survey", "pair", "--error", "0"], &["2 tiles", "--tile"]);
    // Every key starts with nothing at all.
    room.complaint(&["remove", db, "pair", "--tile", ""], &["terraquilt tiles"]);
    room.complaint(&["remove", db, "pair", "pair2", "--tile", "x"], &["--tile", "one survey"]);
    room.complaint(
        &["export", db, &out, "--survey", "pair", "--tile", "zzzz", "--error", "0"],
        &["zzzz", "terraquilt tiles"],
    );
    let tiles: serde_json::Value = serde_json::from_str(&printed(&["tiles", db, "pair", "--json"])).unwrap();
    let shown: Vec<&str> = tiles.as_array().unwrap().iter().map(|t| t["file"].as_str().unwrap()).collect();
    println!("{shown:?}");
    if shown[0] == shown[1] {
        room.complaint(&["remove", db, "pair", "--tile", shown[0]], &["same.tif", "terraquilt tiles"]);
    }
}

#[test]
fn a_survey_is_exported_as_delivered_without_naming_an_error() {
    let room = Room::with_hill();
    printed(&["export", &room.db, &room.text_path("back.tif"), "--survey", "hill"]);
    let read = |name: &str| {
        let mut s = terraquilt::format::open(&room.path(name)).unwrap();
        s.read(Window { col: 0, row: 0, cols: 40, rows: 40 }).unwrap()
    };
    assert_eq!(read("back.tif"), read("hill.tif"));
}

#[test]
fn a_refused_ingest_leaves_no_bytes_behind() {
    let room = Room::with_hill();
    let files = || std::fs::read_dir(Path::new(&room.db).join("segments")).unwrap().count();
    let before = files();
    let void = room.picture("void.tif", Picture { z: Box::new(|_, _| f32::NAN), ..Picture::default() });
    room.complaint(&["ingest", &room.db, &void, "--accuracy", "1"], &["no valid sample"]);
    assert_eq!(files(), before);
    let good = Picture { side: 300, ..Picture::default() };
    let good = std::fs::read(room.picture("good.tif", good)).unwrap();
    let mut bad = good.clone();
    let middle = bad.len() / 2;
    bad[middle..middle + 64].fill(0);
    let bad = room.file("bad.tif", &bad);
    room.complaint(&["ingest", &room.db, &bad, "--accuracy", "1"], &["bad.tif"]);
    assert_eq!(files(), before);
}

#[test]
fn an_init_that_was_cut_off_can_be_repeated() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db");
    for d in ["segments", "readers"] {
        std::fs::create_dir_all(db.join(d)).unwrap();
    }
    std::fs::write(db.join("catalog.new"), "cut off").unwrap();
    let db = db.to_str().unwrap();
    printed(&["init", db, "--crs", "EPSG:32610"]);
    printed(&["verify", db]);
}

#[test]
fn what_is_no_database_is_said_to_be_none() {
    let room = Room::with_hill();
    let file = room.text_path("hill.tif");
    let reading = |db: &str, words: &[&str]| {
        for command in ["surveys", "versions", "info", "fingerprint", "verify", "boxes"] {
            complaint(&[command, db], words);
        }
        complaint(&["heights", db, "--error", "1", "0,0"], words);
        complaint(&["ingest", db, &file, "--accuracy", "1"], words);
        complaint(&["remove", db, "hill"], words);
        complaint(&["prune", db, "--keep", "1"], words);
    };
    reading("no/such/database", &["no/such/database", "not found", "terraquilt init"]);
    let empty = room.text_path("empty");
    std::fs::create_dir(&empty).unwrap();
    reading(&empty, &[&empty]);
    reading(&file, &[&file]);
    assert!(std::fs::read_dir(&empty).unwrap().next().is_none(), "nothing is made there");

    let junk = room.path("junk");
    std::fs::create_dir(&junk).unwrap();
    std::fs::write(junk.join("catalog.sqlite"), "not a catalog at all, but long enough to be one".repeat(40))
        .unwrap();
    reading(junk.to_str().unwrap(), &["catalog"]);
    let nothing = room.path("nothing");
    std::fs::create_dir(&nothing).unwrap();
    std::fs::write(nothing.join("catalog.sqlite"), "").unwrap();
    reading(nothing.to_str().unwrap(), &["catalog"]);
}

/// Changes the catalog behind the program's back.
fn meddle(db: &str, sql: &str) {
    let c = rusqlite::Connection::open(Path::new(db).join("catalog.sqlite")).unwrap();
    c.execute_batch(sql).unwrap();
    c.pragma_update(None, "wal_checkpoint", "TRUNCATE").unwrap_or(());
}

#[test]
fn a_database_of_a_newer_program_is_refused_not_guessed_at() {
    for (sql, words) in [
        ("UPDATE constant SET value = '4' WHERE name = 'format_version'", ["format 4", "newer terraquilt"]),
        ("UPDATE constant SET value = '9' WHERE name = 'margin'", ["margin", "newer terraquilt"]),
        (
            "INSERT INTO refinery_schema_history VALUES (99, 'later', '2030-01-01T00:00:00Z', '1')",
            ["schema 99", "newer terraquilt"],
        ),
    ] {
        let room = Room::with_hill();
        meddle(&room.db, sql);
        let file = room.text_path("hill.tif");
        complaint(&["surveys", &room.db], &words);
        complaint(&["ingest", &room.db, &file, "--accuracy", "1", "--name", "x"], &words);
        complaint(&["prune", &room.db, "--keep", "1"], &words);
    }
    for (sql, words) in [
        ("DELETE FROM constant WHERE name = 'crs'", ["catalog.sqlite", "crs"]),
        (
            "UPDATE constant SET value = 'one' WHERE name = 'format_version'",
            ["catalog.sqlite", "format_version"],
        ),
        ("UPDATE version SET root = x'00'", ["catalog.sqlite", "root"]),
    ] {
        let room = Room::with_hill();
        meddle(&room.db, sql);
        complaint(&["fingerprint", &room.db], &words);
    }
}

#[test]
fn a_second_writer_says_that_it_waits_and_then_succeeds() {
    let room = Room::new();
    let file = room.picture("hill.tif", Picture::default());
    let lock = WriterLock::take(Path::new(&room.db), &mut || panic!("nobody else writes")).unwrap();
    let mut second = Command::new(env!("CARGO_BIN_EXE_terraquilt"))
        .args(["ingest", &room.db, &file, "--accuracy", "1"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut told = String::new();
    BufReader::new(second.stderr.take().unwrap()).read_line(&mut told).unwrap();
    println!("{}", told.trim_end());
    assert!(told.contains("waiting"), "{told}");
    assert_eq!(printed(&["versions", &room.db, "--json"]).trim(), "[]", "readers do not wait");
    drop(lock);
    assert!(second.wait().unwrap().success());
    assert!(printed(&["surveys", &room.db]).contains("hill"));

    // Eight at once.
    let names: Vec<String> = (0..8).map(|k| format!("many{k}")).collect();
    let all: Vec<_> = names
        .iter()
        .map(|n| {
            Command::new(env!("CARGO_BIN_EXE_terraquilt"))
                .args(["ingest", &room.db, &file, "--accuracy", "1", "--name", n])
                .stdout(Stdio::piped())
                .stderr(Stdio::piped())
                .spawn()
                .unwrap()
        })
        .collect();
    for child in all {
        let out = child.wait_with_output().unwrap();
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    }
    let rows: serde_json::Value = serde_json::from_str(&printed(&["versions", &room.db, "--json"])).unwrap();
    assert_eq!(rows.as_array().unwrap().len(), 9);
    printed(&["verify", &room.db]);
}

/// Height and error at each point, bit for bit; none outside.
type Answer = Vec<Option<(u64, u64)>>;

/// Heights on a fine raster over both surveys; an error is an answer, too.
fn heights(s: &Snapshot, error_m: f64) -> Result<Answer, String> {
    let points: Vec<[f64; 2]> = (0..24)
        .flat_map(|a| {
            (0..16).map(move |b| [500_000.3 + 2.6 * f64::from(a), 3_999_999.7 - 2.6 * f64::from(b)])
        })
        .collect();
    let found = s.heights(&points, &Tolerance::Constant(error_m), Blend::Exact).map_err(|e| e.to_string())?;
    Ok(found.into_iter().map(|e| e.map(|e| (e.z.to_bits(), e.error_m.to_bits()))).collect())
}

/// All that a reader may ask: heights at three tolerances, whole boxes.
fn answers(root: &Path) -> Result<Vec<Answer>, String> {
    let db = Db::open(root).map_err(|e| e.to_string())?;
    let s = db.snapshot(None).map_err(|e| e.to_string())?;
    [0.0, 1.0, 8.0].into_iter().map(|e| heights(&s, e)).collect()
}

/// Problems that `verify` finds; an error is one.
fn problems(root: &Path) -> Vec<String> {
    let stop = AtomicBool::new(false);
    let verify = || -> terraquilt::base::Result<Vec<String>> {
        let db = Db::open(root)?;
        let s = db.snapshot(None)?;
        let r = terraquilt::db::verify(&db, &s, &Progress { report: &|_, _| (), stop: &stop })?;
        assert_eq!(r.ok, r.problems.is_empty());
        Ok(r.problems.iter().map(|p| format!("{}: {}", p.place, p.what)).collect())
    };
    verify().unwrap_or_else(|e| vec![e.to_string()])
}

/// A database of two surveys, each byte of whose last files is in use; and those files.
fn two_surveys() -> (Room, Vec<PathBuf>) {
    let room = Room::with_hill();
    let holes = |i: usize, j: usize| {
        if (i / 4 + j / 3).is_multiple_of(11) {
            f32::NAN
        } else {
            ground(i as f64 + 30.0, j as f64).round() as f32 + 2.0
        }
    };
    let second = Picture { east: 25.0, side: 60, z: Box::new(holes), ..Picture::default() };
    let second = room.picture("second.tif", second);
    printed(&["ingest", &room.db, &second, "--accuracy", "0.5"]);
    let c = rusqlite::Connection::open(Path::new(&room.db).join("catalog.sqlite")).unwrap();
    let mut q = c
        .prepare(
            "SELECT file FROM version_file JOIN file ON file.number = file
             WHERE version = 2 AND live = length - 32 ORDER BY file",
        )
        .unwrap();
    let files: Vec<PathBuf> = q
        .query_map([], |r| r.get::<_, i64>(0))
        .unwrap()
        .map(|n| Path::new(&room.db).join(format!("segments/{:08}.tqs", n.unwrap())))
        .collect();
    drop(q);
    (room, files)
}

#[test]
fn a_flipped_byte_anywhere_is_found_and_never_a_wrong_height() {
    let (room, files) = two_surveys();
    let root = Path::new(&room.db);
    assert!(files.len() >= 2, "a survey segment and a derived one");
    let right = answers(root).unwrap();
    assert!(problems(root).is_empty());
    let db = Db::open(root).unwrap();
    let s = db.snapshot(None).unwrap();
    // Pages that are small and few: one flip in each, besides those at even distances.
    let mut named = vec![("root", s.version().unwrap().root)];
    for e in s.entries() {
        named.extend([("head", e.head), ("list of tops", e.tops)]);
        let head = s.head(e.number).unwrap();
        named.extend(head.tiles.iter().map(|t| ("tile directory", t.directory)));
        named.extend(head.pages.iter().map(|(_, p)| ("patch page", *p)));
    }
    drop(s);
    let mut r = Random::new(5);
    let mut flips: Vec<(String, PathBuf, u64)> = named
        .iter()
        .map(|(what, p)| {
            let file = root.join(format!("segments/{:08}.tqs", p.file));
            (what.to_string(), file, p.offset + r.below(u64::from(p.len)))
        })
        .collect();
    for f in &files {
        let len = std::fs::metadata(f).unwrap().len();
        flips.extend((0..32).step_by(3).map(|at| ("header".to_string(), f.clone(), at)));
        let count = 150.min(len - 32);
        flips.extend((0..count).map(|k| ("page".to_string(), f.clone(), 32 + k * (len - 32) / count)));
    }
    let (mut errors, mut untouched, mut writers) = (0, 0, 0);
    for (k, (what, file, at)) in flips.iter().enumerate() {
        let good = std::fs::read(file).unwrap();
        let mut bad = good.clone();
        bad[*at as usize] ^= 1 << r.below(8);
        std::fs::write(file, &bad).unwrap();
        let name = file.file_name().unwrap().to_str().unwrap();
        let place = format!("{what} of {name}, byte {at}");
        let found = problems(root);
        assert!(!found.is_empty(), "{place}: not found");
        assert!(found.iter().any(|p| p.contains(name)), "{place}: {found:?} does not name the file");
        match answers(root) {
            Ok(a) => {
                assert_eq!(a, right, "{place}: a wrong height");
                untouched += 1;
            }
            Err(e) => {
                assert!(e.contains(name), "{place}: {e}");
                errors += 1;
            }
        }
        if k < named.len() || k % 40 == 0 {
            let out = program(&["verify", &room.db]);
            assert_eq!(lived(&out), 1, "{place}");
            let out = program(&["heights", &room.db, "--error", "0", "500020,3999980"]);
            lived(&out);
            writers += u64::from(a_writer_lives_with_damage(root, &place));
        }
        std::fs::write(file, &good).unwrap();
    }
    assert!(problems(root).is_empty());
    println!("{} flips found; {errors} stopped an answer, {untouched} were not met by it", flips.len());
    println!("{writers} writers did not meet the damage");
}

/// In a copy: a writer stops at damage, or does not touch it; it does not hide it.
fn a_writer_lives_with_damage(root: &Path, place: &str) -> bool {
    let copy = tempfile::tempdir().unwrap();
    for d in ["segments", "readers"] {
        std::fs::create_dir(copy.path().join(d)).unwrap();
    }
    for from in [root.join("catalog.sqlite"), root.join("segments")] {
        let files = if from.is_dir() {
            std::fs::read_dir(&from).unwrap().map(|e| e.unwrap().path()).collect()
        } else {
            vec![from]
        };
        for f in files {
            std::fs::copy(&f, copy.path().join(f.strip_prefix(root).unwrap())).unwrap();
        }
    }
    let db = copy.path().to_str().unwrap();
    let out = program(&["set", db, "hill", "--precedence", "4"]);
    let done = lived(&out) == 0;
    assert_eq!(lived(&program(&["verify", db, "--at", "2"])), 1, "{place}: the damage is hidden");
    let versions: serde_json::Value = serde_json::from_str(&printed(&["versions", db, "--json"])).unwrap();
    assert_eq!(versions.as_array().unwrap().len(), 2 + usize::from(done), "{place}");
    done
}

#[test]
fn files_that_are_short_long_missing_or_swapped_are_found() {
    let (room, files) = two_surveys();
    let root = Path::new(&room.db);
    let right = answers(root).unwrap();
    let judge = |what: &str, name: &str| {
        let found = problems(root);
        assert!(found.iter().any(|p| p.contains(name)), "{what} {name}: {found:?}");
        match answers(root) {
            Ok(a) => assert_eq!(a, right, "{what} {name}"),
            Err(e) => println!("{what}: {e}"),
        }
        let out = program(&["verify", &room.db]);
        assert_eq!(lived(&out), 1, "{what} {name}");
        lived(&program(&["heights", &room.db, "--error", "0", "500020,3999980"]));
        lived(&program(&["surveys", &room.db]));
    };
    for f in &files {
        let good = std::fs::read(f).unwrap();
        let name = f.file_name().unwrap().to_str().unwrap().to_string();
        for len in [0, 1, 31, 32, good.len() / 2, good.len() - 1] {
            std::fs::write(f, &good[..len]).unwrap();
            judge(&format!("cut to {len} bytes,"), &name);
        }
        std::fs::write(f, [&good[..], b"x"].concat()).unwrap();
        judge("one byte too long,", &name);
        std::fs::remove_file(f).unwrap();
        judge("missing,", &name);
        std::fs::create_dir(f).unwrap();
        judge("a directory,", &name);
        std::fs::remove_dir(f).unwrap();
        std::fs::write(f, vec![0; good.len()]).unwrap();
        judge("zeros,", &name);
        // Another segment, cut or filled to the same length.
        let mut other = std::fs::read(files.iter().find(|o| *o != f).unwrap()).unwrap();
        other.resize(good.len(), 0);
        std::fs::write(f, &other).unwrap();
        judge("another file's bytes,", &name);
        std::fs::write(f, &good).unwrap();
    }
    assert!(problems(root).is_empty());
    assert_eq!(answers(root).unwrap(), right);
}

/// Lets everybody read and nobody write.
fn forbid_writing(path: &Path, allowed: bool) {
    use std::os::unix::fs::PermissionsExt;
    for e in std::fs::read_dir(path).unwrap() {
        let e = e.unwrap();
        if e.file_type().unwrap().is_dir() {
            forbid_writing(&e.path(), allowed);
        } else {
            let mode = if allowed { 0o644 } else { 0o444 };
            std::fs::set_permissions(e.path(), PermissionsExt::from_mode(mode)).unwrap();
        }
    }
    std::fs::set_permissions(path, PermissionsExt::from_mode(if allowed { 0o755 } else { 0o555 })).unwrap();
}

#[test]
fn a_database_that_cannot_be_written_can_be_read() {
    use std::os::unix::fs::{MetadataExt, PermissionsExt};
    use std::os::unix::process::CommandExt;
    let room = Room::with_hill();
    std::fs::set_permissions(room.folder.path(), PermissionsExt::from_mode(0o755)).unwrap();
    // Permissions do not bind root, so there the program runs as nobody, from a place that nobody can reach.
    let root = std::fs::metadata(room.folder.path()).unwrap().uid() == 0;
    let binary = room.path("terraquilt");
    std::fs::copy(env!("CARGO_BIN_EXE_terraquilt"), &binary).unwrap();
    let run = |args: &[&str]| {
        let mut c = Command::new(&binary);
        if root {
            c.uid(65534).gid(65534);
        }
        c.args(args).current_dir("/").output()
    };
    if run(&["--version"]).is_err() {
        println!("this root may not become nobody: skipped");
        return;
    }
    let point = "500020.5,3999980.5";
    let reading: [Vec<&str>; 6] = [
        vec!["surveys", &room.db],
        vec!["versions", &room.db],
        vec!["heights", &room.db, "--error", "0", point],
        vec!["fingerprint", &room.db],
        vec!["verify", &room.db],
        vec!["boxes", &room.db],
    ];
    let right: Vec<String> = reading.iter().map(|a| printed(a)).collect();
    forbid_writing(Path::new(&room.db), false);
    for (args, right) in reading.iter().zip(&right) {
        let out = run(args).unwrap();
        let told = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(0), "{args:?}: {told}");
        assert_eq!(String::from_utf8_lossy(&out.stdout), *right, "{args:?}");
    }
    let hill = room.text_path("hill.tif");
    for args in [
        vec!["ingest", &room.db, &hill, "--accuracy", "1", "--name", "again"],
        vec!["remove", &room.db, "hill"],
        vec!["prune", &room.db, "--keep", "1"],
    ] {
        let out = run(&args).unwrap();
        let told = String::from_utf8_lossy(&out.stderr).to_string();
        println!("{}", told.trim_end());
        assert_eq!(out.status.code(), Some(1), "{args:?}: {told}");
        assert!(told.starts_with("error: ") && told.contains(&room.db), "{args:?}: {told}");
        assert_eq!(told.lines().count(), 1, "{told}");
    }
    forbid_writing(Path::new(&room.db), true);
    assert_eq!(printed(&reading[3]), right[3]);
}

/// A small disk of its own; given back when dropped.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: &Path, size: &str) -> Option<SmallDisk> {
        std::fs::create_dir_all(at).unwrap();
        let size = format!("size={size}");
        let done = Command::new("mount").args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(at).output();
        match done {
            Ok(o) if o.status.success() => Some(SmallDisk(at.to_path_buf())),
            _ => {
                println!("mounting a small disk is not allowed here: skipped");
                None
            }
        }
    }

    /// Fills the disk until this many bytes are free (in pages of 4096), or as far as others leave room.
    fn leave(&self, free: u64) {
        let filler = self.0.join("filler");
        let _ = std::fs::remove_file(&filler);
        let s = rustix::fs::statvfs(&self.0).unwrap();
        let have = s.f_bavail * s.f_frsize;
        let _ = std::fs::write(&filler, vec![1; have.saturating_sub(free) as usize]);
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_costs_the_new_version_not_the_old_one() {
    let folder = tempfile::tempdir().unwrap();
    let Some(disk) = SmallDisk::mount(&folder.path().join("small"), "16m") else { return };
    let db = disk.0.join("db").to_str().unwrap().to_string();
    let hill = folder.path().join("hill.tif").to_str().unwrap().to_string();
    let noise = |i: usize, j: usize| ((i * 7919 + j * 104_729) % 1013) as f32;
    Picture { side: 300, z: Box::new(noise), ..Picture::default() }.write(Path::new(&hill));
    printed(&["init", &db, "--crs", "EPSG:32610"]);
    printed(&["ingest", &db, &hill, "--accuracy", "1"]);
    let state = || (printed(&["fingerprint", &db]), printed(&["versions", &db, "--json"]));
    let ask = ["heights", &db[..], "--error", "0", "500020.5,3999980.5"];
    let height = printed(&ask);
    let old = state();

    // Said before it starts.
    disk.leave(3 << 20);
    let ingest = ["ingest", &db[..], &hill, "--accuracy", "1", "--name", "again", "--precedence", "1"];
    complaint(&ingest, &["MB needed", "free", "make room"]);
    assert_eq!(state(), old);

    // Room runs out in the middle: of a change that needs little, and of one whose room somebody else takes.
    let (mut failures, mut successes) = (0, 0);
    let pages: Vec<u64> = (0..12).chain([14, 18, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512]).collect();
    for free in pages {
        for name in ["set", "ingest"] {
            let before = state();
            disk.leave(if name == "set" { free * 4096 } else { 6 << 20 });
            let out = if name == "set" {
                let precedence = (free as i64 + 10).to_string();
                program(&["set", &db, "hill", "--precedence", &precedence])
            } else {
                let child = Command::new(env!("CARGO_BIN_EXE_terraquilt"))
                    .args(ingest)
                    .stdout(Stdio::piped())
                    .stderr(Stdio::piped())
                    .spawn()
                    .unwrap();
                // The check of free space comes first, then the first file.
                let segments = Path::new(&db).join("segments");
                let temporary = || {
                    std::fs::read_dir(&segments)
                        .unwrap()
                        .any(|e| e.unwrap().path().extension().is_some_and(|x| x == "tmp"))
                };
                let waiting_since = Instant::now();
                while !temporary() && waiting_since.elapsed() < Duration::from_secs(5) {}
                disk.leave(free * 4096);
                child.wait_with_output().unwrap()
            };
            let done = lived(&out) == 0;
            // The old version opens and answers while the disk is full.
            let after = state();
            assert_eq!(printed(&ask), height);
            if done {
                successes += 1;
                disk.leave(8 << 20);
                printed(&["verify", &db]);
                if name == "ingest" {
                    printed(&["remove", &db, "again"]);
                }
                printed(&["prune", &db, "--keep", "1"]);
            } else {
                failures += 1;
                if failures < 4 {
                    println!(
                        "{free} pages free, {name}: {}",
                        String::from_utf8_lossy(&out.stderr).trim_end()
                    );
                }
                assert_eq!(after, before, "{name} with {free} pages free failed");
                assert!(String::from_utf8_lossy(&out.stderr).starts_with("error: "));
                disk.leave(8 << 20);
                printed(&["prune", &db, "--keep", "1"]);
            }
        }
    }
    println!("full disk: {failures} changes refused, {successes} went through");
    assert!(failures > 10);
    disk.leave(8 << 20);
    printed(&["verify", &db]);
    printed(&ingest);
    printed(&["verify", &db]);
}

#[test]
fn wrong_usage_exits_with_2() {
    let room = Room::with_hill();
    let db = room.db.as_str();
    for args in [
        vec![],
        vec!["nonsense"],
        vec!["ingest"],
        vec!["ingest", db],
        vec!["surveys"],
        vec!["heights", db, "5,5"],
        vec!["heights", db, "--error", "much", "5,5"],
        vec!["heights", db, "--error", "1", "5,5", "--points", "a.csv"],
        vec!["patches", db, "--error", "1", "--eye", "1,2,3", "--look-at", "1,2,3"],
        vec!["patches", db, "--eye", "1,2,3"],
        vec!["prune", db],
        vec!["prune", db, "--keep", "1", "--before", "1"],
        vec!["set", db, "hill"],
        vec!["surveys", db, "--at", "-1"],
        vec!["init", db, "--policy", "oldest"],
        vec!["export", db, "a.tif", "--tile", "x", "--error", "1"],
    ] {
        let out = program(&args);
        let told = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(2), "{args:?}: {told}");
        assert!(!told.is_empty() && out.stdout.is_empty(), "{args:?}");
    }
}

#[test]
fn a_closed_pipe_is_no_crash() {
    let room = Room::new();
    let file = room.picture("big.tif", Picture { side: 400, ..Picture::default() });
    printed(&["ingest", &room.db, &file, "--accuracy", "1"]);
    let boxes = printed(&["boxes", &room.db]);
    assert!(boxes.len() > 1 << 17, "more than a pipe holds");
    for args in [vec!["boxes", &room.db[..]], vec!["patches", &room.db, "--error", "0", "--json"]] {
        let mut child = Command::new(env!("CARGO_BIN_EXE_terraquilt"))
            .args(&args)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut out = child.stdout.take().unwrap();
        let mut some = [0; 100];
        out.read_exact(&mut some).unwrap();
        drop(out);
        let status = child.wait().unwrap();
        let mut told = String::new();
        child.stderr.take().unwrap().read_to_string(&mut told).unwrap();
        assert_eq!((status.code(), told.as_str()), (Some(0), ""), "{args:?}");
    }
    assert_eq!(std::fs::read_dir(Path::new(&room.db).join("readers")).unwrap().count(), 0, "no lease stays");
}

#[test]
fn every_help_has_an_example() {
    let top = printed(&["--help"]);
    assert!(top.contains("Example"));
    let list = top.split("Commands:").nth(1).expect("the commands are listed");
    let names: Vec<&str> = list
        .lines()
        .skip(1)
        .take_while(|l| !l.trim().is_empty())
        .filter_map(|l| l.split_whitespace().next())
        .filter(|n| *n != "help")
        .collect();
    assert!(names.len() >= 16, "{names:?}");
    let without: Vec<&str> = names
        .iter()
        .copied()
        .filter(|n| !printed(&[n, "--help"]).contains(&format!("terraquilt {n}")))
        .filter(|n| !printed(&[n, "--help"]).contains("Example"))
        .collect();
    assert!(without.is_empty(), "no example: {without:?}");
}

#[test]
fn a_repeated_ingest_changes_nothing_and_says_so() {
    let room = Room::with_hill();
    let before = room.state();
    let hill = room.text_path("hill.tif");
    let out = program(&["ingest", &room.db, &hill, "--accuracy", "1"]);
    assert!(out.status.success());
    let told = String::from_utf8_lossy(&out.stderr);
    assert!(told.contains("nothing was changed"), "{told}");
    assert_eq!(room.state(), before);
    let segments = || std::fs::read_dir(Path::new(&room.db).join("segments")).unwrap().count();
    let count = segments();
    program(&["ingest", &room.db, &hill, "--accuracy", "1", "--dry-run", "--name", "other"]);
    assert_eq!((room.state(), segments()), (before, count), "a dry run leaves nothing");
    let db = Db::open(Path::new(&room.db)).unwrap();
    assert!(change(&db, Change::Remove { surveys: vec!["hill".into()], tile: None }).unwrap().changed);
}
