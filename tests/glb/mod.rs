//! Must show 8: a GLB of a region is the surface within its bound, manifold but for its border, where surveys meet too.

mod compact;
pub mod reader;
mod steep;

use crate::support::{Random, bundled, printed};
use reader::{Glb, read};
use serde_json::Value;
use terraquilt::db::query::Tolerance;
use terraquilt::db::{Db, Snapshot};
use terraquilt::height::surface::{Blend, How, Seams};

impl Glb {
    /// Height of the mesh at points: each point is looked for in the triangles of its square.
    pub fn heights(&self, points: &[[f64; 2]]) -> Vec<Option<f64>> {
        let side = 12.0;
        let key = |p: [f64; 2]| ((p[0] / side).floor() as i64, (p[1] / side).floor() as i64);
        let mut squares: std::collections::HashMap<(i64, i64), Vec<usize>> = Default::default();
        for (n, t) in self.triangles.iter().enumerate() {
            let c = t.map(|k| self.positions[k]);
            let lo = key([
                c.iter().map(|p| p[0]).fold(f64::MAX, f64::min),
                c.iter().map(|p| p[1]).fold(f64::MAX, f64::min),
            ]);
            let hi = key([
                c.iter().map(|p| p[0]).fold(f64::MIN, f64::max),
                c.iter().map(|p| p[1]).fold(f64::MIN, f64::max),
            ]);
            for y in lo.1..=hi.1 {
                for x in lo.0..=hi.0 {
                    squares.entry((x, y)).or_default().push(n);
                }
            }
        }
        let height = |p: &[f64; 2]| {
            squares.get(&key(*p))?.iter().find_map(|n| {
                let [a, b, c] = self.triangles[*n].map(|k| self.positions[k]);
                let cross =
                    |a: [f64; 3], b: [f64; 3]| (b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]);
                let (u, v, w) = (cross(b, c), cross(c, a), cross(a, b));
                let sum = u + v + w;
                (u >= 0.0 && v >= 0.0 && w >= 0.0 && sum > 0.0)
                    .then(|| (u * a[2] + v * b[2] + w * c[2]) / sum)
            })
        };
        points.iter().map(height).collect()
    }
}

/// Edges that one triangle has, and that the neighbour does not: the border. Fails where an edge has three.
pub fn border_edges(mesh: &Glb) -> usize {
    let mut edges: std::collections::HashMap<(usize, usize), i32> = Default::default();
    for t in &mesh.triangles {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            let n = edges.entry((a, b)).or_default();
            *n += 1;
            assert_eq!(*n, 1, "edge {a} {b} runs twice in one direction");
        }
    }
    edges.keys().filter(|(a, b)| !edges.contains_key(&(*b, *a))).count()
}

struct Met {
    points: usize,
    worst: f64,
    at_walls: usize,
}

/// Compares mesh and surface at points. A point where they differ by more counts as met if the surface takes the mesh's
/// height within `wall` metres sideways.
fn compare(
    s: &Snapshot,
    mesh: &Glb,
    (surface_error, seams): (f64, Seams),
    bound: f64,
    wall: f64,
    points: &[[f64; 2]],
) -> Met {
    let how = How { blend: Blend::Exact, seams };
    let tolerance = Tolerance::Constant(surface_error);
    let found = s.heights(points, &tolerance, how).unwrap();
    let mut met = Met { points: 0, worst: 0.0, at_walls: 0 };
    for ((p, z), e) in points.iter().zip(mesh.heights(points)).zip(found) {
        let (Some(z), Some(e)) = (z, e) else { continue };
        met.points += 1;
        let error = (z - e.z).abs();
        if error <= bound {
            met.worst = met.worst.max(error);
            continue;
        }
        let around: Vec<[f64; 2]> = (0..32)
            .flat_map(|k| {
                let (s, c) = (f64::from(k) / 16.0 * std::f64::consts::PI).sin_cos();
                [0.25, 0.5, 0.75, 1.0].map(|r| [p[0] + r * wall * c, p[1] + r * wall * s])
            })
            .collect();
        let beside = s.heights(&around, &tolerance, how).unwrap();
        let (lo, hi) = beside.iter().flatten().fold((e.z, e.z), |(lo, hi), b| (lo.min(b.z), hi.max(b.z)));
        let beyond = (lo - z).max(z - hi).max(0.0);
        met.worst = met.worst.max(beyond);
        met.at_walls += 1;
    }
    met
}

#[test]
fn a_mesh_of_a_region_where_surveys_meet_is_the_surface_within_its_bound() {
    mesh_is_surface(Seams::Off);
}

#[test]
fn a_mesh_over_corrected_seams_is_the_surface_within_its_bound() {
    mesh_is_surface(Seams::All);
}

fn mesh_is_surface(seams: Seams) {
    let folder = tempfile::tempdir().unwrap();
    let db = folder.path().join("db");
    let path = db.to_str().unwrap();
    printed(&["init", path, "--crs", "EPSG:26910", "--policy", "newest"]);
    for (file, name, accuracy, date) in [
        ("survey_2000-09-25_native.tif", "crater", "2", "2000-09-25"),
        ("survey_2004-10-11_native.tif", "dome-2", "0.5", "2004-10-11"),
        ("survey_2004-10-13_native.tif", "dome-3", "0.5", "2004-10-13"),
    ] {
        let file = bundled("st_helens").join(file);
        printed(&[
            "ingest",
            path,
            file.to_str().unwrap(),
            "--name",
            name,
            "--accuracy",
            accuracy,
            "--date",
            date,
        ]);
    }
    let out = folder.path().join("dome.glb");
    let bbox = [562_120.0, 5_115_450.0, 562_900.0, 5_116_350.0];
    let text = bbox.map(|v| v.to_string()).join(",");
    let mut args = vec!["export", path, out.to_str().unwrap(), "--error", "6", "--bbox", &text, "--json"];
    // Seams are corrected unless said otherwise.
    if seams == Seams::Off {
        args.extend(["--seams", "off"]);
    }
    let told = printed(&args);
    let told: Value = serde_json::from_str(&told).unwrap();
    let mesh = read(&out);
    let extras = &mesh.json["asset"]["extras"];
    let number = |v: &Value| v.as_f64().unwrap();
    assert_eq!(extras["crs"], "EPSG:26910");
    assert_eq!(extras["version"], 3);
    assert_eq!(number(&extras["error_m"]), number(&told["error_m"]));
    assert_eq!(extras["seams"], seams.name());
    let bent = number(&extras["correction_m"]);
    assert!((bent > 1.0) == (seams == Seams::All));
    // A contributor may be bent by more than the mean of them is.
    assert!(number(&extras["error_m"]) <= 6.0 + 1.1 * bent, "{extras}");
    assert!(number(&extras["surface_error_m"]) >= bent);
    assert_eq!(
        number(&extras["error_m"]),
        number(&extras["surface_error_m"]) + number(&extras["mesh_error_m"])
    );
    // The border is that of the box: a closed line.
    let border = border_edges(&mesh);
    let area: f64 = mesh
        .triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.map(|k| mesh.positions[k]);
            ((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])) / 2.0
        })
        .sum();
    let whole = (bbox[2] - bbox[0]) * (bbox[3] - bbox[1]);
    assert!((area - whole).abs() < 1e-6 * whole, "{area} {whole}");

    let db = Db::open(&db).unwrap();
    let s = db.snapshot(None).unwrap();
    let mut r = Random::new(20_261_122);
    let random: Vec<[f64; 2]> = (0..1_000_000)
        .map(|_| [bbox[0] + r.unit() * (bbox[2] - bbox[0]), bbox[1] + r.unit() * (bbox[3] - bbox[1])])
        .collect();
    let mut edges = Vec::new();
    let mut centres = Vec::new();
    for t in &mesh.triangles {
        let c = t.map(|k| mesh.positions[k]);
        centres.push([0, 1].map(|k| (c[0][k] + c[1][k] + c[2][k]) / 3.0));
        edges.push([0, 1].map(|k| (c[0][k] + c[1][k]) / 2.0));
    }
    // Borders of patches of the 2 m surveys: multiples of 28 posts, and cell centres beside them.
    let mut borders = Vec::new();
    for k in 0..100_000u32 {
        let t = f64::from(k) / 100_000.0;
        let x = ((bbox[0] + t * (bbox[2] - bbox[0])) / 56.0).floor() * 56.0;
        borders.push([x, bbox[1] + r.unit() * (bbox[3] - bbox[1])]);
        borders.push([
            ((bbox[0] + t * (bbox[2] - bbox[0])) / 2.0).floor() * 2.0 + 1.0,
            bbox[1] + r.unit() * 900.0,
        ]);
    }
    for (what, points) in [
        ("random", &random),
        ("edge midpoints", &edges),
        ("triangle centres", &centres),
        ("patch borders", &borders),
    ] {
        // The surface is taken at the accuracy of the crater, 2 m; the mesh has the other 4 m.
        let met = compare(&s, &mesh, (2.0, seams), 4.0, 2.0 * 0.02, points);
        println!(
            "{what}: {} points, worst {:.4} m of 4 m, {} of them at walls (surface passes the mesh within 4 cm)",
            met.points, met.worst, met.at_walls
        );
        assert!(met.worst <= 4.0, "{what}: {} m", met.worst);
        assert!(met.points * 10 > points.len() * 9, "{what}: only {} points compared", met.points);
        assert!(met.at_walls * 200 < met.points, "{what}: {} points at walls", met.at_walls);
    }
    println!("{}: {} triangles, {border} border edges, {}", seams.name(), mesh.triangles.len(), told);
}
