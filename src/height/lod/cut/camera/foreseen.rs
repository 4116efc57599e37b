//! What is certain of many boxes at once, without clipping them against what the camera sees.

use super::super::Boxes;
use super::super::lots::{LOT, lot};
use super::Camera;
use multiversion::multiversion;

/// A fraction whose value is a tolerance: it is compared with a height without a division.
#[derive(Clone, Copy)]
struct Tolerance(f64, f64);

/// [`Foreseen`] in columns of 0 and 1.
///
/// Depths and rho over a domain are those of its corners, but for the least rho: that is no more than the nearest corner's, and no less
/// than to a box along the axes of the camera. The tolerance grows with the depth and falls with rho. Last digits of places are less
/// than `hair` metres, those of a distance less than 1e-7 of the longest, those of what follows less than 1e-9 parts.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub(super) fn foresee(c: &Camera, boxes: &Boxes, kappa: f64, out: &mut [[u8; 64]; 4]) {
    let (s, cosine, depth_of_height) = (c.pitch_sin.abs(), c.pitch_cos, c.h * c.pitch_sin);
    let eye = 1.0 + c.eye[0].abs() + c.eye[1].abs() + c.h.abs();
    // Seen by a level camera, domains have no extent across, and bounds take such for ones that hold the eye.
    let level = s < 1e-100;
    let flat = |dx: f64, dy: f64| {
        [dx * c.forward[0] + dy * c.forward[1], s * (dx * c.forward[1] - dy * c.forward[0])]
    };
    let tolerance = |w: f64, rho: f64| {
        let (w, rho) = (w.max(c.near), rho.max(0.0));
        Tolerance(c.pixels * w * w, c.focal * rho + c.pixels * s * w)
    };
    for from in (0..boxes.x.len().min(64)).step_by(LOT) {
        let (x, y, radius) = (lot(boxes.x, from), lot(boxes.y, from), lot(boxes.radius, from));
        let (top, bot) = (lot(boxes.top, from), lot(boxes.bot, from));
        let [a0, a1, a2, a3] = boxes.arms;
        let arms = [lot(a0, from), lot(a1, from), lot(a2, from), lot(a3, from)];
        let (mut above_lo, mut below_hi) = ([0; LOT], [0; LOT]);
        let (mut not_above_lo, mut not_below_hi) = ([0; LOT], [0; LOT]);
        for k in 0..LOT {
            let hair = 1e-9 * (eye + x[k].abs() + y[k].abs()) + 1e-7 * radius[k];
            let m = flat(x[k] - c.eye[0], y[k] - c.eye[1]);
            let a = flat(f64::from(arms[0][k]), f64::from(arms[1][k]));
            let b = flat(f64::from(arms[2][k]), f64::from(arms[3][k]));
            let half = [a[0].abs().max(b[0].abs()), a[1].abs().max(b[1].abs())];
            let (w, dw) = (m[0] * cosine + depth_of_height, half[0] * cosine);
            let mm = m[0] * m[0] + m[1] * m[1];
            let (ma, aa) = (2.0 * (m[0] * a[0] + m[1] * a[1]).abs(), a[0] * a[0] + a[1] * a[1]);
            let (mb, bb) = (2.0 * (m[0] * b[0] + m[1] * b[1]).abs(), b[0] * b[0] + b[1] * b[1]);
            let far = (mm + (aa + ma).max(bb + mb)).sqrt();
            let near = (mm + (aa - ma).min(bb - mb)).max(0.0).sqrt();
            let beside = [0, 1].map(|k| (m[k].abs() - half[k] - hair).max(0.0));
            let nearer = if level { 0.0 } else { (beside[0] * beside[0] + beside[1] * beside[1]).sqrt() };
            let slack = hair + 1e-7 * far;
            let lo_least = tolerance(w - dw - hair, far + slack);
            let lo_most = tolerance(w - dw + hair, far - slack);
            let hi_least = tolerance(w + dw - hair, near + slack);
            let hi_most = tolerance(w + dw + hair, nearer * (1.0 - 1e-9));
            let (top, bot) = (kappa * f64::from(top[k]), f64::from(bot[k]));
            above_lo[k] = u8::from(lo_most.0 * (1.0 + 1e-9) < top * lo_most.1);
            below_hi[k] = u8::from(bot * hi_least.1 <= hi_least.0 * (1.0 - 1e-9));
            not_above_lo[k] = u8::from(lo_least.0 * (1.0 - 1e-9) >= top * lo_least.1);
            not_below_hi[k] = u8::from(bot * hi_most.1 > hi_most.0 * (1.0 + 1e-9));
        }
        for (column, told) in out.iter_mut().zip([above_lo, below_hi, not_above_lo, not_below_hi]) {
            column[from..from + LOT].copy_from_slice(&told);
        }
    }
}

/// [`Cut::foresee_middles`] in columns of 0 and 1: the bounds over a polygon hold between them the tolerance at each of its points.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub(super) fn foresee_middles(c: &Camera, boxes: &Boxes, kappa: f64, out: &mut [[u8; 64]; 2]) {
    let (s, depth_of_height) = (c.pitch_sin.abs(), c.h * c.pitch_sin);
    let eye = 1.0 + c.eye[0].abs() + c.eye[1].abs() + c.h.abs();
    let tolerance = |w: f64, rho: f64| {
        let (w, rho) = (w.max(c.near), rho.max(0.0));
        Tolerance(c.pixels * w * w, c.focal * rho + c.pixels * s * w)
    };
    for from in (0..boxes.x.len().min(64)).step_by(LOT) {
        let (x, y, radius) = (lot(boxes.x, from), lot(boxes.y, from), lot(boxes.radius, from));
        let (top, bot) = (lot(boxes.top, from), lot(boxes.bot, from));
        let (mut above_lo, mut below_hi) = ([0; LOT], [0; LOT]);
        for k in 0..LOT {
            let hair = 1e-9 * (eye + x[k].abs() + y[k].abs()) + 1e-7 * radius[k];
            let (dx, dy) = (x[k] - c.eye[0], y[k] - c.eye[1]);
            let ahead = dx * c.forward[0] + dy * c.forward[1];
            let aside = s * (dx * c.forward[1] - dy * c.forward[0]);
            let (w, rho) = (ahead * c.pitch_cos + depth_of_height, (ahead * ahead + aside * aside).sqrt());
            let slack = hair + 1e-7 * rho;
            let lo_most = tolerance(w + hair, rho - slack);
            let hi_least = tolerance(w - hair, rho + slack);
            let (top, bot) = (kappa * f64::from(top[k]), f64::from(bot[k]));
            above_lo[k] = u8::from(lo_most.0 * (1.0 + 1e-9) < top * lo_most.1);
            below_hi[k] = u8::from(bot * hi_least.1 <= hi_least.0 * (1.0 - 1e-9));
        }
        for (column, told) in out.iter_mut().zip([above_lo, below_hi]) {
            column[from..from + LOT].copy_from_slice(&told);
        }
    }
}
