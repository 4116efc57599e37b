//! The one integration test binary. A `mod` line per subject.

/// Worlds, databases in temporary folders, running the program.
mod support;

/// Answers computed from the surface: profiles, contours, volumes, lines of sight, contradictions.
mod answers;

/// Bad files, wrong calls, damaged, full and read-only databases: one clear line each, and nothing half done.
mod bad_input;
/// Databases of bicubic patches: slopes and curvature without a jump, and all that holds for bilinear ones.
mod bicubic;
/// Backup, copy, compact, prune, rebuild; what surveys contribute.
mod care;
/// What the surface promises: certified errors, no gap, no jump, equality with the definition.
mod certified;
/// Power cuts on a simulated disk: every change stopped at every step; readers and prune.
mod crash;
/// Coordinates: values of PROJ, datum shifts that have to be chosen, heights over geoids.
mod crs;
/// The database against the oracle and against fresh builds, over random worlds and histories.
mod derivation;
/// Surveys where systems end, and what makes one survey of several files.
mod edges;
/// Formats in, GeoTIFF out: every difficult file, damage, round trips.
mod formats;
/// Fractal tiles from files and to files: bounds, zooms, points, pictures, solids, damage.
mod fractal;
/// The surface as a fractal tile.
mod fractal_surface;
/// Meshes as GLB: within the bound, manifold, exact border.
mod glb;
/// A database of each released version, opened by today's code; same bytes whatever the threads.
mod golden;
/// GTB from files and to files: round trips, prefixes, pictures, meshes, damage.
mod gtb;
/// Histories of tiles that once went wrong, and random ones like them.
mod histories;
/// Which room may know which: the table in docs/architecture.md held against the code.
mod house;
/// The program killed at random moments, readers and writers.
mod kill;
/// The independent oracle: core', kernels, errors, tops, floors and tree from the definitions, by another method.
mod oracle;
/// Any order of arrival, tiles, removal: one fingerprint.
mod order;
/// Tolerances that vary, regions by polygon, coordinates of the user's choice.
mod reach;
/// Newer surveys replace older ones, and give the ground back when they leave.
mod replacement;
/// Surveys delivered in another system than the database's: their posts, their tiles, what is refused.
mod resampled;
/// Seams between surveys that disagree: off they cost nothing, on they do not show.
mod seams;
/// The surface as a progressive stream.
mod streams;
