//! The surface as a fractal tile: the stated error against the surface at its best, post by post; voids, places, refusals.

use crate::support::{bundled, printed, program, refused};
use serde_json::Value;
use std::path::Path;
use terraquilt::base::polygon::Polygon;
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Db, Snapshot};
use terraquilt::height::surface::{Blend, Planes};
use terraquilt_codecs::fractal::Tile;

/// The dome, around the finest survey, and a rim where only the crater's survey lies.
const DOME: &str = "562000,5115300,563300,5116600";

/// The crater at 10 m, and with `dome` its dome at 2 m, four years later.
fn helens(dome: bool) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("db").to_str().unwrap().to_string();
    printed(&["init", &path, "--crs", "EPSG:26910", "--policy", "newest"]);
    arrives(&path, "2000-09-25", "1.5");
    if dome {
        arrives(&path, "2004-10-04", "0.5");
    }
    (folder, path)
}

fn arrives(db: &str, date: &str, accuracy: &str) {
    let file = bundled("st_helens").join(format!("survey_{date}_native.tif"));
    let file = file.to_str().unwrap();
    printed(&["ingest", db, file, "--name", date, "--date", date, "--accuracy", accuracy]);
}

fn snapshot(path: &str) -> Snapshot {
    Db::open(Path::new(path)).unwrap().snapshot(None).unwrap()
}

/// Exports; gives the file and what the program prints.
fn exported(folder: &Path, db: &str, args: &[&str]) -> (Vec<u8>, Value) {
    let out = folder.join("out.ifs");
    let all = [&["export", db, out.to_str().unwrap(), "--json"], args].concat();
    let json = serde_json::from_str(&printed(&all)).unwrap();
    (std::fs::read(out).unwrap(), json)
}

/// A tile with its heights in metres, row by row, NaN where it has a void.
fn decoded(bytes: &[u8]) -> (Tile, Vec<f64>) {
    let tile = Tile::read(bytes).unwrap();
    assert!(tile.complete && tile.error_known() && tile.damaged.is_none());
    let place = tile.header.place.clone();
    let units: Vec<f64> = match tile.header.bound {
        Some(_) => tile.heights().unwrap().z.iter().map(|z| f64::from(*z)).collect(),
        None => tile.plane(0).unwrap().values,
    };
    let is_void = |k: usize| tile.void.get(k).copied().unwrap_or(false);
    let metres = |(k, z): (usize, f64)| if is_void(k) { f64::NAN } else { place.base + place.unit * z };
    let heights = units.into_iter().enumerate().map(metres).collect();
    (tile, heights)
}

/// Where the posts of a tile lie, row by row.
fn posts(tile: &Tile) -> Vec<[f64; 2]> {
    let (t, [cols, rows, _]) = (&tile.header.place.transform, tile.header.size);
    let at = |c: usize, r: usize| [t[0] + c as f64 * t[1], t[3] + r as f64 * t[5]];
    (0..rows).flat_map(|r| (0..cols).map(move |c| at(c, r))).collect()
}

fn surface(s: &Snapshot, tile: &Tile, error_m: f64) -> Planes {
    s.planes(&posts(tile), &Tolerance::Constant(error_m), Blend::Exact).unwrap()
}

/// The largest distance from a surface. Voids are where it has no data, or no error is certified.
fn distance(heights: &[f64], surface: &Planes) -> f64 {
    assert_eq!(heights.len(), surface.z.len());
    let told = |k: &usize| !surface.z[*k].is_nan() && surface.is_certified(*k);
    heights.iter().enumerate().for_each(|(k, z)| assert_eq!(!z.is_nan(), told(&k)));
    (0..heights.len()).filter(told).map(|k| (heights[k] - surface.z[k]).abs()).fold(0.0, f64::max)
}

fn number(json: &Value, name: &str) -> f64 {
    json[name].as_f64().unwrap_or_else(|| panic!("{name} in {json}"))
}

/// Of one survey: no post is farther from the surface at its best than is stated.
#[test]
fn the_error_at_posts_is_no_larger_than_stated() {
    let (folder, db) = helens(false);
    let s = snapshot(&db);
    for (args, promised) in [
        ("--error 0", Some(1.501)),
        ("--error 4 --step 10", Some(4.0)),
        ("--error 4 --step 10 --search exact", Some(4.0)),
        ("--error 30 --step 5", Some(30.0)),
        ("--error 6 --step 7,9 --bound 1", Some(6.0)),
        ("--error 8 --bound 0 --unit 0.5 --step 10", Some(8.0)),
        ("--error 4 --maps 600 --step 10", None),
        ("--error 0 --maps 600 --step 10 --search classes", None),
        ("--focus 562600,5116100,150,2,0.03 --step 10", None),
    ] {
        let args: Vec<&str> = args.split(' ').chain(["--bbox", DOME]).collect();
        let (bytes, json) = exported(folder.path(), &db, &args);
        let (tile, heights) = decoded(&bytes);
        let (found, stated) = (distance(&heights, &surface(&s, &tile, 0.0)), number(&json, "error_m"));
        println!("{args:?}: {} bytes, {found:.3} m at posts, {stated:.3} m stated", bytes.len());
        assert!(found <= stated, "{args:?}: {found} m, {stated} m stated");
        assert!(promised.is_none_or(|m| stated <= m), "{args:?}: {stated} m stated");
        // The file states the same, and of what it is the sum.
        let (h, p) = (&tile.header, &tile.header.place);
        let codec = p.unit * h.bound.map_or(h.error_max, f64::from);
        assert!((p.given_error + codec - stated).abs() < 1e-8 && number(&json, "surface_error_m") >= 1.5);
        assert_eq!(json["codec_error_m"].as_f64(), Some(codec));
        assert_eq!(json["bounded"].as_bool(), Some(!args.contains(&"--maps")));
        assert_eq!((json["maps"].as_u64(), json["bytes"].as_u64()), (Some(h.maps), Some(bytes.len() as u64)));
        if args.contains(&"--maps") {
            assert!(h.maps <= 600 && h.maps > 590 && number(&json, "psnr_db") > 30.0, "{json}");
        } else {
            assert!(number(&json, "error_max_m") <= codec, "{json}");
        }
    }
}

/// Of two surveys that contradict each other: rounding and codec keep their shares at every post; without a bound the share of the
/// codec is what was measured, and is reached.
#[test]
fn rounding_and_codec_keep_their_shares() {
    let (folder, db) = helens(true);
    let s = snapshot(&db);
    for (args, asked) in [
        ("--error 4 --step 10", 2.0),
        ("--error 6 --step 7,9 --bound 1", 4.95 - 2e-9),
        ("--error 4 --maps 500 --step 10", 3.95 - 2e-9),
    ] {
        let args: Vec<&str> = args.split(' ').chain(["--bbox", DOME]).collect();
        let (bytes, json) = exported(folder.path(), &db, &args);
        let (tile, heights) = decoded(&bytes);
        let found = distance(&heights, &surface(&s, &tile, asked));
        let share = number(&json, "rounding_m") + number(&json, "codec_error_m");
        println!("{args:?}: {found:.4} m from the surface, {share:.4} m for rounding and codec");
        assert!(found <= share + 1e-6, "{args:?}: {found} m, {share} m");
        assert!(found > share / 2.0, "{args:?}: {found} m, {share} m");
    }
}

#[test]
fn posts_lie_where_it_is_said() {
    let (folder, db) = helens(true);
    let (bytes, json) = exported(folder.path(), &db, &["--error", "0", "--bbox", DOME]);
    let h = decoded(&bytes).0.header;
    let p = &h.place;
    assert_eq!(json["posts"], "posts of survey 2004-10-04");
    assert_eq!((p.transform[1], p.transform[5], p.unit, h.bound), (2.0, -2.0, 0.001, Some(0)));
    assert_eq!((p.crs.as_str(), p.vertical.as_str()), ("EPSG:26910", "m"));
    assert_eq!((p.source.as_str(), json["version"].as_u64()), ("terraquilt, version 2", Some(2)));
    assert_eq!((json["cols"].as_u64(), json["search"].as_str()), (Some(h.size[0] as u64), Some("near")));
    assert!(json["psnr_db"].is_null() && number(&json, "error_max_m") == 0.0, "{json}");
    // In degrees, of an earlier version.
    let degrees = ["--coords", "EPSG:4326", "--bbox", "-122.195,46.195,-122.185,46.205", "--step", "0.0001"];
    let (bytes, _) = exported(folder.path(), &db, &[&["--error", "9", "--at", "1"], &degrees[..]].concat());
    let h = decoded(&bytes).0.header;
    assert_eq!((h.place.crs.as_str(), h.size), ("EPSG:4326", [101, 101, 1]));
    assert_eq!(h.place.source, "terraquilt, version 1");
}

#[test]
fn polygons_and_places_without_data_are_voids() {
    let (folder, db) = helens(false);
    let s = snapshot(&db);
    let ring = [[562_100.0, 5_115_400.0], [563_200.0, 5_115_700.0], [562_500.0, 5_116_500.0]];
    let corner = |k: usize| format!("[{},{}]", ring[k][0], ring[k][1]);
    let corners = [0, 1, 2, 0].map(corner).join(",");
    let file = folder.path().join("r.geojson");
    std::fs::write(&file, format!(r#"{{"type":"Polygon","coordinates":[[{corners}]]}}"#)).unwrap();
    let polygon = Polygon::new("r", vec![vec![ring.to_vec()]]).unwrap();
    let surveys = s.bounds().unwrap();
    for more in [&[][..], &["--maps", "300"]] {
        let args = ["--error", "6", "--step", "10", "--polygon", file.to_str().unwrap()];
        let (bytes, json) = exported(folder.path(), &db, &[&args, more].concat());
        let (tile, heights) = decoded(&bytes);
        let best = surface(&s, &tile, 0.0);
        let (mut inside, mut found) = (0_u64, 0.0_f64);
        for (k, p) in posts(&tile).into_iter().enumerate() {
            assert_eq!(!heights[k].is_nan(), polygon.contains(p), "{p:?}");
            if polygon.contains(p) {
                inside += 1;
                found = found.max((heights[k] - best.z[k]).abs());
            }
        }
        assert!(found <= number(&json, "error_m"), "{found}: {json}");
        assert_eq!(json["samples"].as_u64(), Some(inside));
        assert!(inside > 1000 && json["voids"].as_u64() > Some(1000), "{json}");
        // Around the surveys nothing lies.
        let [xmin, ymin, xmax, ymax] = surveys;
        let around = format!("{},{},{},{}", xmin - 200.0, ymin - 200.0, xmax + 200.0, ymax + 200.0);
        let args = ["--error", "9", "--step", "20", "--bbox", &around];
        let (bytes, json) = exported(folder.path(), &db, &[&args, more].concat());
        let (tile, heights) = decoded(&bytes);
        assert!(distance(&heights, &surface(&s, &tile, 0.0)) <= number(&json, "error_m"));
        assert!(json["voids"].as_u64() > Some(1000), "{json}");
    }
}

/// A survey arrives: where it does not reach, the surface that tiles are made of is as it was, and so is what they hold, to rounding and codec.
#[test]
fn an_arrival_changes_no_more_than_its_surroundings() {
    let (folder, db) = helens(false);
    let far = ["--error", "4", "--step", "10", "--bbox", "561500,5118600,562800,5119300"];
    let near = ["--error", "4", "--step", "10", "--bbox", DOME];
    let [far_before, near_before] = [far, near].map(|a| exported(folder.path(), &db, &a).0);
    arrives(&db, "2004-10-04", "0.5");
    let [far_after, near_after] = [far, near].map(|a| exported(folder.path(), &db, &a).0);
    assert_eq!(decoded(&far_before).1, decoded(&far_after).1);
    assert_ne!(decoded(&near_before).1, decoded(&near_after).1);
    let (tile, heights) = decoded(&near_after);
    assert!(distance(&heights, &surface(&snapshot(&db), &tile, 2.0)) <= 2.0);
}

#[test]
fn one_post_a_line_and_none() {
    let (folder, db) = helens(false);
    for (bbox, cols, rows) in
        [("562590,5115890,562605,5115905", 1, 1), ("562000,5115890,563000,5115905", 51, 1)]
    {
        let (bytes, json) = exported(folder.path(), &db, &["--error", "3", "--step", "20", "--bbox", bbox]);
        assert_eq!((json["cols"].as_u64(), json["rows"].as_u64()), (Some(cols), Some(rows)));
        let (tile, heights) = decoded(&bytes);
        assert!(distance(&heights, &surface(&snapshot(&db), &tile, 0.0)) <= 3.0);
    }
    let out = folder.path().join("none.ifs");
    let none = "562581,5115881,562585,5115885";
    let line =
        refused(&["export", &db, out.to_str().unwrap(), "--error", "3", "--step", "20", "--bbox", none], 1);
    assert!(line.contains("no post lies in it") && line.contains("smaller step"), "{line}");
    assert!(!out.exists());
}

#[test]
fn what_cannot_be_is_refused_with_a_sentence() {
    let (folder, db) = helens(true);
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (out, tif, gtb, empty) = (path("out.ifs"), path("out.tif"), path("out.gtb"), path("empty"));
    printed(&["init", &empty, "--crs", "EPSG:26910"]);
    for (db, out, args, says) in [
        (&db, &out, "--error 3 --bound 5", "leave nothing of 3 m for the surface"),
        (&db, &out, "--error 3 --unit 9", "9 m round by 4.5 m"),
        (&db, &out, "--error 3 --maps 500 --unit 9", "9 m round by 4.5 m"),
        (&db, &out, "--error 3 --unit 0", "unit: 0 m"),
        (&db, &out, "--error 3 --bound=-1", "no bound"),
        (&db, &out, "--error 3 --step 10 --maps 1", "ask for at least so many"),
        (&db, &out, "--error 3 --step 10 --maps 0", "ask for at least so many"),
        (&db, &out, "--error 0 --step 0.3", "posts of a fractal tile"),
        (&db, &out, "--error 0 --step 2 --search exact", "take near"),
        (&db, &out, "--error 0 --step 0.00001", "a larger step"),
        (&db, &out, "--error 3 --bbox 0,0,9,9", "the surveys lie in"),
        (&db, &out, "--error 3 --layers 2,1", "is for .gtb files"),
        (&db, &out, "--error 3 --resume", "is for .gtb files"),
        (&db, &tif, "--error 3 --bound 1", "is for .gtb and .ifs files"),
        (&db, &tif, "--error 3 --maps 9", "is for fractal tiles (.ifs), not for .tif"),
        (&db, &gtb, "--error 3 --search near", "is for fractal tiles (.ifs), not for .gtb"),
        (&db, &out, "--survey 2004-10-04", "written as .tif"),
        (&empty, &out, "--error 3", "database is empty"),
    ] {
        let args: Vec<&str> = ["export", db, out].into_iter().chain(args.split(' ')).collect();
        let line = refused(&args, 1);
        assert!(line.contains(says), "{args:?}: {line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{line}");
        assert!(!Path::new(out).exists());
    }
    let both = ["export", &db, &out, "--error", "3", "--maps", "900", "--bound", "1"];
    assert_eq!(program(&both).status.code(), Some(2));
    // What surveys or maps cannot keep is told, not refused.
    for (args, says) in
        [("--error 0.2", "more than the 0.2 m asked"), ("--error 4 --maps 400", "as measured")]
    {
        let args = args.split(' ').chain(["--bbox", DOME, "--step", "10"]);
        let told = program(&["export", &db, &out].into_iter().chain(args).collect::<Vec<_>>());
        let text = String::from_utf8_lossy(&told.stderr).to_string();
        assert!(told.status.success() && text.contains(says), "{text}");
    }
}
