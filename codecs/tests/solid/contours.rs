//! Marching cubes.

use super::bodies::{bad_edges, cuboid, least_area, sphere};
use crate::support::random::Random;
use proptest::prelude::*;
use terraquilt_codecs::solid::{Border, Field, MARGIN, Samples, Window, separation, surface};
use terraquilt_codecs::work::Alone;

fn window(size: [usize; 3]) -> Window {
    Window { size, origin: [0.0; 3], voxel: 1.0 }
}

/// Values of every kind of place: full of zeros, of few values, of noise.
fn noise(r: &mut Random, count: usize) -> Vec<f32> {
    let kind = r.below(4);
    (0..count)
        .map(|_| match kind {
            0 => r.below(3) as f32 - 1.0,
            1 => r.below(2) as f32,
            2 => r.below(255) as f32 - 127.0,
            _ => (r.unit() - 0.5) as f32 * 1e30,
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// Of any values whatever: closed, every edge of two triangles that face the same way, no triangle without area.
    #[test]
    fn closed_whatever_the_values(seed in any::<u64>(), size in prop::array::uniform3(1usize..9)) {
        let values = noise(&mut Random::new(seed), size.iter().product());
        let samples = Samples { window: window(size), values: &values };
        let mesh = surface(&samples, 0.0, Border::Closed, &Alone).unwrap();
        prop_assert_eq!(bad_edges(&mesh), 0);
        prop_assert!(mesh.triangles.is_empty() || least_area(&mesh) > 1e-6);
        prop_assert!(mesh.volume() >= 0.0);
        // All vertices are used, and none is there twice.
        let mut used: Vec<u32> = mesh.triangles.as_flattened().to_vec();
        used.sort();
        used.dedup();
        prop_assert_eq!(used.len(), mesh.positions.len());
        let mut places = mesh.positions.clone();
        places.sort_by(|a, b| a.partial_cmp(b).unwrap());
        places.dedup();
        prop_assert_eq!(places.len(), mesh.positions.len());
    }

    /// An open border is open only where the window ends, and the rest is the same surface.
    #[test]
    fn open_only_at_the_border(seed in any::<u64>(), size in prop::array::uniform3(2usize..9)) {
        let values = noise(&mut Random::new(seed), size.iter().product());
        let samples = Samples { window: window(size), values: &values };
        let mesh = surface(&samples, 0.0, Border::Open, &Alone).unwrap();
        let mut sides: Vec<([u32; 2], bool)> = mesh.triangles.iter()
            .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
            .map(|[a, b]| ([a.min(b), a.max(b)], a < b))
            .collect();
        sides.sort();
        for group in sides.chunk_by(|a, b| a.0 == b.0) {
            if let [(ends, _)] = group {
                let at_end = (0..3).any(|k| [0.5, size[k] as f64 - 0.5].into_iter().any(|end| {
                    ends.iter().all(|v| mesh.positions[*v as usize][k] == end)
                }));
                prop_assert!(at_end, "an open edge within the window");
            } else {
                prop_assert!(group.len() == 2 && group[0].1 != group[1].1);
            }
        }
    }
}

/// A sample that equals the level is outside; the vertices beside it are 1/256 of a voxel away from it.
#[test]
fn zeros_are_outside() {
    let mut values = vec![-1.0f64; 27];
    let marched = |values: &[f64]| {
        surface(&Samples { window: window([3; 3]), values }, 0.0, Border::Closed, &Alone).unwrap()
    };
    values[13] = 0.0;
    assert_eq!(marched(&values).triangles.len(), 0);
    values.fill(0.0);
    values[13] = 1.0;
    let mesh = marched(&values);
    assert_eq!((mesh.positions.len(), mesh.triangles.len(), bad_edges(&mesh)), (6, 8, 0));
    for p in &mesh.positions {
        let away: f64 = p.iter().map(|v| (v - 1.5).abs()).sum();
        assert_eq!(away, 255.0 / 256.0);
    }
    // Above its level, and bytes.
    let bytes: Vec<i8> = values.iter().map(|v| (100.0 * v) as i8).collect();
    let mesh =
        surface(&Samples { window: window([3; 3]), values: &bytes }, 50.0, Border::Open, &Alone).unwrap();
    assert!(mesh.positions.iter().all(|p| p.iter().map(|v| (v - 1.5).abs()).sum::<f64>() == 0.5));
}

/// All inside: closed at the window's border, six flat faces.
#[test]
fn a_full_window_is_a_box() {
    let values = [5i8; 60];
    let samples = Samples { window: window([3, 4, 5]), values: &values };
    assert_eq!(surface(&samples, 0.0, Border::Open, &Alone).unwrap().triangles.len(), 0);
    let mesh = surface(&samples, 0.0, Border::Closed, &Alone).unwrap();
    assert_eq!(bad_edges(&mesh), 0);
    assert_eq!(mesh.bounds(), Some([[0.0; 3], [3.0, 4.0, 5.0]]));
}

/// A sphere's field becomes a closed sphere, outward-facing, within a voxel: a tenth of one.
#[test]
fn a_sphere_comes_back() {
    let ball = sphere([5.0, 6.0, 7.0], 2.0, 5);
    for n in [16, 33, 64] {
        let window = Window::around(ball.bounds().unwrap(), [n; 3], MARGIN).unwrap();
        let (field, _) = Field::of(&ball, window, &Alone).unwrap();
        let mesh = surface(&field.samples(), 0.0, Border::Open, &Alone).unwrap();
        assert_eq!(bad_edges(&mesh), 0);
        let off = separation(&ball, &mesh, window.voxel / 4.0, &Alone).unwrap();
        assert!(off.hausdorff() < 0.1 * window.voxel, "{n}: {} voxels", off.hausdorff() / window.voxel);
        let exact = 4.0 / 3.0 * std::f64::consts::PI * 8.0;
        assert!((mesh.volume() / exact - 1.0).abs() < 0.03, "{}", mesh.volume());
        assert!(mesh.face_normals().iter().enumerate().all(|(t, n)| {
            let [a, ..] = mesh.corners(t);
            n.iter().zip([a[0] - 5.0, a[1] - 6.0, a[2] - 7.0]).map(|(a, b)| a * b).sum::<f64>() > 0.0
        }));
    }
}

/// Windows that share a layer of samples have the same vertices on it.
#[test]
fn neighbouring_windows_meet() {
    let ball = sphere([8.0; 3], 6.5, 4);
    let whole = Window { size: [16; 3], origin: [0.0; 3], voxel: 1.0 };
    let (field, _) = Field::of(&ball, whole, &Alone).unwrap();
    let half = |from: usize, layers: usize| {
        let values = &field.values[from * 256..(from + layers) * 256];
        let window = Window { size: [16, 16, layers], origin: [0.0, 0.0, from as f64], voxel: 1.0 };
        surface(&Samples { window, values }, 0.0, Border::Open, &Alone).unwrap()
    };
    let all = surface(&field.samples(), 0.0, Border::Open, &Alone).unwrap();
    let (low, high) = (half(0, 8), half(7, 9));
    assert_eq!(low.triangles.len() + high.triangles.len(), all.triangles.len());
    let on = |mesh: &terraquilt_codecs::solid::Mesh| {
        let mut out: Vec<_> = mesh.positions.iter().filter(|p| p[2] == 7.5).copied().collect();
        out.sort_by(|a, b| a.partial_cmp(b).unwrap());
        out
    };
    assert!(on(&low).len() > 20);
    assert_eq!(on(&low), on(&high));
}

#[test]
fn samples_that_make_no_sense_are_refused() {
    let refused = |window: Window, values: &[f64], level: f64| {
        let found = surface(&Samples { window, values }, level, Border::Closed, &Alone);
        found.expect_err("refused").to_string()
    };
    let cube = window([2; 3]);
    assert!(refused(cube, &[0.0; 7], 0.0).contains("7 values for 8 voxels"));
    assert!(refused(cube, &[f64::NAN; 8], 0.0).contains("voxel 0, 0, 0 is not finite"));
    assert!(refused(cube, &[0.0; 8], f64::INFINITY).contains("level"));
    assert!(refused(window([0, 1, 1]), &[], 0.0).contains("0 voxels"));
    assert!(refused(window([usize::MAX; 3]), &[], 0.0).contains("at most 512 allowed"));
    assert!(refused(Window { voxel: f64::NAN, ..cube }, &[0.0; 8], 0.0).contains("voxel"));
    assert!(refused(Window { origin: [f64::NAN; 3], ..cube }, &[0.0; 8], 0.0).contains("window"));
}

#[test]
fn a_box_comes_back_within_a_voxel() {
    let block = cuboid([0.0; 3], [3.0, 5.0, 9.0]);
    let window = Window::around(block.bounds().unwrap(), [40; 3], MARGIN).unwrap();
    let (field, _) = Field::of(&block, window, &Alone).unwrap();
    let mesh = surface(&field.samples(), 0.0, Border::Closed, &Alone).unwrap();
    let off = separation(&block, &mesh, window.voxel / 4.0, &Alone).unwrap();
    // Corners are cut: up to the diagonal of a voxel's half.
    assert!(off.hausdorff() < 0.9 * window.voxel, "{} voxels", off.hausdorff() / window.voxel);
}
