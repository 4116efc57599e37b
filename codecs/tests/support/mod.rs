//! Grids for tests: seeded terrain, and real ones of the repository's fixtures.
pub mod grids;
pub mod random;
pub mod streams;
