//! The one integration test binary. A `mod` line per subject.

/// Worlds, databases in temporary folders, running the program.
mod support;

/// The database against the oracle and against fresh builds, over random worlds and histories.
mod derivation;
/// GeoTIFF and HGT in, GeoTIFF out: every difficult file, damage, round trips.
mod formats;
/// The independent oracle: core', kernels, errors, tops, floors and tree from the definitions, by another method.
mod oracle;
/// Any order of arrival, tiles, removal: one fingerprint.
mod order;
/// Newer surveys replace older ones, and give the ground back when they leave.
mod replacement;
