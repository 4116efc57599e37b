//! Meshes of a field that is bilinear in the cells of one lattice: most regions lie within one survey.
//!
//! 1. The first triangles, between the vertices of the border, get all the vertices that the bound needs (see `grow`).
//! 2. They are taken apart into tiles (see `parts`), and each is rid of the vertices that it does not need after all (see
//!    `shrink`), in parallel.
//! 3. Put together again, the vertices on the seams of tiles are tried, too.
//!
//! The distance from the field is known everywhere (see `posts`), so nothing is measured between the posts but along sides.

use rayon::prelude::*;

use super::flat::Flat;
use super::grow::{Ground, Grow, measure};
use super::parts::{Part, apart, tiles, together};
use super::posts::PostGrid;
use super::shrink::Shrink;
use crate::base::Result;

/// Tiles between two looks at the caller's wish to stop.
const WAVE_TILES: usize = 16;
/// Distances are kept within a bound that is this much smaller than what was asked, for rounding.
const ROUNDING: f64 = 1e-9;
/// Rounds of splitting sides; a second one finds little, a fourth nothing on any ground that we saw.
const ROUNDS_MAX: usize = 64;

/// The triangles that are left, and the largest distance from the field and at how many points it was found.
pub(super) struct Laid {
    pub flat: Flat,
    pub error_m: f64,
    pub points: u64,
}

/// Fills first triangles with as many as the bound needs. `look` gets the share done and the vertices that there are.
pub(super) fn lay(
    first: Flat,
    grid: &PostGrid,
    (unit, bound): (f64, f64),
    look: &dyn Fn(f64, usize) -> Result<()>,
) -> Result<Laid> {
    let ground = Ground { grid, unit, bound: bound * (1.0 - ROUNDING) };
    let mut grow = Grow::new(first, ground);
    let most = grow.worst().max(bound * 1.001);
    let mut grown = |flat: &Flat, error: f64| {
        let left = (error.clamp(bound, most) / bound).ln() / (most / bound).ln();
        look(0.5 * (1.0 - left), flat.vertices.len())
    };
    for _ in 0..ROUNDS_MAX {
        grow.posts(&mut grown)?;
        if grow.sides(&mut grown)? == 0 {
            break;
        }
    }
    let (part, count) = tiles(&grow.flat);
    let vertices = grow.flat.vertices.len();
    look(0.5, vertices)?;
    let mut waiting = apart(&grow.flat, &part, count).into_iter();
    drop(grow);
    let mut done: Vec<Part> = Vec::with_capacity(count);
    while done.len() < count {
        let wave: Vec<Part> = waiting.by_ref().take(WAVE_TILES).collect();
        done.par_extend(wave.into_par_iter().map(|part| shrunk(part, ground)));
        look(0.5 + 0.4 * done.len() as f64 / count as f64, vertices)?;
    }
    let (flat, seams) = together(done, vertices);
    let mut shrink = Shrink::new(flat, ground);
    for v in seams {
        shrink.take(v);
    }
    let (flat, _) = shrink.flat.compacted();
    look(0.95, flat.vertices.len())?;
    let (error_m, points) = measure(&flat, &ground);
    Ok(Laid { flat, error_m, points })
}

/// Takes out what a tile does not need.
fn shrunk(part: Part, ground: Ground) -> Part {
    let mut shrink = Shrink::new(part.flat, ground);
    // The last vertices that came are the most likely to be needed no more.
    for v in (0..part.whole.len() as u32).rev() {
        shrink.take(v);
    }
    Part { flat: shrink.flat, whole: part.whole }
}
