//! Tolerances that vary from place to place, regions by polygon, coordinates of the user's choice: on Mount St. Helens.

use crate::support::{Random, Scratch, bundled, printed, program, random_grid, refused};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use terraquilt::base::polygon::Polygon;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Db, Policy, Snapshot, triangulate_region};
use terraquilt::format;
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::height::crs::{Crs, DatumChoice, Transform};
use terraquilt::height::lod::cut::{ErrorRaster, Foci, Focus};
use terraquilt::height::source::{Affine, SampleType, Window};
use terraquilt::height::surface::Blend;

/// Where the crater's survey has cells, and a box well inside.
const CRATER: [f64; 4] = [561_210.0, 5_115_070.0, 564_210.0, 5_119_460.0];
const INSIDE: [f64; 4] = [561_600.0, 5_115_400.0, 563_900.0, 5_117_600.0];

/// The crater, and with `domes` two surveys of its dome.
fn helens(domes: bool) -> (tempfile::TempDir, String) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("db").to_str().unwrap().to_string();
    printed(&["init", &path, "--crs", "EPSG:26910", "--policy", "accuracy"]);
    for (date, accuracy) in [("2000-09-25", "2"), ("2004-10-11", "0.5"), ("2004-10-13", "0.5")] {
        let file = bundled("st_helens").join(format!("survey_{date}_native.tif"));
        printed(&["ingest", &path, file.to_str().unwrap(), "--name", date, "--accuracy", accuracy]);
        if !domes {
            break;
        }
    }
    (folder, path)
}

/// The heights that the program prints, to the last bit (JSON readers may lose it).
fn told(args: &[&str], points: &[[f64; 2]]) -> Vec<[f64; 3]> {
    let text: Vec<String> = points.iter().map(|p| format!("{},{}", p[0], p[1])).collect();
    let args: Vec<&str> = args.iter().copied().chain(text.iter().map(String::as_str)).collect();
    let row = |l: &str| {
        let n: Vec<f64> = l.split(',').map(|c| c.parse().unwrap()).collect();
        [n[0], n[1], n[2]]
    };
    printed(&args).lines().skip(1).map(row).collect()
}

fn snapshot(path: &str) -> Snapshot {
    Db::open(Path::new(path)).unwrap().snapshot(None).unwrap()
}

fn scatter(b: [f64; 4], count: usize, seed: u64) -> Vec<[f64; 2]> {
    let mut r = Random::new(seed);
    (0..count).map(|_| [b[0] + r.unit() * (b[2] - b[0]), b[1] + r.unit() * (b[3] - b[1])]).collect()
}

/// Distances from foci, by the formula.
fn foci() -> (Vec<Focus>, impl Fn([f64; 2]) -> f64) {
    let foci = vec![
        Focus { center: [562_600.0, 5_116_100.0], radius: 150.0, error: 0.7, growth: 0.03 },
        Focus { center: [563_500.0, 5_118_800.0], radius: 0.0, error: 3.0, growth: 0.01 },
    ];
    let same = foci.clone();
    let delta = move |p: [f64; 2]| {
        let one = |f: &Focus| {
            let r = (p[0] - f.center[0]).hypot(p[1] - f.center[1]);
            f.error + f.growth * (r - f.radius).max(0.0)
        };
        same.iter().map(one).fold(f64::INFINITY, f64::min)
    };
    (foci, delta)
}

/// A raster of two values, 0.8 m in the middle columns and 25 m elsewhere, 100 m apart; and what it says by hand.
fn two_values() -> (Affine, usize, usize, Vec<f32>, impl Fn([f64; 2]) -> f64) {
    let affine = Affine { origin: [561_000.0, 5_119_600.0], col_step: [100.0, 0.0], row_step: [0.0, -100.0] };
    let (cols, rows) = (30usize, 40usize);
    let value = |c: usize| if (14..18).contains(&c) { 0.8f32 } else { 25.0 };
    let values = (0..rows).flat_map(|_| (0..cols).map(value)).collect();
    let delta = move |p: [f64; 2]| {
        let x = ((p[0] - 561_000.0) / 100.0).clamp(0.0, 29.0);
        let c = (x.floor() as usize).min(28);
        let t = x - c as f64;
        (1.0 - t) * f64::from(value(c)) + t * f64::from(value(c + 1))
    };
    (affine, cols, rows, values, delta)
}

/// No contributor above the tolerance or the best there is, at 10,000 points (theorem T7).
fn certified(s: &Snapshot, tolerance: &Tolerance, delta: impl Fn([f64; 2]) -> f64, seed: u64) {
    let points = scatter(CRATER, 10_000, seed);
    let found = s.heights(&points, tolerance, Blend::Exact).unwrap();
    let (mut asked, mut coarse) = (0, 0);
    for (p, e) in points.iter().zip(&found) {
        let e = e.as_ref().unwrap_or_else(|| panic!("no height at {p:?}"));
        if !e.certified {
            continue;
        }
        asked += 1;
        let allowed = delta(*p).max(e.accuracy_m);
        assert!(e.error_m <= allowed * (1.0 + 1e-9), "{} m at {p:?}, {allowed} m allowed", e.error_m);
        coarse += usize::from(e.error_m > e.accuracy_m);
    }
    for p in &points[..200] {
        let allowed = delta(*p).max(2.0) * (1.0 + 1e-9);
        for (record, weight) in s.explain(*p, tolerance, Blend::Exact).unwrap() {
            assert!(f64::from(record.bot) <= allowed || weight < 1e-12, "{} at {p:?}", record.bot);
        }
    }
    assert!(asked > 9000, "only {asked} points are certified");
    assert!(coarse > 2000, "coarse patches at {coarse} points only: the tolerance was not used");
    // A stricter tolerance everywhere needs more.
    let query = |tolerance| Query { area: Area::Everything, tolerance, how: Blend::Exact.into() };
    let least = points.iter().map(|p| delta(*p)).fold(f64::INFINITY, f64::min);
    let (own, all) = (s.select(&query(tolerance.clone())), s.select(&query(Tolerance::Constant(least))));
    let (own, all) = (own.unwrap().records.len(), all.unwrap().records.len());
    println!(
        "{asked} points within their tolerance, {coarse} above the best; {own} patches, {all} at {least:.2} m"
    );
    assert!(own < all);
}

#[test]
fn foci_are_certified() {
    let (_folder, path) = helens(true);
    let (foci, delta) = foci();
    certified(&snapshot(&path), &Tolerance::Foci(Foci::new(foci.clone()).unwrap()), &delta, 1);
    // The same through the program.
    let focus =
        |f: &Focus| format!("--focus={},{},{},{},{}", f.center[0], f.center[1], f.radius, f.error, f.growth);
    let (one, two) = (focus(&foci[0]), focus(&foci[1]));
    let points = scatter(INSIDE, 20, 5);
    let told = told(&["heights", &path, &one, &two], &points);
    let tolerance = Tolerance::Foci(Foci::new(foci).unwrap());
    let found = snapshot(&path).heights(&points, &tolerance, Blend::Exact).unwrap();
    for (t, e) in told.iter().zip(found) {
        assert_eq!(t[2].to_bits(), e.unwrap().z.to_bits());
    }
}

#[test]
fn rasters_of_tolerances_are_certified() {
    let (folder, path) = helens(true);
    let (affine, cols, rows, values, delta) = two_values();
    let raster = ErrorRaster::new(cols, rows, values.clone(), &affine).unwrap();
    let tolerance = Tolerance::Raster(Arc::new(raster));
    certified(&snapshot(&path), &tolerance, &delta, 2);
    // The same from a file, through the program.
    let file = write_grid(folder.path(), "t.tif", 26910, affine, [cols, rows], &values);
    let points = scatter(INSIDE, 20, 6);
    let told = told(&["heights", &path, "--error-raster", file.to_str().unwrap()], &points);
    let found = snapshot(&path).heights(&points, &tolerance, Blend::Exact).unwrap();
    for (t, e) in told.iter().zip(found) {
        assert_eq!(t[2].to_bits(), e.unwrap().z.to_bits());
    }
    // What cannot be a tolerance.
    let no_place = |name: &str, epsg, values: &[f32], word: &str| {
        let file = write_grid(folder.path(), name, epsg, affine, [2, 2], values);
        let line = refused(&["patches", &path, "--error-raster", file.to_str().unwrap()], 1);
        assert!(line.contains(word) && line.contains(name), "{line}");
    };
    no_place("negative.tif", 26910, &[1.0, 1.0, 1.0, -2.0], "column 1, row 1");
    no_place("void.tif", 26910, &[1.0, f32::NAN, 1.0, 2.0], "column 1, row 0");
    no_place("elsewhere.tif", 26911, &[1.0; 4], "gdalwarp -t_srs EPSG:26910");
    refused(&["patches", &path, "--error-raster", "absent.tif"], 1);
    refused(&["patches", &path, "--error-raster", "a.tif", "--error", "1"], 2);
    refused(&["patches", &path, "--focus", "1,2,3,4,5", "--error", "1"], 2);
    refused(&["patches", &path], 2);
}

fn write_grid(
    folder: &Path,
    name: &str,
    epsg: u32,
    affine: Affine,
    [cols, rows]: [usize; 2],
    z: &[f32],
) -> PathBuf {
    let file = folder.join(name);
    let spec = GeoTiffSpec {
        cols: cols as u64,
        rows: rows as u64,
        sample_type: SampleType::F32,
        affine: Some(affine),
        crs: Some(Crs::from_epsg(epsg).unwrap()),
        nodata: Some("nan".into()),
        scale: 1.0,
        offset: 0.0,
        vertical_datum: None,
    };
    let mut out = GeoTiffWriter::create(&file, spec).unwrap();
    let bytes: Vec<u8> = z.iter().flat_map(|v| v.to_le_bytes()).collect();
    out.write_rows(0, &bytes).unwrap();
    out.finish().unwrap();
    file
}

/// A grid read back: affine, columns, rows, heights (NaN: none).
fn read_grid(path: &Path) -> (Affine, usize, usize, Vec<f32>) {
    let mut source = format::open(path).unwrap();
    let info = source.info().clone();
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    let samples = source.read(Window { col: 0, row: 0, cols, rows }).unwrap();
    let z = samples.data.chunks_exact(4).zip(&samples.valid);
    let z = z.map(|(b, v)| if *v == 1 { info.sample_type.value(b) as f32 } else { f32::NAN }).collect();
    (info.affine.unwrap(), cols, rows, z)
}

#[test]
fn a_mesh_keeps_a_tolerance_that_varies() {
    let (_folder, path) = helens(false);
    let s = snapshot(&path);
    let focus = Focus { center: [562_500.0, 5_116_000.0], radius: 200.0, error: 3.0, growth: 0.02 };
    let delta = |p: [f64; 2]| {
        let r = (p[0] - focus.center[0]).hypot(p[1] - focus.center[1]);
        focus.error + focus.growth * (r - focus.radius).max(0.0)
    };
    let area = Area::Box([561_900.0, 5_115_500.0, 563_300.0, 5_116_900.0]);
    let ask = |tolerance| {
        let query = Query { area: area.clone(), tolerance, how: Blend::Exact.into() };
        triangulate_region(&s, &query, &|_| true)
    };
    let varying = ask(Tolerance::Foci(Foci::new(vec![focus]).unwrap())).unwrap();
    let strict = ask(Tolerance::Constant(3.0)).unwrap();
    let used = varying.tolerance_used.unwrap();
    println!(
        "{} triangles, {} at 3 m everywhere; {used} used",
        varying.mesh.triangles.len(),
        strict.mesh.triangles.len()
    );
    assert!(used <= 1.0, "{used}");
    assert!(varying.mesh.triangles.len() * 3 < strict.mesh.triangles.len() * 2);
    // Mesh and surface, with the 2 m that the survey may err.
    let o = varying.origin;
    let mut r = Random::new(4);
    let (mut points, mut heights) = (Vec::new(), Vec::new());
    for t in &varying.mesh.triangles {
        for _ in 0..4 {
            let (mut u, mut v) = (r.unit(), r.unit());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            let [a, b, c] = t.map(|k| varying.mesh.positions[k as usize]);
            let at = [0, 1, 2].map(|k| o[k] + a[k] + u * (b[k] - a[k]) + v * (c[k] - a[k]));
            points.push([at[0], at[1]]);
            heights.push(at[2]);
        }
    }
    let found = s.heights(&points, &Tolerance::Constant(2.0), Blend::Exact).unwrap();
    let mut worst = 0.0f64;
    for ((p, z), e) in points.iter().zip(heights).zip(found) {
        let off = (e.unwrap().z - z).abs() + 2.0;
        worst = worst.max(off / delta(*p));
        assert!(off <= delta(*p) * (1.0 + 1e-6), "{off} m at {p:?}, {} m allowed", delta(*p));
    }
    println!("{} points: at most {worst:.3} of the tolerance", points.len());
    // A raster of 0 leaves no room for triangles.
    let affine = Affine { origin: [561_000.0, 5_119_600.0], col_step: [100.0, 0.0], row_step: [0.0, -100.0] };
    let zero = ErrorRaster::new(1, 1, vec![0.0], &affine).unwrap();
    let e = ask(Tolerance::Raster(Arc::new(zero))).err().unwrap().to_string();
    assert!(e.contains("positive error"), "{e}");
    // Nor does a 0 at the corner of a hole alone, between posts.
    let corner = [562_505.0, 5_116_005.0];
    let affine = Affine {
        origin: [corner[0] - 100.0, corner[1] + 100.0],
        col_step: [100.0, 0.0],
        row_step: [0.0, -100.0],
    };
    let values = (0..9).map(|k| if k == 4 { 0.0 } else { 9.0 }).collect();
    let pit = Tolerance::Raster(Arc::new(ErrorRaster::new(3, 3, values, &affine).unwrap()));
    let at = |x: f64, y: f64| [corner[0] + x, corner[1] + y];
    let outer = vec![at(-90.0, -90.0), at(90.0, -90.0), at(90.0, 90.0), at(-90.0, 90.0)];
    let ring = vec![corner, at(20.0, 31.0), at(33.0, 20.0)];
    let area = Area::Polygon(Arc::new(Polygon::new("holed", vec![vec![outer, ring]]).unwrap()));
    let query = Query { area, tolerance: pit, how: Blend::Exact.into() };
    let e = triangulate_region(&s, &query, &|_| true).err().unwrap().to_string();
    assert!(e.contains("positive error everywhere") && e.contains("562505"), "{e}");
}

/// Rings that say `contains` by the angle they turn around a point.
fn winds(ring: &[[f64; 2]], p: [f64; 2]) -> bool {
    let angle = |q: &[f64; 2]| (q[1] - p[1]).atan2(q[0] - p[0]);
    let turns: f64 = (0..ring.len())
        .map(|k| {
            let d = angle(&ring[(k + 1) % ring.len()]) - angle(&ring[k]);
            d - (d / std::f64::consts::TAU).round() * std::f64::consts::TAU
        })
        .sum();
    turns.abs() > 3.0
}

fn shoelace(ring: &[[f64; 2]]) -> f64 {
    let o = ring[0];
    let next = ring.iter().cycle().skip(1);
    let cross =
        |(a, b): (&[f64; 2], &[f64; 2])| (a[0] - o[0]) * (b[1] - o[1]) - (b[0] - o[0]) * (a[1] - o[1]);
    (ring.iter().zip(next).map(cross).sum::<f64>() / 2.0).abs()
}

/// A ragged star with a hole, a triangle beside it, and a part of a bar that lies outside of the data.
fn parts() -> Vec<Vec<Vec<[f64; 2]>>> {
    let star = (0..23)
        .map(|k| {
            let (s, c) = (f64::from(k) / 23.0 * std::f64::consts::TAU).sin_cos();
            let r = if k % 2 == 0 { 700.3 } else { 411.7 };
            [562_600.13 + r * c, 5_116_300.7 + r * s]
        })
        .collect();
    let hole = vec![[562_500.5, 5_116_200.25], [562_540.0, 5_116_480.0], [562_760.75, 5_116_310.0]];
    let triangle = vec![[561_500.0, 5_117_100.0], [562_000.0, 5_117_900.5], [561_400.5, 5_117_950.0]];
    let bar = vec![
        [563_900.0, 5_116_000.0],
        [564_900.0, 5_116_000.0],
        [564_900.0, 5_116_055.5],
        [563_900.0, 5_116_055.5],
    ];
    vec![vec![star, hole], vec![triangle], vec![bar]]
}

fn inside(parts: &[Vec<Vec<[f64; 2]>>], p: [f64; 2]) -> bool {
    parts.iter().any(|rings| rings.iter().filter(|r| winds(r, p)).count() % 2 == 1)
}

fn geojson(parts: &[Vec<Vec<[f64; 2]>>]) -> String {
    let close = |r: &Vec<[f64; 2]>| r.iter().chain(&r[..1]).copied().collect::<Vec<_>>();
    let closed: Vec<Vec<Vec<[f64; 2]>>> = parts.iter().map(|p| p.iter().map(close).collect()).collect();
    serde_json::json!({"type": "MultiPolygon", "coordinates": closed}).to_string()
}

#[test]
fn meshes_and_rasters_are_cut_along_a_polygon() {
    let (folder, path) = helens(false);
    let s = snapshot(&path);
    let parts = parts();
    let polygon = Arc::new(Polygon::new("parts", parts.clone()).unwrap());
    let query = |area| Query { area, tolerance: Tolerance::Constant(6.0), how: Blend::Exact.into() };
    let m = triangulate_region(&s, &query(Area::Polygon(polygon.clone())), &|_| true).unwrap();
    let (mut area, mut out) = (0.0, 0);
    for t in &m.mesh.triangles {
        let [a, b, c] = t.map(|k| m.mesh.positions[k as usize]);
        area += ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2.0;
        let centre = [0, 1].map(|k| m.origin[k] + (a[k] + b[k] + c[k]) / 3.0);
        out += usize::from(!inside(&parts, centre));
    }
    // The data end at x = 564210; the bar is 310 of its 1000 m inside.
    let whole = shoelace(&parts[0][0]) - shoelace(&parts[0][1]) + shoelace(&parts[1][0]);
    let wanted = whole + (CRATER[2] - 563_900.0) * 55.5;
    // Points move by less than a unit of the mesh's grid (0.24 mm) along some 13 km of border.
    assert!((area - wanted).abs() < 3.0, "{area} m2, {wanted} wanted");
    assert_eq!(out, 0, "triangles outside of the polygon");
    println!("{} triangles, {area:.3} m2 of {wanted:.3}", m.mesh.triangles.len());

    // Patches: those whose domain meets it.
    let all = s.select(&query(Area::Box(polygon.bounds()))).unwrap();
    let ours = s.select(&query(Area::Polygon(polygon.clone()))).unwrap();
    let told: Value = serde_json::from_str(&printed(&[
        "patches",
        &path,
        "--error",
        "6",
        "--json",
        "--bbox",
        &polygon.bounds().map(|v| v.to_string()).join(","),
    ]))
    .unwrap();
    let mut r = Random::new(12);
    for patch in told["patches"].as_array().unwrap() {
        let corner = |k: usize| [0, 1].map(|c| patch["domain"][k][c].as_f64().unwrap());
        let (a, b, d) = (corner(0), corner(1), corner(3));
        let within = |t: [f64; 2]| [0, 1].map(|k| a[k] + t[0] * (b[k] - a[k]) + t[1] * (d[k] - a[k]));
        let seen = (0..3000).any(|_| inside(&parts, within([r.unit(), r.unit()])));
        let has = ours.records.iter().any(|r| patch["id"] == r.id.to_string());
        assert!(!seen || has, "{patch} is missing");
        // A patch of more than a sliver: 3000 points find what a domain shares with the polygon.
        assert!(!has || polygon.meets(&[a, b, corner(2), d]), "{patch} does not belong");
    }
    println!("{} patches, {} in the box", ours.records.len(), all.records.len());
    assert!(ours.records.len() < all.records.len());

    // Pixels: those whose centre is inside, counted by another method.
    let file = folder.path().join("parts.geojson");
    std::fs::write(&file, geojson(&parts)).unwrap();
    let tif = folder.path().join("parts.tif");
    let (file, out) = (file.to_str().unwrap(), tif.to_str().unwrap());
    printed(&["export", &path, out, "--error", "2", "--polygon", file, "--step", "7.3"]);
    let (affine, cols, rows, z) = read_grid(&tif);
    let (mut filled, mut wrong) = (0, 0);
    for (k, z) in z.iter().enumerate() {
        let (c, r) = ((k % cols) as f64, (k / cols) as f64);
        let p = [affine.origin[0] + c * affine.col_step[0], affine.origin[1] + r * affine.row_step[1]];
        let data = p[0] <= CRATER[2] + 10.0 && inside(&parts, p);
        filled += usize::from(!z.is_nan());
        if data == z.is_nan() {
            println!("wrong: {p:?} {z}");
            wrong += 1;
        }
    }
    println!("{filled} of {} pixels filled", cols * rows);
    assert!(filled > 5000 && wrong == 0, "{wrong} pixels wrong");
}

#[test]
fn a_camera_sees_its_mesh_too() {
    let (folder, path) = helens(false);
    let out = folder.path().join("view.glb");
    let told = printed(&[
        "export",
        &path,
        out.to_str().unwrap(),
        "--eye",
        "562500,5115200,3200",
        "--look-at",
        "562500,5116200,2100",
        "--pixels",
        "8",
        "--viewport",
        "800x600",
        "--fov",
        "30",
        "--far",
        "2500",
        "--json",
    ]);
    let told: Value = serde_json::from_str(&told).unwrap();
    assert!(told["triangles"].as_u64().unwrap() > 100, "{told}");
    let used = told["tolerance_used"].as_f64().unwrap();
    assert!(used > 0.0 && used <= 1.0, "{told}");
}

#[test]
fn polygons_that_are_no_region_are_refused() {
    let (folder, path) = helens(false);
    let e = |text: &str, words: &[&str]| {
        let file = folder.path().join("bad.geojson");
        std::fs::write(&file, text).unwrap();
        let line = refused(&["patches", &path, "--error", "2", "--polygon", file.to_str().unwrap()], 1);
        assert!(words.iter().all(|w| line.contains(w)), "{text}: {line}");
    };
    let one = |ring: &str| format!(r#"{{"type":"Polygon","coordinates":[{ring}]}}"#);
    e(
        &one("[[562000,5116000],[563000,5117000],[563000,5116000],[562000,5117000],[562000,5116000]]"),
        &["bad.geojson", "crosses itself at 562500, 5116500"],
    );
    e(&one("[[0,0],[1,1],[0,0]]"), &["3 points"]);
    e(&one("[[5,5],[5,5],[5,5],[5,5]]"), &["1 different point"]);
    e(&one("[[0,0],[1e999,1],[2,2],[0,0]]"), &["bad.geojson"]);
    e(&one("[[0,0],[null,1],[2,2],[0,0]]"), &["bad.geojson"]);
    e(r#"{"type":"FeatureCollection","features":[]}"#, &["empty"]);
    e("not json", &["damaged GeoJSON"]);
    let square = "[[562000,5116000],[563000,5116000],[563000,5117000],[562000,5116000]]";
    let named = format!(
        r#"{{"type":"Polygon","crs":{{"type":"name","properties":{{"name":"EPSG:99999"}}}},"coordinates":[{square}]}}"#
    );
    e(&named, &["EPSG:99999"]);
    let big = folder.path().join("big.geojson");
    std::fs::File::create(&big).unwrap().set_len(1 << 30).unwrap();
    let line = refused(&["patches", &path, "--error", "2", "--polygon", big.to_str().unwrap()], 1);
    assert!(line.contains("1073741824 wanted"), "{line}");
    refused(&["patches", &path, "--error", "2", "--polygon", "absent.geojson"], 1);
    refused(&["patches", &path, "--error", "2", "--polygon", "a", "--bbox", "0,0,1,1"], 2);
    refused(&["patches", &path, "--error", "2", "--coords", "EPSG:99999"], 1);
    let line = refused(&["heights", &path, "--error", "2", "--coords", "EPSG:4326", "-122.19,460"], 1);
    assert!(line.contains("-122.19, 460") && line.contains("longitude comes first"), "{line}");
}

#[test]
fn longitude_and_latitude_are_the_same_places() {
    let (folder, path) = helens(true);
    let s = snapshot(&path);
    let (lonlat, utm) = (Crs::from_epsg(4326).unwrap(), Crs::from_epsg(26910).unwrap());
    let way = Transform::new(&lonlat, &utm, &DatumChoice::None).unwrap();
    let degrees: Vec<[f64; 2]> = scatter(INSIDE, 300, 9).iter().map(|p| way.inverse(*p).unwrap()).collect();
    let seen = told(&["heights", &path, "--error", "1", "--coords", "EPSG:4326"], &degrees);
    let metres: Vec<[f64; 2]> = degrees.iter().map(|p| way.forward(*p).unwrap()).collect();
    let found = s.heights(&metres, &Tolerance::Constant(1.0), Blend::Exact).unwrap();
    for ((t, e), p) in seen.iter().zip(&found).zip(&degrees) {
        assert_eq!(t[2].to_bits(), e.as_ref().unwrap().z.to_bits(), "{t:?}");
        assert_eq!([t[0], t[1]], *p);
    }

    // A raster in degrees is point queries.
    let tif = folder.path().join("degrees.tif");
    let out = tif.to_str().unwrap();
    let bbox = "-122.195,46.195,-122.185,46.2";
    printed(&[
        "export",
        &path,
        out,
        "--error",
        "1",
        "--coords",
        "EPSG:4326",
        "--bbox",
        bbox,
        "--step",
        "0.0001",
    ]);
    assert_eq!(format::open(&tif).unwrap().info().crs.as_ref().unwrap().code, "EPSG:4326");
    let (affine, cols, rows, z) = read_grid(&tif);
    assert_eq!((cols, rows), (100, 50));
    assert!((affine.origin[0] + 122.19495).abs() < 1e-9 && (affine.origin[1] - 46.19995).abs() < 1e-9);
    let at = |k: usize| {
        let (c, r) = ((k % cols) as f64, (k / cols) as f64);
        way.forward([affine.origin[0] + c * affine.col_step[0], affine.origin[1] + r * affine.row_step[1]])
            .unwrap()
    };
    let points: Vec<[f64; 2]> = (0..cols * rows).map(at).collect();
    let found = s.heights(&points, &Tolerance::Constant(1.0), Blend::Exact).unwrap();
    for (z, e) in z.iter().zip(found) {
        // Positions are read back from the file, to 1e-13 of a degree.
        let (z, e) = (f64::from(*z), e.unwrap().z);
        assert!((z - e).abs() <= 2.5e-4, "{z} {e}");
    }

    // A box in degrees is a polygon of the database: its patches, and a mesh of its area.
    let told =
        printed(&["patches", &path, "--error", "1", "--coords", "EPSG:4326", "--bbox", bbox, "--json"]);
    let told: Value = serde_json::from_str(&told).unwrap();
    assert!(told["count"].as_u64().unwrap() > 0);
    let corners = [[-122.195, 46.195], [-122.185, 46.195], [-122.185, 46.2], [-122.195, 46.2]];
    let file = folder.path().join("box.geojson");
    std::fs::write(&file, geojson(&[vec![corners.to_vec()]])).unwrap();
    let file = file.to_str().unwrap();
    let program = program(&["patches", &path, "--error", "1", "--polygon", file, "--json"]);
    let same: Value = serde_json::from_slice(&program.stdout).unwrap();
    assert_eq!(told["set"], same["set"], "a file that looks like degrees is read as degrees");
    assert!(String::from_utf8_lossy(&program.stderr).contains("longitude and latitude"));
}

#[test]
fn further_columns_of_points_come_back() {
    let (folder, path) = helens(false);
    let file = folder.path().join("stakes.csv");
    let ask = |text: &str, more: &[&str]| {
        std::fs::write(&file, text).unwrap();
        let mut args = vec!["heights", &path, "--error", "0", "--points", file.to_str().unwrap()];
        args.extend(more);
        printed(&args)
    };
    let plain = ask("x,y\n562500,5116000\n0,0\n", &[]);
    let lines: Vec<&str> = plain.lines().collect();
    assert_eq!((lines[0], lines[2]), ("x,y,z,error_m", "0,0,,"));
    let z = lines[1].split(',').nth(2).unwrap();
    let more = ask("id,y,note,x\nA7,5116000,\"rock, loose\",562500\n", &[]);
    assert_eq!(more, format!("id,y,note,x,z,error_m\nA7,5116000,\"rock, loose\",562500,{z},2\n"));
    let json: Value = serde_json::from_str(&ask("x;y;id\n562500;5116000;7\n", &["--json"])).unwrap();
    assert_eq!(json[0]["columns"]["id"], "7");
    let beside = program(&["heights", &path, "--error", "0", "5,5"]);
    let told = String::from_utf8_lossy(&beside.stderr).to_string();
    assert!(told.contains("561210.0,5115070.0,564210.0,5119460.0 (EPSG:26910)"), "{told}");
    let out = folder.path().join("x.tif");
    let line = refused(&["export", &path, out.to_str().unwrap(), "--error", "1", "--bbox", "0,0,9,9"], 1);
    assert!(line.contains("561210.0,5115070.0"), "{line}");
}

#[test]
fn a_tif_without_a_step_lies_on_the_posts() {
    let (folder, path) = helens(false);
    let tif = folder.path().join("posts.tif");
    let bbox = "561703,5115504,562903,5116897.5";
    printed(&["export", &path, tif.to_str().unwrap(), "--error", "0", "--bbox", bbox]);
    let (affine, cols, rows, z) = read_grid(&tif);
    let file = bundled("st_helens").join("survey_2000-09-25_native.tif");
    let (theirs, width, _, samples) = read_grid(&file);
    let column = (affine.origin[0] - theirs.origin[0]) / 10.0;
    let row = (theirs.origin[1] - affine.origin[1]) / 10.0;
    assert!((column - column.round()).abs() < 1e-3 && (row - row.round()).abs() < 1e-3, "{column} {row}");
    assert_eq!((cols, rows), (120, 139));
    for (k, z) in z.iter().enumerate() {
        let there = (row.round() as usize + k / cols) * width + column.round() as usize + k % cols;
        assert_eq!(*z, samples[there], "column {}, row {}", k % cols, k / cols);
    }
}

#[test]
fn points_far_out_of_the_world_have_no_height() {
    let s = Scratch::new(Policy::Newest);
    s.ingest(&random_grid(&mut Random::new(5), "s", 60));
    let now = s.db.snapshot(None).unwrap();
    let b = now.bounds().unwrap();
    let inside = [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0];
    for far in [
        [[1.7e308, 0.0], [1.79e308, 0.0]],
        [[-1.79e308, -1.7e308], [1.79e308, 1.7e308]],
        [[100000000000000016384.0, 0.0], [100000000000000032768.0, 0.0]],
        // Neighbours among floats, within the world.
        [[1073741823.9999999, 0.0], [1073741823.9999998, 0.0]],
        [[f64::NAN, 0.0], [f64::INFINITY, f64::NEG_INFINITY]],
    ] {
        let points = [far[0], inside, far[1]];
        let z = now.heights(&points, &Tolerance::Constant(0.0), Blend::Exact).unwrap();
        assert!(z[0].is_none() && z[2].is_none(), "{far:?}");
        let alone = now.heights(&[inside], &Tolerance::Constant(0.0), Blend::Exact).unwrap();
        assert_eq!(z[1].as_ref().map(|e| e.z.to_bits()), alone[0].as_ref().map(|e| e.z.to_bits()));
    }
}
