//! Terrain and its texture, packed: what a sender and a browser share.
//!
//! Nothing here knows files, threads, clocks, databases or coordinate systems: integers and bytes in, bytes and integers out. The
//! crate uses no `unsafe` and builds for `wasm32-unknown-unknown`.
//!
//! - [`blocks`]: checksums within a body
//! - [`heights`]: heights as integers, voids, where they lie
//! - [`range`]: the range coder and its adaptive models
//! - [`lattice`]: the square lattice of 2^n + 1 posts a side, its passes from coarse to fine
//! - [`lifting`]: wavelets by lifting, on posts and on cells
//! - [`gtb`]: the geometric-textured bitree
//! - [`fractal`]: fractal tiles
//! - [`solid`]: triangle meshes to distance fields and back
//! - [`work`]: whose threads do the work
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod blocks;
pub mod error;
pub mod fractal;
pub mod gtb;
mod head;
pub mod heights;
pub mod lattice;
pub mod lifting;
mod mixing;
pub mod range;
pub mod solid;
pub mod work;

pub use error::{Error, Result};
