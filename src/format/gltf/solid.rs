//! A plain triangle mesh as GLB: positions, normals, indices; axes as it came.

use super::container::Sink;
use super::{ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, TRIANGLES, UNSIGNED_INT, UNSIGNED_SHORT};
use crate::base::{Error, Result};
use serde_json::{Map, Value, json};
use std::io::Write;
use terraquilt_codecs::solid::Mesh;

/// From so many times its extent away from zero, a mesh is written about an origin: 32-bit floats have 24 bits.
const FAR: f64 = 64.0;

/// Writes a mesh as GLB: one node, one primitive, a matt material, normals weighted with the angles of triangles. Positions are 32-bit floats in the mesh's own
/// axes; those of a mesh far from zero are about its middle, and its node moves it back. `extras` goes into `asset.extras`. The same mesh gives
/// the same bytes; one without triangles gives a valid file without a scene.
///
/// # Errors
/// [`Error::Invalid`] for an index out of range or a position that is not finite in 32 bits, [`Error::Limit`] beyond 4 GiB, [`Error::Io`] from
/// `out`.
pub fn write_solid_glb(out: &mut dyn Write, mesh: &Mesh, extras: &Map<String, Value>) -> Result<()> {
    let generator = concat!("terraquilt ", env!("CARGO_PKG_VERSION"));
    let mut document = json!({ "asset": { "version": "2.0", "generator": generator } });
    if !extras.is_empty() {
        document["asset"]["extras"] = Value::Object(extras.clone());
    }
    if mesh.triangles.is_empty() {
        return Sink::begin(out, &document, 0)?.flush();
    }
    mesh.check().map_err(|e| Error::invalid("GLB mesh", e))?;
    let origin = origin(mesh);
    let place = |p: &[f64; 3]| [0, 1, 2].map(|k| (p[k] - origin[k]) as f32 + 0.0);
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in mesh.positions.iter().map(place) {
        if p.iter().any(|v| !v.is_finite()) {
            return Err(Error::invalid("GLB mesh", "a position does not fit 32 bits; write a smaller mesh"));
        }
        for k in 0..3 {
            (min[k], max[k]) = (min[k].min(p[k]), max[k].max(p[k]));
        }
    }
    let count = mesh.positions.len() as u64;
    // The largest 16-bit index means "restart" and is not used.
    let narrow = count <= u64::from(u16::MAX);
    let index_bytes = mesh.triangles.len() as u64 * if narrow { 6 } else { 12 };
    let bytes = count * 24 + index_bytes.next_multiple_of(4);
    let view = |at: u64, length: u64, target: u32| json!({ "buffer": 0, "byteOffset": at, "byteLength": length, "target": target });
    let mut node = json!({ "mesh": 0 });
    if origin != [0.0; 3] {
        node["translation"] = json!(origin);
    }
    let primitive = json!({ "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 2, "material": 0, "mode": TRIANGLES });
    let vectors =
        |view: u32| json!({ "bufferView": view, "componentType": FLOAT, "type": "VEC3", "count": count });
    let mut positions = vectors(0);
    positions["min"] = json!(min.map(f64::from));
    positions["max"] = json!(max.map(f64::from));
    let width = if narrow { UNSIGNED_SHORT } else { UNSIGNED_INT };
    let corners = mesh.triangles.len() * 3;
    document["scene"] = json!(0);
    document["scenes"] = json!([{ "nodes": [0] }]);
    document["nodes"] = json!([node]);
    document["meshes"] = json!([{ "primitives": [primitive] }]);
    document["materials"] = json!([{ "pbrMetallicRoughness": {
        "baseColorFactor": [0.6, 0.6, 0.6, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.9
    } }]);
    document["buffers"] = json!([{ "byteLength": bytes }]);
    document["bufferViews"] = json!([
        view(0, count * 12, ARRAY_BUFFER),
        view(count * 12, count * 12, ARRAY_BUFFER),
        view(count * 24, index_bytes, ELEMENT_ARRAY_BUFFER),
    ]);
    document["accessors"] = json!([
        positions,
        vectors(1),
        { "bufferView": 2, "componentType": width, "type": "SCALAR", "count": corners },
    ]);
    let mut sink = Sink::begin(out, &document, bytes)?;
    mesh.positions.iter().map(place).try_for_each(|p| sink.floats(p))?;
    for n in mesh.vertex_normals() {
        // A normal has length 1, even where no triangle gives one.
        sink.floats(if n == [0.0; 3] { [0.0, 0.0, 1.0] } else { n.map(|v| v as f32 + 0.0) })?;
    }
    for v in mesh.triangles.iter().flatten() {
        if narrow { sink.bytes(&(*v as u16).to_le_bytes())? } else { sink.u32s(&[*v])? }
    }
    sink.bytes(&[0; 2][..(bytes - count * 24 - index_bytes) as usize])?;
    sink.flush()
}

/// The point that positions are about: zero, or the middle of a mesh that is far from it, as a 32-bit float has it.
fn origin(mesh: &Mesh) -> [f64; 3] {
    let [min, max] = mesh.bounds().unwrap_or_default();
    let extent = (0..3).map(|k| max[k] - min[k]).fold(0.0, f64::max);
    let far = (0..3).map(|k| min[k].abs().max(max[k].abs())).fold(0.0, f64::max);
    if far <= FAR * extent {
        return [0.0; 3];
    }
    [0, 1, 2].map(|k| f64::from((min[k] / 2.0 + max[k] / 2.0) as f32))
}
