//! Triangle meshes: what they are made of, their limits.

use super::vector::{Vector, add, cross, dot, scaled, sub, unit};
use crate::{Error, Result};

/// Triangles of a mesh, at most.
pub const TRIANGLES_MAX: usize = 1 << 23;
/// Positions of a mesh, at most.
pub const POSITIONS_MAX: usize = 1 << 24;
/// Coordinates lie between plus and minus this: squares of differences stay finite, and sums of many of them.
pub const COORDINATE_MAX: f64 = 1e100;

/// Triangles that share positions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Points in units of the mesh, in whatever axes it came with.
    pub positions: Vec<Vector>,
    /// Three places in `positions` each, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// Refuses a mesh that makes no sense.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond [`TRIANGLES_MAX`] or [`POSITIONS_MAX`]; [`Error::Invalid`] for no triangles, a coordinate that is not finite or beyond
    /// [`COORDINATE_MAX`], an index out of range.
    pub fn check(&self) -> Result<()> {
        self.check_size()?;
        if self.triangles.is_empty() {
            return Err(Error::invalid("mesh", "it has no triangles; points alone bound no solid"));
        }
        let sound = |v: &f64| v.abs() <= COORDINATE_MAX;
        if let Some(k) = self.positions.iter().position(|p| !p.iter().all(sound)) {
            let p = self.positions[k];
            let reason = format!(
                "position {k} is {}, {}, {}; give coordinates within +-{COORDINATE_MAX:e}",
                p[0], p[1], p[2]
            );
            return Err(Error::invalid("mesh", reason));
        }
        let count = self.positions.len();
        if let Some(k) = self.triangles.iter().position(|t| t.iter().any(|v| *v as usize >= count)) {
            let reason =
                format!("triangle {k} has the corners {:?}, there are {count} positions", self.triangles[k]);
            return Err(Error::invalid("mesh", reason));
        }
        Ok(())
    }

    /// The limits of counts.
    pub(super) fn check_size(&self) -> Result<()> {
        let limited = |what, limit: usize, wanted: usize| {
            let (limit, wanted) = (limit as u64, wanted as u64);
            if wanted > limit { Err(Error::Limit { what, limit, wanted }) } else { Ok(()) }
        };
        limited("triangles of a mesh", TRIANGLES_MAX, self.triangles.len())?;
        limited("positions of a mesh", POSITIONS_MAX, self.positions.len())
    }

    /// The least box round all corners of triangles: least and greatest coordinates. Of no triangles: nothing.
    pub fn bounds(&self) -> Option<[Vector; 2]> {
        let mut corners = self.triangles.iter().flatten().map(|v| self.positions[*v as usize]);
        let first = corners.next()?;
        Some(corners.fold([first, first], |[min, max], p| {
            [[0, 1, 2].map(|k| p[k].min(min[k])), [0, 1, 2].map(|k| p[k].max(max[k]))]
        }))
    }

    /// The corners of a triangle.
    #[inline]
    pub fn corners(&self, triangle: usize) -> [Vector; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// The volume that the triangles enclose, each as a tetrahedron with the middle of the box; negative if they face inwards.
    pub fn volume(&self) -> f64 {
        let Some([min, max]) = self.bounds() else { return 0.0 };
        let middle = scaled(add(min, max), 0.5);
        let one = |t: usize| {
            let [a, b, c] = self.corners(t).map(|p| sub(p, middle));
            dot(a, cross(b, c))
        };
        (0..self.triangles.len()).map(one).sum::<f64>() / 6.0
    }

    /// The unit normal of each triangle; zero for one without area.
    pub fn face_normals(&self) -> Vec<Vector> {
        let normal = |t| {
            let [a, b, c] = self.corners(t);
            // Of unit vectors: the product of two tiny sides would be lost.
            unit(cross(unit(sub(b, a)), unit(sub(c, a))))
        };
        (0..self.triangles.len()).map(normal).collect()
    }

    /// The normal of each position: those of its triangles, weighted with the angles of their corners there, of length 1; zero where there is none.
    pub fn vertex_normals(&self) -> Vec<Vector> {
        let mut sums = vec![[0.0; 3]; self.positions.len()];
        for (t, normal) in self.face_normals().into_iter().enumerate() {
            let p = self.corners(t);
            for k in 0..3 {
                let [a, b] = [1, 2].map(|n| unit(sub(p[(k + n) % 3], p[k])));
                let at = self.triangles[t][k] as usize;
                sums[at] = add(sums[at], scaled(normal, super::vector::angle(a, b)));
            }
        }
        sums.into_iter().map(unit).collect()
    }
}
