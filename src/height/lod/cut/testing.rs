//! What the tests of every tolerance ask: bounds hold, derivatives are derivatives.

use super::{Cut, Region};

/// Uniform in [0, 1) (xorshift64).
pub fn random(state: &mut u64) -> f64 {
    *state ^= *state << 13;
    *state ^= *state >> 7;
    *state ^= *state << 17;
    (*state >> 11) as f64 / (1u64 << 53) as f64
}

/// A random convex polygon within `reach` of `middle`; the tolerance at its corners and at random points inside must lie
/// between its bounds.
pub fn within_bounds(cut: &impl Cut, middle: [f64; 2], reach: f64, points: usize, s: &mut u64) {
    let shift = [0, 1].map(|k| middle[k] + 2000.0 * (random(s) - 0.5));
    let corners: Vec<[f64; 2]> = (0..5).map(|_| shift.map(|c| c + reach * (2.0 * random(s) - 1.0))).collect();
    let hull = Region::hull(corners).polygon;
    let (lo, hi) = cut.bounds(&hull);
    let inside = (0..points).map(|_| {
        let w: Vec<f64> = hull.iter().map(|_| random(s)).collect();
        let t: f64 = w.iter().sum();
        [0, 1].map(|k| hull.iter().zip(&w).map(|(v, w)| v[k] * w / t).sum::<f64>())
    });
    for p in inside.collect::<Vec<_>>().iter().chain(&hull) {
        let d = cut.at(*p);
        assert!(lo <= d && d <= hi, "{lo} {d} {hi} at {p:?}");
    }
}

/// Central differences against the gradient, and of the gradient against the second derivatives.
pub fn derivatives_hold(cut: &impl Cut, p: [f64; 2], hessian: impl Fn([f64; 2]) -> [f64; 3]) {
    let (g, h) = (cut.gradient(p), hessian(p));
    let step = 0.05;
    for k in 0..2 {
        let (mut a, mut b) = (p, p);
        a[k] -= step;
        b[k] += step;
        let slope = (cut.at(b) - cut.at(a)) / (2.0 * step);
        assert!((slope - g[k]).abs() < 1e-6, "{slope} {g:?} at {p:?}");
        for m in 0..2 {
            let bend = (cut.gradient(b)[m] - cut.gradient(a)[m]) / (2.0 * step);
            assert!((bend - h[k + m]).abs() < 1e-6, "{bend} {h:?} at {p:?}");
        }
    }
}
