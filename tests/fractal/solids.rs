//! Solids: a mesh there and back, windows, zooms, points, and meshes that are open.

use super::{Folder, json};
use crate::support::{printed, program, refused, shared};
use std::path::Path;
use terraquilt::format::ply::write_ply;
use terraquilt::format::solid::read_solid;
use terraquilt_codecs::solid::Mesh;

/// An octahedron about a point that is not zero.
fn body() -> Mesh {
    let c = [10.0, -4.0, 2.0];
    let positions: Vec<[f64; 3]> = (0..6)
        .map(|k| {
            let mut p = c;
            p[k / 2] += if k % 2 == 0 { 1.0 } else { -1.0 };
            p
        })
        .collect();
    let triangles =
        vec![[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]];
    Mesh { positions, triangles }
}

fn written(path: &str, mesh: &Mesh) {
    write_ply(&mut std::fs::File::create(path).unwrap(), mesh, "made").unwrap();
}

#[test]
fn a_mesh_comes_back_at_any_zoom_and_window() {
    let f = Folder::new();
    let (ply, ifs) = (f.path("a.ply"), f.path("a.ifs"));
    written(&ply, &body());
    let told = json(&["fractal", "encode", &ply, &ifs, "--slope", "1", "--voxels", "32"]);
    assert_eq!((told["kind"].as_str(), &told["size"]), (Some("volume"), &serde_json::json!([32, 32, 32])));
    let voxel = told["voxel"].as_f64().unwrap();
    assert!((voxel - 2.0 / 28.0).abs() < 1e-12);
    for (zoom, most) in [("1", 0.03), ("2", 0.03), ("0.5", 0.2), ("1.3", 0.05)] {
        let mut meshes = Vec::new();
        for ending in ["glb", "ply"] {
            let out = f.path(&format!("b.{ending}"));
            let told = json(&["fractal", "decode", &ifs, &out, "--zoom", zoom]);
            assert_eq!(told["synthetic"], zoom == "2" || zoom == "1.3");
            let mesh = read_solid(Path::new(&out)).unwrap();
            assert_eq!(told["triangles"].as_u64().unwrap() as usize, mesh.triangles.len());
            assert!((mesh.volume() - 4.0 / 3.0).abs() < most, "{zoom}: {}", mesh.volume());
            meshes.push(mesh.bounds().unwrap());
        }
        let apart = meshes[0].as_flattened().iter().zip(meshes[1].as_flattened()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-4);
        assert!((meshes[1][0][0] - 9.0).abs() < 3.0 * voxel, "{meshes:?}");
    }
    // A corner of it, closed where the window cuts.
    let out = f.path("c.ply");
    let window = ["--window", "10,-4,2,20,20,20"];
    let told = json(&[&["fractal", "decode", &ifs, &out, "--zoom", "2"][..], &window].concat());
    assert_eq!(told["cut"], true);
    let mesh = read_solid(Path::new(&out)).unwrap();
    // The window is whole cells: up to one more on each side.
    assert!((0.15..0.23).contains(&mesh.volume()), "{}", mesh.volume());
    assert!(
        refused(&["fractal", "decode", &ifs, &out, "--window", "50,50,50,60,60,60"], 1).contains("--window")
    );
    assert!(refused(&["fractal", "decode", &ifs, &out, "--zoom", "1000"], 1).contains("--window"));
    assert!(
        refused(&["fractal", "decode", &ifs, &out, "--zoom", "2", "--detail", "none"], 1).contains("plain")
    );
    assert!(refused(&["fractal", "decode", &ifs, &f.path("c.tif")], 1).contains(".glb"));
    // Distances: positive inside.
    let rows = json(&["fractal", "point", &ifs, "10,-4,2", "10.9,-4,2.5", "0,0,0"]);
    let inside = rows[0]["distance"].as_f64().unwrap();
    let error = rows[0]["error"].as_f64().unwrap();
    assert!((inside - 1.0 / 3f64.sqrt()).abs() <= error + voxel * 2.0, "{rows}");
    assert!(rows[1]["distance"].as_f64().unwrap() < 0.0 && rows[2]["distance"].is_null());
    assert!(refused(&["fractal", "point", &ifs, "1,2"], 1).contains("X,Y,Z"));
    let csv = f.path("points.csv");
    for (text, works) in
        [("1,2,3,north\n", true), ("z,x,y\n3,1,2\n", true), ("1,2\n", false), ("x,y,z\n1,2,up\n", false)]
    {
        std::fs::write(&csv, text).unwrap();
        if works {
            let alone = printed(&["fractal", "point", &ifs, "1,2,3"]);
            let told = printed(&["fractal", "point", &ifs, "--points", &csv]);
            assert!(told.trim_end().ends_with(alone.lines().nth(1).unwrap()));
        } else {
            assert!(refused(&["fractal", "point", &ifs, "--points", &csv], 1).contains("z"));
        }
    }
    assert!(printed(&["fractal", "info", &ifs]).contains("volume"));
}

#[test]
fn open_meshes_warn_and_those_that_bound_nothing_are_refused() {
    let f = Folder::new();
    let (ply, ifs) = (f.path("a.ply"), f.path("a.ifs"));
    let mut open = body();
    open.triangles.pop();
    written(&ply, &open);
    let done = program(&["fractal", "encode", &ply, &ifs, "--slope", "1", "--voxels", "16"]);
    assert!(done.status.success());
    assert!(String::from_utf8_lossy(&done.stderr).contains("not as it should be"));
    let point = Mesh { positions: vec![[1.0; 3]; 3], triangles: vec![[0, 1, 2]] };
    written(&ply, &point);
    refused(&["fractal", "encode", &ply, &ifs, "--slope", "1"], 1);
    written(&ply, &Mesh { positions: vec![[0.0; 3]], triangles: vec![] });
    refused(&["fractal", "encode", &ply, &ifs, "--slope", "1"], 1);
    written(&ply, &body());
    for (more, word) in [
        (["--voxels", "4"], "--voxels"),
        (["--voxels", "513"], "--voxels"),
        (["--bound", "1"], "--bound"),
        (["--unit", "1"], "--unit"),
        (["--nodata", "1"], "--nodata"),
        (["--interest", "0,0,1,1,2"], "--interest"),
        (["--isometries", "32"], "isometries"),
    ] {
        let said = refused(&[&["fractal", "encode", &ply, &ifs, "--slope", "1"][..], &more].concat(), 1);
        assert!(said.contains(word), "{said}");
    }
}

#[test]
fn the_bunny_comes_back() {
    let Some(bunny) = shared("mesh/stanford_bunny.ply") else { return };
    let f = Folder::new();
    let (ifs, out) = (f.path("bunny.ifs"), f.path("bunny.glb"));
    let bunny = bunny.to_str().unwrap();
    let told =
        json(&["fractal", "encode", bunny, &ifs, "--maps", "4000", "--voxels", "48", "--search", "near"]);
    println!("{told}");
    assert!(told["psnr_db"].as_f64().unwrap() > 25.0);
    printed(&["fractal", "decode", &ifs, &out]);
    let (a, b) = (read_solid(Path::new(bunny)).unwrap(), read_solid(Path::new(&out)).unwrap());
    let voxel = told["voxel"].as_f64().unwrap();
    for (a, b) in a.bounds().unwrap().as_flattened().iter().zip(b.bounds().unwrap().as_flattened()) {
        assert!((a - b).abs() < 2.0 * voxel, "{a} {b}");
    }
}
