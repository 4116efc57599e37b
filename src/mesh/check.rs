//! Is a mesh the manifold that it promises to be?

use std::collections::HashMap;

use super::Mesh;
use crate::base::{Error, Result};

/// What [`check`] counted.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct MeshStats {
    pub vertices: u64,
    pub triangles: u64,
    /// Edges with a triangle on one side only.
    pub border_edges: u64,
    /// Square metres seen from above.
    pub area_m2: f64,
}

/// Checks a mesh: indices in range, every position a 32-bit float, normals of unit length pointing up,
/// triangles counter-clockwise with an area, each edge with at most two triangles that run along it in
/// opposite directions, the triangles at each vertex one fan. One pass with a table of edges.
///
/// # Errors
/// [`Error::Corrupt`] names the first thing that is wrong.
pub fn check(mesh: &Mesh) -> Result<MeshStats> {
    let wrong = |place: String, reason: &str| Err(Error::corrupt("mesh", place, reason));
    let count = mesh.positions.len();
    if mesh.normals.len() != count {
        return wrong("normals".into(), "not one a vertex");
    }
    for (v, p) in mesh.positions.iter().enumerate() {
        if p.iter().any(|&c| !c.is_finite() || f64::from(c as f32) != c) {
            return wrong(format!("vertex {v}"), "not a 32-bit float");
        }
        let n = mesh.normals[v].map(f64::from);
        let length = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        if (length - 1.0).abs() > 1e-5 || n[2] < 0.0 {
            return wrong(format!("normal {v}"), "not a unit vector that points up");
        }
    }
    let mut stats = MeshStats { vertices: count as u64, ..MeshStats::default() };
    let mut edges: HashMap<(u32, u32), u32> = HashMap::with_capacity(mesh.triangles.len() * 3);
    for (t, corners) in mesh.triangles.iter().enumerate() {
        if corners.iter().any(|&v| v as usize >= count) {
            return wrong(format!("triangle {t}"), "index out of range");
        }
        let [a, b, c] = corners.map(|v| mesh.positions[v as usize]);
        let doubled = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1]);
        if doubled <= 0.0 {
            return wrong(format!("triangle {t}"), "not counter-clockwise");
        }
        stats.triangles += 1;
        stats.area_m2 += doubled / 2.0;
        for k in 0..3 {
            if edges.insert((corners[k], corners[(k + 1) % 3]), t as u32).is_some() {
                return wrong(format!("triangle {t}"), "an edge has two triangles on one side");
            }
        }
    }
    stats.border_edges = edges.keys().filter(|(a, b)| !edges.contains_key(&(*b, *a))).count() as u64;

    // Walk the fan of each vertex from its border edge, or from any: it must hold all triangles there.
    let mut valence = vec![0u32; count];
    let mut start: Vec<Option<u32>> = vec![None; count];
    for corners in &mesh.triangles {
        for k in 0..3 {
            let v = corners[k] as usize;
            valence[v] += 1;
            let next = corners[(k + 1) % 3];
            if start[v].is_none() || !edges.contains_key(&(next, corners[k])) {
                start[v] = Some(next);
            }
        }
    }
    for v in 0..count {
        let Some(first) = start[v] else { return wrong(format!("vertex {v}"), "has no triangle") };
        let (mut spoke, mut walked) = (first, 0);
        while let Some(&t) = edges.get(&(v as u32, spoke)) {
            walked += 1;
            let corners = mesh.triangles[t as usize];
            let k = corners.iter().position(|&c| c == v as u32).unwrap_or(0);
            spoke = corners[(k + 2) % 3];
            if spoke == first || walked > valence[v] {
                break;
            }
        }
        if walked != valence[v] {
            return wrong(format!("vertex {v}"), "its triangles are more than one fan");
        }
    }
    Ok(stats)
}
