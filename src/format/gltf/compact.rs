//! Compact GLB: KHR_mesh_quantization, and EXT_meshopt_compression on top if wanted.
//!
//! Positions are 16-bit whole numbers, normals 8-bit. A node for each tile carries `scale` (the quantum, the same
//! for all) and `translation` (a multiple of it), so that vertices shared by tiles decode to the same bits. The nodes
//! are children of one node `terrain`. Triangles too wide for 16 bits are in a last child with 32-bit floats that are
//! multiples of the same quantum. `asset.extras` has, further to those of a plain GLB:
//!
//! | key | |
//! |---|---|
//! | `quantum_m` | a power of two, metres |
//! | `quantization_error_m` | what the lattice adds to the error, part of `error_m` |
//! | `quantization_shift_m` | the farthest that a vertex moved sideways; where the mesh is steeper than 2, it takes its height within that distance instead |
//!
//! Streams, one view of the buffer each: 16-bit positions, normals, colours if any, 16-bit indices; then 32-bit positions
//! and indices of what is too wide. Elements begin at multiples of 4 bytes. With meshopt the views are of a second
//! buffer without bytes (a fallback), and their extension says where in the first one the compressed bytes are.

use std::io::Write;

use serde_json::{Value, json};

use super::container::Sink;
use super::lattice::Lattice;
use super::tiles::{Tile, split};
use super::{
    ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, GlbMesh, TRIANGLES, UNSIGNED_BYTE, UNSIGNED_INT,
    UNSIGNED_SHORT, asset, check, materials, meshopt_built, squeeze,
};
use crate::base::Result;
use crate::base::round::add_up;

const BYTE: u32 = 5120;
const QUANTIZATION: &str = "KHR_mesh_quantization";
const MESHOPT: &str = "EXT_meshopt_compression";

/// How [`write_compact_glb`] writes.
#[derive(Debug, Clone, Copy)]
pub struct Compact {
    /// What the lattice may add to the error, metres.
    pub error_m: f64,
    /// How far it may move a vertex sideways, metres.
    pub shift_m: f64,
    /// Compress with EXT_meshopt_compression; see [`meshopt_built`].
    pub meshopt: bool,
}

/// What [`write_compact_glb`] did.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Compacted {
    /// The lattice, a power of two, metres.
    pub quantum_m: f64,
    /// What it added to the error, metres.
    pub quantization_error_m: f64,
    /// The farthest that a vertex moved sideways, metres.
    pub quantization_shift_m: f64,
    /// Nodes with a mesh.
    pub tiles: u64,
    /// Triangles in 32-bit floats, too wide for 16 bits.
    pub wide_triangles: u64,
}

/// Writes a mesh as compact GLB. `error_m` of the file is that of the mesh and what the lattice adds. The same
/// mesh gives the same bytes.
///
/// # Errors
/// As [`super::write_glb`]; [`crate::base::Error::Invalid`] also if triangles are thinner than 32-bit floats can tell;
/// as [`meshopt_built`] if meshopt is asked.
pub fn write_compact_glb(out: &mut dyn Write, mesh: &GlbMesh, compact: &Compact) -> Result<Compacted> {
    if compact.meshopt {
        meshopt_built()?;
    }
    check(mesh)?;
    let lattice = Lattice::new(mesh, compact.error_m, compact.shift_m)?;
    let mut tiles = split(&lattice.points, mesh.triangles);
    if compact.meshopt {
        tiles.iter_mut().try_for_each(squeeze::order)?;
    }
    let found = Compacted {
        quantum_m: lattice.quantum_m,
        quantization_error_m: lattice.error_m,
        quantization_shift_m: lattice.shift_m,
        tiles: tiles.len() as u64,
        wide_triangles: tiles.iter().filter(|t| t.corner.is_none()).map(|t| t.triangles.len() as u64).sum(),
    };
    let streams = Streams::new(mesh, &lattice, &tiles);
    let views = streams.views(compact.meshopt)?;
    let document = document(mesh, &lattice, &tiles, &views, &found);
    let bytes = views.iter().map(|v| v.stored.len().next_multiple_of(4) as u64).sum();
    let mut sink = Sink::begin(out, &document, bytes)?;
    for v in &views {
        sink.bytes(&v.stored)?;
        sink.bytes(&[0; 3][..v.stored.len().next_multiple_of(4) - v.stored.len()])?;
    }
    sink.flush()?;
    Ok(found)
}

/// Everything that comes once a vertex or corner, tile after tile; attributes as little-endian bytes.
#[derive(Default)]
struct Streams {
    positions: Vec<[u8; 8]>,
    normals: Vec<[u8; 4]>,
    colors: Vec<[u8; 4]>,
    indices: Vec<u32>,
    wide_positions: Vec<[u8; 12]>,
    wide_indices: Vec<u32>,
}

impl Streams {
    fn new(mesh: &GlbMesh, lattice: &Lattice, tiles: &[Tile]) -> Streams {
        let mut s = Streams::default();
        for tile in tiles {
            for &v in &tile.vertices {
                let (v, point) = (v as usize, lattice.points[v as usize]);
                match tile.corner {
                    Some(c) => {
                        let [[a, b], [c, d], [e, f]] =
                            [0, 1, 2].map(|k| ((point[k] - c[k]) as u16).to_le_bytes());
                        s.positions.push([a, b, c, d, e, f, 0, 0]);
                    }
                    None => {
                        let metres = point.map(|k| ((f64::from(k) * lattice.quantum_m) as f32).to_le_bytes());
                        s.wide_positions.extend(metres.as_flattened().as_chunks().0);
                    }
                }
                let [x, y, z] = mesh.normals[v].map(|n| (n * 127.0).round() as i8);
                s.normals.push([x, z, -y, 0].map(|n| n as u8));
                s.colors.extend(mesh.colors.map(|c| c[v]));
            }
            let indices = if tile.corner.is_some() { &mut s.indices } else { &mut s.wide_indices };
            indices.extend_from_slice(tile.triangles.as_flattened());
        }
        s
    }

    /// The streams that hold something, as they are stored.
    fn views(&self, meshopt: bool) -> Result<Vec<View>> {
        let mut views = Vec::new();
        if !self.positions.is_empty() {
            views.push(View::attributes(Stream::Positions, &self.positions, meshopt)?);
        }
        if !self.normals.is_empty() {
            views.push(View::attributes(Stream::Normals, &self.normals, meshopt)?);
        }
        if !self.colors.is_empty() {
            views.push(View::attributes(Stream::Colors, &self.colors, meshopt)?);
        }
        if !self.indices.is_empty() {
            views.push(View::indices(Stream::Indices, &self.indices, 2, meshopt)?);
        }
        if !self.wide_indices.is_empty() {
            views.push(View::attributes(Stream::WidePositions, &self.wide_positions, meshopt)?);
            views.push(View::indices(Stream::WideIndices, &self.wide_indices, 4, meshopt)?);
        }
        Ok(views)
    }
}

#[derive(Clone, Copy, PartialEq)]
enum Stream {
    Positions,
    Normals,
    Colors,
    Indices,
    WidePositions,
    WideIndices,
}

/// A view of the buffer.
struct View {
    stream: Stream,
    /// Bytes of an element, and how many.
    stride: usize,
    count: usize,
    /// As they are, or compressed.
    stored: Vec<u8>,
    meshopt: bool,
}

impl View {
    fn attributes<const N: usize>(stream: Stream, values: &[[u8; N]], meshopt: bool) -> Result<View> {
        let stored = if meshopt { squeeze::attributes(values)? } else { values.as_flattened().to_vec() };
        Ok(View { stream, stride: N, count: values.len(), stored, meshopt })
    }

    fn indices(stream: Stream, indices: &[u32], stride: usize, meshopt: bool) -> Result<View> {
        let stored = if meshopt {
            squeeze::triangles(indices)?
        } else {
            indices.iter().flat_map(|v| v.to_le_bytes().into_iter().take(stride)).collect()
        };
        Ok(View { stream, stride, count: indices.len(), stored, meshopt })
    }

    fn is_indices(&self) -> bool {
        matches!(self.stream, Stream::Indices | Stream::WideIndices)
    }

    /// Its JSON, and its ends in the buffer and in the fallback.
    fn json(&self, stored_at: &mut usize, plain_at: &mut usize) -> Value {
        let bytes = self.stride * self.count;
        let mut view = json!({
            "buffer": usize::from(self.meshopt),
            "byteOffset": if self.meshopt { *plain_at } else { *stored_at },
            "byteLength": bytes,
            "target": if self.is_indices() { ELEMENT_ARRAY_BUFFER } else { ARRAY_BUFFER },
        });
        if !self.is_indices() {
            view["byteStride"] = json!(self.stride);
        }
        if self.meshopt {
            view["extensions"] = json!({ MESHOPT: {
                "buffer": 0,
                "byteOffset": *stored_at,
                "byteLength": self.stored.len(),
                "byteStride": self.stride,
                "count": self.count,
                "mode": if self.is_indices() { "TRIANGLES" } else { "ATTRIBUTES" },
            }});
        }
        *stored_at += self.stored.len().next_multiple_of(4);
        *plain_at += bytes.next_multiple_of(4);
        view
    }
}

fn document(mesh: &GlbMesh, lattice: &Lattice, tiles: &[Tile], views: &[View], found: &Compacted) -> Value {
    let mut asset = asset(mesh, add_up(mesh.error_m, found.quantization_error_m));
    asset["extras"]["quantum_m"] = json!(found.quantum_m);
    asset["extras"]["quantization_error_m"] = json!(found.quantization_error_m);
    asset["extras"]["quantization_shift_m"] = json!(found.quantization_shift_m);
    let mut document = json!({ "asset": asset });
    if tiles.is_empty() {
        return document;
    }
    let meshopt = views.iter().any(|v| v.meshopt);
    let mut extensions = vec![QUANTIZATION];
    extensions.extend(meshopt.then_some(MESHOPT));
    let view = |stream: Stream| views.iter().position(|v| v.stream == stream);

    let mut nodes = vec![json!({ "name": "terrain", "children": (1..=tiles.len()).collect::<Vec<_>>() })];
    let (mut meshes, mut accessors) = (Vec::new(), Vec::new());
    // Elements of the streams that the tiles before this one have taken.
    let (mut vertices, mut normals, mut indices) = (0, 0, 0);
    for (k, tile) in tiles.iter().enumerate() {
        let mut node = json!({ "name": format!("tile {k}"), "mesh": k });
        let mut attributes = json!({});
        let mut add = |name: Option<&str>, accessor: Value| {
            if let Some(name) = name {
                attributes[name] = json!(accessors.len());
            }
            accessors.push(accessor);
        };
        let count = tile.vertices.len();
        let (mut lo, mut hi) = ([i32::MAX; 3], [i32::MIN; 3]);
        for &v in &tile.vertices {
            for k in 0..3 {
                lo[k] = lo[k].min(lattice.points[v as usize][k]);
                hi[k] = hi[k].max(lattice.points[v as usize][k]);
            }
        }
        if let Some(corner) = tile.corner {
            node["scale"] = json!([lattice.quantum_m, lattice.quantum_m, lattice.quantum_m]);
            node["translation"] = json!(corner.map(|c| f64::from(c) * lattice.quantum_m));
            let ends = [lo, hi].map(|p| [0, 1, 2].map(|k| p[k] - corner[k]));
            add(
                Some("POSITION"),
                json!({
                    "bufferView": view(Stream::Positions), "byteOffset": vertices * 8, "count": count,
                    "componentType": UNSIGNED_SHORT, "type": "VEC3", "min": ends[0], "max": ends[1],
                }),
            );
            vertices += count;
        } else {
            let ends = [lo, hi].map(|p| p.map(|v| f64::from(v) * lattice.quantum_m));
            add(
                Some("POSITION"),
                json!({
                    "bufferView": view(Stream::WidePositions), "count": count,
                    "componentType": FLOAT, "type": "VEC3", "min": ends[0], "max": ends[1],
                }),
            );
        }
        add(
            Some("NORMAL"),
            json!({
                "bufferView": view(Stream::Normals), "byteOffset": normals * 4, "count": count,
                "componentType": BYTE, "normalized": true, "type": "VEC3",
            }),
        );
        if let Some(colors) = view(Stream::Colors) {
            add(
                Some("COLOR_0"),
                json!({
                    "bufferView": colors, "byteOffset": normals * 4, "count": count,
                    "componentType": UNSIGNED_BYTE, "normalized": true, "type": "VEC4",
                }),
            );
        }
        normals += count;
        let corners = tile.triangles.len() * 3;
        let mut index = json!({ "count": corners, "type": "SCALAR" });
        if tile.corner.is_some() {
            index["bufferView"] = json!(view(Stream::Indices));
            index["byteOffset"] = json!(indices * 2);
            index["componentType"] = json!(UNSIGNED_SHORT);
            indices += corners;
        } else {
            index["bufferView"] = json!(view(Stream::WideIndices));
            index["componentType"] = json!(UNSIGNED_INT);
        }
        add(None, index);
        meshes.push(json!({ "primitives": [{
            "attributes": attributes, "indices": accessors.len() - 1, "material": 0, "mode": TRIANGLES,
        }]}));
        nodes.push(node);
    }

    let (mut stored, mut plain) = (0, 0);
    let view_json: Vec<Value> = views.iter().map(|v| v.json(&mut stored, &mut plain)).collect();
    let mut buffers = vec![json!({ "byteLength": stored })];
    if meshopt {
        buffers.push(json!({ "byteLength": plain, "extensions": { MESHOPT: { "fallback": true } } }));
    }
    document["extensionsUsed"] = json!(extensions);
    document["extensionsRequired"] = json!(extensions);
    document["scene"] = json!(0);
    document["scenes"] = json!([{ "nodes": [0] }]);
    document["nodes"] = json!(nodes);
    document["meshes"] = json!(meshes);
    document["materials"] = materials(mesh);
    document["buffers"] = json!(buffers);
    document["bufferViews"] = json!(view_json);
    document["accessors"] = json!(accessors);
    document
}
