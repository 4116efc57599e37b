//! Signed distances to a mesh: the sign is that of the angle-weighted normal of the nearest feature (J. A. Bærentzen, H. Aanæs, Signed distance
//! computation using the angle weighted pseudonormal, IEEE TVCG 11(3), 2005).

use super::mesh::Mesh;
use super::nearest::{Hierarchy, Nearest, Part};
use super::vector::{Vector, add, dot, sub};

/// A mended mesh that is asked for distances.
pub struct Distance {
    hierarchy: Hierarchy,
    faces: Vec<Vector>,
    /// The sums of the normals of the triangles of each edge; three edges a triangle.
    edges: Vec<Vector>,
    edge_of: Vec<[u32; 3]>,
    vertices: Vec<Vector>,
    triangles: Vec<[u32; 3]>,
}

impl Distance {
    /// Of a mesh that was mended and has triangles.
    pub fn new(mesh: &Mesh) -> Distance {
        let faces = mesh.face_normals();
        let mut sides: Vec<([u32; 2], u32)> = Vec::with_capacity(faces.len() * 3);
        for (n, t) in mesh.triangles.iter().enumerate() {
            for k in 0..3 {
                let (a, b) = (t[k], t[(k + 1) % 3]);
                sides.push(([a.min(b), a.max(b)], (3 * n + k) as u32));
            }
        }
        sides.sort_unstable();
        let (mut edges, mut edge_of) = (Vec::new(), vec![[0; 3]; faces.len()]);
        for group in sides.chunk_by(|a, b| a.0 == b.0) {
            let at = edges.len() as u32;
            edges.push(group.iter().fold([0.0; 3], |sum, (_, side)| add(sum, faces[*side as usize / 3])));
            group.iter().for_each(|(_, side)| edge_of[*side as usize / 3][*side as usize % 3] = at);
        }
        Distance {
            hierarchy: Hierarchy::new(mesh),
            faces,
            edges,
            edge_of,
            vertices: mesh.vertex_normals(),
            triangles: mesh.triangles.clone(),
        }
    }

    /// The nearest point, and the signed distance: positive inside. `guess` as for [`Hierarchy::nearest`].
    pub fn signed(&self, p: Vector, guess: usize) -> (Nearest, f64) {
        let near = self.hierarchy.nearest(p, guess);
        let normal = match near.part {
            Part::Face => self.faces[near.triangle],
            Part::Side(k) => self.edges[self.edge_of[near.triangle][k] as usize],
            Part::Corner(k) => self.vertices[self.triangles[near.triangle][k] as usize],
        };
        let inside = dot(sub(p, near.point), normal) <= 0.0;
        let length = near.square.sqrt();
        (near, if inside { length } else { -length })
    }
}
