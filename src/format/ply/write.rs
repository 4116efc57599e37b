//! A triangle mesh as binary PLY.

use crate::base::{Error, Result};
use std::io::Write;
use terraquilt_codecs::solid::Mesh;

/// Writes positions as doubles, triangles as lists of 32-bit indices, little-endian. The same mesh gives the same bytes.
///
/// # Errors
/// [`Error::Io`] from `out`.
pub fn write_ply(out: &mut dyn Write, mesh: &Mesh, comment: &str) -> Result<()> {
    let head = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {comment}\nelement vertex {}\nproperty double x\nproperty double y\nproperty double z\n\
         element face {}\nproperty list uchar int vertex_indices\nend_header\n",
        mesh.positions.len(),
        mesh.triangles.len()
    );
    let mut write = |bytes: &[u8]| out.write_all(bytes).map_err(|e| Error::io("PLY", e));
    write(head.as_bytes())?;
    for p in &mesh.positions {
        write(p.map(f64::to_le_bytes).as_flattened())?;
    }
    for t in &mesh.triangles {
        write(&[3])?;
        write(t.map(u32::to_le_bytes).as_flattened())?;
    }
    Ok(())
}
