//! Files made of the surface: meshes, rasters, pictures; and the samples of a survey as they were delivered.
//!
//! - [`Coords`], [`Place`]: where, in coordinates of the user's choice; [`Raster`]: the surface over a raster
//! - [`FileRequest`], [`write_surface`]: one file of a region, the same bytes whoever asks; [`write_samples`]: a survey's own
//!   samples, bit for bit; [`Written`]: what there is to say of it
//! - [`StreamRequest`], [`stream()`]: the surface as one progressive stream (GTB)
//! - [`drape`]: a picture onto the cells of a lattice; [`grid`]: heights with a place, as files; [`gtb`]: heights to GTB and back; [`fractal`]: fractal tiles

pub mod drape;
mod file;
pub mod fractal;
pub mod grid;
pub mod gtb;
mod mesh;
mod place;
mod posts;
mod raster;
mod shares;
mod stream;

pub use file::{FileRequest, Form, Written, write_samples, write_surface};
pub use mesh::{MeshFound, Packing, write_mesh};
pub use place::{Coords, Place, whereabouts};
pub use posts::version_of;
pub use raster::Raster;
pub use shares::Choice;
pub use stream::{Refined, Stream, StreamRequest, Told, stream};

use crate::base::{Error, Result};

/// Told what is done and the share of it, from any thread; answers whether to go on.
pub type Going<'a> = &'a (dyn Fn(&str, f64) -> bool + Sync);

fn go_on(going: Going, stage: &str, share: f64) -> Result<()> {
    if going(stage, share) { Ok(()) } else { Err(Error::Stopped) }
}
