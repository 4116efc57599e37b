//! Terraquilt: a living terrain database.
//!
//! Overlapping elevation grids go into an on-disk multiple-storage quadtree of patch boxes in LOD space
//! (x, y, error); a region and a tolerance come back as one continuous surface with an error that holds.
//! The state is a pure function of the set of surveys.
//!
//! The floors of the house, from the ground up; a room uses rooms on floors below it (see `docs/architecture.md`):
//!
//! - [`base`]: errors, limits, exact integer geometry
//! - [`height`]: heights as mathematics: patches, LOD space, the surface
//! - [`mesh`], [`store`]: triangulation; the database on disk
//! - [`codec`]: what travels between servers and clients, packed
//! - [`db`]: the junction: ingest, query, verify
//! - [`analysis`]: profiles, contours, volumes: answers computed from the surface
//! - [`format`]: other people's formats
//! - [`cli`]: the command line
//! - [`server`], [`client`]: the daemon and those who ask it, over [`wire`]

pub mod analysis;
pub mod base;
pub mod cli;
pub mod client;
pub mod codec;
pub mod db;
pub mod format;
pub mod height;
pub mod mesh;
pub mod server;
pub mod store;
pub mod wire;
