//! GLB and glTF: round trips, whole numbers, nodes, strips, what is refused.

use super::{hostile, refusal, tetrahedron};
use serde_json::{Map, Value, json};
use terraquilt::format::gltf::write_solid_glb;
use terraquilt::format::solid::{parse_solid, read_solid};
use terraquilt_codecs::solid::Mesh;

fn written(mesh: &Mesh) -> Vec<u8> {
    let mut out = Vec::new();
    write_solid_glb(&mut out, mesh, &Map::new()).unwrap();
    out
}

fn read(bytes: &[u8]) -> Mesh {
    parse_solid("a.glb", bytes).unwrap()
}

/// A GLB of a document and a binary chunk.
fn glb(document: &Value, bin: &[u8]) -> Vec<u8> {
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut out = b"glTF\x02\0\0\0".to_vec();
    let word = |n: usize| (n as u32).to_le_bytes();
    out.extend(word(12 + 8 + text.len() + 8 + bin.len()));
    out.extend([word(text.len()), *b"JSON"].concat());
    out.extend(text);
    out.extend([word(bin.len()), *b"BIN\0"].concat());
    out.extend(bin);
    out
}

/// A document whose one mesh has 16-bit positions, 8 bytes apart, and 8-bit indices.
fn quantised() -> (Value, Vec<u8>) {
    let mesh = tetrahedron();
    let mut bin = Vec::new();
    for p in &mesh.positions {
        p.iter().for_each(|v| bin.extend((*v as u16 * 1000).to_le_bytes()));
        bin.extend([0; 2]);
    }
    bin.extend(mesh.triangles.iter().flatten().map(|v| *v as u8));
    let document = json!({
        "asset": { "version": "2.0" },
        "extensionsRequired": ["KHR_mesh_quantization"],
        "scene": 0,
        "scenes": [{ "nodes": [1] }],
        "nodes": [
            { "mesh": 0, "scale": [0.001, 0.001, 0.001], "translation": [5.0, 0.0, 0.0] },
            { "children": [0], "rotation": [0.0, 0.0, std::f64::consts::FRAC_1_SQRT_2, std::f64::consts::FRAC_1_SQRT_2] },
            { "mesh": 0 },
        ],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }],
        "accessors": [
            { "bufferView": 0, "componentType": 5123, "type": "VEC3", "count": 4 },
            { "bufferView": 1, "componentType": 5121, "type": "SCALAR", "count": 12 },
        ],
        "bufferViews": [
            { "buffer": 0, "byteLength": 32, "byteStride": 8 },
            { "buffer": 0, "byteOffset": 32, "byteLength": 12 },
        ],
        "buffers": [{ "byteLength": 44 }],
    });
    (document, bin)
}

fn near(mesh: &Mesh, wanted: &[[f64; 3]]) {
    assert_eq!(mesh.positions.len(), wanted.len());
    for (p, w) in mesh.positions.iter().zip(wanted) {
        assert!((0..3).all(|k| (p[k] - w[k]).abs() < 1e-9), "{p:?}, not {w:?}");
    }
}

#[test]
fn what_is_written_is_read() {
    let mesh = tetrahedron();
    assert_eq!(read(&written(&mesh)), mesh);
    assert_eq!(written(&mesh), written(&mesh));
    // Beyond 16-bit indices, and far from zero.
    let side = 300;
    let at = |k: u32| [f64::from(k % side) + 5e6, f64::from(k / side) - 3e7, f64::from(k % 7) / 8.0];
    let corners = (0..side * (side - 1)).filter(|k| k % side + 1 < side);
    let great = Mesh {
        positions: (0..side * side).map(at).collect(),
        triangles: corners.flat_map(|k| [[k, k + 1, k + side], [k + 1, k + side + 1, k + side]]).collect(),
    };
    let found = read(&written(&great));
    assert_eq!(found, great);
    let none = written(&Mesh::default());
    assert_eq!(read(&none), Mesh::default());
    let mut broken = mesh.clone();
    broken.triangles[0][0] = 4;
    assert!(write_solid_glb(&mut Vec::new(), &broken, &Map::new()).is_err());
    broken = mesh;
    broken.positions[0][0] = 1e39;
    assert!(write_solid_glb(&mut Vec::new(), &broken, &Map::new()).is_err());
}

/// Normals have length 1, the least and greatest position are those that are written, parts begin at multiples of 4 bytes.
#[test]
fn the_file_is_as_the_standard_says() {
    let mut mesh = tetrahedron();
    mesh.positions.push([9.0; 3]);
    let mut bytes = Vec::new();
    let extras = json!({ "voxel": 0.25 });
    write_solid_glb(&mut bytes, &mesh, extras.as_object().unwrap()).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    assert_eq!((word(8), word(12) % 4, bytes.len() % 4), (bytes.len(), 0, 0));
    let document: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    assert_eq!(document["asset"]["extras"]["voxel"], json!(0.25));
    assert_eq!(document["accessors"][0]["max"], json!([9.0, 9.0, 9.0]));
    let bin = &bytes[28 + word(12)..];
    assert_eq!(document["buffers"][0]["byteLength"], json!(bin.len()));
    let normals = &bin[60..120];
    for n in normals.chunks(12) {
        let square: f32 = n.chunks(4).map(|v| f32::from_le_bytes(v.try_into().unwrap()).powi(2)).sum();
        assert!((square - 1.0).abs() < 1e-6);
    }
}

#[test]
fn whole_numbers_and_nodes() {
    let (document, bin) = quantised();
    let mesh = read(&glb(&document, &bin));
    // Moved by 5 along x, then turned by a quarter about z: x to y, y to -x.
    near(&mesh, &[[0.0, 5.0, 0.0], [0.0, 6.0, 0.0], [-2.0, 5.0, 0.0], [0.0, 5.0, 4.0]]);
    assert_eq!(mesh.triangles, tetrahedron().triangles);
    let with = |change: &dyn Fn(&mut Value)| {
        let mut document = document.clone();
        change(&mut document);
        read(&glb(&document, &bin))
    };
    // A mirror turns triangles over: they still face outwards.
    let mirrored = with(&|d| d["nodes"][0]["scale"] = json!([-0.001, 0.001, 0.001]));
    assert!(mirrored.volume() > 1.0);
    // A matrix, column by column; normalised numbers.
    let matrix = with(&|d| {
        d["nodes"][0] =
            json!({ "mesh": 0, "matrix": [65.535, 0, 0, 0, 0, 65.535, 0, 0, 0, 0, 65.535, 0, 7, 8, 9, 1] });
        d["accessors"][0]["normalized"] = json!(true);
        d["scenes"][0]["nodes"] = json!([0]);
    });
    near(&matrix, &[[7.0, 8.0, 9.0], [8.0, 8.0, 9.0], [7.0, 10.0, 9.0], [7.0, 8.0, 13.0]]);
    // Without scenes: all that hang on nothing. Twice the same mesh is twice its triangles.
    let all = with(&|d| {
        d.as_object_mut().unwrap().remove("scene");
        d.as_object_mut().unwrap().remove("scenes");
    });
    assert_eq!((all.positions.len(), all.triangles.len()), (8, 8));
    assert_eq!(all.positions[7], [0.0, 0.0, 4000.0]);
}

#[test]
fn strips_and_fans() {
    let (document, bin) = quantised();
    let with = |mode: u32| {
        let mut document = document.clone();
        document["meshes"][0]["primitives"] = json!([{ "attributes": { "POSITION": 0 }, "mode": mode }]);
        read(&glb(&document, &bin)).triangles
    };
    assert_eq!(with(5), [[0, 1, 2], [2, 1, 3]]);
    assert_eq!(with(6), [[0, 1, 2], [0, 2, 3]]);
    assert_eq!(with(4), [[0, 1, 2]]);
    assert!(with(1).is_empty());
}

#[test]
fn buffers_in_the_document_and_beside_it() {
    use base64::Engine;
    let (mut document, bin) = quantised();
    let data = base64::engine::general_purpose::STANDARD.encode(&bin);
    document["buffers"][0]["uri"] = json!(format!("data:application/octet-stream;base64,{data}"));
    let wanted = read(document.to_string().as_bytes());
    assert_eq!(wanted.triangles.len(), 4);
    document["buffers"][0]["uri"] = json!("part.bin");
    assert!(refusal(document.to_string().as_bytes()).contains("part.bin"));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.gltf");
    std::fs::write(&path, document.to_string()).unwrap();
    assert!(read_solid(&path).unwrap_err().to_string().contains("part.bin not found"));
    std::fs::write(folder.path().join("part.bin"), &bin).unwrap();
    assert_eq!(read_solid(&path).unwrap(), wanted);
    for outside in ["../part.bin", "/part.bin", "file:part.bin", "a\\part.bin", "%2e%2e", ""] {
        document["buffers"][0]["uri"] = json!(outside);
        assert!(refusal(document.to_string().as_bytes()).contains("write it as GLB"));
    }
}

#[test]
fn what_is_wrong_is_refused() {
    let (document, bin) = quantised();
    let said = |place: &str, value: Value| {
        let mut document = document.clone();
        *document.pointer_mut(place).unwrap() = value;
        refusal(&glb(&document, &bin))
    };
    let holds = |said: String, words: &str| assert!(said.contains(words), "{said}: {words}");
    holds(said("/extensionsRequired/0", json!("EXT_meshopt_compression")), "no compression");
    holds(said("/extensionsRequired/0", json!("KHR_draco_mesh_compression")), "no compression");
    holds(said("/scene", json!(9)), "scene 9");
    holds(said("/scenes/0/nodes", json!([7])), "node 7");
    holds(said("/scenes/0/nodes", json!([0, 1])), "two parents");
    holds(said("/nodes/1/children", json!([1])), "two parents");
    holds(said("/nodes/0/mesh", json!(3)), "mesh 3");
    holds(said("/accessors/0/count", json!(5)), "accessor 0");
    holds(said("/accessors/0/count", json!(u64::MAX)), "accessor 0");
    holds(said("/accessors/0/type", json!("VEC4")), "VEC4");
    holds(said("/accessors/0/componentType", json!(9)), "component type 9");
    holds(said("/accessors/1/componentType", json!(5120)), "no whole numbers");
    holds(said("/accessors/1/bufferView", Value::Null), "sparse");
    holds(said("/bufferViews/0/byteStride", json!(0)), "0 bytes apart");
    holds(said("/bufferViews/0/byteLength", json!(u64::MAX)), "buffer view 0");
    holds(said("/bufferViews/0/buffer", json!(1)), "buffer 1");
    holds(said("/buffers/0/byteLength", json!(45)), "45 bytes, 44 are there");
    holds(said("/meshes/0/primitives/0/indices", json!(0)), "VEC3");
    let mut wild = bin.clone();
    wild[40] = 4;
    holds(refusal(&glb(&document, &wild)), "vertex 4, there are 4");
    holds(refusal(b"glTF\x01\0\0\0\x0c\0\0\0"), "version 1");
    holds(refusal(b"glTF\x02\0\0\0\xff\0\0\0"), "255 bytes");
    holds(refusal(b"{"), "glTF document");
    // Many nodes of one mesh are many triangles: limited before they are made.
    let mut many = document.clone();
    many["accessors"][1] =
        json!({ "bufferView": 2, "componentType": 5121, "type": "SCALAR", "count": 3_000_000 });
    many["bufferViews"].as_array_mut().unwrap().push(json!({ "buffer": 1, "byteLength": 3_000_000 }));
    use base64::Engine;
    let zeros = base64::engine::general_purpose::STANDARD.encode(vec![0; 3_000_000]);
    many["buffers"]
        .as_array_mut()
        .unwrap()
        .push(json!({ "byteLength": 3_000_000, "uri": format!("data:;base64,{zeros}") }));
    many["nodes"] = json!(vec![json!({ "mesh": 0 }); 10]);
    many["scenes"][0]["nodes"] = json!((0..10).collect::<Vec<_>>());
    holds(refusal(&glb(&many, &bin)), "triangles of a mesh: 9000000 wanted, at most 8388608 allowed");
}

#[test]
fn damage_is_harmless() {
    let (document, bin) = quantised();
    hostile(&glb(&document, &bin), 4);
    hostile(&written(&tetrahedron()), 5);
}
