//! Fractal tiles decoded and drawn on a GPU: the inverse walk in WGSL, through wgpu and Vulkan (Multiresolution Modeling Using Fractal
//! Image Compression Techniques, section 3.2; what holds: the specification's section 4).
//!
//! Values agree with the CPU's to 1e-4 of the tile's height range; they are not the same bits, nor are they on two GPUs.
//!
//! - [`Gpu`]: an adapter, opened; [`Gpu::decode`] gives the values of a window
//! - [`Window`]: which samples are wanted
//! - [`Uploaded`]: a tile in the GPU's memory, for several windows or for drawing
//! - [`shader`]: the text of both shaders
#![forbid(unsafe_code)]
#![warn(missing_docs)]

mod decode;
mod device;
mod error;
pub mod shader;
mod window;
mod words;

pub use decode::Uploaded;
pub use device::Gpu;
pub use error::{Error, Result};
pub use wgpu;
pub use window::{SAMPLES_MAX, Window};
