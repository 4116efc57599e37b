//! A camera over ground that reaches beyond every sample, bent by corrections or swung by splines, sees it there.

use super::{how, world_of};
use crate::support::Grid;
use terraquilt::db::Policy;
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::height::lod::cut::Camera;
use terraquilt::height::patch::Kind;
use terraquilt::height::source::Affine;
use terraquilt::height::surface::Seams;

fn grid(name: &str, posts: [usize; 2], step: f64, z: impl Fn(usize) -> f32) -> Grid {
    Grid {
        name: name.into(),
        cols: posts[0],
        rows: posts[1],
        z: (0..posts[0] * posts[1]).map(|k| z(k % posts[0])).collect(),
        affine: Affine { origin: [500_000.0, 4_002_000.0], col_step: [step, 0.0], row_step: [0.0, -step] },
        accuracy: step / 10.0,
        precedence: None,
        date: None,
    }
}

#[test]
fn a_camera_sees_ground_above_every_sample() {
    // A cliff of 200 m; in the west a finer survey, 100 m above its foot.
    let cliff = grid("cliff", [200, 200], 10.0, |col| if col < 104 { 0.0 } else { 200.0 });
    let fine = grid("fine", [500, 1000], 2.0, |_| 100.0);
    let both = [cliff.clone(), fine];
    for (name, kind, grids, seams, above) in [
        ("bent", Kind::Bilinear, &both[..], Seams::All, 40.0),
        ("bent and swung", Kind::Bicubic, &both[..], Seams::All, 40.0),
        ("swung", Kind::Bicubic, &both[..1], Seams::Off, 5.0),
    ] {
        let s = world_of(kind, grids, Policy::Accuracy).snapshot;
        assert_eq!(s.z_range(), Some([0.0, 200.0]));
        let ground: Vec<[f64; 2]> =
            (0..1200).map(|k| [501_000.0 + f64::from(k) / 2.0, 4_001_000.0]).collect();
        let z = s.heights(&ground, &Tolerance::Constant(0.0), how(seams)).unwrap();
        let (at, top) = ground
            .iter()
            .zip(&z)
            .filter_map(|(p, e)| Some((*p, e.as_ref()?.z)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .unwrap();
        println!("{name}: {top:.1} m at {at:?}");
        assert!(top > 200.0 + above);
        // Level with the summit, near it; its view does not come down to any sample.
        let eye = [at[0] + 30.0, at[1], top];
        let camera = Camera::new(eye, [at[0], at[1], top], 4.0, [400, 400], 1.0, Some(60.0)).unwrap();
        let query = Query { area: Area::Everything, tolerance: Tolerance::Camera(camera), how: how(seams) };
        let found = s.select(&query).unwrap();
        assert!(!found.records.is_empty(), "{name}: nothing is seen");
        let ground = s.surface(&query).unwrap();
        let seen = ground.heights(&[at]).unwrap().remove(0).unwrap();
        let asked = s.heights(&[at], &query.tolerance, how(seams)).unwrap().remove(0).unwrap();
        assert!((seen.z - asked.z).abs() < 1e-6, "{name}: {seen:?} {asked:?}");
        let b = found.region.bounds();
        assert!(b[0] < at[0] && at[0] < b[2] && b[1] < at[1] && at[1] < b[3], "{name}: {at:?} {b:?}");
    }
}
