//! Heights as mathematics: no files, no clocks, no threads.
//!
//! [`source`] is what a survey file gives (rows on demand); [`crs`] what its coordinates mean;
//! [`lifted`] moves its heights between geoid and ellipsoid;
//! [`frame`] places posts on the exact integer lattice; [`cells`] are sets of level-0 cells; [`patch`]
//! are bilinear or spline pieces with a stored error; [`lod`] orders them, cuts their boxes and decides coverage
//! exactly; [`surface`] blends them into the one function that is measured and drawn.

pub mod block;
pub mod cells;
pub mod crs;
pub mod frame;
pub mod lifted;
pub mod lod;
pub mod patch;
pub mod resample;
pub mod source;
pub mod surface;
