//! The shaders' text. The walk is the same text in both: WGSL has no includes, so the parts are joined here.

const WALK: &str = include_str!("walk.wgsl");

/// Decodes a block of a window: entry point `decode`, 8 x 8 invocations per workgroup.
pub fn compute() -> String {
    [WALK, include_str!("compute.wgsl")].concat()
}

/// Draws a tile: entry points `cover` (vertices 0 to 2, no buffers) and `shade`.
///
/// A program that draws terrain of its own takes `shade` with its own vertex shader, which hands over `@location(0)` the place in cells of
/// the zoom-1 grid.
pub fn fragment() -> String {
    [WALK, include_str!("fragment.wgsl")].concat()
}
