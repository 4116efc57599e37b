//! Compact GLB: every vertex on the lattice, no seam between tiles, the error stated holds.

use super::reader::{Glb, from_bytes, read};
use super::{border_edges, compare};
use crate::support::{Random, bundled, printed, refused, seeds};
use serde_json::{Map, Value};
use terraquilt::db::Db;
use terraquilt::format::gltf::{Compact, Compacted, GlbMesh, write_compact_glb};
use terraquilt::height::surface::Seams;

/// A mesh of hills on a turned, uneven lattice; heights and steps are 32-bit floats.
struct Hills {
    positions: Vec<[f64; 3]>,
    normals: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl Hills {
    fn new(r: &mut Random, side: usize, step: f64, height: f64) -> Hills {
        let single = |v: f64| f64::from(v as f32);
        let half = side as f64 * step / 2.0;
        let (mut positions, mut normals, mut triangles) = (vec![], vec![], vec![]);
        for j in 0..side {
            for i in 0..side {
                let mut off = || (r.unit() - 0.5) * 0.4 * step;
                let p = [i as f64 * step - half + off(), j as f64 * step - half + off()];
                let z =
                    ((p[0] / (9.0 * step)).sin() * (p[1] / (7.0 * step)).cos() + r.unit() * 0.01) * height;
                positions.push([single(p[0]), single(p[1]), single(z)]);
                let n = [r.unit() - 0.5, r.unit() - 0.5, 1.0];
                let length = (n[0] * n[0] + n[1] * n[1] + 1.0).sqrt();
                normals.push(n.map(|v| (v / length) as f32));
                if i > 0 && j > 0 {
                    let [a, b, c, d] =
                        [(1, 1), (0, 1), (0, 0), (1, 0)].map(|(x, y)| ((j - y) * side + i - x) as u32);
                    triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
        Hills { positions, normals, triangles }
    }

    fn mesh(&self) -> GlbMesh<'_> {
        GlbMesh {
            positions: &self.positions,
            normals: &self.normals,
            triangles: &self.triangles,
            colors: None,
            origin: [0.0; 3],
            crs: "EPSG:32610",
            error_m: 1.0,
            version: 1,
            extras: Map::new(),
        }
    }

    fn compact(&self, error_m: f64, shift_m: f64, meshopt: bool) -> (Glb, Compacted) {
        let mut bytes = Vec::new();
        let found =
            write_compact_glb(&mut bytes, &self.mesh(), &Compact { error_m, shift_m, meshopt }).unwrap();
        (from_bytes(&bytes), found)
    }

    fn plain(&self) -> Glb {
        Glb {
            json: Value::Null,
            positions: self.positions.clone(),
            normals: Vec::new(),
            triangles: self.triangles.iter().map(|t| t.map(|v| v as usize)).collect(),
            stored: self.positions.len(),
        }
    }
}

/// Every triangle as its corners, from the smallest on: the same for the same surface, whatever the order.
fn surface(glb: &Glb) -> Vec<[[u64; 3]; 3]> {
    let mut all: Vec<[[u64; 3]; 3]> = glb
        .triangles
        .iter()
        .map(|t| {
            let mut c = t.map(|v| glb.positions[v].map(|x| (x + 0.0).to_bits()));
            let first = (0..3).min_by_key(|k| c[*k]).unwrap();
            c.rotate_left(first);
            c
        })
        .collect();
    all.sort_unstable();
    all
}

#[test]
fn a_lattice_moves_a_mesh_by_no_more_than_it_says() {
    let mut r = Random::new(77);
    for seed in seeds(12) {
        let step = [0.5, 3.0, 30.0, 90.0][(seed % 4) as usize];
        // Gentle hills, and some with walls.
        let hills = Hills::new(&mut r, 40, step, step * [1.0, 4.0, 60.0][(seed % 3) as usize]);
        let allowed = step * [0.004, 0.05, 0.4][(seed % 3) as usize];
        let (glb, found) = hills.compact(allowed, step * 0.02, false);
        let q = found.quantum_m;
        assert_eq!(q.log2().fract(), 0.0, "{q} is no power of two");
        assert!(found.quantization_error_m <= allowed, "{found:?}");
        assert!(found.quantization_shift_m <= step * 0.02, "{found:?}");
        // As many vertices, each where the nearest point of the lattice is: half a quantum away at most.
        assert_eq!(glb.positions.len(), hills.positions.len());
        assert_eq!(glb.triangles.len(), hills.triangles.len());
        let sorted = |mut v: Vec<[f64; 3]>| {
            v.sort_by(|a, b| a.partial_cmp(b).unwrap());
            v
        };
        let nearest =
            hills.positions.iter().map(|p| p.map(|v| (v / q).round() * q + 0.0)).collect::<Vec<_>>();
        assert_eq!(sorted(glb.positions.clone()), sorted(nearest));
        // The two surfaces at random points; walls are compared sideways.
        let half = 17.0 * step;
        let points: Vec<[f64; 2]> =
            (0..20_000).map(|_| [0, 1].map(|_| (r.unit() * 2.0 - 1.0) * half)).collect();
        let plain = hills.plain();
        let (mut compared, mut beyond) = (0, vec![]);
        for ((p, old), new) in points.iter().zip(plain.heights(&points)).zip(glb.heights(&points)) {
            let (Some(old), Some(new)) = (old, new) else { panic!("a hole at {p:?}") };
            compared += 1;
            if (old - new).abs() > found.quantization_error_m + 1e-9 {
                beyond.push((*p, old, new));
            }
        }
        let around: Vec<[f64; 2]> = beyond
            .iter()
            .flat_map(|(p, ..)| {
                (0..64).map(|k| {
                    let (s, c) = (f64::from(k) / 32.0 * std::f64::consts::PI).sin_cos();
                    [p[0] + c * found.quantization_shift_m, p[1] + s * found.quantization_shift_m]
                })
            })
            .collect();
        for ((p, old, new), beside) in beyond.iter().zip(plain.heights(&around).chunks(64)) {
            let (lo, hi) = beside.iter().flatten().fold((*old, *old), |(lo, hi), z| (lo.min(*z), hi.max(*z)));
            let off = (lo - new).max(new - hi);
            assert!(off <= found.quantization_error_m, "seed {seed}, {p:?}: {old} became {new}, {found:?}");
        }
        assert_eq!(compared, points.len());
        println!("seed {seed}: {found:?}, {} of {compared} met sideways", beyond.len());
        assert!(seed % 3 == 2 || beyond.is_empty(), "there are no walls with seed {seed}");
    }
}

#[test]
fn tiles_have_common_vertices_bit_for_bit() {
    let mut r = Random::new(5);
    // 4 km in quanta of some millimetres: hundreds of metres fit 16 bits.
    let hills = Hills::new(&mut r, 130, 30.0, 120.0);
    let (one, _) = hills.compact(0.9, 0.6, false);
    let (glb, found) = hills.compact(0.01, 0.6, false);
    assert!(found.tiles > 9, "{found:?}");
    assert!(glb.stored > glb.positions.len(), "no vertex is in two tiles");
    // Joined by the bits of their positions, the tiles have the border of the mesh and no other.
    assert_eq!(one.positions.len(), 130 * 130);
    assert_eq!(glb.positions.len(), 130 * 130);
    assert_eq!(border_edges(&glb), 4 * 129);
    assert_eq!(border_edges(&one), 4 * 129);
}

#[test]
fn triangles_too_wide_for_16_bits_are_32_bit_floats_on_the_same_lattice() {
    let mut r = Random::new(6);
    let mut hills = Hills::new(&mut r, 30, 400.0, 40.0);
    let (glb, found) = hills.compact(0.004, 4.0, false);
    assert!(found.wide_triangles > 0, "{found:?}");
    assert_eq!(border_edges(&glb), 4 * 29);
    // Some fine, some wide.
    hills.triangles.truncate(0);
    hills.positions.truncate(0);
    hills.normals.truncate(0);
    let fine = Hills::new(&mut r, 60, 2.0, 4.0);
    hills.positions.extend(&fine.positions);
    hills.normals.extend(&fine.normals);
    hills.triangles.extend(&fine.triangles);
    let n = fine.positions.len() as u32;
    hills.positions.extend([[-9000.0, -9000.0, 0.0], [9000.0, -9000.0, 0.0]]);
    hills.normals.extend([[0.0, 0.0, 1.0]; 2]);
    hills.triangles.push([n, n + 1, 0]);
    let (glb, found) = hills.compact(0.01, 0.04, false);
    assert!(found.wide_triangles >= 1 && found.tiles >= 2, "{found:?}");
    assert!(found.wide_triangles < 256, "{found:?}");
    // The wide triangle meets the fine ones in one vertex, which is one and the same.
    assert_eq!(glb.positions.len(), hills.positions.len());
}

#[test]
fn normals_keep_their_direction() {
    let hills = Hills::new(&mut Random::new(9), 30, 10.0, 30.0);
    let (glb, found) = hills.compact(0.5, 0.2, false);
    for (p, n) in hills.positions.iter().zip(&hills.normals) {
        let on = p.map(|v| (v / found.quantum_m).round() * found.quantum_m);
        let k = glb.positions.iter().position(|g| *g == on).expect("each vertex is there");
        let m = glb.normals[k];
        let dot: f64 = (0..3).map(|a| m[a] * f64::from(n[a])).sum();
        let length = m.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!(dot / length > 0.5f64.to_radians().cos(), "{n:?} became {m:?}");
    }
}

#[test]
fn a_triangle_thinner_than_floats_is_refused_and_nothing_is_written() {
    let none = Hills { positions: vec![], normals: vec![], triangles: vec![] };
    // 32-bit floats are 1/16 m apart there: the nearest points of that lattice turn the triangle over.
    let positions = [[1e6, 0.0313, 0.0], [1e6 + 4.0, 0.0312, 0.0], [1e6 + 3.9, 0.031_202_6, 0.0]];
    let mesh = GlbMesh {
        positions: &positions,
        normals: &[[0.0, 0.0, 1.0]; 3],
        triangles: &[[0, 1, 2]],
        ..none.mesh()
    };
    let mut out = Vec::new();
    let compact = Compact { error_m: 0.001, shift_m: 0.001, meshopt: false };
    let e = write_compact_glb(&mut out, &mesh, &compact).unwrap_err().to_string();
    assert!(e.contains("thinner than 0.0625 m") && out.is_empty(), "{e}");
}

#[cfg(feature = "meshopt")]
#[test]
fn compressed_is_the_same_surface() {
    let mut r = Random::new(11);
    for (side, step, error) in [(130, 30.0, 0.05), (60, 2.0, 0.1), (30, 400.0, 0.004)] {
        let hills = Hills::new(&mut r, side, step, step * 4.0);
        let (plain, a) = hills.compact(error, step * 0.02, false);
        let (packed, b) = hills.compact(error, step * 0.02, true);
        assert_eq!(a, b);
        assert_eq!(surface(&plain), surface(&packed));
        let again = hills.compact(error, step * 0.02, true).0;
        assert_eq!(again.positions, packed.positions);
        assert_eq!(again.triangles, packed.triangles);
        let required = &packed.json["extensionsRequired"];
        assert_eq!(*required, serde_json::json!(["KHR_mesh_quantization", "EXT_meshopt_compression"]));
        // The fallback buffer has no bytes, and every view is of it.
        assert_eq!(packed.json["buffers"][1]["extensions"]["EXT_meshopt_compression"]["fallback"], true);
        assert!(packed.json["bufferViews"].as_array().unwrap().iter().all(|v| v["buffer"] == 1));
    }
}

#[cfg(not(feature = "meshopt"))]
#[test]
fn a_build_without_meshopt_says_how_to_get_it() {
    let hills = Hills::new(&mut Random::new(1), 4, 1.0, 1.0);
    let mut out = Vec::new();
    let compact = Compact { error_m: 0.1, shift_m: 0.1, meshopt: true };
    let e = write_compact_glb(&mut out, &hills.mesh(), &compact).unwrap_err().to_string();
    assert!(e.contains("--features meshopt") && out.is_empty(), "{e}");
    assert!(!surface(&hills.plain()).is_empty());
}

#[test]
fn a_compact_mesh_of_a_region_is_the_surface_within_its_bound() {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db");
    let path = db.to_str().unwrap();
    printed(&["init", path, "--crs", "EPSG:26910", "--policy", "newest"]);
    for (date, accuracy) in [("2000-09-25", "2"), ("2004-10-13", "0.5")] {
        let survey = bundled("st_helens").join(format!("survey_{date}_native.tif"));
        printed(&["ingest", path, survey.to_str().unwrap(), "--accuracy", accuracy, "--date", date]);
    }
    let out = folder.path().join("dome.glb");
    let bbox = [562_300.0, 5_115_600.0, 562_800.0, 5_116_100.0];
    let text = bbox.map(|v| v.to_string()).join(",");
    let told = printed(&[
        "export",
        path,
        out.to_str().unwrap(),
        "--error",
        "6",
        "--bbox",
        &text,
        "--quantize",
        "--seams",
        "off",
        "--json",
    ]);
    let told: Value = serde_json::from_str(&told).unwrap();
    let glb = read(&out);
    let extras = &glb.json["asset"]["extras"];
    let number = |key: &str| extras[key].as_f64().unwrap();
    assert_eq!(extras["error_m"], told["error_m"]);
    let parts = number("surface_error_m") + number("mesh_error_m") + number("quantization_error_m");
    assert!((number("error_m") - parts).abs() < 1e-12 && number("error_m") <= 6.0, "{extras}");
    assert!(number("quantization_error_m") > 0.0 && number("quantization_shift_m") <= 0.04, "{extras}");
    let s = Db::open(&db).unwrap().snapshot(None).unwrap();
    let mut r = Random::new(20_261_122);
    let points: Vec<[f64; 2]> =
        (0..200_000).map(|_| [0, 1].map(|k| bbox[k] + 0.05 + r.unit() * 499.9)).collect();
    let bound = number("mesh_error_m") + number("quantization_error_m");
    // Two metres is the accuracy of the crater, at which the surface is taken.
    let met = compare(&s, &glb, (2.0, Seams::Off), bound, 0.04 + number("quantization_shift_m"), &points);
    println!("{} points, worst {:.4} m of {bound:.4} m, {} at walls", met.points, met.worst, met.at_walls);
    assert!(met.worst <= bound, "{} m", met.worst);
    assert!(met.points == points.len(), "{} of {}", met.points, points.len());
    assert!(met.at_walls * 200 < met.points, "{} at walls", met.at_walls);

    let tif = folder.path().join("dome.tif");
    let line = refused(&["export", path, tif.to_str().unwrap(), "--error", "6", "--quantize"], 1);
    assert!(line.contains("--quantize") && line.contains(".glb"), "{line}");
}
