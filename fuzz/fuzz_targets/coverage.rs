//! Small parallelograms as kernel and cover: the exact predicate against points tried one by one.
//!
//! - It never says "covered" while a point of the kernel lies in no quad of the cover. Points are tried on a grid of
//!   thirds of a unit, half of them moved off it, so that edges are met and missed.
//! - It stays "covered" when quads are added, in whatever order they stand, and when all is moved far away.
//! - A quad of the cover that holds the kernel decides; so does an empty cover.
//! - Among upright rectangles (first byte odd) the points tried decide both ways: one of them lies in every unit cell.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::base::lattice::{Point, Quad, covered, cross};

/// Coordinates are whole units below 16, times this; the points to try lie between.
const FINE: i64 = 6;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else { return };
    let upright = mode % 2 == 1;
    let mut quads = data.chunks_exact(4).take(9).filter_map(|b| quad(b, upright));
    let Some(kernel) = quads.next() else { return };
    let cover: Vec<Quad> = quads.collect();
    let mut before = false;
    for n in 0..=cover.len() {
        let now = covered(&kernel, &cover[..n]);
        assert!(now || !before, "a quad more and no longer covered: {kernel:?} {:?}", &cover[..n]);
        if now && !before {
            assert!(n > 0, "covered by nothing: {kernel:?}");
            if let Some(p) = missed(&kernel, &cover[..n]) {
                panic!("said to be covered, but {p:?} is not: {kernel:?} {:?}", &cover[..n]);
            }
        }
        if upright {
            assert_eq!(now, missed(&kernel, &cover[..n]).is_none(), "{kernel:?} {:?}", &cover[..n]);
        }
        before = now;
    }
    if cover.iter().any(|c| c.contains(&kernel)) {
        assert!(before, "one quad holds it: {kernel:?} {cover:?}");
    }
    let mut turned = cover.clone();
    turned.reverse();
    assert_eq!(covered(&kernel, &turned), before, "the order of the cover decides: {kernel:?} {cover:?}");
    let far = |q: &Quad| Quad(q.0.map(|p| Point::new((p.x << 49) + (1 << 58), (p.y << 49) - (1 << 57))));
    let moved: Vec<Quad> = cover.iter().map(far).collect();
    assert_eq!(
        covered(&far(&kernel), &moved),
        before,
        "large numbers decide otherwise: {kernel:?} {cover:?}"
    );
});

/// A parallelogram, counter-clockwise, of positive area: corner and two steps, a nibble a number; the fourth byte
/// doubles the steps.
fn quad(b: &[u8], upright: bool) -> Option<Quad> {
    let nibble = |k: usize| i64::from(b[k / 2] >> (4 * (k % 2)) & 15);
    let (x, y) = (nibble(0), nibble(1));
    let (ux, uy, vx, vy) = (nibble(2) - 4, nibble(3) - 4, nibble(4) - 4, nibble(5) - 4);
    let (uy, vx) = if upright { (0, 0) } else { (uy, vx) };
    let scale = 1 + i64::from(b[3] & 1);
    let (ux, uy, vx, vy) = (ux * scale, uy * scale, vx * scale, vy * scale);
    let p = |a: i64, b: i64| Point::new((x + a * ux + b * vx) * FINE, (y + a * uy + b * vy) * FINE);
    match ux * vy - uy * vx {
        0 => None,
        d if d > 0 => Some(Quad([p(0, 0), p(1, 0), p(1, 1), p(0, 1)])),
        _ => Some(Quad([p(0, 0), p(0, 1), p(1, 1), p(1, 0)])),
    }
}

/// A point of the kernel's inside that no quad of the cover holds.
fn missed(kernel: &Quad, cover: &[Quad]) -> Option<Point> {
    let b = kernel.bounds();
    let inside = |p: Point| {
        let q = &kernel.0;
        (0..4).all(|k| cross(q[k], q[(k + 1) % 4], q[k], p) > 0)
    };
    for y in (b.min.y..b.max.y).step_by(2) {
        for x in (b.min.x..b.max.x).step_by(2) {
            let p = Point::new(x + y / 2 % 2, y);
            if inside(p) && !cover.iter().any(|c| c.contains_point(p)) {
                return Some(p);
            }
        }
    }
    None
}
