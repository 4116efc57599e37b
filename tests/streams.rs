//! The surface as a progressive stream: the stated error against the surface at its best, post by post; voids, places, refusals.

use crate::support::{bundled, printed, program, refused};
use serde_json::Value;
use std::path::Path;
use terraquilt::base::polygon::Polygon;
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Db, Snapshot};
use terraquilt::height::lod::cut::{Foci, Focus};
use terraquilt::height::surface::{Blend, Planes};
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Header, Stop, decode};

/// The dome, around the finest survey, and a rim where only the crater's survey lies.
const DOME: &str = "562000,5115300,563300,5116600";

/// The crater at 10 m, and with `dome` its dome at 2 m, four years later.
fn helens(dome: bool) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("db").to_str().unwrap().to_string();
    printed(&["init", &path, "--crs", "EPSG:26910", "--policy", "newest"]);
    let surveys = [
        ("survey_2000-09-25_native.tif", "2000-09-25", "1.5"),
        ("survey_2004-10-04_native.tif", "2004-10-04", "0.5"),
    ];
    for (file, date, accuracy) in &surveys[..1 + usize::from(dome)] {
        let file = bundled("st_helens").join(file);
        let file = file.to_str().unwrap();
        printed(&["ingest", &path, file, "--name", date, "--date", date, "--accuracy", accuracy]);
    }
    (folder, path)
}

fn snapshot(path: &str) -> Snapshot {
    Db::open(Path::new(path)).unwrap().snapshot(None).unwrap()
}

/// Exports; gives the file and what the program prints.
fn exported(folder: &Path, db: &str, args: &[&str]) -> (Vec<u8>, Value) {
    let out = folder.join("out.gtb");
    let all = [&["export", db, out.to_str().unwrap(), "--json"], args].concat();
    let json = serde_json::from_str(&printed(&all)).unwrap();
    (std::fs::read(out).unwrap(), json)
}

fn decoded(bytes: &[u8]) -> Decoded {
    decode(bytes, &mut Vec::new(), Stop::End, None, &mut Alone, &mut |_| true).unwrap()
}

/// The posts of a file: place in the lattice, place on the ground.
fn posts(h: &Header) -> Vec<(usize, [f64; 2])> {
    let t = &h.place.transform;
    let one = |row: usize, col: usize| {
        let p = [t[0] + col as f64 * t[1], t[3] + row as f64 * t[5]];
        (row * h.lattice.side() + col, p)
    };
    (0..h.rows).flat_map(|r| (0..h.cols).map(move |c| (r, c))).map(|(r, c)| one(r, c)).collect()
}

/// The largest distance of a prefix from a surface, at posts where an error is certified.
fn distance(d: &Decoded, surface: &Planes) -> f64 {
    let (place, z) = (&d.header.place, d.surface());
    let posts = posts(&d.header).into_iter().enumerate().filter(|(k, _)| surface.is_certified(*k));
    posts.map(|(k, (at, _))| (place.base + place.unit * z[at] - surface.z[k]).abs()).fold(0.0, f64::max)
}

/// Voids are where no data is.
fn voids_fit(d: &Decoded, best: &Planes) {
    for (k, (at, p)) in posts(&d.header).into_iter().enumerate() {
        assert_eq!(d.is_free(at), best.z[k].is_nan(), "{p:?}");
    }
}

fn surface(s: &Snapshot, h: &Header, tolerance: &Tolerance) -> Planes {
    let points: Vec<[f64; 2]> = posts(h).into_iter().map(|(_, p)| p).collect();
    s.planes(&points, tolerance, Blend::Exact).unwrap()
}

fn best(s: &Snapshot, h: &Header) -> Planes {
    surface(s, h, &Tolerance::Constant(0.0))
}

/// Arguments, what was promised, and what the surface is asked for then.
fn cases() -> Vec<(Vec<&'static str>, Option<f64>, Tolerance)> {
    let words = |t: &'static str| t.split(' ').collect::<Vec<_>>();
    let focus = Focus { center: [562_600.0, 5_116_100.0], radius: 150.0, error: 2.0, growth: 0.03 };
    let foci = Tolerance::Foci(Foci::new(vec![focus]).unwrap());
    let m = Tolerance::Constant;
    vec![
        (words("--error 0"), None, m(0.0)),
        (words("--error 4 --step 10"), Some(4.0), m(2.0)),
        (words("--error 30 --step 5"), Some(30.0), m(15.0)),
        (words("--error 6 --step 7,9 --bound 1"), Some(6.0), m(4.95)),
        (words("--error 8 --bound 0 --unit 0.5 --step 10"), Some(8.0), m(7.75)),
        (words("--error 0 --bound 3 --step 10"), None, m(0.0)),
        (words("--focus 562600,5116100,150,2,0.03 --step 5"), None, foci),
        (words("--error 25 --layers 20,6,2 --step 10"), Some(25.0), m(22.95)),
        (words("--error 5 --profile adaptive --step 10"), Some(5.0), m(2.5)),
    ]
}

/// Of one survey: how far a stream is from the surface at its best. (Where surveys contradict each other, a coarser surface goes
/// from one to the other elsewhere than a finer one: its error is that to the surveys that have a part in it.)
#[test]
fn the_error_at_posts_is_no_larger_than_stated() {
    let (folder, db) = helens(false);
    let s = snapshot(&db);
    for (args, promised, _) in cases() {
        let args = [&args[..], &["--bbox", DOME]].concat();
        let (bytes, json) = exported(folder.path(), &db, &args);
        let d = decoded(&bytes);
        let best = best(&s, &d.header);
        voids_fit(&d, &best);
        let (found, stated) = (distance(&d, &best), json["error_m"].as_f64().unwrap());
        println!("{args:?}: {} bytes, {found:.3} m at posts, {stated:.3} m stated", bytes.len());
        assert!(found <= stated, "{args:?}: {found} m, {stated} m stated");
        assert!(promised.is_none_or(|m| stated <= m), "{args:?}: {stated} m stated");
        // The file states the same.
        let p = &d.header.place;
        let told = p.given_error + p.unit * f64::from(d.bound);
        assert!((told - stated).abs() < 1e-8, "{told} in the file, {stated} m printed");
        assert!(stated > 1.5 && json["surface_error_m"].as_f64().unwrap() >= 1.5, "{json}");
        // And for every beginning that is a surface.
        for part in [0.05, 0.2, 0.4, 0.6, 0.9] {
            let cut = 200 + ((bytes.len() - 200) as f64 * part) as usize;
            let d = decoded(&bytes[..cut]);
            let (found, stated) = (distance(&d, &best), p.given_error + p.unit * f64::from(d.bound));
            assert!(found <= stated, "{args:?} at {part}: {found} m, {stated} m stated");
        }
    }
}

/// Of two surveys that contradict each other: rounding and codec keep their shares at every post.
#[test]
fn rounding_and_codec_keep_their_shares() {
    let (folder, db) = helens(true);
    let s = snapshot(&db);
    for (args, _, asked) in cases() {
        let args = [&args[..], &["--bbox", DOME]].concat();
        let (bytes, json) = exported(folder.path(), &db, &args);
        let d = decoded(&bytes);
        let surface = surface(&s, &d.header, &asked);
        let number = |name: &str| json[name].as_f64().unwrap();
        let (found, share) = (distance(&d, &surface), number("rounding_m") + number("codec_error_m"));
        println!("{args:?}: {found:.4} m from the surface, {share:.4} m for rounding and codec");
        assert!(found <= share + 1e-6, "{args:?}: {found} m, {share} m");
        let certified = (0..surface.z.len()).filter(|k| surface.is_certified(*k));
        let most = certified.map(|k| surface.error_m[k]).fold(0.0, f64::max);
        assert!((number("surface_error_m") - most).abs() < 1e-9, "{most}: {json}");
    }
}

#[test]
fn posts_lie_where_it_is_said() {
    let (folder, db) = helens(true);
    let (bytes, json) = exported(folder.path(), &db, &["--error", "0", "--bbox", DOME]);
    let h = decoded(&bytes).header;
    assert_eq!(json["posts"], "posts of survey 2004-10-04");
    assert_eq!((h.place.transform[1], h.place.transform[5]), (2.0, -2.0));
    assert_eq!((h.place.unit, h.layers.clone(), h.place.crs.as_str()), (0.001, vec![0], "EPSG:26910"));
    assert_eq!((h.place.vertical.as_str(), h.place.source.as_str()), ("m", "terraquilt, version 2"));
    assert_eq!((json["version"].as_u64(), json["cols"].as_u64()), (Some(2), Some(h.cols as u64)));
    let (bytes, json) = exported(folder.path(), &db, &["--error", "9", "--step", "16", "--bbox", DOME]);
    let h = decoded(&bytes).header;
    let t = h.place.transform;
    assert_eq!(json["posts"], "whole multiples of the spacing");
    assert_eq!((t[0], t[3]), ((562_000.0_f64 / 16.0).ceil() * 16.0, (5_116_600.0_f64 / 16.0).floor() * 16.0));
    // Every other post of the coarser lattice is one of the finer.
    let (fine, _) = exported(folder.path(), &db, &["--error", "9", "--step", "8", "--bbox", DOME]);
    let f = decoded(&fine).header.place.transform;
    assert_eq!(((t[0] - f[0]) % 8.0, (t[3] - f[3]) % 8.0), (0.0, 0.0));
    // In degrees.
    let degrees = ["--coords", "EPSG:4326", "--bbox", "-122.195,46.195,-122.185,46.205", "--step", "0.0001"];
    let (bytes, _) = exported(folder.path(), &db, &[&["--error", "9"], &degrees[..]].concat());
    let h = decoded(&bytes).header;
    assert_eq!((h.place.crs.as_str(), h.cols, h.rows), ("EPSG:4326", 101, 101));
}

#[test]
fn polygons_and_places_without_data_are_voids() {
    let (folder, db) = helens(false);
    let ring = [[562_100.0, 5_115_400.0], [563_200.0, 5_115_700.0], [562_500.0, 5_116_500.0]];
    let text = format!(
        r#"{{"type":"Polygon","coordinates":[[[{},{}],[{},{}],[{},{}],[{},{}]]]}}"#,
        ring[0][0], ring[0][1], ring[1][0], ring[1][1], ring[2][0], ring[2][1], ring[0][0], ring[0][1]
    );
    let file = folder.path().join("r.geojson");
    std::fs::write(&file, text).unwrap();
    let args = ["--error", "6", "--step", "10", "--polygon", file.to_str().unwrap()];
    let (bytes, json) = exported(folder.path(), &db, &args);
    let d = decoded(&bytes);
    let polygon = Polygon::new("r", vec![vec![ring.to_vec()]]).unwrap();
    let (mut inside, mut voids) = (0, 0);
    for (at, p) in posts(&d.header) {
        let is_in = polygon.contains(p);
        assert_eq!(!d.is_free(at), is_in, "{p:?}");
        inside += u64::from(is_in);
        voids += u64::from(!is_in);
    }
    assert!(inside > 1000 && voids > 1000);
    assert_eq!((json["samples"].as_u64(), json["voids"].as_u64()), (Some(inside), Some(voids)));
    // Around the surveys nothing lies.
    let s = snapshot(&db);
    let b = s.bounds().unwrap();
    let around = format!("{},{},{},{}", b[0] - 200.0, b[1] - 200.0, b[2] + 200.0, b[3] + 200.0);
    let (bytes, json) = exported(folder.path(), &db, &["--error", "9", "--step", "20", "--bbox", &around]);
    let d = decoded(&bytes);
    let best = best(&s, &d.header);
    voids_fit(&d, &best);
    assert!(distance(&d, &best) <= json["error_m"].as_f64().unwrap());
    assert!(json["voids"].as_u64().unwrap() > 1000);
}

#[test]
fn one_post_and_none() {
    let (folder, db) = helens(false);
    let one = "562590,5115890,562605,5115905";
    let (bytes, json) = exported(folder.path(), &db, &["--error", "3", "--step", "20", "--bbox", one]);
    assert_eq!((json["cols"].as_u64(), json["rows"].as_u64()), (Some(1), Some(1)));
    let d = decoded(&bytes);
    assert!(distance(&d, &best(&snapshot(&db), &d.header)) <= 3.0);
    let out = folder.path().join("none.gtb");
    let none = "562581,5115881,562585,5115885";
    let line =
        refused(&["export", &db, out.to_str().unwrap(), "--error", "3", "--step", "20", "--bbox", none], 1);
    assert!(line.contains("no post lies in it") && line.contains("smaller step"), "{line}");
    assert!(!out.exists());
}

#[test]
fn what_cannot_be_is_refused_with_a_sentence() {
    let (folder, db) = helens(true);
    let out = folder.path().join("out.gtb");
    let out = out.to_str().unwrap();
    let tif = folder.path().join("out.tif");
    let empty = folder.path().join("empty").to_str().unwrap().to_string();
    printed(&["init", &empty, "--crs", "EPSG:26910"]);
    for (args, says) in [
        (vec![db.as_str(), out, "--error", "3", "--bound", "5"], "leave nothing of 3 m for the surface"),
        (vec![&db, out, "--error", "3", "--unit", "9"], "9 m round by 4.5 m"),
        (vec![&db, out, "--error", "3", "--unit", "0"], "unit: 0 m"),
        (vec![&db, out, "--error", "3", "--bound=-1"], "no bound"),
        (vec![&db, out, "--error", "3", "--layers", "1,2"], "each must be finer"),
        (vec![&db, out, "--error", "3", "--layers", "1,x"], "not numbers between commas"),
        (vec![&db, out, "--error", "0", "--step", "0.3"], "at most 8193 allowed"),
        (vec![&db, out, "--error", "0", "--step", "0.0001"], "a larger step"),
        (vec![&db, out, "--error", "3", "--bbox", "0,0,9,9"], "the surveys lie in"),
        (vec![&db, out, "--error", "3", "--resume"], "from a server"),
        (vec![&db, tif.to_str().unwrap(), "--error", "3", "--bound", "1"], "is for .gtb and .ifs files"),
        (vec![&empty, out, "--error", "3"], "database is empty"),
    ] {
        let line = refused(&[&["export"], &args[..]].concat(), 1);
        assert!(line.contains(says), "{args:?}: {line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{line}");
        assert!(!Path::new(out).exists());
    }
    let both = ["export", &db, out, "--error", "3", "--layers", "2,1", "--bound", "1"];
    assert_eq!(program(&both).status.code(), Some(2));
    // A promise that the surveys cannot keep is told, not refused.
    let told = program(&["export", &db, out, "--error", "0.2", "--bbox", DOME, "--step", "10"]);
    let text = String::from_utf8_lossy(&told.stderr).to_string();
    assert!(told.status.success() && text.contains("more than the 0.2 m asked"), "{text}");
}
