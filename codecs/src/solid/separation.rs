//! How far two meshes are from each other: the Hausdorff distance, by samples (acceptance F8).

use super::mesh::Mesh;
use super::nearest::Hierarchy;
use super::vector::{Vector, add, scaled, sub};
use crate::work::{self, Workers};
use crate::{Error, Result};
use std::sync::OnceLock;

/// Samples on one mesh, at most.
pub const SAMPLES_MAX: u64 = 200_000_000;
/// Triangles that are one part of the work.
const TRIANGLES: usize = 256;
/// Parts between two looks at whether the work goes on.
const PARTS: usize = 256;

/// Distances from samples on one mesh to another mesh, in units of the mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distances {
    /// The greatest: the one-sided Hausdorff distance.
    pub max: f64,
    /// Where on the one mesh it is.
    pub place: Vector,
    /// The root of the mean of squares over the samples.
    pub rms: f64,
    /// How many.
    pub samples: u64,
}

/// The distances both ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Separation {
    /// From samples on the first to the second.
    pub there: Distances,
    /// From samples on the second to the first.
    pub back: Distances,
}

impl Separation {
    /// The Hausdorff distance.
    pub fn hausdorff(&self) -> f64 {
        self.there.max.max(self.back.max)
    }
}

/// The Hausdorff distance of two meshes: the samples are all corners of triangles, and points on faces no farther than `spacing` apart.
///
/// # Errors
/// As [`Mesh::check`]; [`Error::Invalid`] for a spacing that is not above 0; [`Error::Limit`] beyond [`SAMPLES_MAX`]; [`Error::Stopped`].
pub fn separation(a: &Mesh, b: &Mesh, spacing: f64, workers: &dyn Workers) -> Result<Separation> {
    Ok(Separation { there: distances(a, b, spacing, workers)?, back: distances(b, a, spacing, workers)? })
}

/// One way: from samples on `from` to the mesh `to`.
///
/// # Errors
/// As [`separation`].
pub fn distances(from: &Mesh, to: &Mesh, spacing: f64, workers: &dyn Workers) -> Result<Distances> {
    from.check()?;
    to.check()?;
    if spacing.is_nan() || spacing <= 0.0 {
        return Err(Error::invalid("spacing of samples", format!("{spacing}; take more than 0")));
    }
    let count = from.triangles.len();
    let wanted = (0..count).fold(0u64, |sum, t| {
        let n = steps(&from.corners(t), spacing);
        sum.saturating_add((n + 1).saturating_mul(n + 2) / 2)
    });
    if wanted > SAMPLES_MAX {
        return Err(Error::Limit { what: "samples on a mesh", limit: SAMPLES_MAX, wanted });
    }
    let tree = Hierarchy::new(to);
    let parts = count.div_ceil(TRIANGLES);
    let done: Vec<OnceLock<Distances>> = vec![OnceLock::new(); parts];
    let part = |k: usize| {
        let mut out = Distances::default();
        let mut guess = 0;
        for t in k * TRIANGLES..count.min((k + 1) * TRIANGLES) {
            let corners = from.corners(t);
            let n = steps(&corners, spacing);
            for i in 0..=n {
                for j in 0..=n - i {
                    let p = between(&corners, n, i, j);
                    let near = tree.nearest(p, guess);
                    guess = near.triangle;
                    out.samples += 1;
                    out.rms += near.square;
                    if near.square > out.max {
                        (out.max, out.place) = (near.square, p);
                    }
                }
            }
        }
        let _ = done[k].set(out);
    };
    for first in (0..parts).step_by(PARTS) {
        work::check(workers, first as f64 / parts as f64)?;
        workers.run(PARTS.min(parts - first), &|k| part(first + k));
    }
    let mut out = Distances::default();
    for found in &done {
        let found = found.get().ok_or(Error::Stopped)?;
        if found.max > out.max {
            (out.max, out.place) = (found.max, found.place);
        }
        out.rms += found.rms;
        out.samples += found.samples;
    }
    out.rms = (out.rms / out.samples as f64).sqrt();
    out.max = out.max.sqrt();
    Ok(out)
}

/// Into how many parts the sides of a triangle are divided.
fn steps(corners: &[Vector; 3], spacing: f64) -> u64 {
    let [a, b, c] = corners;
    let longest = [sub(*b, *a), sub(*c, *b), sub(*a, *c)].map(super::vector::length);
    // `as` stops at the greatest number.
    ((longest[0].max(longest[1]).max(longest[2]) / spacing).ceil() as u64).max(1)
}

/// Point i, j of a triangle whose sides are divided by n.
fn between([a, b, c]: &[Vector; 3], n: u64, i: u64, j: u64) -> Vector {
    let share = |v: u64| v as f64 / n as f64;
    add(add(scaled(*a, share(n - i - j)), scaled(*b, share(i))), scaled(*c, share(j)))
}
