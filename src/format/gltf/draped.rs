//! A mesh with a picture on it, as triangles or as one strip.

use super::container::Sink;
use super::{
    ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER, FLOAT, GlbMesh, TRIANGLES, UNSIGNED_INT, asset, check, materials,
    to_gltf,
};
use crate::base::{Error, Result};
use serde_json::{Value, json};
use std::io::Write;

const TRIANGLE_STRIP: u32 = 5;
const LINEAR: u32 = 9729;
const LINEAR_MIPMAP_LINEAR: u32 = 9987;
const CLAMP_TO_EDGE: u32 = 33071;

/// What lies on a mesh, and how its triangles are written.
#[derive(Clone, Copy, Debug, Default)]
pub struct Drape<'a> {
    /// The picture; `None`: the neutral colour.
    pub picture: Option<DrapePicture<'a>>,
    /// One strip in place of the mesh's triangles: a post that is there twice in three makes none.
    pub strip: Option<&'a [u32]>,
}

/// A picture (sRGB), embedded as PNG.
#[derive(Clone, Copy, Debug)]
pub struct DrapePicture<'a> {
    /// Pixels in a row.
    pub cols: usize,
    /// `cols` times rows pixels, the first row on top.
    pub rgb: &'a [[u8; 3]],
    /// One a position: 0, 0 is the upper left corner of the picture, 1, 1 the lower right one.
    pub uv: &'a [[f32; 2]],
}

/// Writes a mesh with a picture as GLB: one node, one primitive, a matt material. The same input gives the same bytes. A mesh
/// without triangles gives a valid file without a scene.
///
/// # Errors
/// As [`write_glb`](super::write_glb()); [`Error::Invalid`] if the picture does not fit the mesh.
pub fn write_draped_glb(out: &mut dyn Write, mesh: &GlbMesh, drape: &Drape) -> Result<()> {
    check(mesh)?;
    let count = mesh.positions.len();
    let invalid = |reason: &str| Err(Error::invalid("GLB mesh", reason));
    if drape.strip.is_some_and(|s| s.iter().any(|v| *v as usize >= count)) {
        return invalid("an index of the strip is out of range");
    }
    let png = match drape.picture {
        Some(p) if p.uv.len() != count || p.uv.iter().flatten().any(|v| !v.is_finite()) => {
            return invalid("places on the picture must be numbers, one a position");
        }
        Some(p) if p.cols == 0 || p.rgb.is_empty() || !p.rgb.len().is_multiple_of(p.cols) => {
            return invalid("the picture has no whole rows of pixels");
        }
        Some(p) => encode(&p)?,
        None => Vec::new(),
    };
    let indices = drape.strip.unwrap_or(mesh.triangles.as_flattened());
    if indices.is_empty() {
        return Sink::begin(out, &json!({ "asset": origin(mesh) }), 0)?.flush();
    }
    let (document, bytes) = document(mesh, drape, indices, png.len());
    let mut sink = Sink::begin(out, &document, bytes)?;
    for p in mesh.positions {
        sink.floats(to_gltf(p.map(|v| v as f32)))?;
    }
    for n in mesh.normals {
        sink.floats(to_gltf(*n))?;
    }
    for v in drape.picture.iter().flat_map(|p| p.uv).flatten() {
        sink.bytes(&v.to_le_bytes())?;
    }
    sink.u32s(indices)?;
    sink.bytes(&png)?;
    sink.bytes(&[0; 3][..png.len().next_multiple_of(4) - png.len()])?;
    sink.flush()
}

/// What is known of the mesh; version 0 is none of a database and is left out.
fn origin(mesh: &GlbMesh) -> Value {
    let mut asset = asset(mesh, mesh.error_m);
    if let Some(extras) = asset["extras"].as_object_mut().filter(|_| mesh.version == 0) {
        extras.remove("version");
    }
    asset
}

fn encode(p: &DrapePicture) -> Result<Vec<u8>> {
    let mut out = Vec::new();
    let mut encoder = png::Encoder::new(&mut out, p.cols as u32, (p.rgb.len() / p.cols) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual);
    let written = encoder.write_header().and_then(|mut w| {
        w.write_image_data(p.rgb.as_flattened())?;
        w.finish()
    });
    written.map_err(|e| Error::invalid("picture of the GLB", e))?;
    Ok(out)
}

/// The JSON, and the bytes of the binary chunk: positions, normals, places on the picture, indices, picture.
fn document(mesh: &GlbMesh, drape: &Drape, indices: &[u32], png: usize) -> (Value, u64) {
    let count = mesh.positions.len();
    let (mut views, mut at) = (Vec::new(), 0u64);
    let mut view = |bytes: usize, target: Option<u32>| {
        let mut v = json!({ "buffer": 0, "byteOffset": at, "byteLength": bytes });
        if let Some(target) = target {
            v["target"] = json!(target);
        }
        at += bytes.next_multiple_of(4) as u64;
        views.push(v);
        views.len() - 1
    };
    let accessor = |view: usize, component: u32, kind: &str, count: usize| json!({ "bufferView": view, "componentType": component, "type": kind, "count": count });
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in mesh.positions {
        let p = to_gltf(p.map(|v| v as f32));
        for k in 0..3 {
            min[k] = min[k].min(p[k]);
            max[k] = max[k].max(p[k]);
        }
    }
    let mut accessors = vec![
        accessor(view(12 * count, Some(ARRAY_BUFFER)), FLOAT, "VEC3", count),
        accessor(view(12 * count, Some(ARRAY_BUFFER)), FLOAT, "VEC3", count),
    ];
    accessors[0]["min"] = json!(min.map(f64::from));
    accessors[0]["max"] = json!(max.map(f64::from));
    let mut attributes = json!({ "POSITION": 0, "NORMAL": 1 });
    if drape.picture.is_some() {
        attributes["TEXCOORD_0"] = json!(accessors.len());
        accessors.push(accessor(view(8 * count, Some(ARRAY_BUFFER)), FLOAT, "VEC2", count));
    }
    let place = accessors.len();
    let of_indices = view(4 * indices.len(), Some(ELEMENT_ARRAY_BUFFER));
    accessors.push(accessor(of_indices, UNSIGNED_INT, "SCALAR", indices.len()));
    let mode = if drape.strip.is_some() { TRIANGLE_STRIP } else { TRIANGLES };
    let mut document = json!({
        "asset": origin(mesh),
        "scene": 0,
        "scenes": [{ "nodes": [0] }],
        "nodes": [{ "mesh": 0, "name": "terrain" }],
        "meshes": [{
            "name": "terrain",
            "primitives": [{ "attributes": attributes, "indices": place, "material": 0, "mode": mode }]
        }],
        "materials": materials(mesh),
    });
    if drape.picture.is_some() {
        let material = &mut document["materials"][0]["pbrMetallicRoughness"];
        material["baseColorFactor"] = json!([1.0, 1.0, 1.0, 1.0]);
        material["baseColorTexture"] = json!({ "index": 0 });
        document["textures"] = json!([{ "sampler": 0, "source": 0 }]);
        document["samplers"] = json!([{
            "magFilter": LINEAR, "minFilter": LINEAR_MIPMAP_LINEAR, "wrapS": CLAMP_TO_EDGE, "wrapT": CLAMP_TO_EDGE
        }]);
        document["images"] =
            json!([{ "bufferView": view(png, None), "mimeType": "image/png", "name": "ground" }]);
    }
    document["buffers"] = json!([{ "byteLength": at }]);
    document["bufferViews"] = Value::Array(views);
    document["accessors"] = Value::Array(accessors);
    (document, at)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_and_strips_that_do_not_fit_are_refused() {
        let mesh = GlbMesh {
            positions: &[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            normals: &[[0.0, 0.0, 1.0]; 3],
            triangles: &[[0, 1, 2]],
            colors: None,
            origin: [0.0; 3],
            crs: "",
            error_m: 0.0,
            version: 0,
            extras: Default::default(),
        };
        let good = DrapePicture { cols: 2, rgb: &[[1, 2, 3]; 2], uv: &[[0.0; 2]; 3] };
        let write = |drape: &Drape| write_draped_glb(&mut Vec::new(), &mesh, drape).is_ok();
        assert!(write(&Drape { picture: Some(good), strip: Some(&[0, 1, 2]) }));
        assert!(!write(&Drape { picture: Some(DrapePicture { uv: &[], ..good }), strip: None }));
        assert!(!write(&Drape { picture: Some(DrapePicture { cols: 3, ..good }), strip: None }));
        assert!(!write(&Drape { picture: None, strip: Some(&[0, 1, 3]) }));
    }
}
