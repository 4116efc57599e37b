//! GTB from files and to files: what goes in comes out, every prefix holds what it says, and nothing bad brings it down.

mod mesh;
mod picture;

use crate::support::{Random, bundled, ground, printed, refused};
use serde_json::Value;
use std::path::{Path, PathBuf};
use terraquilt::export::gtb::{Grid, Prefix, Request, Until, read_prefix, send};
use terraquilt::format;
use terraquilt::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use terraquilt::height::crs::Crs;
use terraquilt::height::source::{Affine, SampleType, Samples, SourceInfo, Window};
use terraquilt_codecs::gtb::Profile;

const CRATER: &str = "crater_2005-06-15_10m.tif";
/// With voids.
const DOME: &str = "survey_2004-10-04_native.tif";

fn st_helens(name: &str) -> PathBuf {
    bundled("st_helens").join(name)
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

fn json(args: &[&str]) -> Value {
    serde_json::from_str(&printed(args)).unwrap()
}

/// A whole file: what it says of itself, and its samples.
fn samples(path: &Path) -> (SourceInfo, Samples) {
    let mut source = format::open(path).unwrap();
    let info = source.info().clone();
    let (cols, rows) = (info.cols as usize, info.rows as usize);
    (info, source.read(Window { col: 0, row: 0, cols, rows }).unwrap())
}

fn grid_of(path: &Path) -> Grid {
    Grid::read(format::open(path).unwrap().as_mut(), &|_, _| true).unwrap()
}

/// Some ground with voids, `step` metres apart near St. Helens.
pub fn made(cols: usize, rows: usize, voids: impl Fn(usize, usize) -> bool) -> Grid {
    let at = |k: usize| (k % cols, k / cols);
    let height = |k: usize| {
        let (x, y) = at(k);
        if voids(x, y) { f64::NAN } else { (ground(x as f64 * 10.0, y as f64 * 10.0) * 10.0).round() / 10.0 }
    };
    Grid {
        cols,
        rows,
        z: (0..cols * rows).map(height).collect(),
        affine: Some(Affine {
            origin: [560_000.0, 5_116_000.0],
            col_step: [10.0, 0.0],
            row_step: [0.0, -10.0],
        }),
        crs: Some(Crs::parse("EPSG:26910").unwrap()),
        vertical_unit_m: Some(1.0),
        source: "made".into(),
        ..Grid::default()
    }
}

pub fn request(profile: Profile, bounds: &[f64]) -> Request<'static> {
    Request { profile, unit: None, bounds: bounds.to_vec(), share: None, picture: None, cells_n: None }
}

pub fn coded(grid: &Grid, profile: Profile, bounds: &[f64]) -> Vec<u8> {
    send(grid, request(profile, bounds), &|_, _| true).unwrap().encoded.bytes
}

pub fn read(bytes: &[u8], until: Until) -> Prefix {
    read_prefix("test", bytes, until, None, 0, &mut |_| true).unwrap()
}

/// The greatest difference at posts with data; voids must be the same.
fn difference(a: &Grid, b: &Grid) -> f64 {
    assert_eq!((a.cols, a.rows), (b.cols, b.rows));
    assert!(a.z.iter().zip(&b.z).all(|(a, b)| a.is_nan() == b.is_nan()), "voids are others");
    a.z.iter().zip(&b.z).filter(|(a, _)| !a.is_nan()).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn float_and_integer_files_come_back_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (gtb, tif) = (folder.path().join("a.gtb"), folder.path().join("a.tif"));
    // Heights between 1024 and 4096 m as float32 are multiples of 2^-13.
    let source = st_helens(CRATER);
    let told = json(&["gtb", "encode", text(&source), text(&gtb), "--unit", "0.0001220703125", "--json"]);
    assert_eq!((told["error_max"].as_f64(), told["samples"].as_u64()), (Some(0.0), Some(303 * 442)));
    assert_eq!(told["bytes"].as_u64().unwrap(), std::fs::metadata(&gtb).unwrap().len());
    let bits = told["bits_per_sample"].as_f64().unwrap();
    assert!((bits - told["bytes"].as_f64().unwrap() * 8.0 / (303.0 * 442.0)).abs() < 1e-9);
    let told = json(&["gtb", "decode", text(&gtb), text(&tif), "--json"]);
    assert_eq!((told["error_bound"].as_f64(), &told["complete"]), (Some(0.0), &Value::Bool(true)));
    let ((a, left), (b, right)) = (samples(&source), samples(&tif));
    assert_eq!((a.sample_type, a.affine, a.crs), (b.sample_type, b.affine, b.crs));
    assert!(left == right, "samples are others");

    // Integers with voids, of a scale that is not 1, and larger than 16 bits.
    let crs = Crs::parse("EPSG:26910").unwrap();
    let affine = Affine { origin: [0.25, 80.0], col_step: [2.0, 0.5], row_step: [0.5, -2.0] };
    for (sample_type, scale, tall) in
        [(SampleType::I16, 1.0, 1), (SampleType::I16, 0.25, 1), (SampleType::I32, 1.0, 1000)]
    {
        let (cols, rows) = (37, 21);
        let data: Vec<u8> = (0..cols * rows)
            .map(|k| {
                if k % 11 == 0 {
                    -32768
                } else {
                    tall * (ground((k % cols) as f64, (k / cols) as f64) as i32 - 400)
                }
            })
            .flat_map(|v: i32| v.to_le_bytes()[..sample_type.bytes()].to_vec())
            .collect();
        let spec = GeoTiffSpec {
            cols: cols as u64,
            rows: rows as u64,
            sample_type,
            affine: Some(affine),
            crs: Some(crs.clone()),
            nodata: Some("-32768".into()),
            scale,
            offset: if scale == 1.0 { 0.0 } else { 7.5 },
            vertical_datum: Some("EPSG:5703".into()),
        };
        let source = folder.path().join("whole.tif");
        let mut tiff = GeoTiffWriter::create(&source, spec).unwrap();
        tiff.write_rows(0, &data).unwrap();
        tiff.finish().unwrap();
        printed(&["gtb", "encode", text(&source), text(&gtb)]);
        printed(&["gtb", "decode", text(&gtb), text(&tif)]);
        let ((a, left), (b, right)) = (samples(&source), samples(&tif));
        assert_eq!((a.affine, a.crs, &a.vertical_datum), (b.affine, b.crs, &b.vertical_datum));
        assert_eq!(left.valid, right.valid);
        assert_eq!(difference(&grid_of(&source), &grid_of(&tif)), 0.0);
        if scale == 1.0 {
            assert_eq!(b.sample_type, sample_type);
            if sample_type == SampleType::I16 {
                assert_eq!(left.data, right.data);
            }
        }
    }
}

#[test]
fn a_bound_is_kept_and_what_rounding_costs_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let (gtb, tif) = (folder.path().join("a.gtb"), folder.path().join("a.tif"));
    for file in [CRATER, DOME] {
        let source = st_helens(file);
        let before = grid_of(&source);
        let mut last = u64::MAX;
        for asked in [
            &["--bound", "0.02"][..],
            &["--bound", "0.5"],
            &["--layers", "13,4,1"],
            &["--bound", "5"],
            &["--profile", "sparse", "--bound", "10"],
        ] {
            let bound: f64 = asked.last().unwrap().rsplit(',').next().unwrap().parse().unwrap();
            let told = json(&[&["gtb", "encode", text(&source), text(&gtb), "--json"], asked].concat());
            let error = told["error_max"].as_f64().unwrap();
            printed(&["gtb", "decode", text(&gtb), text(&tif)]);
            let found = difference(&before, &grid_of(&tif));
            assert!(found <= error + 1e-3 && error <= bound, "{file} {asked:?}: {found} {error}");
            let bytes = told["bytes"].as_u64().unwrap();
            if asked[0] == "--bound" {
                assert!(bytes < last, "{asked:?}: {bytes} after {last}");
                last = bytes;
            }
        }
    }
}

#[test]
fn every_prefix_holds_what_it_says() {
    let hole = |x: usize, y: usize| (x as i64 - 40).pow(2) + (y as i64 - 20).pow(2) < 90;
    for (profile, bounds) in
        [(Profile::Cubic, &[0.0][..]), (Profile::Cubic, &[4.0, 1.0, 0.1]), (Profile::Sparse, &[0.5])]
    {
        let grid = made(97, 61, hole);
        let bytes = coded(&grid, profile, bounds);
        let (mut last, mut shown) = (f64::INFINITY, 0);
        for cut in (0..=bytes.len()).step_by(7).chain([bytes.len()]) {
            let Ok(p) = read_prefix("test", &bytes[..cut], Until::End, None, 0, &mut |_| true) else {
                assert_eq!(shown, 0, "byte {cut}: a longer prefix shows nothing");
                continue;
            };
            shown += 1;
            let off = difference(&grid, &p.grid);
            assert!(off <= p.reached.error_bound + 1e-9, "byte {cut}: {off} {:?}", p.reached);
            assert!(p.reached.error_bound <= last + 1e-9, "byte {cut}: {:?} after {last}", p.reached);
            assert!(p.reached.bytes_used <= cut as u64);
            assert_eq!(p.reached.complete, cut == bytes.len(), "byte {cut}");
            last = p.reached.error_bound;
        }
        assert!(shown > 50 && last <= bounds[bounds.len() - 1] + 1e-9, "{shown} {last}");
        // Stopping by error: no more bytes than that takes.
        let mut used = 0;
        for asked in [60.0, 30.0, 10.0, 3.0] {
            let p = read(&bytes, Until::Error(asked));
            assert!(p.reached.error_bound <= asked && difference(&grid, &p.grid) <= asked);
            assert!(p.reached.bytes_used >= used, "{asked}: {:?}", p.reached);
            used = p.reached.bytes_used;
            assert!(asked < 60.0 || used < bytes.len() as u64, "{asked}: {:?}", p.reached);
        }
    }
}

#[test]
fn the_program_stops_where_it_is_told_and_reads_what_is_there() {
    let folder = tempfile::tempdir().unwrap();
    let gtb = folder.path().join("a.gtb");
    let out = |name: &str| folder.path().join(name);
    printed(&["gtb", "encode", text(&st_helens(DOME)), text(&gtb)]);
    let whole = std::fs::metadata(&gtb).unwrap().len();
    let told = json(&["gtb", "decode", text(&gtb), text(&out("a.png")), "--bytes", "3000", "--json"]);
    assert!(told["bytes_used"].as_u64().unwrap() <= 3000 && told["complete"] == false);
    let told = json(&["gtb", "decode", text(&gtb), text(&out("b.tif")), "--error", "30", "--json"]);
    assert!(told["bytes_used"].as_u64().unwrap() < whole && told["error_bound"].as_f64().unwrap() <= 30.001);
    assert!(difference(&grid_of(&st_helens(DOME)), &grid_of(&out("b.tif"))) <= 30.001);
    // A file that is cut is read as far as it goes; info says how far.
    let cut = folder.path().join("cut.gtb");
    std::fs::write(&cut, &std::fs::read(&gtb).unwrap()[..3000]).unwrap();
    let info = json(&["gtb", "info", text(&cut), "--json"]);
    assert_eq!((info["bytes"].as_u64(), info["bytes_whole"].as_u64()), (Some(3000), Some(whole)));
    assert_eq!(
        (&info["sound"], &info["complete"], &info["crs"]),
        (&true.into(), &false.into(), &"EPSG:26910".into())
    );
    let passes = info["passes"].as_array().unwrap();
    let ends: Vec<u64> = passes.iter().map(|p| p["bytes"].as_u64().unwrap()).collect();
    assert!(ends.is_sorted() && !ends.is_empty() && ends[ends.len() - 1] <= 3000);
    assert!(printed(&["gtb", "info", text(&cut)]).contains("not complete"));
    // The pass that ends there is known with these bytes.
    let p = read(&std::fs::read(&gtb).unwrap(), Until::Bytes(ends[ends.len() - 1]));
    assert!(p.reached.spacing <= passes[passes.len() - 1]["spacing"].as_u64().unwrap() * 2);
}

#[test]
fn grids_of_one_post_one_row_and_of_voids_alone() {
    let dots = |cols: usize, rows: usize| made(cols, rows, |_, _| false);
    for profile in [Profile::Cubic, Profile::Sparse] {
        for grid in
            [dots(1, 1), dots(1, 9), dots(70, 1), dots(2, 2), dots(3, 2), made(9, 5, |x, y| (x, y) != (4, 2))]
        {
            let p = read(&coded(&grid, profile, &[0.0]), Until::End);
            assert!(p.reached.complete && p.reached.error_bound == 0.0, "{:?}", p.reached);
            assert!(difference(&grid, &p.grid) <= 1e-9);
        }
    }
    let nothing = made(20, 30, |_, _| true);
    let p = read(&coded(&nothing, Profile::Cubic, &[0.0]), Until::End);
    assert!(p.reached.complete && p.grid.z.iter().all(|z| z.is_nan()));
}

#[test]
fn what_is_no_stream_or_a_damaged_one_is_an_error_or_a_true_surface() {
    let grid = made(50, 40, |x, y| x + y < 9);
    let bytes = coded(&grid, Profile::Cubic, &[1.0, 0.0]);
    let mut r = Random::new(7);
    let (mut shown, mut refused) = (0, 0);
    for _ in 0..300 {
        let mut bad = bytes.clone();
        let at = r.below(bad.len() as u64) as usize;
        bad[at] ^= 1 << r.below(8);
        match read_prefix("bad", &bad, Until::End, None, 0, &mut |_| true) {
            Ok(p) => {
                // Blocks with a wrong checksum are left out, so what is shown is true.
                assert!(p.reached.damaged_at.is_some() && !p.reached.complete);
                assert!(difference(&grid, &p.grid) <= p.reached.error_bound + 1e-9);
                shown += 1;
            }
            Err(e) => {
                assert!(e.to_string().contains("bad"), "{e}");
                refused += 1;
            }
        }
    }
    println!("{shown} flips show a part, {refused} are refused");
    for _ in 0..500 {
        let n = r.below(300) as usize;
        let mut noise: Vec<u8> = (0..n).map(|_| r.next() as u8).collect();
        let head = (r.below(30) as usize).min(n);
        noise[..head].copy_from_slice(&bytes[..head]);
        assert!(read_prefix("noise", &noise, Until::End, None, 0, &mut |_| true).is_err());
    }
    // Work that is stopped is stopped.
    let stopped = read_prefix("test", &bytes, Until::End, None, 0, &mut |_| false).err().unwrap();
    assert!(matches!(stopped, terraquilt::base::Error::Stopped));
}

#[test]
fn wrong_calls_get_one_clear_line_and_leave_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_string();
    let (gtb, out) = (path("a.gtb"), path("out.tif"));
    let dome = st_helens(DOME);
    let dome = text(&dome);
    printed(&["gtb", "encode", dome, &gtb]);
    let whole = std::fs::read(&gtb).unwrap();
    std::fs::write(path("cut.gtb"), &whole[..40]).unwrap();
    std::fs::write(path("empty.gtb"), []).unwrap();
    let mut head = whole.clone();
    head[20] ^= 64;
    std::fs::write(path("head.gtb"), head).unwrap();
    let (png, glb, txt) = (path("out.png"), path("out.glb"), path("out.txt"));
    let cases: [(&[&str], &str); 16] = [
        (&["gtb", "decode", &gtb, &out, "--bytes", "0"], "longer prefix"),
        (&["gtb", "decode", &gtb, &txt], "'.txt'"),
        (&["gtb", "decode", &gtb, &out, "--strips"], ".glb"),
        (&["gtb", "decode", &gtb, &png, "--mesh-error", "1"], ".glb"),
        (&["gtb", "decode", &gtb, &glb, "--mesh-error", "nan"], "at least 0"),
        (&["gtb", "decode", &path("cut.gtb"), &out], "40 bytes are there"),
        (&["gtb", "decode", &path("empty.gtb"), &out], "0 bytes are there"),
        (&["gtb", "decode", &path("head.gtb"), &out], "checksum"),
        (&["gtb", "decode", dome, &out], "no GTB file"),
        (&["gtb", "info", &path("none.gtb")], "not found"),
        (&["gtb", "encode", &gtb, &path("b.gtb")], "gdal_translate"),
        (&["gtb", "encode", dome, &path("b.gtb"), "--unit", "0"], "positive"),
        (&["gtb", "encode", dome, &path("b.gtb"), "--unit", "0.000001"], "larger unit"),
        (&["gtb", "encode", dome, &path("b.gtb"), "--layers", "4,3"], "--layers"),
        (&["gtb", "encode", dome, &path("b.gtb"), "--posts", "5"], "sparse"),
        (&["gtb", "encode", dome, &path("b.gtb"), "--image", dome], "colours"),
    ];
    for (args, word) in cases {
        let said = refused(args, 1);
        assert!(said.contains(word), "{args:?}: {said}");
    }
    let left: Vec<_> = std::fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert_eq!(left.len(), 4, "{left:?}");
    assert!(refused(&["gtb", "decode", &gtb, &path("none/out.tif")], 1).contains("folder"));
}
