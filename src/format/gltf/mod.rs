//! Meshes as glTF 2.0 binary files (GLB). Terrain is written as follows; what is no terrain keeps its axes ([`write_solid_glb`]).
//!
//! glTF is x right, y up, z towards the viewer: here x = east, y = up, z = south. Positions are 32-bit
//! floats relative to an origin near the middle of the mesh; the origin is in `asset.extras`:
//!
//! | key | |
//! |---|---|
//! | `origin` | `[east, north, up]` of the point 0, 0, 0, metres |
//! | `crs` | coordinate system of the origin |
//! | `error_m` | certified error of the mesh |
//! | `version` | version of the database |
//!
//! Layout of the binary chunk: positions, normals, colours if any, indices; little-endian, each part begins
//! at a multiple of 4 bytes. Indices are 16 bits wide if they fit.

mod affine;
mod compact;
mod container;
mod document;
mod draped;
mod lattice;
mod solid;
mod squeeze;
mod tiles;
mod triangles;

pub use compact::{Compact, Compacted, write_compact_glb};
pub use draped::{Drape, DrapePicture, write_draped_glb};
pub use solid::write_solid_glb;
pub use squeeze::meshopt_built;
pub(super) use triangles::{Beside, read_triangles};

use std::io::Write;

use serde_json::{Map, Value, json};

use self::container::Sink;
use crate::base::{Error, Result};

/// What [`write_glb`] writes.
#[derive(Debug, Clone)]
pub struct GlbMesh<'a> {
    /// x east, y north, z up, metres relative to `origin`.
    pub positions: &'a [[f64; 3]],
    /// Unit vectors in the same axes, one a position.
    pub normals: &'a [[f32; 3]],
    /// Indices into `positions`, counter-clockwise seen from above.
    pub triangles: &'a [[u32; 3]],
    /// One a position: red, green, blue (linear light), opacity. `None`: one neutral colour for all.
    pub colors: Option<&'a [[u8; 4]]>,
    /// East, north, up of the point 0, 0, 0.
    pub origin: [f64; 3],
    /// Coordinate system of `origin`, such as `EPSG:32611`.
    pub crs: &'a str,
    /// Certified error, metres; NaN: nobody knows, which the file says as `null`.
    pub error_m: f64,
    /// Version of the database.
    pub version: u64,
    /// Further entries of `asset.extras`, such as `surface_error_m`; the ones above win.
    pub extras: Map<String, Value>,
}

const FLOAT: u32 = 5126;
const UNSIGNED_BYTE: u32 = 5121;
const UNSIGNED_SHORT: u32 = 5123;
const UNSIGNED_INT: u32 = 5125;
const ARRAY_BUFFER: u32 = 34962;
const ELEMENT_ARRAY_BUFFER: u32 = 34963;
const TRIANGLES: u32 = 4;

/// Dry grass and rock, linear light.
const BASE_COLOR: [f64; 4] = [0.47, 0.43, 0.34, 1.0];

/// Writes a mesh as GLB: one node, one primitive, a matt material. The same mesh gives the same bytes. A mesh
/// without triangles gives a valid file without a scene. Holds no second copy of the mesh.
///
/// # Errors
/// [`Error::Invalid`] if a number is not finite or an array has the wrong length, [`Error::Limit`] beyond
/// 4 GiB, [`Error::Io`] from `out`.
pub fn write_glb(out: &mut dyn Write, mesh: &GlbMesh) -> Result<()> {
    check(mesh)?;
    let layout = Layout::new(mesh);
    let document = document(mesh, &layout);
    let mut sink = Sink::begin(out, &document, layout.bytes)?;
    if layout.bytes > 0 {
        for p in mesh.positions {
            sink.floats(to_gltf(p.map(|v| v as f32)))?;
        }
        for n in mesh.normals {
            sink.floats(to_gltf(*n))?;
        }
        for c in mesh.colors.unwrap_or_default() {
            sink.bytes(c)?;
        }
        if layout.narrow {
            for &v in mesh.triangles.iter().flatten() {
                sink.bytes(&(v as u16).to_le_bytes())?;
            }
            sink.bytes(&[0; 2][..(mesh.triangles.len() % 2) * 2])?;
        } else {
            for t in mesh.triangles {
                sink.u32s(t)?;
            }
        }
    }
    sink.flush()
}

/// Lengths, numbers and indices.
fn check(mesh: &GlbMesh) -> Result<()> {
    let count = mesh.positions.len();
    let invalid = |reason: &str| Err(Error::invalid("GLB mesh", reason));
    if mesh.normals.len() != count || mesh.colors.is_some_and(|c| c.len() != count) {
        return invalid("normals and colours must be as many as positions");
    }
    let mut numbers = mesh.positions.iter().flatten().chain(&mesh.origin);
    if numbers.any(|v| !v.is_finite())
        || mesh.error_m.is_infinite()
        || mesh.normals.iter().flatten().any(|v| !v.is_finite())
    {
        return invalid("a number is not finite");
    }
    if mesh.positions.iter().flatten().any(|v| !(*v as f32).is_finite()) {
        return invalid("a position does not fit 32 bits; choose an origin in the middle");
    }
    if mesh.triangles.iter().flatten().any(|&v| v as usize >= count) {
        return invalid("an index is out of range");
    }
    Ok(())
}

/// East, north, up to east, up, south; never a negative zero.
fn to_gltf(p: [f32; 3]) -> [f32; 3] {
    [p[0] + 0.0, p[2] + 0.0, 0.0 - p[1]]
}

/// Where the parts begin in the binary chunk, bytes.
struct Layout {
    normals: u64,
    colors: u64,
    indices: u64,
    index_bytes: u64,
    bytes: u64,
    narrow: bool,
}

impl Layout {
    fn new(mesh: &GlbMesh) -> Layout {
        // The largest 16-bit index means "restart" and is not used.
        let narrow = mesh.positions.len() <= usize::from(u16::MAX);
        if mesh.triangles.is_empty() {
            return Layout { normals: 0, colors: 0, indices: 0, index_bytes: 0, bytes: 0, narrow };
        }
        let count = mesh.positions.len() as u64;
        let normals = count * 12;
        let colors = normals + count * 12;
        let indices = colors + if mesh.colors.is_some() { count * 4 } else { 0 };
        let index_bytes = mesh.triangles.len() as u64 * if narrow { 6 } else { 12 };
        Layout {
            normals,
            colors,
            indices,
            index_bytes,
            bytes: indices + index_bytes.next_multiple_of(4),
            narrow,
        }
    }
}

/// `asset`: who wrote it, and what is known of the mesh.
fn asset(mesh: &GlbMesh, error_m: f64) -> Value {
    let mut extras = mesh.extras.clone();
    extras.insert("origin".into(), json!(mesh.origin));
    extras.insert("crs".into(), json!(mesh.crs));
    extras.insert("error_m".into(), json!(error_m));
    extras.insert("version".into(), json!(mesh.version));
    let generator = concat!("terraquilt ", env!("CARGO_PKG_VERSION"));
    json!({ "version": "2.0", "generator": generator, "extras": extras })
}

/// The one matt material. Colours of vertices are multiplied with it.
fn materials(mesh: &GlbMesh) -> Value {
    let base = if mesh.colors.is_some() { [1.0; 4] } else { BASE_COLOR };
    json!([{
        "name": "ground",
        "pbrMetallicRoughness": { "baseColorFactor": base, "metallicFactor": 0.0, "roughnessFactor": 0.95 }
    }])
}

fn document(mesh: &GlbMesh, layout: &Layout) -> Value {
    let mut document = json!({ "asset": asset(mesh, mesh.error_m) });
    if mesh.triangles.is_empty() {
        return document;
    }
    let count = mesh.positions.len();
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in mesh.positions {
        let p = to_gltf(p.map(|v| v as f32));
        for k in 0..3 {
            min[k] = min[k].min(p[k]);
            max[k] = max[k].max(p[k]);
        }
    }
    let view = |from: u64, to: u64, target: u32| json!({ "buffer": 0, "byteOffset": from, "byteLength": to - from, "target": target });
    let accessor = |view: usize, component: u32, kind: &str, count: usize| json!({ "bufferView": view, "componentType": component, "type": kind, "count": count });
    let mut views =
        vec![view(0, layout.normals, ARRAY_BUFFER), view(layout.normals, layout.colors, ARRAY_BUFFER)];
    let mut accessors = vec![accessor(0, FLOAT, "VEC3", count), accessor(1, FLOAT, "VEC3", count)];
    accessors[0]["min"] = json!(min.map(f64::from));
    accessors[0]["max"] = json!(max.map(f64::from));
    let mut attributes = json!({ "POSITION": 0, "NORMAL": 1 });
    if mesh.colors.is_some() {
        attributes["COLOR_0"] = json!(accessors.len());
        views.push(view(layout.colors, layout.indices, ARRAY_BUFFER));
        let mut colors = accessor(2, UNSIGNED_BYTE, "VEC4", count);
        colors["normalized"] = json!(true);
        accessors.push(colors);
    }
    let indices = accessors.len();
    views.push(view(layout.indices, layout.indices + layout.index_bytes, ELEMENT_ARRAY_BUFFER));
    let width = if layout.narrow { UNSIGNED_SHORT } else { UNSIGNED_INT };
    accessors.push(accessor(indices, width, "SCALAR", mesh.triangles.len() * 3));
    document["scene"] = json!(0);
    document["scenes"] = json!([{ "nodes": [0] }]);
    document["nodes"] = json!([{ "mesh": 0, "name": "terrain" }]);
    document["meshes"] = json!([{
        "name": "terrain",
        "primitives": [{ "attributes": attributes, "indices": indices, "material": 0, "mode": TRIANGLES }]
    }]);
    document["materials"] = materials(mesh);
    document["buffers"] = json!([{ "byteLength": layout.bytes }]);
    document["bufferViews"] = Value::Array(views);
    document["accessors"] = Value::Array(accessors);
    document
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square<'a>() -> GlbMesh<'a> {
        GlbMesh {
            positions: &[[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [2.0, 3.0, 4.0]],
            normals: &[[0.0, 0.0, 1.0]; 3],
            triangles: &[[0, 1, 2]],
            colors: None,
            origin: [500_000.0, 4_000_000.0, 10.0],
            crs: "EPSG:32611",
            error_m: 0.5,
            version: 7,
            extras: Map::new(),
        }
    }

    fn written(mesh: &GlbMesh) -> Vec<u8> {
        let mut bytes = Vec::new();
        write_glb(&mut bytes, mesh).expect("a good mesh is written");
        bytes
    }

    fn document_of(bytes: &[u8]) -> Value {
        let length = u32::from_le_bytes(bytes[12..16].try_into().expect("4 bytes")) as usize;
        serde_json::from_slice(&bytes[20..20 + length]).expect("JSON")
    }

    #[test]
    fn the_container_is_laid_out_as_the_standard_says() {
        let bytes = written(&square());
        assert_eq!(&bytes[..8], b"glTF\x02\0\0\0");
        assert_eq!(bytes[8..12], (bytes.len() as u32).to_le_bytes());
        assert_eq!(&bytes[16..20], b"JSON");
        let document = document_of(&bytes);
        assert_eq!(document["asset"]["extras"]["origin"], json!([500_000.0, 4_000_000.0, 10.0]));
        assert_eq!(document["accessors"][0]["min"], json!([0.0, 1.0, -3.0]));
        assert_eq!(document["accessors"][0]["max"], json!([2.0, 4.0, 0.0]));
        assert_eq!(document["accessors"][2]["componentType"], json!(UNSIGNED_SHORT));
        // 3 positions, 3 normals, 3 indices of 2 bytes and 2 bytes to the multiple of 4.
        assert_eq!(document["buffers"][0]["byteLength"], json!(36 + 36 + 8));
        let bin = &bytes[bytes.len() - 80..];
        assert_eq!(&bin[12..24], [2f32, 1.0, 0.0].map(f32::to_le_bytes).as_flattened());
        assert_eq!(&bin[72..], [0, 0, 1, 0, 2, 0, 0, 0]);
    }

    #[test]
    fn colours_come_between_normals_and_indices() {
        let bytes = written(&GlbMesh { colors: Some(&[[1, 2, 3, 255]; 3]), ..square() });
        let document = document_of(&bytes);
        assert_eq!(document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"], json!(2));
        assert_eq!(bytes[bytes.len() - 20..bytes.len() - 16], [1, 2, 3, 255]);
    }

    #[test]
    fn a_mesh_without_triangles_is_a_file_without_a_scene() {
        let bytes = written(&GlbMesh { positions: &[], normals: &[], triangles: &[], ..square() });
        assert_eq!(bytes.len() % 4, 0);
        let document = document_of(&bytes);
        assert!(document.get("scene").is_none());
        assert_eq!(document["asset"]["extras"]["version"], json!(7));
    }

    /// Synthetic ground has no error that could be stated: readers find `null`, and no number that looks like one.
    #[test]
    fn an_unknown_error_is_null() {
        let mut bytes = Vec::new();
        write_glb(&mut bytes, &GlbMesh { error_m: f64::NAN, ..square() }).unwrap();
        let extras = &document_of(&bytes)["asset"]["extras"];
        assert!(extras["error_m"].is_null() && extras.get("error_m").is_some());
    }

    #[test]
    fn what_glb_cannot_hold_is_refused() {
        let mut sink = Vec::new();
        assert!(write_glb(&mut sink, &GlbMesh { normals: &[], ..square() }).is_err());
        assert!(write_glb(&mut sink, &GlbMesh { triangles: &[[0, 1, 3]], ..square() }).is_err());
        assert!(write_glb(&mut sink, &GlbMesh { error_m: f64::INFINITY, ..square() }).is_err());
        assert!(write_glb(&mut sink, &GlbMesh { origin: [f64::INFINITY; 3], ..square() }).is_err());
        assert!(sink.is_empty());
    }
}
