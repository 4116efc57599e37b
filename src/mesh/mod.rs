//! A height field becomes a triangle mesh with a measured error.
//!
//! A [`Field`] is a surface z = F(x, y) on a region; [`outline`] makes the region's [`Polygon`]s out of
//! the quads that it is the union of, and [`triangulate`] lays a constrained Delaunay triangulation into
//! them that is nowhere farther from F than the bound: as few triangles as greedy insertion finds, the
//! border exact, holes open, no cracks and no T-junctions. The [`Mesh`] says the error that was measured;
//! [`check`] tells whether a mesh is the manifold that it promises to be.
//!
//! All coordinates are local metres (some origin near the middle subtracted), x east, y north, z up.
//! Meshes are kept in files as 32-bit floats, so every x, y and z of a [`Mesh`] *is* a 32-bit float: the
//! plane is a grid of [`grid_unit`] (2^-24 of the largest coordinate), the outline is snapped to it by
//! the union itself, and every inserted vertex is. Orientation tests on this grid are exact, and what is
//! measured is what is stored.

mod border;
mod check;
mod delaunay;
mod extract;
mod flat;
mod grow;
mod lattice;
mod measure;
mod outline;
mod parts;
mod plain;
mod posts;
mod shrink;
#[cfg(test)]
mod tests;
mod thin;
mod tin;
mod weave;

pub use check::{MeshStats, check};
pub use delaunay::triangulate;
pub use outline::{Polygon, grid_unit, outline, outline_within};
pub use posts::PostGrid;

/// Height and slope of a surface at a point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldSample {
    /// Metres.
    pub z: f64,
    /// Metres per metre towards east.
    pub dzdx: f64,
    /// Metres per metre towards north.
    pub dzdy: f64,
}

/// A surface that can be asked anywhere. Ask for many points at once; implementations may share a batch
/// among threads, and are themselves called from several.
pub trait Field: Sync {
    /// Height and gradient at each point, in order; `None` outside the region. `out` is cleared first.
    ///
    /// The answer to a point must not depend on the batch that it is in. A point on the region's border
    /// should be answered; where it is not, points up to a tenth of a step inside are tried.
    fn sample(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>);

    /// The same heights, bit for bit; gradients may be left at 0 if they cost extra.
    fn heights(&self, points: &[[f64; 2]], out: &mut Vec<Option<FieldSample>>) {
        self.sample(points, out);
    }

    /// Which part of the bound is allowed at a point, above 0 and at most 1. It need not be continuous.
    fn share(&self, _: [f64; 2]) -> f64 {
        1.0
    }

    /// Whether a wall may be at a point or within [`MeshOptions::wall_m`] of it. Everywhere else the bound is vertical.
    fn at_wall(&self, _: [f64; 2]) -> bool {
        true
    }
}

/// What [`triangulate`] shall do.
#[derive(Debug, Clone)]
pub struct MeshOptions {
    /// Bound on the vertical distance of mesh and field, metres, above zero; at a point, the field's share of it. Where less
    /// is allowed, distances count more: every error is divided by the share before it is compared or told.
    pub error_m: f64,
    /// Finest step of posts in the region, metres. Errors are measured on a lattice 4 times finer, and
    /// vertices are not nearer to each other than a thousandth of it.
    pub step_m: f64,
    /// The posts of the surveys in the region: where vertices are tried first, and where the error is
    /// measured. Posts outside the region are ignored.
    pub posts: Vec<[f64; 2]>,
    /// Walls: the mesh may differ from the field by more than the bound at a point [at a wall](Field::at_wall), where the
    /// field takes the mesh's height within this horizontal distance, metres; 0: nowhere. A continuous surface may climb metres in
    /// millimetres where two surveys disagree, and no mesh of 32-bit floats follows that vertically.
    pub wall_m: f64,
    /// Set where the field is bilinear in the cells of one lattice all over the region, and its share 1: then no other point of
    /// the field is asked for than those of the border, and `posts` are not used.
    pub grid: Option<PostGrid>,
    /// At most so many vertices.
    pub vertices_max: usize,
}

impl MeshOptions {
    /// Options with the largest number of vertices that is allowed.
    pub fn new(error_m: f64, step_m: f64, posts: Vec<[f64; 2]>) -> MeshOptions {
        MeshOptions {
            error_m,
            step_m,
            posts,
            wall_m: 0.0,
            grid: None,
            vertices_max: crate::base::limits::MESH_VERTICES_MAX,
        }
    }
}

/// Triangles over a region, manifold but for their border.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Mesh {
    /// Metres; every number is a 32-bit float. A point at which the outline touches itself comes once
    /// for each fan of triangles around it.
    pub positions: Vec<[f64; 3]>,
    /// Unit vectors, from the gradient of the field.
    pub normals: Vec<[f32; 3]>,
    /// Counter-clockwise seen from above.
    pub triangles: Vec<[u32; 3]>,
    /// The largest distance from the field that was found, metres. At most the bound that was asked
    /// for, unless the field jumps between points less than a thousandth of a step apart.
    pub error_m: f64,
    /// Points at which the distance was measured.
    pub measured_points: u64,
}
