//! The geometric-textured bitree (GTB): heights on a square lattice and the texture over them, in one stream that may be cut at
//! any byte. Every prefix is a whole surface without cracks, with a bound on its error.
//!
//! Specification of GTB; after Abdelguerfi and others, "Geometric-Textured Bitree".
//!
//! - [`header`]: the head of a file, and its blocks with checksums
//! - [`companion`]: what travels between the heights: the texture
//! - [`encode()`], [`decode()`]: the doors

pub mod bitree;
mod bounds;
pub mod companion;
mod decode;
mod dense;
mod encode;
mod field;
pub mod header;
mod mask;
pub mod select;
mod sparse;
mod strips;
pub mod surface;
pub mod texture;

pub use crate::heights::{self, Heights, Place};
pub use decode::{Decoded, Stop, decode, decode_within};
pub use dense::Reached;
pub use encode::{Encoded, Options, PassEnd, Profile, encode};
pub use field::{Given, SHOWN_WHOLE};
pub use header::Header;
