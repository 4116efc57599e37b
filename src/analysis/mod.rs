//! Answers that people expect of a terrain, each computed from the one surface that is measured and drawn.
//!
//! - [`profile`]: heights along a line; [`sight`]: what is seen along one
//! - [`contours`]: lines of equal height; [`Shape`]: slope, aspect and hillshade from the analytic gradient
//! - [`statistics`]: heights of a region; [`volumes`]: cut, fill and difference of two states of the ground
//! - [`dissolve`]: cells joined into polygons
//!
//! Every answer names the error of the surface where that has a meaning: the largest error of the patches that
//! contributed, which rests on the accuracies stated for the surveys. Regions are asked on a [`Grid`] of cells.
//! Sums run row by row, so an answer does not depend on the number of threads.

mod contours;
mod dissolve;
mod grid;
mod ground;
mod profile;
mod shape;
mod sight;
mod statistics;
mod terrain;
mod volume;

pub use contours::{Contour, Contours, Levels, contours};
pub use dissolve::{Piece, dissolve};
pub use grid::{Grid, Spot};
pub use ground::{Ground, Posts};
pub use profile::{Station, Stations, line_length_m, profile};
pub use shape::{Shape, Sun};
pub use sight::{End, Ray, Sight, SightOptions, Verdict, sight};
pub use statistics::{Statistics, statistics};
pub use terrain::Terrain;
pub use volume::{Volumes, volumes};

/// Told the share of the work that is done; answers whether to go on.
pub type Going<'a> = &'a dyn Fn(f64) -> bool;
