//! Planes of a tile decoded on a GPU, in builds with the feature `gpu`.

use super::{Opened, Zoom};
use crate::base::{Error, Result};
use terraquilt_codecs::fractal::grid::Grid;

/// Refuses where the build has no GPU decoder.
///
/// # Errors
/// [`Error::Unsupported`] there.
pub fn gpu_built() -> Result<()> {
    if cfg!(feature = "gpu") { Ok(()) } else { Err(absent()) }
}

fn absent() -> Error {
    let what = "this program was built without the GPU decoder";
    Error::unsupported("--gpu", what, "build it with --features gpu, or leave --gpu out")
}

/// A plane at a zoom of at least 1, by the maps alone: within 1e-4 of the range of what [`plane`](super::plane()) gives.
///
/// # Errors
/// [`Error::Unsupported`] without an adapter; [`Error::Limit`] for results that are too large.
#[cfg(feature = "gpu")]
pub fn plane_on_gpu(o: &Opened, k: usize, zoom: Zoom) -> Result<Grid<2>> {
    use terraquilt_gpu::{Gpu, Window};
    let refused = |e: terraquilt_gpu::Error| Error::invalid("--gpu", e);
    let walk = o.tile.walk(k).map_err(|e| o.told(e))?;
    let size = walk.size();
    zoom.check(&size)?;
    let z = zoom.get();
    let cells = size.map(|n| zoom.cells(n));
    let [cols, rows] = cells.map(|n| n as u32);
    let window = Window { x0: 0.0, y0: 0.0, step: 1.0 / z, cols, rows, depth: zoom.depth() };
    let mut values = Gpu::open().and_then(|gpu| gpu.decode(&walk, &window)).map_err(refused)?;
    if k == 0 {
        for (n, v) in values.iter_mut().enumerate() {
            let sample = |cell: usize, count: usize| (((cell as f64 + 0.5) / z) as usize).min(count - 1);
            *v += o.tile.added(sample(n % cells[0], size[0]), sample(n / cells[0], size[1]));
        }
    }
    Ok(Grid { size: cells, values })
}

/// As in builds with the feature `gpu`; here it is refused.
///
/// # Errors
/// [`Error::Unsupported`].
#[cfg(not(feature = "gpu"))]
pub fn plane_on_gpu(_: &Opened, _: usize, _: Zoom) -> Result<Grid<2>> {
    Err(absent())
}
