//! Fractal tiles on a GPU. Where no Vulkan driver is installed the tests that need one say so and end; with TERRAQUILT_REQUIRE_GPU set
//! they fail.

/// The GPU's values against the CPU's.
mod agreement;
/// Windows that cannot be, tiles that do not fit, and a GPU that fails.
mod bad_input;
/// The fragment form, drawn.
mod drawing;
/// Both shaders held against the rules of WGSL, without a GPU.
mod shaders;
/// Tiles at random, and the GPU if there is one.
mod support;
