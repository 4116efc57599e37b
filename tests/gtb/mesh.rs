//! Meshes of prefixes: exactly the decoded surface, without cracks, none where there is no data.

use super::{coded, made, read, request};
use crate::glb::border_edges;
use crate::glb::reader::{Glb, from_bytes};
use std::collections::BTreeSet;
use terraquilt::export::gtb::{Grid, MeshRequest, MeshTold, Prefix, Until, send, write_mesh};
use terraquilt::height::crs::Crs;
use terraquilt::height::source::Affine;
use terraquilt_codecs::gtb::{Profile, bitree};

fn mesh(p: &Prefix, strips: bool, error: f64) -> (Glb, MeshTold) {
    let mut bytes = Vec::new();
    let told = write_mesh(&mut bytes, p, MeshRequest { strips, error }, &|_, _| true).unwrap();
    (from_bytes(&bytes), told)
}

fn area(mesh: &Glb) -> f64 {
    let of = |t: &[usize; 3]| {
        let [a, b, c] = t.map(|k| mesh.positions[k]);
        let twice = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        assert!(twice > 0.0, "a triangle is seen from below");
        twice / 2.0
    };
    mesh.triangles.iter().map(of).sum()
}

/// Area in cells of the half cells whose three posts have data: what a mesh must cover.
fn covered(p: &Prefix) -> f64 {
    let lattice = p.header.lattice;
    let finest = bitree::triangles(lattice, &vec![true; lattice.side() * lattice.side()]);
    finest.iter().filter(|t| t.iter().all(|at| !p.free[*at as usize])).count() as f64 / 2.0
}

/// Triangles by the places of their corners, each from its least corner on.
fn set(mesh: &Glb) -> BTreeSet<[[u64; 3]; 3]> {
    let of = |t: &[usize; 3]| {
        let corners = t.map(|k| mesh.positions[k].map(f64::to_bits));
        let least = (0..3).min_by_key(|k| corners[*k]).unwrap();
        [0, 1, 2].map(|k| corners[(k + least) % 3])
    };
    mesh.triangles.iter().map(of).collect()
}

fn hole(x: usize, y: usize) -> bool {
    (x as i64 - 40).pow(2) + (y as i64 - 20).pow(2) < 90 || (x > 70 && y > 50) || (x, y) == (5, 5)
}

#[test]
fn a_mesh_is_the_decoded_surface_at_every_post() {
    let grid = made(97, 61, hole);
    let affine = grid.affine.unwrap();
    for (profile, bounds) in [(Profile::Cubic, [0.0]), (Profile::Sparse, [0.8])] {
        let bytes = coded(&grid, profile, &bounds);
        for until in [Until::End, Until::Bytes(900), Until::Error(12.0)] {
            let p = read(&bytes, until);
            let (indexed, told) = mesh(&p, false, 0.0);
            assert_eq!((told.mesh_error, told.triangles), (0.0, indexed.triangles.len() as u64));
            assert!(border_edges(&indexed) > 4);
            assert!((area(&indexed) - 100.0 * covered(&p)).abs() < 1e-6, "{until:?}");
            // Posts lie on it, vertices or not.
            let posts: Vec<usize> = (0..p.grid.z.len()).filter(|k| !p.grid.z[*k].is_nan()).collect();
            let place = |k: &usize| {
                [affine.origin[0] + 10.0 * (k % 97) as f64, affine.origin[1] - 10.0 * (k / 97) as f64]
            };
            let points: Vec<[f64; 2]> = posts.iter().map(place).collect();
            let found = indexed.heights(&points);
            let met = found.iter().zip(&posts).filter_map(|(z, k)| Some((z.as_ref()?, p.grid.z[*k])));
            assert!(met.clone().count() + 20 > posts.len());
            for (z, expected) in met {
                assert!((z - expected).abs() < 1e-4, "{until:?}: {z} {expected}");
            }
            let extras = &indexed.json["asset"]["extras"];
            let error = extras["error_m"].as_f64().unwrap();
            assert!((error - p.reached.error_bound).abs() < 1e-12 && extras["crs"] == "EPSG:26910");
            assert_eq!(extras["complete"], p.reached.complete);
            // A strip is the same triangles; so is one of a thinned mesh.
            let (strip, told) = mesh(&p, true, 0.0);
            assert!(set(&strip) == set(&indexed) && told.strip_length.is_some());
            let (thin, told) = mesh(&p, false, 2.0);
            assert!(thin.triangles.len() <= indexed.triangles.len() && told.mesh_error <= 2.0);
            for (z, k) in thin.heights(&points).iter().zip(&posts) {
                assert!(z.is_none_or(|z| (z - p.grid.z[*k]).abs() <= told.mesh_error + 1e-4));
            }
            border_edges(&thin);
            assert!((area(&thin) - 100.0 * covered(&p)).abs() < 1e-6);
        }
    }
    // Fewer triangles where fewer are needed.
    let p = read(&coded(&grid, Profile::Cubic, &[0.0]), Until::End);
    assert!(mesh(&p, false, 5.0).1.triangles * 3 < mesh(&p, false, 0.0).1.triangles);
}

#[test]
fn a_square_without_voids_is_as_few_triangles_as_it_needs() {
    let flat = Grid { z: vec![7.0; 33 * 33], ..made(33, 33, |_, _| false) };
    let p = read(&coded(&flat, Profile::Cubic, &[0.0]), Until::End);
    let (glb, told) = mesh(&p, false, 0.0);
    assert_eq!((told.triangles, told.vertices, border_edges(&glb)), (2, 4, 4));
    let (strip, told) = mesh(&p, true, 0.0);
    assert!(told.strip_length.unwrap() <= 9 && set(&strip) == set(&glb));
}

#[test]
fn south_up_grids_degrees_and_no_place_face_up() {
    let base = made(20, 20, |_, _| false);
    let south_up = Affine { origin: [560_000.0, 5_116_000.0], col_step: [10.0, 0.0], row_step: [0.0, 10.0] };
    let grid = Grid { affine: Some(south_up), ..base.clone() };
    for strips in [false, true] {
        let (glb, _) = mesh(&read(&coded(&grid, Profile::Cubic, &[0.0]), Until::End), strips, 0.0);
        assert!((area(&glb) - 190.0 * 190.0).abs() < 1e-6);
    }
    let degrees = Affine { origin: [-122.0, 46.0], col_step: [1e-4, 0.0], row_step: [0.0, -1e-4] };
    let grid = Grid { affine: Some(degrees), crs: Some(Crs::parse("EPSG:4326").unwrap()), ..base.clone() };
    let (glb, _) = mesh(&read(&coded(&grid, Profile::Cubic, &[0.0]), Until::End), false, 0.0);
    let origin = &glb.json["asset"]["extras"]["origin"];
    assert!((origin[0].as_f64().unwrap() + 121.99905).abs() < 1e-9);
    assert!(glb.json["asset"]["extras"]["projection"].is_string());
    // 7.74 m by 11.11 m a cell there.
    assert!((area(&glb) / (361.0 * 7.745 * 11.115) - 1.0).abs() < 1e-3, "{}", area(&glb));
    let grid = Grid { affine: None, crs: None, ..base };
    let (glb, _) = mesh(&read(&coded(&grid, Profile::Cubic, &[0.0]), Until::End), false, 0.0);
    assert!((area(&glb) - 361.0).abs() < 1e-6 && glb.json["asset"]["extras"]["place"].is_string());
}

#[test]
fn nothing_to_draw_is_a_file_without_a_scene() {
    for grid in [made(1, 1, |_, _| false), made(30, 1, |_, _| false), made(9, 9, |_, _| true)] {
        let p = read(&coded(&grid, Profile::Cubic, &[0.0]), Until::End);
        for strips in [false, true] {
            let mut bytes = Vec::new();
            let told = write_mesh(&mut bytes, &p, MeshRequest { strips, error: 0.0 }, &|_, _| true).unwrap();
            assert_eq!((told.triangles, told.vertices), (0, 0));
            assert!(!String::from_utf8_lossy(&bytes).contains("scene"));
        }
    }
    let stopped = write_mesh(
        &mut Vec::new(),
        &read(
            &send(&made(9, 9, |_, _| false), request(Profile::Cubic, &[0.0]), &|_, _| true)
                .unwrap()
                .encoded
                .bytes,
            Until::End,
        ),
        MeshRequest::default(),
        &|_, _| false,
    );
    assert!(matches!(stopped, Err(terraquilt::base::Error::Stopped)));
}
