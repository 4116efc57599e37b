//! Wavelets by lifting: CDF 5/3 with whole-point mirror.
//!
//! - [`posts`]: on the lattice of 2^n + 1 posts a side

pub mod posts;
