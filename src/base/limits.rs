//! The largest sizes accepted from outside. Every size read from a file, a wire or a command line meets
//! one of these before it becomes an allocation.

/// Posts in one input file (columns times rows).
pub const POSTS_MAX: u64 = 40_000_000_000;
/// Posts in the rectangle around all tiles of a survey, voids between them included: building it costs by that rectangle.
pub const EXTENT_POSTS_MAX: u64 = 4_000_000_000;
/// Columns or rows of one input file.
pub const SIDE_MAX: u64 = 2_000_000;
/// Posts handed over by one call of a source.
pub const WINDOW_POSTS_MAX: u64 = 64 << 20;
/// Bytes of one decoded block or strip of an input file.
pub const INPUT_BLOCK_BYTES_MAX: u64 = 1 << 30;
/// Posts of one geoid grid: a global grid of one minute of arc has 233 million.
pub const GEOID_POSTS_MAX: u64 = 250_000_000;
/// Bytes of a text field (name, CRS) in a declaration.
pub const TEXT_BYTES_MAX: usize = 4096;
/// Posts (cells) of one exported raster.
pub const RASTER_POSTS_MAX: u64 = 400_000_000;
/// Vertices of one exported mesh.
pub const MESH_VERTICES_MAX: usize = 20_000_000;
/// Bytes of one page of a segment, compressed or not.
pub const PAGE_BYTES_MAX: u64 = 64 << 20;
