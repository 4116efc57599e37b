//! Fractal tiles: a grid as contractive maps from the grid to itself (Multiresolution Modeling Using Fractal Image Compression
//! Techniques; what holds: the specification's section 1 to 6).
//!
//! A **range** is a cell of a quadtree (in space: an octree), a **domain** a cell of twice its side anywhere at multiples of the jump. A
//! **leaf** is a range with its map: `R = m + s (iso(D) - mean(D))`.
//!
//! - [`grid`]: samples in the plane or in space
//! - [`isometry`]: the 8 symmetries of the square, the 48 of the cube
//! - [`domains`]: where domains lie
//! - [`scale`]: the levels of s
//! - [`matching`]: the search for the domain that is most like a range
//! - [`encode_heights()`], [`encode_picture()`], [`encode_volume()`]; [`Tile`]: the doors
//! - [`Ifs`]: leaves; [`iterate`]: from them to samples, [`walk`]: the value at any point
//! - [`detail`]: synthetic detail below the sample distance, as rough as the tile's own
mod colour;
pub mod detail;
pub mod domains;
mod encode;
pub mod grid;
pub mod header;
pub mod ifs;
pub mod isometry;
pub mod iterate;
mod mask;
pub mod matching;
mod number;
mod partition;
mod residual;
pub mod scale;
mod tile;
mod tree;
mod volume;
pub mod walk;

pub use encode::{Encoded, Options, encode_heights, encode_picture};
pub use header::{Header, Kind, Shapes, Space};
pub use ifs::{Ifs, Leaf, SAMPLES_MAX, Shape};
pub use iterate::{Iterated, Stop};
pub use matching::Search;
pub use partition::Partition;
pub use tile::{Parts, Picture, Tile};
pub use volume::encode_volume;
pub use walk::Walk;
