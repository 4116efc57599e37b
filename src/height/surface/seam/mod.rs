//! Seams that do not show: the field by which a survey is bent towards a better one along their common border
//! (LOD-space specification, section 15.1).
//!
//! ```text
//! w(p, b) = length (1 - r^2/R^2)^3 / (r^2 + ease^2)                       r = |p - b| < R
//! E(p)    = sum w gap_b (1 - g(r / reach_b)) / sum w                      the membrane through the gaps, without a solve
//! C(p)    = E outside of the better surveys;  (1 - k) E + k gap(p) inside,   k = 1 - g((distance to the border - 3) / 4)
//! ```
//!
//! Lengths are in cells of the bent survey, in its index space, so a level-0 place is one unit of work whatever the CRS,
//! the rotation or the sides of a cell: for square cells this is the formula of the specification, letter by letter.
//!
//! Where the better survey is not shown at a tolerance there is no seam to hide: every piece of border carries the
//! spans of tolerance in which better surveys have a live patch there, and its part of the sums fades with them ([`Spans`]). Pieces
//! with equal spans form one [`Channel`]; at small tolerances all of them are there, and the sum is the formula above.

mod border;
mod field;
mod sides;
mod spans;

pub use border::{Border, Gathering, Piece};
pub use field::{Channel, Field, Near, Spot};
pub use sides::{Side, outline};
pub use spans::{Spans, spans, union};

use crate::height::lod::KERNEL;

/// Pieces of border further than this do not count, in cells: one level-0 place.
pub const REACH_MAX: f64 = KERNEL as f64;
/// A gap is carried at least this far, in cells.
const REACH_MIN: f64 = 4.0;
/// The gaps within this distance decide how far one is carried, in cells.
const SPREAD: f64 = 8.0;
/// Slope that a correction may add.
const SLOPE: f64 = 0.15;
/// Largest slope of the ramp g of class C2.
const RAMP_SLOPE: f64 = 1.875;
/// Inside the better surveys the gap itself is used up to here, and fades until the sum of both, in cells.
pub const BAND: [f64; 2] = [3.0, 4.0];
/// Nodes along the side of a place: half a cell apart.
pub const NODES: usize = 2 * KERNEL as usize + 1;

/// Nodes are whole numbers of 2^-16 m, so that they travel in few bits; what they stand for is invented ground anyway.
pub const STEP_LOG2: i32 = 16;

/// The ramp g of class C2: 0 below 0, 1 above 1.
fn ramp(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

fn square(a: [f64; 2], b: [f64; 2]) -> f64 {
    let d = [a[0] - b[0], a[1] - b[1]];
    d[0] * d[0] + d[1] * d[1]
}
