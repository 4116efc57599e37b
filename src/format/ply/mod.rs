//! Triangle meshes as PLY (G. Turk, The PLY Polygon File Format, 1994): text, binary little-endian and big-endian.
//!
//! Read are `x`, `y`, `z` of the element `vertex`, and the list `vertex_indices` (or `vertex_index`) of the element `face`; a face of more corners becomes
//! a fan from its first, one of fewer than three bounds nothing. Every other property and element is passed over. Lines of texts end with LF,
//! CR LF or CR.

mod header;
mod rows;
mod write;

pub use write::write_ply;

use self::header::{Element, Header};
use self::rows::Rows;
use crate::base::{Error, Result};
use terraquilt_codecs::solid::Mesh;
use terraquilt_codecs::solid::mesh::{POSITIONS_MAX, TRIANGLES_MAX};

/// Whether a file begins as PLY does.
pub(super) fn begins(head: &[u8]) -> bool {
    head.starts_with(b"ply\n") || head.starts_with(b"ply\r")
}

/// Reads the mesh of a file in memory; `file` is named in errors.
///
/// # Errors
/// [`Error::Corrupt`] with element and row for what is cut, not a number or out of range; [`Error::Unsupported`] for files without faces;
/// [`Error::Limit`] beyond what a mesh may have.
pub fn parse(file: &str, bytes: &[u8]) -> Result<Mesh> {
    let header = Header::read(file, bytes)?;
    let vertex = header.element("vertex").ok_or_else(|| {
        Error::unsupported(
            file,
            "a PLY without the element vertex",
            "write it with vertices x, y, z and faces",
        )
    })?;
    if header.element("face").is_none() {
        let what = "a PLY without the element face: points alone bound no solid";
        return Err(Error::unsupported(file, what, "write its triangles as faces"));
    }
    let positions = vertex.count;
    if positions > POSITIONS_MAX as u64 {
        return Err(Error::limit(format!("vertices of {file}"), POSITIONS_MAX as u64, positions));
    }
    let mut rows = Rows::new(file, &bytes[header.bytes..], header.encoding);
    let mut mesh = Mesh::default();
    for element in &header.elements {
        rows.enter(element)?;
        match element.name.as_str() {
            "vertex" => read_vertices(&mut rows, element, &mut mesh)?,
            "face" => read_faces(&mut rows, element, positions, &mut mesh)?,
            _ => rows.pass_over(element)?,
        }
    }
    Ok(mesh)
}

fn read_vertices(rows: &mut Rows, element: &Element, mesh: &mut Mesh) -> Result<()> {
    let axes = ["x", "y", "z"];
    for axis in axes {
        if !element.properties.iter().any(|p| p.name == axis && p.count.is_none()) {
            return Err(rows.bad(format!("it has no property {axis}; write its vertices with x, y, z")));
        }
    }
    let axis_of: Vec<Option<usize>> = element
        .properties
        .iter()
        .map(|p| axes.iter().position(|axis| p.name == *axis).filter(|_| p.count.is_none()))
        .collect();
    for _ in 0..element.count {
        rows.begin()?;
        let mut position = [0.0; 3];
        for (property, axis) in element.properties.iter().zip(&axis_of) {
            match axis {
                None => rows.skip(property)?,
                Some(axis) => position[*axis] = rows.number(property.kind)?,
            }
        }
        rows.end()?;
        mesh.positions.push(position);
    }
    Ok(())
}

fn read_faces(rows: &mut Rows, element: &Element, positions: u64, mesh: &mut Mesh) -> Result<()> {
    let is_corners = |p: &header::Property| {
        p.count.is_some() && ["vertex_indices", "vertex_index"].contains(&p.name.as_str())
    };
    let Some(corners) = element.properties.iter().position(is_corners) else {
        return Err(rows.bad("it has no list vertex_indices; write its faces with one"));
    };
    for _ in 0..element.count {
        rows.begin()?;
        for (k, property) in element.properties.iter().enumerate() {
            if k != corners {
                rows.skip(property)?;
                continue;
            }
            let (mut first, mut last) = (0, 0);
            for n in 0..rows.length(property)? {
                let index = rows.number(property.kind)?;
                if !(index >= 0.0 && index < positions as f64 && index.fract() == 0.0) {
                    return Err(rows.bad(format!("corner {n} is vertex {index}, there are {positions}")));
                }
                let index = index as u32;
                match n {
                    0 => first = index,
                    1 => {}
                    _ if mesh.triangles.len() == TRIANGLES_MAX => {
                        let wanted = TRIANGLES_MAX as u64 + 1;
                        return Err(Error::limit("triangles of a mesh", TRIANGLES_MAX as u64, wanted));
                    }
                    _ => mesh.triangles.push([first, last, index]),
                }
                last = index;
            }
        }
        rows.end()?;
    }
    Ok(())
}
