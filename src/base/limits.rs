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
/// Bytes of a small file beside an input file (`.hdr`, `.prj`, `.aux.xml`, world file).
pub const SIDECAR_BYTES_MAX: u64 = 4 << 20;
/// Members of a zip archive that are looked at.
pub const ARCHIVE_MEMBERS_MAX: u64 = 10_000;
/// Bytes of an unpacked member of a zip archive: it is held in memory while it is read.
pub const ARCHIVE_MEMBER_BYTES_MAX: u64 = 512 << 20;
/// Posts of one geoid grid: a global grid of one minute of arc has 233 million.
pub const GEOID_POSTS_MAX: u64 = 250_000_000;
/// Metres above or below the datum that a height may be.
pub const HEIGHT_M_MAX: f64 = 1e6;
/// Places along borders whose corrections one answer may carry: some KiB each, and a derivation of its field the first time.
pub const CORRECTIONS_MAX: u64 = 4096;
/// Bytes of a text field (name, CRS) in a declaration.
pub const TEXT_BYTES_MAX: usize = 4096;
/// Posts (cells) of one exported raster.
pub const RASTER_POSTS_MAX: u64 = 400_000_000;
/// Vertices of one exported mesh.
pub const MESH_VERTICES_MAX: usize = 20_000_000;
/// Bytes of one page of a segment, compressed or not.
pub const PAGE_BYTES_MAX: u64 = 64 << 20;
/// Points of a grid that is held in memory at once, to draw contour lines through it.
pub const CONTOUR_POSTS_MAX: u64 = 64 << 20;
/// Vertices of one file of lines or polygons, about 30 bytes each as text.
pub const LINE_VERTICES_MAX: u64 = 20_000_000;
/// Bytes of a text file of lines that is read.
pub const LINE_FILE_BYTES_MAX: u64 = 64 << 20;
/// Posts of a raster of tolerances.
pub const TOLERANCE_POSTS_MAX: u64 = 64 << 20;
/// Points of one polygon that names a region.
pub const POLYGON_POINTS_MAX: u64 = 500_000;
/// Boxes and edges of a polygon that are compared to show that no ring crosses itself: a few seconds of work. A coast of
/// half a million points needs a tenth of them.
pub const POLYGON_COMPARISONS_MAX: u64 = 200_000_000;
/// Bytes of a GeoJSON file.
pub const GEOJSON_BYTES_MAX: u64 = 128 << 20;
/// Grids of one upload.
pub const UPLOAD_GRIDS_MAX: u64 = 10_000;
/// Rows of all grids of one upload: one bit each is held while it comes in, 24 bytes are kept beside its samples.
pub const UPLOAD_ROWS_MAX: u64 = 16 << 20;
/// Bytes of one row of an upload. It has to fit into a message.
pub const UPLOAD_ROW_BYTES_MAX: u64 = 2 << 20;
/// Bytes of the caller's id of an operation.
pub const OPERATION_BYTES_MAX: usize = 200;
/// Files of one call that names files.
pub const FILES_MAX: u64 = 1000;
/// Posts along a side of a lattice that is coded as GTB.
pub const LATTICE_SIDE_MAX: u64 = 8193;
/// Posts of the surface that are coded as one fractal tile: some 200 bytes of memory a post while it is made.
pub const FRACTAL_POSTS_MAX: u64 = 16 << 20;
/// Posts of a fractal tile whose search meets domains far away: its time goes by their square.
pub const FRACTAL_FAR_POSTS_MAX: u64 = 1 << 20;
/// Bytes of one GTB file.
pub const GTB_BYTES_MAX: u64 = 1 << 30;
/// Bytes of one fractal tile.
pub const FRACTAL_BYTES_MAX: u64 = 1 << 30;
/// Samples of a fractal tile that is decoded, and of what is made of it at any zoom: 16 bytes of memory each and more.
pub const FRACTAL_SAMPLES_MAX: u64 = 64 << 20;
/// Samples up to which a tile is searched whole where no search is named: some seconds of work.
pub const FRACTAL_EXACT_SAMPLES_MAX: u64 = 1 << 18;
/// Bytes of one file with a triangle mesh.
pub const MESH_FILE_BYTES_MAX: u64 = 1 << 30;
