//! Heights: bounds, zooms, time, points.

use super::{Folder, PLACE, difference, grid_of, hills, json, tif};
use crate::support::{Random, bundled, printed, program};
use terraquilt::export::gtb::Grid;

/// Means of `by` x `by` cells with data; NaN where there is none.
fn means(g: &Grid, by: usize) -> Grid {
    let [cols, rows] = [g.cols.div_ceil(by), g.rows.div_ceil(by)];
    let one = |k: usize| {
        let at = |x: usize, y: usize| g.z[(k / cols * by + y) * g.cols + k % cols * by + x];
        let fits = |x: usize, y: usize| k % cols * by + x < g.cols && k / cols * by + y < g.rows;
        let cells = (0..by * by).map(|n| (n % by, n / by)).filter(|(x, y)| fits(*x, *y));
        let found: Vec<f64> = cells.map(|(x, y)| at(x, y)).filter(|z| !z.is_nan()).collect();
        found.iter().sum::<f64>() / found.len() as f64
    };
    Grid { cols, rows, z: (0..cols * rows).map(one).collect(), ..g.clone() }
}

#[test]
fn a_bound_is_kept_and_without_one_the_error_is_what_was_measured() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 70, 45, hills);
    let before = grid_of(&dem);
    let voids = before.z.iter().filter(|z| z.is_nan()).count() as u64;
    assert!(voids > 20);
    for bound in ["0", "0.04", "1", "2.5", "40"] {
        let told = json(&["fractal", "encode", &dem, &ifs, "--bound", bound]);
        let asked: f64 = bound.parse().unwrap();
        let (error, promised) = (told["error_max"].as_f64().unwrap(), told["error_bound"].as_f64().unwrap());
        assert!(error <= promised && promised <= asked + 1e-12, "{told}");
        assert_eq!((&told["certified"], told["voids"].as_u64()), (&true.into(), Some(voids)));
        assert_eq!(told["bytes"].as_u64().unwrap(), std::fs::metadata(&ifs).unwrap().len());
        let shown = json(&["fractal", "decode", &ifs, &out]);
        let found = difference(&before, &grid_of(&out));
        assert!(
            found <= shown["error_max"].as_f64().unwrap() + 1e-4 && (found - error).abs() < 1e-3,
            "{found} {told}"
        );
        assert_eq!((&shown["certified"], &shown["synthetic"]), (&true.into(), &false.into()));
    }
    for far in [["--maps", "200"], ["--const", "4"], ["--tolerance", "3"], ["--slope", "10"]] {
        let told = json(&[&["fractal", "encode", &dem, &ifs][..], &far].concat());
        printed(&["fractal", "decode", &ifs, &out]);
        let now = grid_of(&out);
        let found = difference(&before, &now);
        assert!((found - told["error_max"].as_f64().unwrap()).abs() < 1e-3, "{far:?}: {found} {told}");
        assert_eq!((&told["certified"], &told["error_bound"]), (&false.into(), &().into()));
        let squares = before.z.iter().zip(&now.z).filter(|(a, _)| !a.is_nan()).map(|(a, b)| (a - b).powi(2));
        let data = before.z.iter().filter(|z| !z.is_nan());
        let (low, high) = data.clone().fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(*z), h.max(*z)));
        let psnr = 10.0 * ((high - low).powi(2) * data.count() as f64 / squares.sum::<f64>()).log10();
        assert!((psnr - told["psnr_db"].as_f64().unwrap()).abs() < 0.01, "{far:?}: {psnr} {told}");
        assert!(far[0] != "--maps" || told["maps"].as_u64().unwrap() <= 200);
        assert!(printed(&["fractal", "info", &ifs]).contains("as measured"));
    }
}

#[test]
fn a_unit_is_made_finer_where_a_bound_needs_it_and_real_ground_comes_back() {
    let f = Folder::new();
    let (ifs, out) = (f.path("a.ifs"), f.path("a.tif"));
    let dome = bundled("st_helens").join("survey_2004-10-04_native.tif");
    let dome = dome.to_str().unwrap();
    let told = json(&["fractal", "encode", dome, &ifs, "--bound", "0.002", "--search", "near"]);
    assert!(told["unit"].as_f64().unwrap() < 0.004 && told["error_max"].as_f64().unwrap() <= 0.002, "{told}");
    printed(&["fractal", "decode", &ifs, &out]);
    let (before, now) = (grid_of(dome), grid_of(&out));
    assert!(difference(&before, &now) <= 0.002 + 1e-3);
    assert_eq!((before.affine, before.crs), (now.affine, now.crs));
    // What the unit does not allow is refused.
    let said = crate::support::refused(
        &["fractal", "encode", dome, &ifs, "--bound", "0.002", "--unit", "1", "--search", "near"],
        1,
    );
    assert!(said.contains("finer --unit"), "{said}");
}

#[test]
fn zooms_keep_the_means_and_say_what_is_synthetic() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 70, 45, hills);
    for far in [&["--maps", "300"][..], &["--bound", "2"]] {
        printed(&[&["fractal", "encode", &dem, &ifs][..], far].concat());
        printed(&["fractal", "decode", &ifs, &out]);
        let own = grid_of(&out);
        let affine = own.affine.unwrap();
        assert!((affine.origin[0] - PLACE.origin[0]).abs() < 1e-6);
        for (zoom, by) in [("0.5", 2), ("0.25", 4)] {
            let told = json(&["fractal", "decode", &ifs, &out, "--zoom", zoom]);
            let small = grid_of(&out);
            let wanted = means(&own, by);
            // A last cell with its middle beyond the tile is left out.
            for (k, z) in small.z.iter().enumerate() {
                let other = wanted.z[k / small.cols * wanted.cols + k % small.cols];
                assert!(
                    (z - other).abs() < 1e-2 || (z.is_nan() && other.is_nan()),
                    "{zoom}: {k}: {z} {other}"
                );
            }
            assert_eq!((told["synthetic"].as_bool(), told["error_max"].is_number()), (Some(false), true));
            assert!((small.affine.unwrap().col_step[0] - 10.0 * by as f64).abs() < 1e-9);
        }
        for detail in ["plain", "controlled", "none"] {
            let mut last = Vec::new();
            for (zoom, by) in [("2", 2), ("4", 4)] {
                let told = json(&["fractal", "decode", &ifs, &out, "--zoom", zoom, "--detail", detail]);
                assert_eq!((&told["synthetic"], &told["error_max"]), (&true.into(), &().into()));
                assert_eq!(told["detail"], detail);
                let fine = grid_of(&out);
                assert_eq!((fine.cols, fine.rows), (70 * by, 45 * by));
                let back = means(&fine, by);
                // Rounding to whole units, where a bound adds to them.
                let off = difference(&own, &back);
                assert!(off < 0.06, "{detail} {zoom} {far:?}: {off}");
                let first = fine.affine.unwrap();
                let edge = first.origin[0] - first.col_step[0] / 2.0;
                assert!((edge - (PLACE.origin[0] - 5.0)).abs() < 1e-6, "{edge}");
                let text = std::fs::read(&out).unwrap();
                let says = text.windows(9).any(|w| w == b"SYNTHETIC");
                assert_eq!(says, detail != "none");
                let relief = f.path("relief.png");
                printed(&["fractal", "decode", &ifs, &relief, "--zoom", zoom, "--detail", detail]);
                let drawn = std::fs::read(&relief).unwrap();
                assert_eq!(drawn.windows(9).any(|w| w == b"SYNTHETIC"), detail != "none");
                last = fine.z;
            }
            // Between 2 and 4: its cells are means of those, or points of the same function.
            printed(&["fractal", "decode", &ifs, &out, "--zoom", "2.5", "--detail", detail]);
            let some = grid_of(&out);
            assert_eq!((some.cols, some.rows), (175, 112));
            let span = |z: &[f64]| {
                z.iter()
                    .filter(|z| !z.is_nan())
                    .fold([f64::MAX, f64::MIN], |[l, h], z| [l.min(*z), h.max(*z)])
            };
            let ([a, b], [c, d]) = (span(&some.z), span(&last));
            assert!(a >= c - 1.0 && b <= d + 1.0, "{detail}: {a} {b} {c} {d}");
        }
    }
}

#[test]
fn points_are_the_samples_and_above_zoom_1_what_the_maps_say() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 70, 45, hills);
    printed(&["fractal", "encode", &dem, &ifs, "--bound", "1"]);
    let fine = f.path("fine.tif");
    printed(&["fractal", "decode", &ifs, &out]);
    printed(&["fractal", "decode", &ifs, &fine, "--zoom", "4", "--detail", "plain"]);
    let (own, fine) = (grid_of(&out), grid_of(&fine));
    let mut r = Random::new(3);
    let mut asked = vec![];
    for _ in 0..60 {
        let (x, y) = (r.unit() * 700.0 - 5.0, r.unit() * 450.0 - 5.0);
        asked.push([PLACE.origin[0] + x, PLACE.origin[1] - y]);
    }
    asked.push([0.0, 0.0]);
    let texts: Vec<String> = asked.iter().map(|p| format!("{},{}", p[0], p[1])).collect();
    let texts: Vec<&str> = texts.iter().map(String::as_str).collect();
    for (zoom, grid) in [("1", &own), ("4", &fine)] {
        let z: usize = zoom.parse().unwrap();
        let rows = json(&[&["fractal", "point", &ifs, "--zoom", zoom][..], &texts].concat());
        let csv = printed(&[&["fractal", "point", &ifs, "--zoom", zoom][..], &texts].concat());
        let mut lines = csv.lines();
        assert_eq!(lines.next(), Some("x,y,z,error"));
        let rows = rows.as_array().unwrap();
        assert_eq!(rows.len(), asked.len());
        let mut void = 0;
        for ((p, row), line) in asked.iter().zip(rows).zip(lines) {
            assert_eq!(row["synthetic"], z > 1);
            let cell = |d: f64| ((d / 10.0 + 0.5) * z as f64) as usize;
            if p[0] == 0.0 {
                assert!(row["z"].is_null() && line == "0,0,,");
                continue;
            }
            let at = cell(PLACE.origin[1] - p[1]) * grid.cols + cell(p[0] - PLACE.origin[0]);
            let wanted = grid.z[at];
            if wanted.is_nan() {
                assert!(row["z"].is_null() && row["error"].is_null() && line.ends_with(",,"));
                void += 1;
                continue;
            }
            assert!((row["z"].as_f64().unwrap() - wanted).abs() < 1e-3, "{row} {wanted}");
            assert_eq!(row["error"].is_null(), z > 1);
            assert_eq!(line.ends_with(','), z > 1, "{line}");
        }
        assert!(void < 20);
    }
    assert!(
        crate::support::refused(&["fractal", "point", &ifs, "1,2", "--zoom", "0.5"], 1).contains("--zoom")
    );
    assert!(crate::support::refused(&["fractal", "point", &ifs, "1,2,3"], 1).contains("X,Y"));
    // From a file, further columns come along.
    let csv = f.path("stakes.csv");
    std::fs::write(&csv, "id;y;x\n\"a, b\";5115990;560012\nc;0;0\n").unwrap();
    let alone = printed(&["fractal", "point", &ifs, "560012,5115990"]);
    let told = printed(&["fractal", "point", &ifs, "--points", &csv]);
    let rows: Vec<&str> = told.lines().collect();
    assert_eq!(rows[0], "id,x,y,z,error");
    assert_eq!(rows[1], format!("\"a, b\",{}", alone.lines().nth(1).unwrap()));
    assert_eq!(rows[2], "c,0,0,,");
    std::fs::write(&csv, "x,y,z\n560012,5115990,7\n").unwrap();
    assert!(
        printed(&["fractal", "point", &ifs, "--points", &csv]).starts_with("z_given,x,y,z,error\n7,560012,")
    );
    std::fs::write(&csv, "x,y\n").unwrap();
    assert!(crate::support::refused(&["fractal", "point", &ifs, "--points", &csv], 1).contains("no points"));
    std::fs::write(&csv, "id;y;x\n\"a, b\";5115990;560012\nc;0;0\n").unwrap();
    let rows = json(&["fractal", "point", &ifs, "--points", &csv]);
    assert_eq!((&rows[0]["columns"]["id"], &rows[0]["x"]), (&"a, b".into(), &560012.0.into()));
}

#[test]
fn passes_and_time_limit_the_work_and_enough_of_them_finish_it() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 70, 45, hills);
    for far in [&["--maps", "300"][..], &["--bound", "2"]] {
        printed(&[&["fractal", "encode", &dem, &ifs][..], far].concat());
        printed(&["fractal", "decode", &ifs, &out]);
        let own = grid_of(&out);
        let mut last = f64::INFINITY;
        for n in ["1", "3", "60"] {
            let told = json(&["fractal", "decode", &ifs, &out, "--passes", n]);
            assert!(told["passes"].as_u64().unwrap() <= n.parse().unwrap(), "{told}");
            let off = difference(&own, &grid_of(&out));
            assert!(off <= last, "{n}: {off} after {last}");
            assert_eq!(
                (told["finished"].as_bool(), told["error_max"].is_number()),
                (Some(n == "60"), n == "60")
            );
            last = off;
        }
        assert!(last < 1e-3);
        let told = json(&["fractal", "decode", &ifs, &out, "--milliseconds", "0"]);
        assert_eq!((told["finished"].as_bool(), &told["error_max"]), (Some(false), &().into()));
        assert!(std::fs::read(&out).unwrap().windows(14).any(|w| w == b"stopped before"));
        let told = json(&["fractal", "decode", &ifs, &out, "--milliseconds", "100000"]);
        assert_eq!(told["finished"], true);
    }
}

#[test]
fn what_is_cut_or_damaged_decodes_with_an_unknown_error_or_is_refused() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 70, 45, hills);
    printed(&["fractal", "encode", &dem, &ifs, "--bound", "1"]);
    let whole = std::fs::read(&ifs).unwrap();
    let bad = f.path("bad.ifs");
    let mut r = Random::new(11);
    let (mut shown, mut refused) = (0, 0);
    for k in 0..24 {
        let mut bytes = whole.clone();
        if k % 2 == 0 {
            bytes.truncate(r.below(whole.len() as u64) as usize);
        } else {
            let at = r.below(whole.len() as u64) as usize;
            bytes[at] ^= 1 << r.below(8);
        }
        std::fs::write(&bad, &bytes).unwrap();
        let done = program(&["fractal", "decode", &bad, &out, "--json"]);
        let said = String::from_utf8_lossy(&done.stderr).into_owned();
        match done.status.code() {
            Some(0) => {
                let told: serde_json::Value = serde_json::from_slice(&done.stdout).unwrap();
                assert_eq!((&told["complete"], &told["error_max"]), (&false.into(), &().into()), "{said}");
                assert!(said.contains("nobody knows"), "{said}");
                let info = json(&["fractal", "info", &bad]);
                assert_eq!(
                    (info["bytes_whole"].as_u64(), &info["complete"]),
                    (Some(whole.len() as u64), &false.into())
                );
                shown += 1;
            }
            code => {
                assert_eq!(code, Some(1), "{said}");
                assert!(said.starts_with("error: "), "{said}");
                refused += 1;
            }
        }
    }
    println!("{shown} show something, {refused} are refused");
    assert!(shown > 4);
    let from_pipe = json(&["fractal", "info", &ifs]);
    let spent = |v: &serde_json::Value| v.as_u64().unwrap();
    let parts = spent(&from_pipe["planes"][0]["bytes"])
        + spent(&from_pipe["residual_bytes"])
        + spent(&from_pipe["mask_bytes"]);
    assert!(parts > 0 && parts < spent(&from_pipe["bytes"]));
    assert_eq!(
        (&from_pipe["sound"], from_pipe["maps"].as_u64()),
        (&true.into(), from_pipe["maps_there"].as_u64())
    );
}

#[test]
fn tiny_narrow_constant_and_empty_grids() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    let flat = |_: usize, _: usize| 7.0;
    let nothing = |_: usize, _: usize| f64::NAN;
    for (cols, rows) in [(1, 1), (1, 9), (40, 1), (3, 2), (17, 5), (2, 64)] {
        for (name, height) in [
            ("hills", &hills as &dyn Fn(usize, usize) -> f64),
            ("flat", &flat as &dyn Fn(usize, usize) -> f64),
            ("nothing", &nothing as &dyn Fn(usize, usize) -> f64),
        ] {
            tif(&dem, cols, rows, height);
            for far in [["--bound", "0"], ["--slope", "1"], ["--const", "2"]] {
                printed(&[&["fractal", "encode", &dem, &ifs][..], &far].concat());
                printed(&["fractal", "decode", &ifs, &out]);
                let off = difference(&grid_of(&dem), &grid_of(&out));
                assert!(far[0] != "--bound" || off < 1e-3, "{name} {cols} x {rows}: {off}");
                for zoom in ["2", "0.3", "1.5"] {
                    printed(&["fractal", "decode", &ifs, &out, "--zoom", zoom]);
                }
                printed(&["fractal", "decode", &ifs, &f.path("a.png"), "--zoom", "2"]);
                printed(&["fractal", "decode", &ifs, &f.path("a.glb")]);
                printed(&["fractal", "info", &ifs]);
                printed(&["fractal", "point", &ifs, "560000,5116000"]);
            }
        }
    }
}

/// Far from zero float32 would round by a tenth of the bound.
#[test]
fn a_bound_holds_in_the_file_that_is_written() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 65, 33, |x, y| -8000.0 + hills(x, y) / 1000.0);
    for (bound, samples) in [("0.005", "float64"), ("0.5", "float32")] {
        printed(&["fractal", "encode", &dem, &ifs, "--bound", bound]);
        let told = json(&["fractal", "decode", &ifs, &out]);
        let bound: f64 = bound.parse().unwrap();
        assert_eq!(told["samples"], samples, "{told}");
        let off = difference(&grid_of(&dem), &grid_of(&out));
        assert!(off <= told["error_max"].as_f64().unwrap() && off <= bound * 1.01, "{off} {told}");
    }
}

#[test]
fn interest_takes_maps_to_where_it_is() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("a.tif"));
    tif(&dem, 96, 96, |x, y| if hills(x, y).is_nan() { 500.0 } else { hills(x, y) });
    let before = grid_of(&dem);
    let mut squares = Vec::new();
    for more in [&[][..], &["--interest", "560200,5115500,560400,5115800,50"]] {
        printed(
            &[&["fractal", "encode", &dem, &ifs, "--maps", "400", "--search", "near"][..], more].concat(),
        );
        printed(&["fractal", "decode", &ifs, &out]);
        let now = grid_of(&out);
        let inside = |k: &usize| (20..=40).contains(&(k % 96)) && (20..=50).contains(&(k / 96));
        squares
            .push((0..before.z.len()).filter(inside).map(|k| (before.z[k] - now.z[k]).powi(2)).sum::<f64>());
    }
    assert!(squares[1] < squares[0] * 0.5, "{squares:?}");
}
