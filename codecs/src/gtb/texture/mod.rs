//! The texture half (specification of GTB, section 6): a picture over the heights as classes of ground, a pattern of each, and a small part
//! of the picture itself.
//!
//! What a receiver paints is *synthetic* but for the part that is sent plainly: the colours and the look of the ground are those
//! of the picture, single cells are not.
//!
//! - `labels`, `isodata`: which class each cell belongs to
//! - `patterns`: a window of each class
//! - `tree`, `map`: which triangle has which class, in codes
//! - `zerotree`, `planes`, `colour`: pictures as wavelet coefficients, bit plane by bit plane
//! - `synthesis`: more of a pattern
//! - `stream`: the turns that the texture takes between the heights
//! - `paint`: the picture at the receiver

mod colour;
mod isodata;
mod labels;
mod map;
mod paint;
mod patterns;
mod planes;
mod stream;
mod synthesis;
mod tree;
mod zerotree;

pub use stream::{Reader, Sizes, Writer};

use crate::lattice::N_MAX;
use crate::{Error, Result};

/// A picture as cells over the square of the lattice: 2^n x 2^n, the first row northernmost.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cells {
    /// The picture is 2^n cells a side, n at least 1.
    pub n: u32,
    /// Red, green, blue.
    pub rgb: Vec<[u8; 3]>,
    /// Cells that the picture does not cover; empty if it covers all.
    pub void: Vec<bool>,
}

impl Cells {
    /// Refuses shapes that do not fit.
    pub fn check(&self) -> Result<()> {
        let cells = 1usize << (2 * self.n.min(N_MAX));
        let fits = self.rgb.len() == cells && (self.void.is_empty() || self.void.len() == cells);
        if !(1..=N_MAX).contains(&self.n) || !fits {
            return Err(Error::invalid(
                "picture",
                format!(
                    "{} cells and {} void marks for a side of 2^{}; n is 1 to {N_MAX}, and a cell each is needed",
                    self.rgb.len(),
                    self.void.len(),
                    self.n
                ),
            ));
        }
        Ok(())
    }
}

/// How a picture is coded.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The part of the picture's raw bytes (3 a cell) that ordinary wavelet coefficients may take; 0: patterns alone.
    pub plain: f64,
    /// A triangle is final when so much of it is of one class.
    pub tolerance: f64,
    /// Triangles are cut so many times at most.
    pub depth_max: u32,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings { plain: 0.005, tolerance: 0.95, depth_max: 12 }
    }
}
