//! GeoJSON: lines and polygons are read and written.
//!
//! Coordinates are in the CRS of the database. RFC 7946 knows only longitude and latitude; a file in another CRS is
//! given the `crs` member of the GeoJSON of 2008, which GDAL and QGIS read. A reader that goes by the RFC alone will
//! take the numbers for degrees.

mod line;
mod polygons;
mod write;

pub use line::read_line;
pub use polygons::{Polygons, read_polygons};
pub use write::{FeatureWriter, Shape};
