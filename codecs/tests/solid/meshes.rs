//! Meshes that are not as they should be.

use super::bodies::{both, cuboid, sphere, to_cuboid};
use crate::support::random::Random;
use terraquilt_codecs::Error;
use terraquilt_codecs::solid::mending::mended;
use terraquilt_codecs::solid::mesh::COORDINATE_MAX;
use terraquilt_codecs::solid::{Border, Field, MARGIN, Mesh, Report, Window, surface};
use terraquilt_codecs::work::Alone;

fn report(mesh: &Mesh) -> Report {
    mended(mesh).unwrap().1
}

fn field(mesh: &Mesh, n: usize) -> (Field, Report) {
    let window = Window::around(mesh.bounds().unwrap(), [n; 3], MARGIN).unwrap();
    Field::of(mesh, window, &Alone).unwrap()
}

#[test]
fn a_sound_mesh_has_nothing_to_report() {
    let found = report(&cuboid([0.0; 3], [1.0; 3]));
    assert_eq!((found.triangles, found.positions, found.components), (12, 8, 1));
    assert!(found.is_closed() && found.warning().is_none());
    // Corners apart are joined.
    let found = report(&sphere([0.0; 3], 1.0, 2));
    assert_eq!((found.triangles, found.positions, found.warning()), (128, 66, None));
}

#[test]
fn what_is_wrong_is_counted() {
    let sound = cuboid([0.0; 3], [1.0; 3]);
    let open = Mesh { triangles: sound.triangles[1..].to_vec(), ..sound.clone() };
    assert_eq!(report(&open).open_edges, 3);
    assert!(report(&open).warning().unwrap().contains("3 open edges"));
    // A wall within: its four outer edges have three triangles.
    let mut walled = both(&sound, &cuboid([0.0; 3], [1.0; 3]));
    walled.triangles.truncate(12);
    walled.triangles.extend([[0, 1, 7], [0, 7, 6]]);
    let found = report(&walled);
    assert_eq!((found.crowded_edges, found.open_edges), (4, 0));
    assert!(!found.is_closed());
    // Three triangles turned over.
    let mut mixed = sound.clone();
    [2, 5, 9].into_iter().for_each(|k: usize| mixed.triangles[k].swap(0, 2));
    let (mesh, found) = mended(&mixed).unwrap();
    assert_eq!((found.turned, found.one_sided_edges, found.inside_out), (3, 0, false));
    assert!((mesh.volume() - 1.0).abs() < 1e-12 && found.is_closed());
    // All turned over.
    let mut inward = sound.clone();
    inward.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let (mesh, found) = mended(&inward).unwrap();
    assert!(found.inside_out && (mesh.volume() - 1.0).abs() < 1e-12);
    // A band with half a turn has one side.
    let band: Vec<[f64; 3]> = (0..10u32)
        .flat_map(|k| {
            let (a, half) = (f64::from(k) * 0.628_318_530_717, f64::from(k) * 0.314_159_265_358);
            [-1.0, 1.0].map(|w: f64| {
                let r = 5.0 + w * half.cos();
                [r * a.cos(), r * a.sin(), w * half.sin()]
            })
        })
        .collect();
    let mut triangles: Vec<[u32; 3]> = (0..9)
        .flat_map(|k: u32| [[2 * k, 2 * k + 2, 2 * k + 1], [2 * k + 1, 2 * k + 2, 2 * k + 3]])
        .collect();
    triangles.extend([[18, 1, 19], [19, 1, 0]]);
    let found = report(&Mesh { positions: band, triangles });
    assert_eq!((found.one_sided_edges, found.open_edges, found.components), (1, 20, 1));
}

/// Of triangles on the same corners one stays, and none of two back to back.
#[test]
fn doubled_triangles_cancel() {
    let sound = cuboid([0.0; 3], [1.0; 3]);
    let mut mesh = both(&sound, &sound);
    let (found, said) = mended(&mesh).unwrap();
    assert_eq!((found.triangles.len(), said.doubled), (12, 12));
    assert!(said.is_closed());
    // A flap: out from an edge and back.
    let alone = mended(&sound).unwrap().0.triangles;
    mesh = sound.clone();
    mesh.positions.push([-3.0, 0.0, 0.0]);
    mesh.triangles.extend([[0, 4, 8], [8, 4, 0]]);
    let (found, said) = mended(&mesh).unwrap();
    assert_eq!((found.triangles, said.doubled, said.crowded_edges), (alone, 2, 0));
    mesh.triangles.drain(..12);
    let said = mended(&mesh).unwrap_err().to_string();
    assert!(said.contains("2 lie back to back"), "{said}");
}

/// Every hole is closed by triangles that face as the rest: also holes that touch at a corner.
#[test]
fn holes_are_closed() {
    let sound = sphere([0.0; 3], 1.0, 3);
    let whole = mended(&sound).unwrap().0;
    let mut r = Random::new(3);
    for _ in 0..50 {
        let missing = 0.02 + 0.3 * r.unit();
        let triangles = whole.triangles.iter().filter(|_| r.unit() > missing).copied().collect();
        let (closed, said) = mended(&Mesh { triangles, ..whole.clone() }).unwrap();
        assert!(said.holes > 0 && said.open_edges > 2);
        let mut sides: Vec<[u32; 2]> =
            closed.triangles.iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]).collect();
        let mut back: Vec<[u32; 2]> = sides.iter().map(|[a, b]| [*b, *a]).collect();
        sides.sort();
        back.sort();
        assert_eq!(sides, back, "a side that none runs back along");
        assert!(closed.volume() > 0.5 * whole.volume());
    }
}

/// Boxes that cross: what is inside of either is inside, though the nearest triangle may face the other way.
#[test]
fn crossing_parts_are_one() {
    let (a, b) = ([[0.0; 3], [10.0; 3]], [[4.0, 4.0, 4.0], [16.0, 7.0, 7.0]]);
    let mesh = both(&cuboid(a[0], a[1]), &cuboid(b[0], b[1]));
    let (field, said) = field(&mesh, 40);
    assert!(said.is_closed() && said.resigned > 0);
    assert_eq!(said.torn, 0);
    for (k, value) in field.values.iter().enumerate() {
        let p = field.window.from_voxels([k % 40, k / 40 % 40, k / 1600].map(|v| v as f64 + 0.5));
        let depth = to_cuboid(p, a[0], a[1]).max(to_cuboid(p, b[0], b[1])) / field.window.voxel;
        assert!(depth.abs() < 0.07 || (depth > 0.0) == (*value >= 0), "{p:?}: {value}, {depth}");
    }
}

#[test]
fn degenerate_triangles_are_left_out_and_open_nothing() {
    let mut mesh = cuboid([0.0; 3], [2.0; 3]);
    // A side is divided, and a triangle on one line holds it to its neighbour.
    mesh.triangles.retain(|t| *t != [0, 4, 6]);
    mesh.positions.push([0.0, 1.0, 2.0]);
    mesh.triangles.extend([[0, 4, 8], [0, 8, 6], [4, 6, 8], [1, 1, 2]]);
    let found = report(&mesh);
    assert_eq!((found.degenerate, found.open_edges, found.crowded_edges), (2, 0, 0));
    let (field, found) = field(&mesh, 32);
    assert_eq!((found.torn, found.resigned), (0, 0));
    let again = surface(&field.samples(), 0.0, Border::Open, &Alone).unwrap();
    assert!((again.volume() - 8.0).abs() < 0.1, "{}", again.volume());
}

/// A bowl: open above. The voxels beyond its box are outside, so the surface that comes back is closed.
#[test]
fn open_meshes_come_back_closed() {
    let mut bowl = sphere([0.0; 3], 3.0, 4);
    let low = |t: &[u32; 3]| t.iter().all(|v| bowl.positions[*v as usize][2] < 0.8);
    bowl.triangles = bowl.triangles.iter().filter(|t| low(t)).copied().collect();
    let (field, found) = field(&bowl, 48);
    assert!(found.open_edges > 20 && found.warning().unwrap().contains("best guess"));
    let mesh = surface(&field.samples(), 0.0, Border::Open, &Alone).unwrap();
    assert_eq!(super::bodies::bad_edges(&mesh), 0);
    assert!(mesh.volume() > 0.0);
}

#[test]
fn meshes_that_make_no_sense_are_refused() {
    let said = |mesh: &Mesh| match mended(mesh) {
        Err(e) => e.to_string(),
        Ok(_) => panic!("not refused: {mesh:?}"),
    };
    let sound = cuboid([0.0; 3], [1.0; 3]);
    assert!(said(&Mesh::default()).contains("no triangles"));
    assert!(said(&Mesh { triangles: Vec::new(), ..sound.clone() }).contains("no triangles"));
    for bad in [f64::NAN, f64::INFINITY, 2.0 * COORDINATE_MAX] {
        let mut mesh = sound.clone();
        mesh.positions[3][1] = bad;
        assert!(said(&mesh).contains("position 3"));
    }
    let mut mesh = sound.clone();
    mesh.triangles[4][2] = 8;
    assert!(said(&mesh).contains("triangle 4") && said(&mesh).contains("8 positions"));
    // No extent: a point, a line.
    let point = Mesh { positions: vec![[1.0; 3]; 8], ..sound.clone() };
    assert!(said(&point).contains("of its 12 triangles 12 have no area"));
    let line = Mesh { positions: (0..8).map(|k| [f64::from(k), 0.0, 0.0]).collect(), ..sound.clone() };
    assert!(said(&line).contains("of its 12 triangles 12 have no area"));
    let bounds = point.bounds().unwrap();
    assert!(Window::around(bounds, [32; 3], MARGIN).unwrap_err().to_string().contains("extent"));
    // A speck far away leaves no digits for its voxels.
    let speck = cuboid([1e15; 3], [1e15 + 1.0; 3]);
    let said = Window::around(speck.bounds().unwrap(), [32; 3], MARGIN).unwrap_err().to_string();
    assert!(said.contains("move the mesh"), "{said}");
    let (min, max) = ([0.0; 3], [1.0; 3]);
    assert!(matches!(Window::around([min, max], [513; 3], MARGIN), Err(Error::Limit { .. })));
    assert!(Window::around([min, max], [4; 3], MARGIN).is_err());
    assert!(Window::around([min, max], [9; 3], f64::NAN).is_err());
    // Far beyond the window.
    let window = Window { size: [8; 3], origin: [0.0; 3], voxel: 1e-30 };
    assert!(Field::of(&sound, window, &Alone).unwrap_err().to_string().contains("voxels from the window"));
}

/// Tiny and great meshes are as good as any: distances are in voxels.
#[test]
fn any_scale() {
    let wanted = field(&cuboid([0.0; 3], [1.0, 2.0, 3.0]), 24).0.values;
    for scale in [1.0 / (1u64 << 60) as f64 / (1u64 << 60) as f64, (1u64 << 60) as f64] {
        let (found, report) = field(&cuboid([0.0; 3], [scale, 2.0 * scale, 3.0 * scale]), 24);
        assert_eq!((found.values == wanted, report.warning()), (true, None));
    }
}
