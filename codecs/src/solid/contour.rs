//! Marching cubes: a sampled field becomes triangles (paper section 3.3, "From 3D image to polygonal mesh").
//!
//! A sample is inside if it is greater than the level; one that equals it is outside. On each edge of the lattice between an inside and an outside
//! sample lies one vertex, where the line between the two values meets the level, but never nearer than [`NEAR`] of the edge to
//! either end: so no triangle is degenerate where samples equal the level. Triangles are counter-clockwise seen from outside. The mesh has no
//! open edge except where the surface leaves the window, and every other edge has two triangles exactly ([`cases`](super::cases)).

use super::cases::{CASES, EDGES, NONE};
use super::mesh::Mesh;
use super::window::Window;
use crate::work::{self, Workers};
use crate::{Error, Result};

/// How near a vertex comes to a sample, of the distance between two samples.
pub const NEAR: f64 = 1.0 / 256.0;

/// Samples in a window: signed bytes, 32-bit or 64-bit numbers.
#[derive(Clone, Copy, Debug)]
pub struct Samples<'a, T> {
    /// Where they lie.
    pub window: Window,
    /// One a voxel, x running fastest, z slowest.
    pub values: &'a [T],
}

/// What happens where the surface leaves the window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Border {
    /// The mesh ends at the outermost samples, with open edges.
    Open,
    /// All beyond the window is outside: what is cut is closed, flat on the window's border, half a voxel beyond the outermost samples.
    Closed,
}

/// The surface where the samples pass `level`. Vertices come in the order of their lattice edges, triangles in that of their cubes: the same samples
/// give the same mesh. Costs about 2 ns a sample; memory beside the mesh is 24 bytes a sample of one layer.
///
/// # Errors
/// [`Error::Invalid`] if the window makes no sense, the values are not as many as its voxels, or one is not finite; [`Error::Limit`] beyond the
/// mesh's limits; [`Error::Stopped`].
pub fn surface<T: Copy + Into<f64>>(
    samples: &Samples<T>,
    level: f64,
    border: Border,
    workers: &dyn Workers,
) -> Result<Mesh> {
    let count = samples.window.check()?;
    if samples.values.len() != count {
        let reason = format!("{} values for {count} voxels; give one a voxel", samples.values.len());
        return Err(Error::invalid("samples", reason));
    }
    if !level.is_finite() {
        return Err(Error::invalid("level", format!("{level}; take a finite one")));
    }
    let pad = usize::from(border == Border::Closed);
    let mut march = March {
        samples,
        level,
        pad,
        size: samples.window.size.map(|n| n + 2 * pad),
        layers: Default::default(),
        mesh: Mesh::default(),
    };
    for z in 0..march.size[2] {
        work::check(workers, z as f64 / march.size[2] as f64)?;
        march.enter(z)?;
        march.cubes();
        march.mesh.check_size()?;
    }
    Ok(march.mesh)
}

/// What is known of one layer of the lattice.
#[derive(Default)]
struct Layer {
    /// Values less the level; minus infinity beyond the window.
    values: Vec<f64>,
    /// For each sample the vertices on the edges that run from it along x, y, z; meaningless where the surface crosses none.
    vertices: Vec<[u32; 3]>,
}

struct March<'a, T> {
    samples: &'a Samples<'a, T>,
    level: f64,
    /// Rings of outside samples about the window.
    pad: usize,
    size: [usize; 3],
    /// The layer before, and the one that was entered last.
    layers: [Layer; 2],
    mesh: Mesh,
}

impl<T: Copy + Into<f64>> March<'_, T> {
    /// Takes the next layer: its values, the vertices on the edges up to it, those on the edges in it.
    fn enter(&mut self, z: usize) -> Result<()> {
        let [nx, ny, _] = self.size;
        let [mut layer, mut below] = std::mem::take(&mut self.layers);
        self.fill(z, &mut layer.values)?;
        layer.vertices.clear();
        layer.vertices.resize(nx * ny, [0; 3]);
        if z > 0 {
            for k in 0..nx * ny {
                if let Some(t) = crossing(below.values[k], layer.values[k]) {
                    below.vertices[k][2] = self.vertex([k % nx, k / nx, z - 1], 2, t);
                }
            }
        }
        for y in 0..ny {
            for x in 0..nx {
                let k = y * nx + x;
                for (axis, step, more) in [(0, 1, x + 1 < nx), (1, nx, y + 1 < ny)] {
                    if more && let Some(t) = crossing(layer.values[k], layer.values[k + step]) {
                        layer.vertices[k][axis] = self.vertex([x, y, z], axis, t);
                    }
                }
            }
        }
        self.layers = [below, layer];
        Ok(())
    }

    fn fill(&self, z: usize, out: &mut Vec<f64>) -> Result<()> {
        let [nx, ny, nz] = self.size;
        let pad = self.pad;
        out.clear();
        out.resize(nx * ny, f64::NEG_INFINITY);
        if z < pad || z >= nz - pad {
            return Ok(());
        }
        let [cols, rows, _] = self.samples.window.size;
        for y in 0..rows {
            let at = self.samples.window.at([0, y, z - pad]);
            let row = &mut out[(y + pad) * nx + pad..][..cols];
            for (o, v) in row.iter_mut().zip(&self.samples.values[at..]) {
                *o = (*v).into() - self.level;
            }
            if let Some(x) = row.iter().position(|v| !v.is_finite()) {
                let reason = format!("the value of voxel {x}, {y}, {} is not finite", z - pad);
                return Err(Error::invalid("samples", reason));
            }
        }
        Ok(())
    }

    /// A vertex on the edge from a sample along an axis, `t` of the way.
    fn vertex(&mut self, sample: [usize; 3], axis: usize, t: f64) -> u32 {
        let mut p = sample.map(|v| v as f64 - self.pad as f64 + 0.5);
        p[axis] += t;
        self.mesh.positions.push(self.samples.window.from_voxels(p));
        (self.mesh.positions.len() - 1) as u32
    }

    /// The triangles of the cubes between the two layers.
    fn cubes(&mut self) {
        let [nx, ny, _] = self.size;
        let [below, above] = &self.layers;
        if below.values.is_empty() {
            return;
        }
        for y in 0..ny - 1 {
            let column = |x: usize| {
                let k = y * nx + x;
                let inside = |v: f64| usize::from(v > 0.0);
                inside(below.values[k])
                    | inside(below.values[k + nx]) << 2
                    | inside(above.values[k]) << 4
                    | inside(above.values[k + nx]) << 6
            };
            let mut left = column(0);
            for x in 1..nx {
                let right = column(x);
                let case = left | right << 1;
                left = right;
                if case == 0 || case == 255 {
                    continue;
                }
                let vertex = |edge: u8| {
                    let [a, b] = EDGES[usize::from(edge)];
                    let k = (y + (a >> 1 & 1)) * nx + x - 1 + (a & 1);
                    let layer = if a >> 2 == 0 { below } else { above };
                    layer.vertices[k][(a ^ b).trailing_zeros() as usize]
                };
                for t in CASES[case].as_chunks().0.iter().take_while(|t: &&[u8; 3]| t[0] != NONE) {
                    self.mesh.triangles.push(t.map(vertex));
                }
            }
        }
    }
}

/// Where between two samples the surface passes, of the way from the first to the second.
#[inline(always)]
fn crossing(a: f64, b: f64) -> Option<f64> {
    if (a > 0.0) == (b > 0.0) {
        return None;
    }
    // Beyond the window is no value to go by: its border is in the middle.
    if a == f64::NEG_INFINITY || b == f64::NEG_INFINITY {
        return Some(0.5);
    }
    // Halves: the difference of two great numbers may not be one.
    Some((a * 0.5 / (a * 0.5 - b * 0.5)).clamp(NEAR, 1.0 - NEAR))
}
