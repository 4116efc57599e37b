//! Solids: meshes to fields and back, held against shapes whose distances are known.

mod bodies;
mod contours;
mod fields;
mod meshes;
pub mod real;
