//! Meshes of surfaces that are known, on regions that are ugly.

use super::*;
use crate::base::Error;

/// A field made of a height function and a region given as quads; gradients by differences.
struct Surface<F: Fn(f64, f64) -> f64 + Sync> {
    quads: Vec<[[f64; 2]; 4]>,
    height: F,
}

impl<F: Fn(f64, f64) -> f64 + Sync> Surface<F> {
    fn has(&self, p: [f64; 2]) -> bool {
        let left = |a: [f64; 2], b: [f64; 2]| {
            let cross = (b[0] - a[0]) * (p[1] - a[1]) - (p[0] - a[0]) * (b[1] - a[1]);
            cross >= -1e-9
        };
        self.quads.iter().any(|q| (0..4).all(|k| left(q[k], q[(k + 1) % 4])))
    }
}

impl<F: Fn(f64, f64) -> f64 + Sync> Field for Surface<F> {
    fn sample(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>) {
        let (h, e) = (&self.height, 1e-4);
        out.clear();
        out.extend(points.iter().map(|&[x, y]| {
            self.has([x, y]).then(|| FieldSample {
                z: h(x, y),
                dzdx: (h(x + e, y) - h(x - e, y)) / (2.0 * e),
                dzdy: (h(x, y + e) - h(x, y - e)) / (2.0 * e),
            })
        }));
    }
}

fn square(x0: f64, y0: f64, side: f64) -> [[f64; 2]; 4] {
    [[x0, y0], [x0 + side, y0], [x0 + side, y0 + side], [x0, y0 + side]]
}

/// Cells of a grid of `n` times `n` but those that `void` names, turned by `angle` around the middle.
fn cells(n: i32, step: f64, angle: f64, void: impl Fn(i32, i32) -> bool) -> Vec<[[f64; 2]; 4]> {
    let (sin, cos) = angle.sin_cos();
    let corner = |i: i32, j: i32| {
        let (u, v) = (f64::from(i - n / 2) * step, f64::from(j - n / 2) * step);
        [u * cos - v * sin, u * sin + v * cos]
    };
    let quad = |(i, j)| [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
    let all = (0..n).flat_map(|j| (0..n).map(move |i| (i, j)));
    all.filter(|&(i, j)| !void(i, j)).map(quad).collect()
}

fn corners(quads: &[[[f64; 2]; 4]]) -> Vec<[f64; 2]> {
    quads.iter().flatten().copied().collect()
}

fn next(seed: &mut u64) -> f64 {
    *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    (*seed >> 11) as f64 / (1u64 << 53) as f64
}

/// Bilinear interpolation of noise on lattices of 5 sizes: kinks, peaks, no symmetry.
fn fractal(x: f64, y: f64) -> f64 {
    let noise = |i: i64, j: i64, k: u64| {
        let mut seed =
            (i as u64).wrapping_mul(0x9e37_79b9) ^ (j as u64).wrapping_mul(0x85eb_ca6b_1234) ^ (k << 48);
        next(&mut seed);
        next(&mut seed) - 0.5
    };
    (0..5)
        .map(|k| {
            let size = 64.0 / f64::from(1 << k);
            let (u, v) = (x / size, y / size);
            let (i, j) = (u.floor(), v.floor());
            let (s, t) = (u - i, v - j);
            let at = |di: i64, dj: i64| noise(i as i64 + di, j as i64 + dj, k as u64);
            let south = at(0, 0) * (1.0 - s) + at(1, 0) * s;
            let north = at(0, 1) * (1.0 - s) + at(1, 1) * s;
            size * 0.7 * (south * (1.0 - t) + north * t)
        })
        .sum()
}

/// Triangulates and checks all that is promised; returns the mesh.
fn meshed<F: Fn(f64, f64) -> f64 + Sync>(
    surface: &Surface<F>,
    error_m: f64,
    step_m: f64,
    clip: Option<[f64; 4]>,
) -> Mesh {
    let region = outline(&surface.quads, clip).expect("an outline");
    let posts = corners(&surface.quads);
    let options = MeshOptions::new(error_m, step_m, posts.clone());
    let mesh = triangulate(surface, &region, &options, &|_| true).expect("a mesh");
    let stats = check(&mesh).expect("a manifold");
    let area: f64 = region.iter().map(Polygon::area).sum();
    assert!(
        (stats.area_m2 - area).abs() <= 1e-5 * area,
        "area {} of the mesh, {area} of the region",
        stats.area_m2
    );
    assert!(mesh.error_m <= error_m, "{} is above {error_m}", mesh.error_m);
    assert!(mesh.measured_points as usize >= mesh.positions.len());

    // Random points of all triangles, those at the middles of edges among them.
    let mut seed = 42;
    let mut worst = 0.0f64;
    let per_triangle = (100_000 / mesh.triangles.len().max(1)).max(4);
    for t in &mesh.triangles {
        let at = t.map(|v| mesh.positions[v as usize]);
        for i in 0..per_triangle {
            let w = match i {
                0 => [0.5, 0.5, 0.0],
                1 => [0.0, 0.5, 0.5],
                2 => [0.5, 0.0, 0.5],
                _ => {
                    let (a, b) = (next(&mut seed), next(&mut seed));
                    let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                    [a, b, 1.0 - a - b]
                }
            };
            let p: Vec<f64> = (0..3).map(|k| (0..3).map(|c| w[c] * at[c][k]).sum()).collect();
            worst = worst.max((p[2] - (surface.height)(p[0], p[1])).abs());
        }
    }
    assert!(worst <= error_m * 1.02, "{worst} at a random point, {error_m} promised");

    let again = triangulate(surface, &region, &options, &|_| true).expect("a mesh again");
    assert!(mesh == again, "two runs differ");
    mesh
}

#[test]
fn a_plane_needs_two_triangles() {
    let surface =
        Surface { quads: cells(16, 2.0, 0.0, |_, _| false), height: |x, y| 3.0 + 0.5 * x - 0.25 * y };
    let mesh = meshed(&surface, 0.01, 2.0, None);
    assert_eq!((mesh.positions.len(), mesh.triangles.len()), (4, 2));
    let n = mesh.normals[0];
    assert!((n[0] / n[2] + 0.5).abs() < 1e-4 && (n[1] / n[2] - 0.25).abs() < 1e-4);
}

#[test]
fn a_cone_is_met_within_the_bound() {
    let surface =
        Surface { quads: cells(32, 1.0, 0.0, |_, _| false), height: |x: f64, y: f64| 10.0 - x.hypot(y) };
    let coarse = meshed(&surface, 0.5, 1.0, None);
    let fine = meshed(&surface, 0.05, 1.0, None);
    assert!(coarse.triangles.len() < 100 && fine.triangles.len() > coarse.triangles.len());
}

#[test]
fn holes_stay_open() {
    let void = |i: i32, j: i32| {
        (i - 12).pow(2) + (j - 9).pow(2) < 20 || (i == 20 && j == 20) || (i == 21 && j == 21)
    };
    let surface = Surface { quads: cells(32, 3.0, 0.0, void), height: fractal };
    let mesh = meshed(&surface, 1.0, 3.0, None);
    assert!(check(&mesh).expect("checked").border_edges > 20);
}

#[test]
fn components_that_touch_at_a_corner_share_no_vertex() {
    let surface = Surface {
        quads: vec![square(0.0, 0.0, 10.0), square(10.0, 10.0, 10.0), square(-10.0, 10.0, 10.0)],
        height: |x, y| 0.1 * x * y / 10.0,
    };
    let mesh = meshed(&surface, 0.2, 1.0, None);
    let touching = mesh.positions.iter().filter(|p| p[0] == 10.0 && p[1] == 10.0).count();
    assert_eq!(touching, 2);
}

#[test]
fn a_turned_grid_with_voids_has_straight_borders() {
    let quads = cells(40, 1.0, 0.35, |i, j| i % 9 == 4 && j % 7 == 3);
    let region = outline(&quads, None).expect("an outline");
    assert_eq!(region.len(), 1);
    assert_eq!(region[0].outer.len(), 4, "rounding must leave no vertex between the corners");
    assert_eq!(region[0].holes.len(), quads.len().abs_diff(1600));
    assert!(region[0].holes.iter().all(|h| h.len() == 4));
    meshed(&Surface { quads, height: fractal }, 0.8, 1.0, None);
}

#[test]
fn two_surveys_turned_against_each_other_make_one_region() {
    let mut quads = cells(20, 2.0, 0.0, |_, _| false);
    quads.extend(cells(24, 1.5, 0.6, |i, j| i == 3 && j == 3));
    meshed(
        &Surface { quads, height: |x, y| fractal(x + 200.0, y) },
        0.7,
        1.5,
        Some([-18.0, -100.0, 17.3, 11.1]),
    );
}

#[test]
fn checkerboards_are_manifold() {
    let surface = Surface { quads: cells(6, 1.0, 0.2, |i, j| (i + j) % 2 == 0), height: |x, y| x * y * 0.3 };
    let mesh = meshed(&surface, 0.1, 1.0, None);
    assert!(mesh.triangles.len() >= 36);
    let surface = Surface {
        quads: cells(8, 1.0, 0.0, |i, j| i > 0 && j > 0 && i < 7 && j < 7 && (i + j) % 2 == 0),
        height: fractal,
    };
    meshed(&surface, 0.1, 1.0, None);
}

#[test]
fn a_border_that_bends_between_vertices_is_split() {
    let surface = Surface {
        quads: vec![square(-50.0, -50.0, 100.0)],
        height: |x: f64, y: f64| 5.0 * (x * 0.2).sin() * (y * 0.1).cos(),
    };
    let mesh = meshed(&surface, 0.2, 4.0, None);
    assert!(mesh.positions.iter().filter(|p| p[1] == -50.0).count() > 10);
}

#[test]
fn a_cliff_between_posts_ends_and_is_told() {
    let surface = Surface {
        quads: vec![square(0.0, 0.0, 8.0)],
        height: |x: f64, y: f64| if x + 0.37 * y > 5.2 { 10.0 } else { 0.0 },
    };
    let region = outline(&surface.quads, None).expect("an outline");
    let options = MeshOptions { vertices_max: 30_000, ..MeshOptions::new(1.0, 1.0, vec![]) };
    match triangulate(&surface, &region, &options, &|_| true) {
        Ok(mesh) => assert!(mesh.error_m > 1.0 && check(&mesh).is_ok()),
        Err(e) => assert!(matches!(e, Error::Limit { .. }), "{e}"),
    }
}

#[test]
fn work_can_be_stopped_and_is_limited() {
    let surface = Surface { quads: cells(32, 1.0, 0.0, |_, _| false), height: fractal };
    let region = outline(&surface.quads, None).expect("an outline");
    let mut options = MeshOptions::new(0.1, 1.0, corners(&surface.quads));
    assert!(matches!(triangulate(&surface, &region, &options, &|_| false), Err(Error::Stopped)));
    options.vertices_max = 50;
    assert!(matches!(triangulate(&surface, &region, &options, &|_| true), Err(Error::Limit { .. })));
    options.error_m = 0.0;
    assert!(matches!(triangulate(&surface, &region, &options, &|_| true), Err(Error::Invalid { .. })));
    assert_eq!(
        triangulate(&surface, &[], &MeshOptions::new(1.0, 1.0, vec![]), &|_| true).expect("empty"),
        Mesh::default()
    );
}

#[test]
fn outlines_merge_what_touches_and_keep_what_does_not() {
    let grid = outline(&cells(64, 90.0, 0.0, |_, _| false), None).expect("an outline");
    assert_eq!(grid.len(), 1);
    assert_eq!((grid[0].outer.len(), grid[0].holes.len()), (4, 0));
    assert_eq!(grid[0].area(), (64.0f64 * 90.0).powi(2));
    let apart = outline(&[square(0.0, 0.0, 1.0), square(2.0, 0.0, 1.0)], None).expect("an outline");
    assert_eq!(apart.len(), 2);
    let cut =
        outline(&cells(64, 90.0, 0.0, |_, _| false), Some([-100.0, -100.0, 50.0, 1e9])).expect("an outline");
    assert_eq!(cut[0].area(), 150.0 * (100.0 + 32.0 * 90.0));
    assert!(
        outline(&cells(4, 1.0, 0.0, |_, _| false), Some([10.0, 10.0, 11.0, 11.0])).expect("empty").is_empty()
    );
    assert!(outline(&[square(f64::NAN, 0.0, 1.0)], None).is_err());
    let clockwise = square(0.0, 0.0, 1.0).map(|p| [-p[0], p[1]]);
    assert_eq!(outline(&[clockwise], None).expect("an outline")[0].area(), 1.0);
}

#[test]
fn surveys_computed_apart_leave_no_slivers() {
    // Coarse and fine cells along a turned seam; the fine corners are off the coarse edges by rounding.
    let (sin, cos) = 0.7f64.sin_cos();
    let turn = |u: f64, v: f64| [u * cos - v * sin, u * sin + v * cos];
    let quad = |u: f64, v: f64, s: f64| [turn(u, v), turn(u + s, v), turn(u + s, v + s), turn(u, v + s)];
    let mut quads: Vec<_> = (0..10).map(|j| quad(-30.0, f64::from(j) * 30.0, 30.0)).collect();
    quads.extend(
        (0..3).flat_map(|i| (0..100).map(move |j| quad(f64::from(i) * 3.0, f64::from(j) * 3.0, 3.0))),
    );
    let region = outline(&quads, None).expect("an outline");
    assert_eq!(region.len(), 1);
    assert_eq!((region[0].outer.len(), region[0].holes.len()), (4, 0));
}

#[test]
fn the_grid_is_what_32_bits_resolve() {
    assert_eq!(grid_unit(16_384.0), 16_384.0 / f64::from(1 << 24));
    assert_eq!(grid_unit(16_385.0), 2.0 * grid_unit(16_384.0));
    let unit = grid_unit(46_080.0);
    for k in [1i32, 12_345_677, 46_080 << 8] {
        let x = f64::from(k) * unit;
        assert_eq!(f64::from(x as f32), x);
    }
}

/// The bilinear cells of a lattice, of which some are void.
struct Cells {
    grid: PostGrid,
    quads: Vec<[[f64; 2]; 4]>,
}

impl Field for Cells {
    fn sample(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>) {
        out.clear();
        out.extend(points.iter().map(|p| {
            let (i, j) = self.grid.index(*p);
            let [dzdx, dzdy] = self.grid.slopes(i, j);
            let z = self.grid.at(i, j);
            z.is_finite().then_some(FieldSample { z, dzdx, dzdy })
        }));
    }
}

#[test]
fn a_lattice_is_met_everywhere_and_not_only_at_its_posts() {
    let n = 200i32;
    for (angle, voids) in [(0.0f64, false), (0.35, false), (0.0, true)] {
        let step = 2.0;
        let void = |i: i32, j: i32| voids && (i - 60).pow(2) + (j - 90).pow(2) < 300;
        let quads = cells(n, step, angle, void);
        let (sin, cos) = angle.sin_cos();
        let (u, v) = ([step * cos, step * sin], [-step * sin, step * cos]);
        let half = f64::from(n / 2);
        let origin = [0, 1].map(|k| -half * (u[k] + v[k]));
        let side = n as usize + 1;
        let mut grid = PostGrid { origin, u, v, cols: side, rows: side, heights: vec![] };
        grid.heights = (0..side * side)
            .map(|k| {
                let (i, j) = ((k % side) as i32, (k / side) as i32);
                // A post of void cells only has no height.
                let alone = (0..4).all(|c| void(i - c % 2, j - c / 2));
                let [x, y] = grid.place(f64::from(i), f64::from(j));
                if alone { f64::NAN } else { fractal(x, y) }
            })
            .collect();
        let field = Cells { grid, quads };
        let region = outline(&field.quads, None).expect("an outline");
        let bound = 0.4;
        let options = MeshOptions { grid: Some(field.grid.clone()), ..MeshOptions::new(bound, step, vec![]) };
        let mesh = triangulate(&field, &region, &options, &|_| true).expect("a mesh");
        let stats = check(&mesh).expect("a manifold");
        let area: f64 = region.iter().map(Polygon::area).sum();
        assert!((stats.area_m2 - area).abs() <= 1e-5 * area, "{} of {area}", stats.area_m2);
        assert!(mesh.error_m <= bound && mesh.error_m > 0.9 * bound, "{}", mesh.error_m);
        assert!(mesh.triangles.len() < 2 * (n * n) as usize, "no fewer than the cells have");
        let (mut seed, mut worst) = (7, 0.0f64);
        for t in &mesh.triangles {
            let at = t.map(|v| mesh.positions[v as usize]);
            for _ in 0..20 {
                let (a, b) = (next(&mut seed), next(&mut seed));
                let (a, b) = if a + b > 1.0 { (1.0 - a, 1.0 - b) } else { (a, b) };
                let p: Vec<f64> =
                    (0..3).map(|c| a * at[0][c] + b * at[1][c] + (1.0 - a - b) * at[2][c]).collect();
                let (i, j) = field.grid.index([p[0], p[1]]);
                worst = worst.max((p[2] - field.grid.at(i, j)).abs());
            }
        }
        println!("turned by {angle}: {} triangles, {worst} m at random points", mesh.triangles.len());
        assert!(worst <= mesh.error_m * (1.0 + 1e-6), "{worst} at a random point, {} told", mesh.error_m);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a thread");
        let again = pool.install(|| triangulate(&field, &region, &options, &|_| true)).expect("a mesh again");
        assert!(mesh == again, "two runs differ");
    }
}
