//! A second opinion on `terraquilt boxes`, from the definitions of the LOD-space specification alone.
//!
//! Nothing of the product is called. Where the product decides "is this polygon covered?" edge by edge, the
//! oracle asks no such question: it overlays the lattices of all surveys once and enumerates the *faces*, the
//! convex pieces of the plane inside exactly one cell of every lattice. Every region of the specification
//! (core, core', kernel) is a union of cells, hence of faces, so that afterwards
//!
//! - `region ⊆ union` is "every face of the region is in some member", with no geometry left;
//! - `top(P)` is the largest, over the faces of kernel(P), of the least error of a greater patch there.
//!
//! Geometry is exact (see [`exact`]): a face is kept iff its interior is not empty.
//!
//! [`check()`] compares a whole database ([`check_splines()`] one with bicubic patches); [`expected_tree`] rebuilds the logical tree of section 4.

pub mod check;
pub mod exact;
pub mod json;
pub mod overlay;
pub mod spline;
pub mod survey;
pub mod tree;

#[cfg(test)]
mod selftest;

pub use check::{check, check_splines};
pub use json::parse_boxes;
pub use tree::{Node, expected_tree};

/// Cells along the side of a kernel rectangle, in steps of its level.
pub const KERNEL: i64 = 28;
/// Cells by which the domain is larger than the kernel rectangle on each side.
pub const MARGIN: i64 = 2;

/// A survey as the specification sees it: a lattice, the union of its tiles, and what is claimed of them.
#[derive(Clone, Debug)]
pub struct OracleSurvey {
    /// As `boxes` prints it in `survey`.
    pub id: String,
    /// Post (i, j) lies exactly at `anchor + i * u + j * v`, in lattice units.
    pub anchor: [i64; 2],
    pub u: [i64; 2],
    pub v: [i64; 2],
    /// Index of the first post of `heights`.
    pub first: [i64; 2],
    pub cols: usize,
    pub rows: usize,
    /// As stored, row by row (j outer); `None` is a void.
    pub heights: Vec<Option<f64>>,
    pub nominal_step: [f64; 2],
    /// Stated accuracy, not rounded.
    pub accuracy: f64,
    pub precedence: i64,
}

/// One line of `terraquilt boxes`.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchBox {
    pub id: String,
    /// Hexadecimal; compared as text.
    pub key: String,
    pub survey: String,
    pub level: u32,
    pub index: [i64; 2],
    /// Convex pieces, counter-clockwise.
    pub kernel: Vec<Vec<[i64; 2]>>,
    pub domain: [[i64; 2]; 4],
    pub area: f64,
    pub err: f32,
    /// Infinite where the line says null.
    pub top: f32,
    pub live: bool,
    pub floor: bool,
}

impl PatchBox {
    /// Posts from one vertex of this level to the next.
    pub fn stride(&self) -> i64 {
        1 << self.level
    }
}
