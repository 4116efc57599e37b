//! A grid of heights with a place: what codecs take and give, read of a file, and as files.
//!
//! - [`Grid`], [`Units`]: heights as numbers; the same as integers of a unit
//! - [`write_tif`], [`write_relief`]: GeoTIFF, and a shaded picture
//! - [`Surface`], [`write_mesh`]: heights at the posts of a lattice as triangles

mod heights;
mod mesh;
mod relief;
mod tif;

pub use heights::{Grid, Units, name_of, place_of, units_within};
pub use mesh::{Coat, MeshRequest, MeshTold, Said, Surface, write_mesh};
pub use relief::write_relief;
pub use tif::{RasterTold, Samples, write_tif};
