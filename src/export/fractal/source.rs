//! What a file is taken for: heights, a picture or a mesh.

use crate::base::{Error, Result};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// What a file is taken for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Taken {
    /// Heights with a place.
    Heights,
    /// Grey or colours, a byte a sample.
    Picture,
    /// Triangles that bound a solid.
    Mesh,
}

/// Bytes that tell: of a PNG up to its depth and colours.
const HEAD: usize = 26;

impl Taken {
    /// By its first bytes and its name: PNG and JPEG are pictures, but not 16 bits of grey; PLY, GLB and glTF are meshes; all else is heights.
    ///
    /// # Errors
    /// If there is no such file.
    pub fn of(path: &Path) -> Result<Taken> {
        let mut head = Vec::new();
        let file = File::open(path).map_err(|e| match e.kind() {
            std::io::ErrorKind::NotFound => {
                Error::missing(format!("file {}", path.display()), "check the name")
            }
            _ => Error::io(path, e),
        })?;
        // What cannot be read is refused by the reader, with better words.
        let _ = file.take(HEAD as u64).read_to_end(&mut head);
        let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        if head.starts_with(b"ply") || head.starts_with(b"glTF") || ["ply", "glb", "gltf"].contains(&&*ending)
        {
            return Ok(Taken::Mesh);
        }
        let png = head.starts_with(b"\x89PNG\r\n\x1a\n");
        if head.starts_with(&[0xff, 0xd8, 0xff]) || (png && !is_deep_grey(&head)) {
            return Ok(Taken::Picture);
        }
        Ok(Taken::Heights)
    }

    /// In a sentence.
    pub fn name(self) -> &'static str {
        match self {
            Taken::Heights => "heights",
            Taken::Picture => "picture",
            Taken::Mesh => "mesh",
        }
    }
}

/// Whether a PNG has 16 bits of grey a sample: no screen shows them, heights need them.
fn is_deep_grey(head: &[u8]) -> bool {
    head.get(24..26) == Some(&[16, 0])
}
