//! Fields of shapes whose distances are known.

use super::bodies::{both, cuboid, sphere, to_cuboid, to_torus, torus};
use crate::support::random::Random;
use proptest::prelude::*;
use terraquilt_codecs::solid::field::{UNITS, quantised};
use terraquilt_codecs::solid::{Field, MARGIN, Mesh, Report, Window};
use terraquilt_codecs::work::{Alone, Workers};

fn field(mesh: &Mesh, size: [usize; 3]) -> (Field, Report) {
    let window = Window::around(mesh.bounds().unwrap(), size, MARGIN).unwrap();
    Field::of(mesh, window, &Alone).unwrap()
}

/// Calls `look` with each voxel's middle and value.
fn each(field: &Field, mut look: impl FnMut([f64; 3], i8)) {
    let [nx, ny, nz] = field.window.size;
    for z in 0..nz {
        for y in 0..ny {
            for x in 0..nx {
                let p = field.window.from_voxels([x, y, z].map(|v| v as f64 + 0.5));
                look(p, field.values[field.window.at([x, y, z])]);
            }
        }
    }
}

/// Each value is the true distance to the nearest unit; `slack` (in units of the mesh) is how far the triangles are from the shape.
fn holds(field: &Field, slack: f64, distance: impl Fn([f64; 3]) -> f64) {
    each(field, |p, value| {
        let at = |d: f64| quantised(d / field.window.voxel);
        let true_one = distance(p);
        let (low, high) = (at(true_one - slack), at(true_one + slack));
        assert!((low..=high).contains(&value), "{p:?}: {value}, not {low} to {high}");
    });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn boxes_are_exact(
        corner in prop::array::uniform3(-50.0..50.0f64),
        sides in prop::array::uniform3(0.5..20.0f64),
        size in prop::array::uniform3(9usize..50),
    ) {
        let max = [0, 1, 2].map(|k| corner[k] + sides[k]);
        let (field, report) = field(&cuboid(corner, max), size);
        prop_assert_eq!(report.warning(), None);
        prop_assert_eq!(report.resigned, 0);
        // 1e-9: a distance that is half way between two units may round either way.
        holds(&field, 1e-9, |p| to_cuboid(p, corner, max));
    }

    #[test]
    fn spheres_are_as_near_as_their_triangles(radius in 0.1..9.0f64, n in 20usize..60) {
        let middle = [3.0, -2.0, 7.0];
        let (field, report) = field(&sphere(middle, radius, 4), [n; 3]);
        prop_assert_eq!((report.warning(), report.components, report.resigned), (None, 1, 0));
        // Triangles of up to 9 degrees a side: their middles lie up to 0.4 % inside.
        holds(&field, radius * 0.005, |p| {
            radius - [0, 1, 2].map(|k| p[k] - middle[k]).iter().map(|v| v * v).sum::<f64>().sqrt()
        });
    }
}

#[test]
fn a_torus_has_its_hole() {
    let (r, t) = (10.0, 3.0);
    let (field, report) = field(&torus(r, t, 192), [72, 72, 30]);
    assert_eq!((report.warning(), report.resigned), (None, 0));
    holds(&field, 0.012, |p| to_torus(p, r, t));
    let middle = field.window.size.map(|n| n / 2);
    assert!(field.values[field.window.at(middle)] < -100);
}

/// A ball within a hollow box: two surfaces, and inside changes twice.
#[test]
fn hollows_are_outside() {
    let mut hollow = cuboid([3.0; 3], [37.0; 3]);
    hollow.triangles.iter_mut().for_each(|t| t.swap(0, 1));
    let ball = sphere([20.0; 3], 4.0, 4);
    let (field, report) = field(&both(&both(&cuboid([0.0; 3], [40.0; 3]), &hollow), &ball), [96; 3]);
    assert_eq!((report.warning(), report.components, report.resigned), (None, 3, 0));
    holds(&field, 0.02, |p| {
        let ball = 4.0 - p.map(|v| v - 20.0).iter().map(|v| v * v).sum::<f64>().sqrt();
        let shell = to_cuboid(p, [0.0; 3], [40.0; 3]).min(-to_cuboid(p, [3.0; 3], [37.0; 3]));
        ball.max(shell)
    });
}

/// Voxels that are farther than 16 voxels have no value but the greatest: the octree gives them at once.
#[test]
fn far_voxels_saturate() {
    let (field, _) = field(&cuboid([0.0; 3], [90.0, 90.0, 10.0]), [128; 3]);
    let mut full = 0;
    each(&field, |p, value| {
        let d = to_cuboid(p, [0.0; 3], [90.0, 90.0, 10.0]) / field.window.voxel;
        if d.abs() > 16.0 {
            full += 1;
            assert_eq!(value, if d > 0.0 { 127 } else { -127 }, "{p:?}");
        }
    });
    assert!(full > 1_000_000, "{full}");
}

/// The nearest feature of a spike's tip is a corner of many thin triangles: a face's own plane would give the wrong sign there.
#[test]
fn signs_hold_at_sharp_corners_and_edges() {
    let mut r = Random::new(5);
    for _ in 0..40 {
        // A star about the middle: a tetrahedron with corners in general position is convex, so its faces say what is inside.
        let corner = |r: &mut Random| [0; 3].map(|_| r.unit() * 20.0 - 10.0);
        let p: Vec<[f64; 3]> = (0..4).map(|_| corner(&mut r)).collect();
        let mut mesh = Mesh { positions: p, triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] };
        if mesh.volume().abs() < 30.0 {
            continue;
        }
        if mesh.volume() < 0.0 {
            mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        }
        let (field, report) = field(&mesh, [40; 3]);
        assert_eq!((report.torn, report.resigned), (0, 0));
        each(&field, |p, value| {
            // Least distance to a face's plane, in voxels: positive inside all of them.
            let depth = (0..4)
                .map(|t| {
                    let [a, b, c] = mesh.corners(t);
                    let (u, v) = ([0, 1, 2].map(|k| b[k] - a[k]), [0, 1, 2].map(|k| c[k] - a[k]));
                    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
                    let length = n.iter().map(|x| x * x).sum::<f64>().sqrt();
                    (0..3).map(|k| (a[k] - p[k]) * n[k] / length).sum::<f64>()
                })
                .fold(f64::INFINITY, f64::min)
                / field.window.voxel;
            if depth > 0.0 {
                assert_eq!(f64::from(value), (depth * UNITS).round().min(127.0), "{p:?}");
            } else {
                assert!(
                    value <= 0 && f64::from(value) <= (depth * UNITS).ceil().max(-127.0),
                    "{p:?}: {value}, {depth}"
                );
            }
        });
    }
}

/// Threads that take the parts in another order.
struct Backwards;

impl Workers for Backwards {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        std::thread::scope(|s| {
            let (few, many) = (0..parts).rev().partition::<Vec<_>, _>(|k| k % 3 == 0);
            s.spawn(|| few.into_iter().for_each(part));
            many.into_iter().for_each(part);
        });
    }
}

#[test]
fn workers_do_not_change_the_field() {
    let mesh = torus(8.0, 3.0, 40);
    let window = Window::around(mesh.bounds().unwrap(), [50, 41, 33], MARGIN).unwrap();
    let (a, b) = (Field::of(&mesh, window, &Alone).unwrap(), Field::of(&mesh, window, &Backwards).unwrap());
    assert_eq!(a, b);
}

/// Stops after some looks.
struct Impatient(std::sync::atomic::AtomicU32);

impl Workers for Impatient {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        (0..parts).for_each(part);
    }
    fn going(&self, _: f64) -> bool {
        self.0.fetch_sub(1, std::sync::atomic::Ordering::Relaxed) > 1
    }
}

#[test]
fn work_can_be_stopped() {
    let mesh = cuboid([0.0; 3], [1.0; 3]);
    let window = Window::around(mesh.bounds().unwrap(), [64; 3], MARGIN).unwrap();
    for looks in 1..5 {
        let found = Field::of(&mesh, window, &Impatient(looks.into()));
        assert_eq!(found.err(), Some(terraquilt_codecs::Error::Stopped));
    }
}
