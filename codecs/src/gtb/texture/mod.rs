//! The texture half (specification of GTB, section 6).

use super::companion::Companion;
use crate::lattice::N_MAX;
use crate::range::Coder;
use crate::{Error, Result};

/// A picture as cells over the square of the lattice: 2^n x 2^n, the first row northernmost.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Cells {
    /// The picture is 2^n cells a side.
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
        if self.n > N_MAX || self.rgb.len() != cells || !(self.void.is_empty() || self.void.len() == cells) {
            return Err(Error::invalid(
                "picture",
                format!("{} cells for a side of 2^{}; n is at most {N_MAX}", self.rgb.len(), self.n),
            ));
        }
        Ok(())
    }
}

/// How a picture is coded.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// A part of the picture as ordinary wavelet coefficients, in parts of the raw bytes (0.005); 0: patterns alone.
    pub plain: f64,
    /// A triangle is final when so much of it is of one class.
    pub tolerance: f64,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings { plain: 0.005, tolerance: 0.95 }
    }
}

/// The sender's companion.
pub struct Writer {}

impl Writer {
    /// Analyses a picture.
    pub fn new(cells: &Cells, _settings: &Settings) -> Result<Writer> {
        cells.check()?;
        Ok(Writer {})
    }
}

impl<C: Coder> Companion<C> for Writer {}

/// The receiver's companion.
pub struct Reader {
    n: u32,
}

impl Reader {
    /// For a head that says `texture: Some(n)`.
    pub fn new(n: u32) -> Reader {
        Reader { n }
    }

    /// The picture as far as it came; the same seed paints the same bytes everywhere.
    pub fn picture(&self, _seed: u64) -> Cells {
        Cells { n: self.n, rgb: vec![[128; 3]; 1 << (2 * self.n)], void: Vec::new() }
    }
}

impl<C: Coder> Companion<C> for Reader {}
