//! Coordinates: against values of PROJ, and what is refused.

use terraquilt::height::crs::{Crs, DatumChoice, Transform};

fn way(from: &str, to: &str) -> Transform {
    Transform::new(&Crs::parse(from).unwrap(), &Crs::parse(to).unwrap(), &DatumChoice::None).unwrap()
}

#[test]
fn there_and_back() {
    let t = way("EPSG:4326", "EPSG:32611");
    let p = t.forward([-118.5, 37.3]).unwrap();
    let q = t.inverse(p).unwrap();
    assert!((q[0] + 118.5).abs() < 1e-11 && (q[1] - 37.3).abs() < 1e-11, "{p:?} {q:?}");
    assert!(t.forward([f64::NAN, 0.0]).is_none());
}

#[test]
fn old_datums_want_a_choice() {
    let (nad27, utm) = (Crs::from_epsg(26710).unwrap(), Crs::from_epsg(32610).unwrap());
    let refused = Transform::new(&nad27, &utm, &DatumChoice::None).err().unwrap().to_string();
    assert!(refused.contains("NAD27") && refused.contains("--datum-shift"), "{refused}");
    let ballpark = Transform::new(&nad27, &utm, &DatumChoice::Ballpark).unwrap();
    assert!(ballpark.description().contains("ballpark") && ballpark.notes().len() == 1);
    let choice = DatumChoice::parse("-8,160,176").unwrap();
    let shifted = Transform::new(&nad27, &utm, &choice).unwrap();
    assert!(shifted.description().contains("towgs84=-8,160,176"), "{}", shifted.description());
    let p = [560000.0, 5115000.0];
    let (a, b) = (ballpark.forward(p).unwrap(), shifted.forward(p).unwrap());
    let apart = (a[0] - b[0]).hypot(a[1] - b[1]);
    assert!((50.0..150.0).contains(&apart), "{apart} m");
    let back = shifted.inverse(b).unwrap();
    assert!((back[0] - p[0]).hypot(back[1] - p[1]) < 1e-6);
    // On one datum nothing is shifted, whatever it is.
    let same = Transform::new(&nad27, &Crs::from_epsg(4267).unwrap(), &DatumChoice::None).unwrap();
    assert!(same.notes().is_empty());
}
