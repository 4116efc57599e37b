//! A mesh on a lattice: every coordinate becomes a whole number of one quantum, a power of two of a metre.
//!
//! One quantum for the whole mesh, all three axes, all tiles: a vertex that two tiles share is the same three
//! numbers in both. What it costs in height is bounded as follows. A point x of a triangle goes to a point x'
//! that is the same mix of the moved corners, so it moves by at most `shift_m` sideways and `lift_m` upwards or
//! downwards. Between x and the foot of x' the old mesh climbs by at most the steepest slope times `shift_m`.
//! So at each point of the moved mesh farther than `shift_m` from the outline, the old mesh is at most
//! `lift_m + slope * shift_m` away. Walls, steeper than [`WALL_SLOPE`], are left out of that slope: within
//! `shift_m` of one, the old mesh takes the height of the moved one, to `lift_m`, within `shift_m` sideways.

use super::GlbMesh;
use crate::base::{Error, Result};

/// Metres up in a metre sideways. Steeper triangles are walls: bounded sideways, not upwards. A few steep triangles
/// shall not make the lattice of a whole mesh fine.
pub(super) const WALL_SLOPE: f64 = 2.0;

/// Whole numbers below this are exact as 32-bit floats, and so are their products with a power of two.
const EXACT: f64 = 16_777_216.0;

/// A mesh on the lattice.
pub(super) struct Lattice {
    /// Metres; a power of two.
    pub quantum_m: f64,
    /// East, up, south (the axes of glTF), in quanta from the mesh's origin. At most 2^24.
    pub points: Vec<[i32; 3]>,
    /// Bound on the vertical distance from the mesh that was given, metres; at walls see `shift_m`.
    pub error_m: f64,
    /// The farthest that a vertex moved sideways, metres.
    pub shift_m: f64,
}

impl Lattice {
    /// Puts a mesh on the coarsest lattice that moves it by at most `error_m` in height and `shift_m` sideways, and
    /// that turns no triangle over. Where that would be finer than 32-bit floats of this size, it is as fine as
    /// those, and the result says what that costs.
    ///
    /// # Errors
    /// [`Error::Invalid`] if triangles are thinner than 32-bit floats can tell.
    pub fn new(mesh: &GlbMesh, error_m: f64, shift_m: f64) -> Result<Lattice> {
        let slope = steepest(mesh);
        let largest = mesh.positions.iter().flatten().fold(0.0f64, |a, v| a.max(v.abs()));
        let mut finest = power_of_two_below(largest / EXACT);
        if finest * EXACT < largest {
            finest *= 2.0;
        }
        // A vertex moves by half a quantum in each axis, at most.
        let upwards = error_m / (0.5 + std::f64::consts::FRAC_1_SQRT_2 * slope);
        let sideways = shift_m * std::f64::consts::SQRT_2;
        let mut quantum = power_of_two_below(upwards.min(sideways));
        loop {
            quantum = quantum.max(finest);
            let points: Vec<[i32; 3]> = mesh.positions.iter().map(|p| nearest(*p, quantum)).collect();
            if !turns_over(mesh, &points) {
                let (lift, shift) = moved(mesh, &points, quantum);
                // The slope was rounded a few times on its way.
                let error_m = (lift + slope * shift) * (1.0 + 1e-9);
                return Ok(Lattice { quantum_m: quantum, points, error_m, shift_m: shift });
            }
            if quantum <= finest {
                return Err(Error::invalid(
                    "GLB mesh",
                    format!("a triangle is thinner than {finest} m, what 32-bit floats can tell there"),
                ));
            }
            quantum /= 2.0;
        }
    }
}

/// The largest power of two that is not above `x`; 2^-126 at least.
fn power_of_two_below(x: f64) -> f64 {
    const EXPONENT: u64 = 0x7ff0_0000_0000_0000;
    f64::from_bits(x.max(f64::from(f32::MIN_POSITIVE)).to_bits() & EXPONENT)
}

/// The nearest point of the lattice, in glTF's axes.
fn nearest(p: [f64; 3], quantum: f64) -> [i32; 3] {
    let [east, north, up] = p.map(|v| (v / quantum).round() as i32);
    [east, up, -north]
}

/// The steepest slope that is no wall's.
fn steepest(mesh: &GlbMesh) -> f64 {
    let slope = |t: &[u32; 3]| {
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        let [u, v] = [b, c].map(|p| [p[0] - a[0], p[1] - a[1], p[2] - a[2]]);
        let area = u[0] * v[1] - u[1] * v[0];
        (u[1] * v[2] - u[2] * v[1]).hypot(u[2] * v[0] - u[0] * v[2]) / area.abs()
    };
    // Without an area the slope is infinite or not a number.
    mesh.triangles.iter().map(slope).filter(|s| *s <= WALL_SLOPE).fold(0.0, f64::max)
}

/// Whether a triangle that was counter-clockwise seen from above is clockwise now. One without an area, upright or
/// a line, is not.
fn turns_over(mesh: &GlbMesh, points: &[[i32; 3]]) -> bool {
    mesh.triangles.iter().any(|t| {
        let [a, b, c] = t.map(|v| points[v as usize].map(i64::from));
        // South is positive: clockwise in these axes is counter-clockwise from above.
        let now = (c[0] - a[0]) * (b[2] - a[2]) - (b[0] - a[0]) * (c[2] - a[2]);
        if now >= 0 {
            return false;
        }
        let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
        (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]) > 0.0
    })
}

/// The farthest that a vertex moved up or down, and sideways.
fn moved(mesh: &GlbMesh, points: &[[i32; 3]], quantum: f64) -> (f64, f64) {
    let far = mesh.positions.iter().zip(points).map(|(p, k)| {
        let q = k.map(|v| f64::from(v) * quantum);
        ((q[1] - p[2]).abs(), (q[0] - p[0]).hypot(q[2] + p[1]))
    });
    far.fold((0.0, 0.0), |(lift, shift), (l, s)| (lift.max(l), shift.max(s)))
}
