//! A reader of what the program writes: GLB with float or 16-bit positions, tiles in nodes, compressed or not.

use serde_json::Value;
use std::collections::HashMap;

/// A mesh read back from the bytes of a GLB, its tiles joined where vertices are the same bits.
pub struct Glb {
    pub json: Value,
    /// East, north, up.
    pub positions: Vec<[f64; 3]>,
    /// East, north, up: one a position, that of the first tile that has it.
    pub normals: Vec<[f64; 3]>,
    pub triangles: Vec<[usize; 3]>,
    /// Vertices of all tiles together, those on common sides counted in each.
    pub stored: usize,
}

pub fn read(path: &std::path::Path) -> Glb {
    from_bytes(&std::fs::read(path).unwrap())
}

pub fn from_bytes(bytes: &[u8]) -> Glb {
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!(&bytes[..4], b"glTF");
    assert_eq!(word(8), bytes.len());
    let json: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    let bin = &bytes[20 + word(12) + 8..];
    let views: Vec<Vec<u8>> = json["bufferViews"].as_array().unwrap().iter().map(|v| view(v, bin)).collect();
    let origin = numbers(&json["asset"]["extras"]["origin"]);
    let nodes = json["nodes"].as_array().unwrap();
    let mut glb =
        Glb { json: json.clone(), positions: vec![], normals: vec![], triangles: vec![], stored: 0 };
    let mut known: HashMap<[u32; 3], usize> = HashMap::new();
    for node in nodes.iter().filter(|n| n["mesh"].is_u64()) {
        let primitive = &json["meshes"][node["mesh"].as_u64().unwrap() as usize]["primitives"][0];
        let accessor = |n: &Value| Accessor::new(&json, &views, n.as_u64().unwrap() as usize);
        let positions = accessor(&primitive["attributes"]["POSITION"]);
        let normals = accessor(&primitive["attributes"]["NORMAL"]);
        let scale = node.get("scale").map_or([1.0; 3], numbers);
        let shift = node.get("translation").map_or([0.0; 3], numbers);
        let mut here = Vec::new();
        for k in 0..positions.count {
            let p = positions.triple(k);
            // In 32-bit floats, as a viewer does it; and nothing may be lost by that.
            let single = [0, 1, 2].map(|a| p[a] as f32 * scale[a] as f32 + shift[a] as f32);
            let double = [0, 1, 2].map(|a| p[a] * scale[a] + shift[a]);
            assert_eq!(single.map(f64::from), double, "vertex {k} is not exact in 32-bit floats");
            glb.stored += 1;
            here.push(*known.entry(single.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
                // glTF axes: x east, y up, z south.
                glb.positions.push([origin[0] + double[0], origin[1] - double[2], origin[2] + double[1]]);
                let n = normals.triple(k);
                glb.normals.push([n[0], -n[2], n[1]]);
                glb.positions.len() - 1
            }));
        }
        let indices = accessor(&primitive["indices"]);
        let corner = |k: usize| here[indices.number(k, 0) as usize];
        if primitive["mode"] == 5 {
            let strip: Vec<usize> = (0..indices.count).map(corner).collect();
            // Every second triangle of a strip runs the other way; one with a corner twice is none.
            let turned =
                |(k, t): (usize, &[usize])| if k % 2 == 0 { [t[0], t[1], t[2]] } else { [t[1], t[0], t[2]] };
            let all = strip.windows(3).enumerate().map(turned);
            glb.triangles.extend(all.filter(|t| t[0] != t[1] && t[1] != t[2] && t[0] != t[2]));
            continue;
        }
        glb.triangles
            .extend((0..indices.count / 3).map(|k| [corner(3 * k), corner(3 * k + 1), corner(3 * k + 2)]));
    }
    glb
}

fn numbers(v: &Value) -> [f64; 3] {
    [0, 1, 2].map(|k| v[k].as_f64().unwrap())
}

fn number(v: &Value) -> usize {
    v.as_u64().unwrap_or(0) as usize
}

/// The bytes of a view, decompressed if they are compressed.
fn view(v: &Value, bin: &[u8]) -> Vec<u8> {
    let packed = &v["extensions"]["EXT_meshopt_compression"];
    let part = |v: &Value| bin[number(&v["byteOffset"])..][..number(&v["byteLength"])].to_vec();
    if packed.is_null() {
        assert_eq!(v["buffer"], 0);
        return part(v);
    }
    let bytes = decompressed(packed, &part(packed));
    assert_eq!(bytes.len(), number(&v["byteLength"]));
    bytes
}

#[cfg(feature = "meshopt")]
fn decompressed(packed: &Value, bytes: &[u8]) -> Vec<u8> {
    let (count, stride) = (number(&packed["count"]), number(&packed["byteStride"]));
    fn attributes<const N: usize>(bytes: &[u8], count: usize) -> Vec<u8>
    where
        [u8; N]: Default,
    {
        let found: Vec<[u8; N]> = meshopt::decode_vertex_buffer(bytes, count).unwrap();
        found.into_flattened()
    }
    match (packed["mode"].as_str().unwrap(), stride) {
        ("ATTRIBUTES", 4) => attributes::<4>(bytes, count),
        ("ATTRIBUTES", 8) => attributes::<8>(bytes, count),
        ("ATTRIBUTES", 12) => attributes::<12>(bytes, count),
        ("TRIANGLES", 2) => {
            let found: Vec<u16> = meshopt::decode_index_buffer(bytes, count).unwrap();
            found.iter().flat_map(|v| v.to_le_bytes()).collect()
        }
        ("TRIANGLES", 4) => {
            let found: Vec<u32> = meshopt::decode_index_buffer(bytes, count).unwrap();
            found.iter().flat_map(|v| v.to_le_bytes()).collect()
        }
        other => panic!("{other:?}"),
    }
}

#[cfg(not(feature = "meshopt"))]
fn decompressed(packed: &Value, _: &[u8]) -> Vec<u8> {
    panic!("compressed by a build without meshopt: {packed}")
}

struct Accessor<'a> {
    bytes: &'a [u8],
    stride: usize,
    kind: u64,
    normalized: bool,
    count: usize,
}

impl<'a> Accessor<'a> {
    fn new(json: &Value, views: &'a [Vec<u8>], n: usize) -> Accessor<'a> {
        let a = &json["accessors"][n];
        let view = number(&a["bufferView"]);
        let kind = a["componentType"].as_u64().unwrap();
        let size = match kind {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let parts = if a["type"] == "SCALAR" { 1 } else { 3 };
        let stride = json["bufferViews"][view]["byteStride"].as_u64().map_or(parts * size, |s| s as usize);
        assert!(parts == 1 || stride.is_multiple_of(4), "elements must begin at multiples of 4 bytes");
        Accessor {
            bytes: &views[view][number(&a["byteOffset"])..],
            stride,
            kind,
            normalized: a["normalized"] == true,
            count: number(&a["count"]),
        }
    }

    fn number(&self, k: usize, part: usize) -> f64 {
        let at = &self.bytes[k * self.stride..];
        let word = |size: usize| -> [u8; 4] {
            let mut w = [0; 4];
            w[..size].copy_from_slice(&at[part * size..(part + 1) * size]);
            w
        };
        let whole = match self.kind {
            5120 => f64::from(word(1)[0] as i8),
            5123 => f64::from(u32::from_le_bytes(word(2))),
            5125 => f64::from(u32::from_le_bytes(word(4))),
            5126 => f64::from(f32::from_le_bytes(word(4))),
            other => panic!("component type {other}"),
        };
        if self.normalized { whole / 127.0 } else { whole }
    }

    fn triple(&self, k: usize) -> [f64; 3] {
        [0, 1, 2].map(|part| self.number(k, part))
    }
}
