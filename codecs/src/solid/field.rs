//! Distance fields of meshes (paper section 3.3, "From 3D mesh to 3D image"; specification section 6).

use super::contour::Samples;
use super::distance::Distance;
use super::mending::mended;
use super::mesh::Mesh;
use super::report::Report;
use super::vector::{Vector, add};
use super::winding;
use super::window::Window;
use crate::work::{self, Workers};
use crate::{Error, Result};
use std::sync::OnceLock;

/// Units of a field in one voxel.
pub const UNITS: f64 = 8.0;
/// The greatest value: so far or farther from the surface.
pub const FULL: i8 = 127;
/// From this distance on, in voxels, a value is [`FULL`].
const FAR: f64 = (FULL as f64 - 0.5) / UNITS;
/// Side of the octree's largest cells; one is a part of the work.
const CELL: usize = 16;

/// Distances to the surface of a solid, positive inside, in eighths of a voxel, saturating at +-127 (16 voxels).
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Where the samples lie.
    pub window: Window,
    /// One a voxel, at its middle; x runs fastest, z slowest.
    pub values: Vec<i8>,
}

impl Field {
    /// The field of a mesh. It is mended first ([`mended`]); cells of an octree in which no distance can be less than 16 voxels get their one value at
    /// once, the others are divided. At most 1/2 unit from the true distance to the mesh.
    ///
    /// The sign is that of the angle-weighted normal of the nearest face, edge or corner. It is certain for closed meshes that do not cross
    /// themselves. Of others (edges of more than two triangles, holes, which are closed first, or signs that change without a surface) every voxel takes the sign
    /// that the triangles round it give, see [`Report::resigned`]. Results do not depend on the workers.
    ///
    /// # Errors
    /// As [`Mesh::check`] and [`Window::check`]; [`Error::Invalid`] for a mesh of no area; [`Error::Stopped`].
    pub fn of(mesh: &Mesh, window: Window, workers: &dyn Workers) -> Result<(Field, Report)> {
        let count = window.check()?;
        let (mesh, mut report) = mended(mesh)?;
        work::check(workers, 0.0)?;
        let scaled = Mesh {
            positions: mesh.positions.iter().map(|p| window.to_voxels(*p)).collect(),
            triangles: mesh.triangles,
        };
        check_near(&scaled)?;
        let distance = Distance::new(&scaled);
        let mut field = Field { window, values: vec![0; count] };
        let cells = window.size.map(|n| n.div_ceil(CELL));
        // Layer by layer: between them the work can be stopped.
        for z in 0..cells[2] {
            work::check(workers, z as f64 / cells[2] as f64)?;
            let parts = cells[0] * cells[1];
            let done: Vec<OnceLock<Vec<i8>>> = vec![OnceLock::new(); parts];
            let corner = |k: usize| [k % cells[0], k / cells[0], z].map(|v| v * CELL);
            workers.run(parts, &|k| {
                let _ = done[k].set(Cell::whole(&distance, window, corner(k)));
            });
            for (k, values) in done.into_iter().enumerate() {
                field.put(corner(k), &values.into_inner().ok_or(Error::Stopped)?);
            }
        }
        report.torn = field.torn();
        if !report.is_closed() || report.torn > 0 {
            report.resigned = field.resign(&scaled, workers)?;
            report.torn = field.torn();
        }
        Ok((field, report))
    }

    /// Gives each voxel the sign that the triangles round it say; returns how many changed.
    fn resign(&mut self, mesh: &Mesh, workers: &dyn Workers) -> Result<usize> {
        let [cols, rows, layers] = self.window.size;
        let mut changed = 0;
        for first in (0..layers).step_by(CELL) {
            work::check(workers, 1.0)?;
            let count = CELL.min(layers - first);
            let slab = [first as f64, (first + count) as f64];
            let near = |t: &u32| {
                let z = mesh.corners(*t as usize).map(|p| p[2]);
                z.iter().any(|z| *z <= slab[1]) && z.iter().any(|z| *z >= slab[0])
            };
            let some: Vec<u32> = (0..mesh.triangles.len() as u32).filter(near).collect();
            let done: Vec<OnceLock<Vec<bool>>> = vec![OnceLock::new(); count];
            workers.run(count, &|k| {
                let _ = done[k].set(winding::inside(mesh, &some, self.window.size, first + k));
            });
            for (k, inside) in done.into_iter().enumerate() {
                let inside = inside.into_inner().ok_or(Error::Stopped)?;
                let values = &mut self.values[(first + k) * cols * rows..][..cols * rows];
                for (v, inside) in values.iter_mut().zip(inside) {
                    if *v != 0 && (*v > 0) != inside {
                        *v = -*v;
                        changed += 1;
                    }
                }
            }
        }
        Ok(changed)
    }

    /// Pairs of neighbours whose values differ by more than one voxel and the rounding of both.
    fn torn(&self) -> usize {
        let size = self.window.size;
        let most = UNITS as i32 + 1;
        let mut count = 0;
        for (axis, step) in [(0, 1), (1, size[0]), (2, size[0] * size[1])] {
            let pairs = self.values.iter().zip(self.values.iter().skip(step)).enumerate();
            let inner = |k: usize| k / step % size[axis] + 1 < size[axis];
            let differ = |a: i8, b: i8| (i32::from(a) - i32::from(b)).abs() > most;
            count += pairs.filter(|(k, (a, b))| differ(**a, **b) && inner(*k)).count();
        }
        count
    }

    /// The field as samples.
    pub fn samples(&self) -> Samples<'_, i8> {
        Samples { window: self.window, values: &self.values }
    }

    /// Writes the values of a cell.
    fn put(&mut self, corner: [usize; 3], values: &[i8]) {
        let size = self.window.size;
        let cols = CELL.min(size[0] - corner[0]);
        for (n, row) in values.chunks_exact(CELL).enumerate() {
            let (y, z) = (corner[1] + n % CELL, corner[2] + n / CELL);
            if y < size[1] && z < size[2] {
                let at = self.window.at([corner[0], y, z]);
                self.values[at..at + cols].copy_from_slice(&row[..cols]);
            }
        }
    }
}

/// Positions may lie beyond the window, but not so far that squares lose their digits.
fn check_near(mesh: &Mesh) -> Result<()> {
    const MOST: f64 = (1u64 << 40) as f64;
    match mesh.positions.iter().position(|p| !p.iter().all(|v| v.abs() <= MOST)) {
        None => Ok(()),
        Some(k) => {
            let reason = format!(
                "position {k} is more than {MOST:e} voxels from the window; take the window round the mesh"
            );
            Err(Error::invalid("mesh", reason))
        }
    }
}

/// The value of a signed distance, in voxels.
pub fn quantised(distance: f64) -> i8 {
    (distance * UNITS).round().clamp(-f64::from(FULL), f64::from(FULL)) as i8
}

/// One of the octree's largest cells, while it is filled.
struct Cell<'a> {
    distance: &'a Distance,
    size: [usize; 3],
    corner: [usize; 3],
    values: Vec<i8>,
    /// The triangle that was nearest last.
    near: usize,
}

impl Cell<'_> {
    fn whole(distance: &Distance, window: Window, corner: [usize; 3]) -> Vec<i8> {
        let values = vec![0; CELL * CELL * CELL];
        let mut cell = Cell { distance, size: window.size, corner, values, near: 0 };
        cell.fill([0; 3], CELL);
        cell.values
    }

    /// Fills the cube of `side` at `at` within the cell.
    fn fill(&mut self, at: [usize; 3], side: usize) {
        let corner = [0, 1, 2].map(|k| self.corner[k] + at[k]);
        if (0..3).any(|k| corner[k] >= self.size[k]) {
            return;
        }
        let half = side as f64 / 2.0;
        let middle: Vector = add(corner.map(|v| v as f64), [half; 3]);
        let (near, distance) = self.distance.signed(middle, self.near);
        self.near = near.triangle;
        // No sample of the cube is farther from its middle than its outermost ones.
        let reach = (side - 1) as f64 / 2.0 * 3f64.sqrt();
        if side == 1 || distance.abs() - reach >= FAR {
            let value = quantised(distance);
            for z in at[2]..at[2] + side {
                for y in at[1]..at[1] + side {
                    self.values[(z * CELL + y) * CELL + at[0]..][..side].fill(value);
                }
            }
            return;
        }
        let half = side / 2;
        for k in 0..8 {
            self.fill([at[0] + (k & 1) * half, at[1] + (k >> 1 & 1) * half, at[2] + (k >> 2) * half], half);
        }
    }
}
