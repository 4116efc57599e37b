//! Steep ground is no wall: away from the borders of surveys the error of a mesh is vertical, and what is told holds there.

use super::reader::{Glb, read};
use crate::support::{Random, bundled, printed, refused};
use serde_json::Value;
use std::path::Path;
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Db, Snapshot, WALL_STEPS};
use terraquilt::height::surface::{Blend, How, Seams};

/// The crater at 10 m, and its dome at 2 m.
fn crater(folder: &Path, dome: bool) -> String {
    let path = folder.join("db").to_str().unwrap().to_string();
    printed(&["init", &path, "--crs", "EPSG:26910", "--policy", "accuracy"]);
    for (date, accuracy) in [("2000-09-25", "2"), ("2004-10-13", "0.5")] {
        let file = bundled("st_helens").join(format!("survey_{date}_native.tif"));
        printed(&["ingest", &path, file.to_str().unwrap(), "--name", date, "--accuracy", accuracy]);
        if !dome {
            break;
        }
    }
    path
}

fn export(folder: &Path, path: &str, (error, b, seams): (&str, [f64; 4], &str)) -> (Value, Glb, Snapshot) {
    let out = folder.join("steep.glb");
    let bbox = b.map(|v| v.to_string()).join(",");
    let out_text = out.to_str().unwrap();
    let told =
        printed(&["export", path, out_text, "--error", error, "--bbox", &bbox, "--seams", seams, "--json"]);
    let s = Db::open(Path::new(path)).unwrap().snapshot(None).unwrap();
    (serde_json::from_str(&told).unwrap(), read(&out), s)
}

fn scatter(r: &mut Random, b: [f64; 4], count: usize) -> Vec<[f64; 2]> {
    (0..count).map(|_| [b[0] + r.unit() * (b[2] - b[0]), b[1] + r.unit() * (b[3] - b[1])]).collect()
}

/// Random points, and a square of points 0.4 m apart.
fn everywhere(b: [f64; 4]) -> Vec<[f64; 2]> {
    let mut points = scatter(&mut Random::new(8), b, 60_000);
    let middle = [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0];
    let side = |k: u32| f64::from(k) * 0.4 + 0.013;
    points.extend((0..250).flat_map(|j| (0..250).map(move |i| [middle[0] + side(i), middle[1] + side(j)])));
    points
}

/// Points where mesh and surface are vertically farther apart than the mesh's error, and the largest distance.
fn beyond(told: &Value, mesh: &Glb, s: &Snapshot, points: &[[f64; 2]]) -> (Vec<[f64; 2]>, f64) {
    beyond_with(Seams::Off, told, mesh, s, points)
}

fn beyond_with(
    seams: Seams,
    told: &Value,
    mesh: &Glb,
    s: &Snapshot,
    points: &[[f64; 2]],
) -> (Vec<[f64; 2]>, f64) {
    let bound = told["mesh_error_m"].as_f64().unwrap() * (1.0 + 1e-6);
    let how = How { blend: Blend::Exact, seams };
    let found = s.heights(points, &Tolerance::Constant(2.0), how).unwrap();
    let (mut far, mut worst) = (Vec::new(), 0.0f64);
    for ((p, z), e) in points.iter().zip(mesh.heights(points)).zip(found) {
        let off = (z.unwrap() - e.unwrap().z).abs();
        worst = worst.max(off);
        if off > bound {
            far.push(*p);
        }
    }
    println!("{} points, {} beyond {bound:.4} m, worst {worst:.4} m", points.len(), far.len());
    (far, worst)
}

#[test]
fn one_survey_on_steep_ground_is_met_vertically() {
    let folder = tempfile::tempdir().unwrap();
    let b = [563_300.0, 5_116_300.0, 564_000.0, 5_117_000.0];
    for dome in [false, true] {
        let folder = folder.path().join(dome.to_string());
        std::fs::create_dir(&folder).unwrap();
        let path = crater(&folder, dome);
        let (told, mesh, s) = export(&folder, &path, ("2.5", b, "off"));
        let (far, worst) = beyond(&told, &mesh, &s, &everywhere(b));
        assert!(far.is_empty(), "{worst} m, {far:?}");
        assert!(told["mesh_error_m"].as_f64().unwrap() <= 0.5);
    }
}

#[test]
fn two_surveys_are_met_vertically_outside_of_the_cells_where_they_meet() {
    let folder = tempfile::tempdir().unwrap();
    let path = crater(folder.path(), true);
    let b = [562_500.0, 5_115_200.0, 563_100.0, 5_115_700.0];
    let (told, mesh, s) = export(folder.path(), &path, ("3", b, "off"));
    let points = everywhere(b);
    let (far, _) = beyond(&told, &mesh, &s, &points);
    // Both surveys have a part in a cell where they meet; the dome's step is 2 m.
    let both = |p: [f64; 2]| {
        let who = s.explain(p, &Tolerance::Constant(2.0), Blend::Exact).unwrap();
        who.iter().any(|(r, _)| r.survey != who[0].0.survey)
    };
    let wall = WALL_STEPS * 2.0;
    for p in &far {
        let near = [-wall, 0.0, wall];
        assert!(near.iter().any(|x| near.iter().any(|y| both([p[0] + x, p[1] + y]))), "{p:?}");
    }
    assert!(far.len() * 1000 < points.len(), "{} points", far.len());
}

#[test]
fn beside_a_better_survey_bent_ground_is_met_between_its_posts() {
    let folder = tempfile::tempdir().unwrap();
    let path = crater(folder.path(), true);
    // The crater alone, 20 m west of the dome's rectangle: corrections reach here, and are bilinear in half cells.
    let b = [561_900.0, 5_115_900.0, 562_140.0, 5_116_300.0];
    let (told, mesh, s) = export(folder.path(), &path, ("2.3", b, "all"));
    assert!(told["correction_m"].as_f64().unwrap() > 0.1, "{told}");
    let (far, worst) = beyond_with(Seams::All, &told, &mesh, &s, &everywhere(b));
    assert!(far.is_empty(), "{worst} m, {} points", far.len());
}

#[test]
fn what_is_told_of_corrections_holds_between_posts() {
    let folder = tempfile::tempdir().unwrap();
    let path = crater(folder.path(), true);
    let b = [562_100.0, 5_115_600.0, 562_700.0, 5_116_200.0];
    let (told, _, s) = export(folder.path(), &path, ("6", b, "all"));
    let mut points = scatter(&mut Random::new(9), b, 100_000);
    // Nodes of the crater's correction lie every 5 m, with the posts among them.
    let node = |k: u32| f64::from(k) * 5.0;
    points.extend((0..=120).flat_map(|j| (0..=120).map(move |i| [b[0] + node(i), b[1] + node(j)])));
    let how = How { blend: Blend::Exact, seams: Seams::All };
    let found = s.heights(&points, &Tolerance::Constant(2.0), how).unwrap();
    let most = |of: &dyn Fn(&terraquilt::height::surface::Evaluation) -> f64| {
        found.iter().flatten().filter(|e| e.certified).map(of).fold(0.0, f64::max)
    };
    let (bent, error) = (most(&|e| e.correction_m.abs()), most(&|e| e.error_m));
    println!(
        "correction {bent} m of {}, error {error} m of {}",
        told["correction_m"], told["surface_error_m"]
    );
    assert!(bent <= told["correction_m"].as_f64().unwrap() * (1.0 + 1e-9), "{bent} m, {told}");
    assert!(error <= told["surface_error_m"].as_f64().unwrap() * (1.0 + 1e-9), "{error} m, {told}");
    assert!(bent > 1.0);
}

#[test]
fn a_compact_mesh_needs_one_tolerance() {
    let folder = tempfile::tempdir().unwrap();
    let path = crater(folder.path(), false);
    let out = folder.path().join("small.glb");
    let out = out.to_str().unwrap();
    let line = refused(&["export", &path, out, "--quantize", "--focus", "562500,5116000,200,3,0.02"], 1);
    assert!(line.contains("--quantize") && line.contains("--error"), "{line}");
}
