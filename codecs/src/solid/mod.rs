//! Solids: triangle meshes become distance fields, and samples of fields become triangle meshes (specification section 6; paper section 3.3, "From 3D mesh
//! to 3D image" and "From 3D image to polygonal mesh").
//!
//! - [`mesh`]: triangles that share positions, and their limits
//! - [`report`]: what is wrong with a mesh
//! - [`mending`]: a mesh made fit to be asked what is inside
//! - [`window`]: where the samples of a field lie
//! - [`field`]: the distance field of a mesh
//! - [`contour`]: marching cubes
//! - [`separation`]: the Hausdorff distance of two meshes
//!
//! ```
//! use terraquilt_codecs::solid::{Border, Field, MARGIN, Mesh, Window, surface};
//! use terraquilt_codecs::work::Alone;
//! // A tetrahedron.
//! let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
//! let mesh = Mesh { positions, triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]] };
//! let window = Window::around(mesh.bounds().unwrap(), [32; 3], MARGIN)?;
//! let (field, report) = Field::of(&mesh, window, &Alone)?;
//! assert!(report.is_closed());
//! let again = surface(&field.samples(), 0.0, Border::Closed, &Alone)?;
//! // Edges are cut off within a voxel: a bit more than a hundredth of this one.
//! assert!((again.volume() - 1.0 / 6.0).abs() < 0.003);
//! # Ok::<(), terraquilt_codecs::Error>(())
//! ```
mod cases;
pub mod contour;
mod distance;
pub mod field;
mod holes;
pub mod mending;
pub mod mesh;
mod nearest;
pub mod report;
pub mod separation;
mod sets;
mod turning;
mod vector;
mod winding;
pub mod window;

pub use contour::{Border, Samples, surface};
pub use field::Field;
pub use mesh::Mesh;
pub use report::Report;
pub use separation::{Separation, separation};
pub use window::{MARGIN, Window};
