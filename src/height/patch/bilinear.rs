//! Bilinear patches: each cell from its four vertices.

use super::{Local, Vertices, cell};
use crate::height::lod::SIDE;

/// At (s, t) in cells from the first vertex, `0 <= s, t <= 32`. The mixed derivative is that within the cell.
#[inline(always)]
pub fn evaluate(z: &Vertices, s: f64, t: f64) -> Local {
    let ((a, x), (b, y)) = (cell(s), cell(t));
    let k = b * SIDE + a;
    let (z00, z10, z01, z11) = (z[k], z[k + 1], z[k + SIDE], z[k + SIDE + 1]);
    let left = z00 + (z01 - z00) * y;
    let right = z10 + (z11 - z10) * y;
    let ds = right - left;
    let dt = (z01 - z00) + ((z11 - z10) - (z01 - z00)) * x;
    Local { z: left + ds * x, first: [ds, dt], second: [0.0, (z11 - z10) - (z01 - z00), 0.0] }
}

/// The height at `x` in column `a`, `y` in row `b` of its cells. The same bits as [`evaluate`].
#[inline(always)]
pub fn height(z: &Vertices, a: usize, x: f64, b: usize, y: f64) -> f64 {
    let k = b * SIDE + a;
    let (z00, z10, z01, z11) = (z[k], z[k + 1], z[k + SIDE], z[k + SIDE + 1]);
    let left = z00 + (z01 - z00) * y;
    let right = z10 + (z11 - z10) * y;
    left + (right - left) * x
}

/// Heights at the 33 columns of vertices, at `y` in row `b` of its cells, into the first 33 of `to`: between them the patch is
/// linear. From these come the bits of [`evaluate`].
#[inline(always)]
pub fn line(z: &Vertices, b: usize, y: f64, to: &mut [f64]) {
    let (low, high) = (&z[b * SIDE..][..SIDE], &z[(b + 1) * SIDE..][..SIDE]);
    for ((to, low), high) in to[..SIDE].iter_mut().zip(low).zip(high) {
        *to = low + (high - low) * y;
    }
}
