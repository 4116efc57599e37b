//! Wavelets by lifting, with whole-point mirror at the borders.
//!
//! - [`cells`]: pictures of 2^n x 2^n cells

pub mod cells;
