//! Triangles out of GLB and glTF 2.0: those of the scene, where its nodes put them, in glTF's axes.
//!
//! Positions are 32-bit floats, or whole numbers of 8 or 16 bits (KHR_mesh_quantization); their node has the scale. Triangles, strips and fans are
//! read; points, lines, and everything about colour are passed over. The document is other people's: every index and every length in it is looked up
//! before it is used, which is why no library reads it.

use super::affine::Affine;
use super::document::{Accessor, Document, Primitive};
use crate::base::bytes::Reader;
use crate::base::{Error, Result, limits};
use base64::Engine;
use std::borrow::Cow;
use terraquilt_codecs::solid::Mesh;
use terraquilt_codecs::solid::mesh::{POSITIONS_MAX, TRIANGLES_MAX};

/// Reads a file beside the document, by its name.
pub(in crate::format) type Beside<'a> = dyn Fn(&str) -> Result<Vec<u8>> + 'a;

const CHUNK_JSON: u32 = 0x4e4f_534a;
const CHUNK_BIN: u32 = 0x004e_4942;
/// Bytes of the document, at most: the numbers are elsewhere.
const DOCUMENT_BYTES_MAX: usize = 64 << 20;
/// Required extensions that say nothing about where triangles are.
const HARMLESS: [&str; 8] = [
    "KHR_mesh_quantization",
    "KHR_materials_",
    "KHR_texture_",
    "KHR_lights_",
    "KHR_xmp",
    "EXT_texture_",
    "EXT_lights_",
    "MSFT_texture_",
];

/// Reads the triangles of a GLB or of a glTF document.
///
/// # Errors
/// [`Error::Corrupt`] for damage; [`Error::Unsupported`] for compressed meshes and sparse accessors; [`Error::Limit`] beyond what a mesh may have.
pub(in crate::format) fn read_triangles(file: &str, bytes: &[u8], beside: &Beside) -> Result<Mesh> {
    let (document, bin) = if bytes.starts_with(b"glTF") { chunks(file, bytes)? } else { (bytes, None) };
    if document.len() > DOCUMENT_BYTES_MAX {
        let (most, wanted) = (DOCUMENT_BYTES_MAX as u64, document.len() as u64);
        return Err(Error::limit(format!("bytes of the document of {file}"), most, wanted));
    }
    let document: Document =
        serde_json::from_slice(document).map_err(|e| Error::corrupt(file, "glTF document", e))?;
    let known = |name: &&String| !HARMLESS.iter().any(|h| name.starts_with(h));
    if let Some(name) = document.extensions_required.iter().find(known) {
        return Err(Error::unsupported(
            file,
            format!("the glTF extension {name} is required"),
            "write it without (no compression)",
        ));
    }
    let mut source = Source { file, document: &document, bin, beside, buffers: Vec::new() };
    source.load()?;
    source.scene()
}

/// The document and the binary chunk of a GLB.
fn chunks<'a>(file: &'a str, bytes: &'a [u8]) -> Result<(&'a [u8], Option<&'a [u8]>)> {
    let mut head = Reader::new(bytes, file, "GLB header");
    head.u32()?;
    let version = head.u32()?;
    if version != 2 {
        return Err(Error::unsupported(file, format!("GLB of version {version}"), "write it as version 2"));
    }
    let length = head.u32()? as usize;
    if length > bytes.len() || length < 12 {
        return Err(head.bad(format!("it says {length} bytes, the file has {}", bytes.len())));
    }
    let mut reader = Reader::new(&bytes[12..length], file, "GLB chunk");
    let (mut document, mut bin) = (None, None);
    while reader.remaining() > 0 {
        let (length, kind) = (reader.u32()? as usize, reader.u32()?);
        let chunk = reader.take(length)?;
        match kind {
            CHUNK_JSON if document.is_none() => document = Some(chunk),
            CHUNK_BIN if bin.is_none() => bin = Some(chunk),
            _ => {}
        }
    }
    let document = document.ok_or_else(|| Error::corrupt(file, "GLB", "it has no document (JSON chunk)"))?;
    Ok((document, bin))
}

struct Source<'a> {
    file: &'a str,
    document: &'a Document,
    bin: Option<&'a [u8]>,
    beside: &'a Beside<'a>,
    buffers: Vec<Cow<'a, [u8]>>,
}

impl<'a> Source<'a> {
    fn bad(&self, place: impl ToString, reason: impl ToString) -> Error {
        Error::corrupt(self.file, place, reason)
    }

    /// One of a list of the document.
    fn get<'b, T>(&self, list: &'b [T], what: &str, index: usize) -> Result<&'b T> {
        let none = || self.bad(format!("{what} {index}"), format!("there are {}", list.len()));
        list.get(index).ok_or_else(none)
    }

    /// Finds the bytes of all buffers.
    fn load(&mut self) -> Result<()> {
        let mut left = limits::MESH_FILE_BYTES_MAX;
        for (k, buffer) in self.document.buffers.iter().enumerate() {
            let found: Cow<[u8]> = match &buffer.uri {
                None => Cow::Borrowed(self.bin.filter(|_| k == 0).unwrap_or_default()),
                Some(uri) => Cow::Owned(self.named_bytes(k, uri)?),
            };
            let has = found.len() as u64;
            // A buffer without bytes is the fallback of a compressed one; a view of it is refused.
            if has < buffer.byte_length && has > 0 {
                let reason = format!("it says {} bytes, {has} are there", buffer.byte_length);
                return Err(self.bad(format!("buffer {k}"), reason));
            }
            left = left.checked_sub(has).ok_or_else(|| {
                Error::limit(
                    format!("bytes of the buffers of {}", self.file),
                    limits::MESH_FILE_BYTES_MAX,
                    has,
                )
            })?;
            self.buffers.push(found);
        }
        Ok(())
    }

    fn named_bytes(&self, k: usize, uri: &str) -> Result<Vec<u8>> {
        if let Some(data) = uri.strip_prefix("data:") {
            let place = || format!("buffer {k}");
            let (_, text) =
                data.split_once(";base64,").ok_or_else(|| self.bad(place(), "its data is not base64"))?;
            return base64::engine::general_purpose::STANDARD.decode(text).map_err(|e| self.bad(place(), e));
        }
        if uri.is_empty() || uri.contains(['/', '\\', ':', '%']) || uri.starts_with('.') {
            let what = format!("buffer {k} is '{}'", super::super::geotiff::shorten(uri));
            return Err(Error::unsupported(
                self.file,
                what,
                "write it as GLB, or with its buffers in the same folder",
            ));
        }
        (self.beside)(uri)
    }

    /// The triangles of the scene: the one that is shown first, or all nodes if there is none.
    fn scene(&self) -> Result<Mesh> {
        let document = self.document;
        let mut open: Vec<(usize, Affine)> =
            match document.scene.or((!document.scenes.is_empty()).then_some(0)) {
                Some(k) => {
                    let scene = self.get(&document.scenes, "scene", k)?;
                    scene.nodes.iter().rev().map(|n| (*n, Affine::NONE)).collect()
                }
                None => {
                    let mut root = vec![true; document.nodes.len()];
                    for child in document.nodes.iter().flat_map(|n| &n.children) {
                        *root
                            .get_mut(*child)
                            .ok_or_else(|| self.bad("nodes", format!("no node {child}")))? = false;
                    }
                    let roots = (0..root.len()).rev().filter(|k| root[*k]);
                    roots.map(|k| (k, Affine::NONE)).collect()
                }
            };
        let mut seen = vec![false; document.nodes.len()];
        let mut mesh = Mesh::default();
        while let Some((k, outer)) = open.pop() {
            let node = self.get(&document.nodes, "node", k)?;
            if std::mem::replace(&mut seen[k], true) {
                return Err(self.bad(format!("node {k}"), "it has two parents"));
            }
            let place = outer.after(&Affine::of(node));
            if let Some(m) = node.mesh {
                for (n, primitive) in self.get(&document.meshes, "mesh", m)?.primitives.iter().enumerate() {
                    self.primitive(&format!("mesh {m}, primitive {n}"), primitive, &place, &mut mesh)?;
                }
            }
            open.extend(node.children.iter().rev().map(|c| (*c, place)));
        }
        Ok(mesh)
    }

    fn primitive(&self, name: &str, primitive: &Primitive, place: &Affine, mesh: &mut Mesh) -> Result<()> {
        let mode = primitive.mode.unwrap_or(super::TRIANGLES);
        if !(super::TRIANGLES..=6).contains(&mode) {
            return Ok(());
        }
        let Some(position) = primitive.attributes.position else { return Ok(()) };
        let positions = Numbers::new(self, position, "VEC3")?;
        let indices = primitive.indices.map(|k| Numbers::new(self, k, "SCALAR")).transpose()?;
        if indices.as_ref().is_some_and(|i| i.is_signed_or_float()) {
            return Err(self.bad(name, "its indices are no whole numbers"));
        }
        let before = mesh.positions.len();
        let limited = |what: &str, most: usize, wanted: u64| {
            if wanted > most as u64 { Err(Error::limit(what, most as u64, wanted)) } else { Ok(()) }
        };
        limited("positions of a mesh", POSITIONS_MAX, before as u64 + positions.count)?;
        let corners = indices.as_ref().map_or(positions.count, |i| i.count);
        let count = if mode == super::TRIANGLES { corners / 3 } else { corners.saturating_sub(2) };
        limited("triangles of a mesh", TRIANGLES_MAX, mesh.triangles.len() as u64 + count)?;
        for k in 0..positions.count {
            mesh.positions.push(place.apply([0, 1, 2].map(|axis| positions.number(k, axis))));
        }
        let corner = |k: u64| {
            let index = indices.as_ref().map_or(k, |i| i.number(k, 0) as u64);
            if index < positions.count {
                return Ok((before as u64 + index) as u32);
            }
            let reason = format!("index {k} is vertex {index}, there are {}", positions.count);
            Err(self.bad(name, reason))
        };
        let mirrors = place.mirrors();
        for k in 0..count {
            let [a, b, c] = match mode {
                super::TRIANGLES => [3 * k, 3 * k + 1, 3 * k + 2],
                // Every second triangle of a strip runs the other way.
                5 if k % 2 == 1 => [k + 1, k, k + 2],
                5 => [k, k + 1, k + 2],
                _ => [0, k + 1, k + 2],
            };
            let [a, b, c] = [corner(a)?, corner(b)?, corner(c)?];
            mesh.triangles.push(if mirrors { [a, c, b] } else { [a, b, c] });
        }
        Ok(())
    }
}

/// The numbers of an accessor.
struct Numbers<'a> {
    bytes: &'a [u8],
    stride: usize,
    count: u64,
    component: u32,
    normalized: bool,
}

impl<'a> Numbers<'a> {
    fn new(source: &'a Source, index: usize, shape: &str) -> Result<Numbers<'a>> {
        let place = || format!("accessor {index}");
        let a: &Accessor = source.get(&source.document.accessors, "accessor", index)?;
        if a.shape != shape {
            let found = super::super::geotiff::shorten(&a.shape);
            return Err(source.bad(place(), format!("it is {found}, {shape} is needed")));
        }
        let Some(view) = a.buffer_view.filter(|_| a.sparse.is_none()) else {
            let what = format!("accessor {index} is sparse or has no view");
            return Err(Error::unsupported(source.file, what, "write it without sparse accessors"));
        };
        let width = match a.component_type {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            other => return Err(source.bad(place(), format!("component type {other} is not known"))),
        };
        let element = width * if shape == "VEC3" { 3 } else { 1 };
        let v = source.get(&source.document.buffer_views, "buffer view", view)?;
        let buffer = source.get(&source.buffers, "buffer", v.buffer)?;
        let stride = v.byte_stride.unwrap_or(element);
        let range = |from: u64, length: u64, whole: usize| {
            let end = from.checked_add(length).filter(|end| *end <= whole as u64);
            end.map(|end| from as usize..end as usize)
        };
        let outside = |what: &str, has: usize| {
            source.bad(what, format!("it reaches beyond the {has} bytes that are there"))
        };
        let bytes = &buffer[range(v.byte_offset, v.byte_length, buffer.len())
            .ok_or_else(|| outside(&format!("buffer view {view}"), buffer.len()))?];
        let span = match a.count {
            0 => Some(0),
            n => (n - 1).checked_mul(stride).and_then(|s| s.checked_add(element)),
        };
        let part = span.and_then(|span| range(a.byte_offset, span, bytes.len()));
        let bytes = &bytes[part.ok_or_else(|| outside(&place(), bytes.len()))?];
        // Elements that overlap would make much of few bytes.
        if stride < element {
            return Err(
                source.bad(place(), format!("its elements of {element} bytes are {stride} bytes apart"))
            );
        }
        Ok(Numbers {
            bytes,
            stride: stride as usize,
            count: a.count,
            component: a.component_type,
            normalized: a.normalized,
        })
    }

    fn is_signed_or_float(&self) -> bool {
        !matches!(self.component, 5121 | 5123 | 5125)
    }

    /// Component `n` of element `k`.
    fn number(&self, k: u64, n: usize) -> f64 {
        let at = k as usize * self.stride;
        let byte = |b: usize| self.bytes[at + b];
        let two = [0, 1].map(|b| 2 * n + b);
        let four = [0, 1, 2, 3].map(|b| 4 * n + b);
        let scaled = |value: f64, most: f64| if self.normalized { (value / most).max(-1.0) } else { value };
        match self.component {
            5120 => scaled(f64::from(byte(n) as i8), 127.0),
            5121 => scaled(f64::from(byte(n)), 255.0),
            5122 => scaled(f64::from(i16::from_le_bytes(two.map(byte))), 32767.0),
            5123 => scaled(f64::from(u16::from_le_bytes(two.map(byte))), 65535.0),
            5125 => f64::from(u32::from_le_bytes(four.map(byte))),
            _ => f64::from(f32::from_le_bytes(four.map(byte))),
        }
    }
}
