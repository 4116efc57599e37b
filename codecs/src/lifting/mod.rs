//! Wavelets by lifting, with whole-point mirror at the borders.
//!
//! - [`cells`]: pictures of 2^n x 2^n cells
//! - [`posts`]: the lattice of 2^n + 1 posts a side

pub mod cells;
pub mod posts;
