//! How often the triangles go round each voxel: what is inside where the nearest triangle cannot say.
//!
//! A line runs along x through each row of voxels' middles; each triangle that it passes adds or takes one for all voxels beyond. Whether it passes is
//! counted side by side of the triangle, a side backwards giving exactly the opposite: over a mesh without holes the sum is zero beyond the last
//! triangle, whatever the rounding. Where a mesh crosses itself, all that is inside of any part is inside.

use super::mesh::Mesh;
use super::vector::{Vector, cross, sub};

/// For one layer of voxels, whether each is inside. `mesh` is in voxels from the window's corner, without holes; `some` are those of its triangles that may
/// meet the layer.
pub fn inside(mesh: &Mesh, some: &[u32], size: [usize; 3], z: usize) -> Vec<bool> {
    let [cols, rows, _] = size;
    let mut sums = vec![0i32; (cols + 1) * rows];
    let height = z as f64 + 0.5;
    for t in some {
        let t = *t as usize;
        let corners = mesh.corners(t);
        if !spans(&corners, 2, height) {
            continue;
        }
        let [first, end] = range(&corners, 1, rows);
        for y in first..end {
            let at = [y as f64 + 0.5, height];
            let [a, b, c] = mesh.triangles[t];
            let times =
                [(a, b), (b, c), (c, a)].into_iter().map(|(a, b)| passes(mesh, a, b, at)).sum::<i32>();
            if times != 0 {
                // Voxels whose middle is beyond the place where the line meets the triangle.
                let x = (meets(&corners, at) + 0.5).floor().clamp(0.0, cols as f64) as usize;
                sums[y * (cols + 1) + x] += times;
            }
        }
    }
    let mut out = Vec::with_capacity(cols * rows);
    for row in sums.chunks_exact(cols + 1) {
        let mut sum = 0;
        out.extend(row[..cols].iter().map(|times| {
            sum += times;
            sum > 0
        }));
    }
    out
}

/// Whether a triangle has points on both sides of a plane across an axis, or on it.
pub fn spans(corners: &[Vector; 3], axis: usize, at: f64) -> bool {
    corners.iter().any(|p| p[axis] <= at) && corners.iter().any(|p| p[axis] >= at)
}

/// The voxels along an axis whose middles lie within a triangle's extent, and one more at each end.
fn range(corners: &[Vector; 3], axis: usize, count: usize) -> [usize; 2] {
    let low = corners.iter().map(|p| p[axis]).fold(f64::INFINITY, f64::min);
    let high = corners.iter().map(|p| p[axis]).fold(f64::NEG_INFINITY, f64::max);
    [(low - 1.0).max(0.0) as usize, ((high + 1.0).max(0.0) as usize).min(count)]
}

/// Seen along x: how often the side from a to b passes the half-line from `at` upwards, rightwards less leftwards.
fn passes(mesh: &Mesh, a: u32, b: u32, at: [f64; 2]) -> i32 {
    // Always computed from the lesser corner to the greater.
    let (low, high) = (a.min(b), a.max(b));
    let [p, q] = [low, high].map(|v| {
        let p = mesh.positions[v as usize];
        [p[1] - at[0], p[2] - at[1]]
    });
    let (before, after) = (p[0] > 0.0, q[0] > 0.0);
    if before == after {
        return 0;
    }
    let side = p[0] * q[1] - p[1] * q[0];
    let leftwards = before;
    if (side > 0.0) != leftwards {
        return 0;
    }
    if (a == low) == leftwards { -1 } else { 1 }
}

/// Where the line along x at `at` meets a triangle's plane, within the triangle's extent.
fn meets(corners: &[Vector; 3], at: [f64; 2]) -> f64 {
    let [a, b, c] = corners;
    let normal = cross(sub(*b, *a), sub(*c, *a));
    let x = a[0] - (normal[1] * (at[0] - a[1]) + normal[2] * (at[1] - a[2])) / normal[0];
    let (low, high) = (a[0].min(b[0]).min(c[0]), a[0].max(b[0]).max(c[0]));
    // Along the plane of a triangle on its edge there is no place: any of the triangle's will do.
    if x.is_nan() { low } else { x.clamp(low, high) }
}
