//! Files of triangle meshes: PLY, GLB and glTF in; GLB out by [`write_solid_glb`](super::gltf::write_solid_glb). A mesh is not terrain: it has no system of
//! coordinates, and keeps the axes that it came with.

use super::{gltf, ply};
use crate::base::{Error, Result, limits};
use std::path::Path;
use terraquilt_codecs::solid::Mesh;

/// Reads the triangles of a file, by its first bytes: PLY, GLB, glTF.
///
/// # Errors
/// [`Error::Missing`] if there is none of that name; [`Error::Limit`] above [`limits::MESH_FILE_BYTES_MAX`] bytes or the limits of a [`Mesh`];
/// [`Error::Unsupported`] for other formats and for what of glTF is not read; [`Error::Corrupt`] for damage, with its place.
pub fn read_solid(path: &Path) -> Result<Mesh> {
    let bytes = read_file(path)?;
    let beside = |name: &str| read_file(&path.with_file_name(name));
    parse(&path.display().to_string(), &bytes, &beside)
}

/// As [`read_solid`], of bytes with nothing beside them; `name` is used in errors.
///
/// # Errors
/// As [`read_solid`].
pub fn parse_solid(name: &str, bytes: &[u8]) -> Result<Mesh> {
    parse(name, bytes, &|other| {
        Err(Error::missing(format!("file {other}, which {name} names,"), "write it as GLB, in one file"))
    })
}

fn parse(name: &str, bytes: &[u8], beside: &gltf::Beside) -> Result<Mesh> {
    if ply::begins(bytes) {
        return ply::parse(name, bytes);
    }
    if bytes.starts_with(b"glTF") || bytes.trim_ascii_start().starts_with(b"{") {
        return gltf::read_triangles(name, bytes, beside);
    }
    if bytes.is_empty() {
        return Err(Error::corrupt(name, "file", "it is empty (0 bytes)"));
    }
    Err(Error::unsupported(name, "not a mesh that is read", "write it as PLY or GLB"))
}

fn read_file(path: &Path) -> Result<Vec<u8>> {
    let name = path.display().to_string();
    let meta = std::fs::metadata(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => Error::missing(format!("file {name}"), "check the name"),
        _ => Error::io(path, e),
    })?;
    if !meta.is_file() {
        return Err(Error::unsupported(name, "not a regular file", "name a file with a mesh"));
    }
    if meta.len() > limits::MESH_FILE_BYTES_MAX {
        return Err(Error::limit(format!("bytes of {name}"), limits::MESH_FILE_BYTES_MAX, meta.len()));
    }
    std::fs::read(path).map_err(|e| Error::io(path, e))
}
