//! Fractal tiles (`docs/fractal-format.md`): of the surface, and of files.
//!
//! - [`Threads`]: the threads of the current pool, at work for the codec
//! - [`Taken`]: what a file is taken for; [`send_heights`], [`send_picture`]: files as tiles
//! - [`Opened`]: a tile as it was read; [`plane()`], [`passes`]: its samples at any [`Zoom`], or as far as time allows; [`Shown`]: the files that are made of
//!   them; [`Points`]: its value at points; [`plane_on_gpu`]: the same as planes, on a GPU
//! - [`send_solid`], [`Solid`]: meshes as tiles, and back
//! - [`tile()`]: the surface of a region as a tile, [`Choice`]: what a caller may choose of it, [`TileTold`]: what there is to say of it

mod files;
mod gpu;
mod opened;
mod point;
mod sender;
mod solid;
mod source;
mod surface;
mod workers;
mod zoom;

pub use files::Shown;
pub use gpu::{gpu_built, plane_on_gpu};
pub use opened::{Opened, Worth};
pub use point::{Answer, Points};
pub use sender::{NEAR, Request, Sent, SentTold, kind_name, send_heights, send_picture};
pub use solid::{Solid, SolidTold, VOXELS, send_solid};
pub use source::Taken;
pub use surface::{Choice, TileRequest, TileTold, search_name, search_of, tile};
pub use workers::Threads;
pub use zoom::{Detail, Progress, Zoom, passes, plane};

use crate::base::Error;
use terraquilt_codecs::fractal::{Header, Kind};

/// An error of the codec about a file (or a tile that is made).
pub fn told(file: &str, e: terraquilt_codecs::Error) -> Error {
    super::gtb::told(file, e)
}

/// Peak signal to noise ratio in decibels, of the errors that the encoder measured. The peak is 255 for pictures and volumes, the
/// span of the heights for heights. `None` where nothing differs.
pub fn psnr_db(h: &Header) -> Option<f64> {
    let peak = match h.kind {
        Kind::Heights => f64::from(h.range[1]) - f64::from(h.range[0]),
        Kind::Grey | Kind::Colour | Kind::Volume => 255.0,
    };
    (h.error_rms > 0.0 && peak > 0.0).then(|| 20.0 * (peak / h.error_rms).log10())
}
