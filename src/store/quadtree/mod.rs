//! The multiple-storage quadtree (paper, section 4.2; LOD-space specification, section 4).
//!
//! Logically: the root cell is the world; a node stores the first 64 of its pending records in key order
//! (top descending, key ascending); the rest goes to every child whose cell their open domain meets. The
//! tree is a function of the set of live records alone. On disk: nodes are pages, never changed; an update
//! writes the changed nodes and the paths to the root.

mod build;
mod check;
mod explored;
mod node;
mod shelf;
mod walk;

pub use build::{Domains, Editor};
pub use check::{Stats, check};
pub use explored::{Explored, SPOTS_MAX, Spot};
pub use node::{ChildRef, Node, Record, child_cell, root_cell};
pub use shelf::{Below, SHELF, Shelf, bits, first};
pub use walk::{Question, Range, Shelves, walk};

/// Records a node stores before it passes the rest on.
pub const CAPACITY: usize = 64;
/// Depth at which a node stores everything. The cell side there is 2^29 units: 1.6 cm, or 1e-6 degrees / 4.
pub const DEPTH_MAX: u8 = 32;
