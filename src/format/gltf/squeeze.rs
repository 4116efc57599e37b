//! The door of meshoptimizer: order of triangles and vertices, and the codecs of EXT_meshopt_compression.

pub(super) use codec::{attributes, order, triangles};

use super::tiles::Tile;
use crate::base::{Error, Result};

/// Whether this build can write EXT_meshopt_compression.
///
/// # Errors
/// [`Error::Unsupported`] without the cargo feature `meshopt`; the message says how to build it.
pub fn meshopt_built() -> Result<()> {
    if cfg!(feature = "meshopt") {
        return Ok(());
    }
    Err(Error::unsupported(
        "EXT_meshopt_compression",
        "this program was built without meshopt",
        "build it with `cargo build --release --features meshopt` (a C++ compiler is needed), or use --quantize",
    ))
}

#[cfg(feature = "meshopt")]
mod codec {
    use super::*;

    /// Reorders triangles so that neighbours follow each other, then vertices in the order of their first use: what
    /// caches like and what the codecs expect. The same tile gives the same order.
    pub fn order(tile: &mut Tile) -> Result<()> {
        let count = tile.vertices.len();
        let mut indices = meshopt::optimize_vertex_cache_strip(tile.triangles.as_flattened(), count);
        tile.vertices = meshopt::optimize_vertex_fetch(&mut indices, &tile.vertices);
        tile.triangles = indices.as_chunks().0.to_vec();
        Ok(())
    }

    /// Mode ATTRIBUTES: elements of 4 to 256 bytes, a multiple of 4. Version 0 of the codec, the extension's.
    pub fn attributes<const N: usize>(values: &[[u8; N]]) -> Result<Vec<u8>> {
        meshopt::encode_vertex_buffer_level(values, 3, Some(0)).map_err(failed)
    }

    /// Mode TRIANGLES. Tiles may follow one another: a triangle 0 1 2 begins anew.
    pub fn triangles(indices: &[u32]) -> Result<Vec<u8>> {
        let vertices = indices.iter().max().map_or(0, |v| *v as usize + 1);
        meshopt::encode_index_buffer(indices, vertices).map_err(failed)
    }

    fn failed(e: meshopt::Error) -> Error {
        Error::invalid("GLB mesh", format!("meshoptimizer refuses it: {e}"))
    }
}

/// Nothing is compressed in a build without meshopt: [`meshopt_built`] says so to each.
#[cfg(not(feature = "meshopt"))]
mod codec {
    use super::*;

    pub fn order(_: &mut Tile) -> Result<()> {
        meshopt_built()
    }
    pub fn attributes<const N: usize>(_: &[[u8; N]]) -> Result<Vec<u8>> {
        meshopt_built().map(|()| Vec::new())
    }
    pub fn triangles(_: &[u32]) -> Result<Vec<u8>> {
        meshopt_built().map(|()| Vec::new())
    }
}
