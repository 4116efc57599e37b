//! A box of voxels in the mesh's own coordinates.

use super::vector::Vector;
use crate::{Error, Result};

/// Voxels along a side, at most.
pub const SIDE_MAX: usize = 512;
/// Room kept free on each side of a mesh, voxels: the outermost samples lie outside, and the surface closes within the window.
pub const MARGIN: f64 = 2.0;
/// A coordinate is at most so many voxels from zero: more would leave no bits for the place within a voxel.
const FAR_MAX: f64 = (1u64 << 40) as f64;

/// Where the samples of a field lie. Sample i, j, k is at the middle of its voxel, `origin + voxel (i + 1/2, j + 1/2, k + 1/2)`; so a window
/// keeps its origin when its voxels are halved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// Voxels along x, y, z.
    pub size: [usize; 3],
    /// The window's corner of least coordinates, in units of the mesh.
    pub origin: Vector,
    /// Side of a voxel, in units of the mesh.
    pub voxel: f64,
}

impl Window {
    /// The window of `size` voxels round a box, from `min` to `max`: the smallest voxels that leave `margin` voxels free on each side ([`MARGIN`]
    /// is enough); the box in the middle.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond [`SIDE_MAX`]; [`Error::Invalid`] if the margin leaves no room, or the box has no extent or is not finite.
    pub fn around(bounds: [Vector; 2], size: [usize; 3], margin: f64) -> Result<Window> {
        let [min, max] = bounds;
        if !(0.0..=SIDE_MAX as f64).contains(&margin) {
            return Err(Error::invalid(
                "margin",
                format!("{margin} voxels; take 0 to {SIDE_MAX}, {MARGIN} is enough"),
            ));
        }
        let mut voxel = 0.0f64;
        for k in 0..3 {
            let room = size[k] as f64 - 2.0 * margin;
            if room < 1.0 {
                let reason = format!(
                    "{} voxels do not hold a margin of {margin} on both sides and the mesh; take more",
                    size[k]
                );
                return Err(Error::invalid("size", reason));
            }
            voxel = voxel.max((max[k] - min[k]) / room);
        }
        let middle = [0, 1, 2].map(|k| min[k] / 2.0 + max[k] / 2.0);
        let origin = [0, 1, 2].map(|k| middle[k] - voxel * (size[k] as f64 / 2.0));
        let window = Window { size, origin, voxel };
        window.check()?;
        Ok(window)
    }

    /// How many voxels, if the window makes sense.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond [`SIDE_MAX`]; [`Error::Invalid`] for no voxels, numbers that are not finite, a voxel without extent or too small for where
    /// it is.
    pub fn check(&self) -> Result<usize> {
        for n in self.size {
            if n > SIDE_MAX {
                return Err(Error::Limit {
                    what: "voxels along a side",
                    limit: SIDE_MAX as u64,
                    wanted: n as u64,
                });
            }
            if n == 0 {
                return Err(Error::invalid("size", "0 voxels along a side; take 1 or more"));
            }
        }
        let voxel = self.voxel;
        if !(f64::MIN_POSITIVE..=f64::MAX / FAR_MAX).contains(&voxel) {
            return Err(Error::invalid("voxel", format!("side {voxel}; take a mesh that has extent")));
        }
        let is_near = |v: &&f64| v.abs() / voxel <= FAR_MAX;
        if let Some(far) = self.origin.iter().find(|v| !is_near(v)) {
            let reason = format!(
                "a coordinate of {far} at voxels of {voxel} leaves no digits; move the mesh to the origin"
            );
            return Err(Error::invalid("window", reason));
        }
        Ok(self.size.iter().product())
    }

    /// A point in voxels from the window's corner.
    pub fn to_voxels(&self, p: Vector) -> Vector {
        [0, 1, 2].map(|k| (p[k] - self.origin[k]) / self.voxel)
    }

    /// A point given in voxels from the window's corner.
    pub fn from_voxels(&self, p: Vector) -> Vector {
        [0, 1, 2].map(|k| self.origin[k] + p[k] * self.voxel)
    }

    /// The place of a sample in memory: x runs fastest, z slowest.
    pub fn at(&self, p: [usize; 3]) -> usize {
        (p[2] * self.size[1] + p[1]) * self.size[0] + p[0]
    }
}
