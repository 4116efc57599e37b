//! Synthetic detail below the sample distance, held to the tile's own spectrum octave by octave (specification, sections 7 and 8 F7).
//!
//! The maps of a fractal tile say something at every zoom, and on terrain they say too much: plain zooming has up to 16 times the power
//! of the real ground below the sample distance. So heights come from the samples by [`doubled`], which keeps every sample as
//! the mean of its cell, and of the maps only the texture is taken, with a gain for each octave:
//!
//! ```text
//! x_0 = the tile,     x_o = doubled(x_(o-1)) + g_o h_o
//! e_0 = x_0 - doubled(half(x_0)),     e_o = the maps without their means, applied to e_(o-1)
//! h_o = e_o smoothed, less doubled(half(of that))
//! ```
//!
//! `e_0` is what the finest octave of the tile holds that its half does not foretell. The maps carry it one octave down at each step.
//! Taking it before the maps and not after them keeps the edges of ranges out of it: there plain zooming has cliffs. Each `h_o` has
//! mean zero over every cell of the octave before, so the 2^k x 2^k means of the result are the tile.
//!
//! The gain: the power of `e` in the tile's two finest octaves, measured alike, has a ratio q. The next octave should have q times
//! the power of the one before, and gets three quarters of it ([`SHARE`]). Box filtering of the source weakens both measured octaves
//! alike and leaves q as it is.
//!
//! What comes out is **no measurement**. It has the roughness of the ground, not its shape.

mod doubled;

pub use doubled::doubled;

use super::grid::{Grid, points, strides};
use super::tile::{Tile, cropped};
use super::walk::Walk;
use crate::{Error, Result};

/// Of the power that an octave should have by extrapolation, the share that is given. Detail that has nothing to do with the truth adds
/// its whole power to the squared error; three quarters of it keep the error within 1.25 times that of bicubic interpolation on most grids.
pub const SHARE: f64 = 0.75;
/// Greatest gain. Where most ranges are flat, the few that are not must not carry the power of all.
pub const GAIN_MAX: f64 = 8.0;
/// Tiles with fewer samples along an axis have no spectrum to go by: their gains are 0.
pub const SIDE_MIN: usize = 8;
/// Most octaves.
pub const OCTAVES_MAX: u32 = 8;
/// Most samples of a result.
pub const SAMPLES_MAX: u64 = 1 << 26;

/// A tile with synthetic detail.
#[derive(Clone, Debug, PartialEq)]
pub struct Detailed {
    /// Samples of the tile's size times 2^octaves. Sample (i, j) covers i / 2^octaves and j / 2^octaves onwards of the tile.
    pub grid: Grid<2>,
    /// The gain of each octave.
    pub gains: Vec<f64>,
    /// The power that each octave's detail has, in squared units of the samples.
    pub powers: Vec<f64>,
}

/// Adds `octaves` octaves of detail to `tile`: the heights at zoom 1 as they were decoded, best with their residual. They need not be
/// those that the maps alone come to.
///
/// Samples are means of cells. The 2 x 2 mean of the result with k octaves is the result with k - 1, to rounding; with none it is the tile.
/// Time: about 60 operations a sample of the result. Memory: 4 grids of the result's size.
///
/// ```
/// # use terraquilt_codecs::fractal::{Options, Tile, encode_heights};
/// # use terraquilt_codecs::{heights::{Heights, Place}, work::Alone};
/// # fn main() -> terraquilt_codecs::Result<()> {
/// let z = (0..1024).map(|k| 3 * (k / 32) + k % 32 * (k % 7)).collect();
/// let options = Options { bound: Some(0), ..Options::default() };
/// let file = encode_heights(&Heights::new(32, 32, z), &Place::default(), &[], &options, &Alone)?;
/// let fine = Tile::read(&file.bytes)?.detailed(2)?;
/// assert_eq!(fine.grid.size, [128, 128]);
/// # Ok(())
/// # }
/// ```
pub fn detailed(walk: &Walk<2>, tile: &Grid<2>, octaves: u32) -> Result<Detailed> {
    check(walk, tile, octaves)?;
    let [finest, before] = own_powers(tile);
    // Detail never grows from octave to octave.
    let ratio = if before > 0.0 { (finest / before).min(1.0) } else { 0.0 };
    let mut wanted = finest * SHARE;
    let mut carried = in_whole_ranges(&novelty(tile), walk.grid().size);
    let mut out = Detailed { grid: tile.clone(), gains: Vec::new(), powers: Vec::new() };
    for octave in 0..octaves {
        wanted *= ratio;
        carried = applied(walk, &carried, 1 << octave);
        let size = out.grid.size.map(|n| 2 * n);
        let detail = novelty(&smoothed(&cropped(carried.clone(), size)));
        let power = mean_square(&detail);
        let gain = if power > 0.0 { (wanted / power).sqrt().min(GAIN_MAX) } else { 0.0 };
        let mut grid = doubled(&out.grid);
        for (v, d) in grid.values.iter_mut().zip(&detail.values) {
            *v += gain * d;
        }
        out.grid = grid;
        out.gains.push(gain);
        out.powers.push(gain * gain * power);
    }
    Ok(out)
}

impl Tile {
    /// The heights with `octaves` octaves of synthetic detail, in units: see [`detailed`]. Of a bounded tile the heights are those within the
    /// bound. Voids come filled, as their maps fill them.
    pub fn detailed(&self, octaves: u32) -> Result<Detailed> {
        let heights = if self.header.bound.is_some() {
            let h = self.heights()?;
            Grid { size: [h.cols, h.rows], values: h.z.iter().map(|z| f64::from(*z)).collect() }
        } else {
            self.plane(0)?
        };
        detailed(&self.walk(0)?, &heights, octaves)
    }
}

fn check(walk: &Walk<2>, tile: &Grid<2>, octaves: u32) -> Result<()> {
    if tile.size != walk.size() || tile.values.len() as u64 != tile.size.iter().map(|n| *n as u64).product() {
        return Err(Error::invalid(
            "tile",
            format!("{:?} samples, the maps are of {:?}; give the heights at zoom 1", tile.size, walk.size()),
        ));
    }
    if octaves > OCTAVES_MAX {
        return Err(Error::Limit {
            what: "octaves of detail",
            limit: u64::from(OCTAVES_MAX),
            wanted: u64::from(octaves),
        });
    }
    let samples: u64 = walk.grid().size.iter().map(|n| (*n as u64) << octaves).product();
    if samples > SAMPLES_MAX {
        return Err(Error::Limit {
            what: "samples with detail; take fewer octaves or a smaller tile",
            limit: SAMPLES_MAX,
            wanted: samples,
        });
    }
    Ok(())
}

/// Mean squares of what the two finest octaves hold that is new, the finest first; zeros where a tile is too small to tell.
fn own_powers(tile: &Grid<2>) -> [f64; 2] {
    if tile.size.iter().any(|n| *n < SIDE_MIN) {
        return [0.0; 2];
    }
    [mean_square(&novelty(tile)), mean_square(&novelty(&tile.half()))]
}

/// What a grid's half does not foretell. An odd column or row at the end has none.
fn novelty(grid: &Grid<2>) -> Grid<2> {
    let foretold = doubled(&grid.half());
    let mut out = Grid::filled(grid.size, 0.0);
    for p in points(foretold.size) {
        let at = out.at(p);
        out.values[at] = grid.values[at] - foretold.values[foretold.at(p)];
    }
    out
}

fn mean_square(grid: &Grid<2>) -> f64 {
    let sum: f64 = grid.values.iter().map(|v| v * v).sum();
    sum / (grid.values.len().max(1)) as f64
}

/// The same values in a box at least as large, zeros beyond.
fn in_whole_ranges(grid: &Grid<2>, size: [usize; 2]) -> Grid<2> {
    let mut out = Grid::filled(size, 0.0);
    for (to, from) in out.values.chunks_exact_mut(size[0]).zip(grid.values.chunks_exact(grid.size[0])) {
        to[..grid.size[0]].copy_from_slice(from);
    }
    out
}

/// The linear part of all maps: from the octave at `zoom` to that at twice the zoom. Flat ranges get none.
fn applied(walk: &Walk<2>, from: &Grid<2>, zoom: usize) -> Grid<2> {
    let mut out = Grid::filled(from.size.map(|n| 2 * n), 0.0);
    let to_strides = strides(out.size);
    for step in walk.steps() {
        let side = step.side as usize * 2 * zoom;
        let isometry = &walk.group()[usize::from(step.isometry)];
        let (start, steps) = isometry.steps(strides(from.size), side);
        let start = (from.at(step.domain.map(|v| v as usize * zoom)) + start) as isize;
        let to = out.at(step.range.map(|v| v as usize * 2 * zoom));
        for y in 0..side {
            let row = start + y as isize * steps[1];
            let at = to + y * to_strides[1];
            for (x, v) in out.values[at..at + side].iter_mut().enumerate() {
                *v = step.scale * from.values[(row + x as isize * steps[0]) as usize];
            }
        }
    }
    out
}

/// Each sample with its neighbours, weights 1 2 1 along both axes: power within an octave falls as on terrain.
fn smoothed(grid: &Grid<2>) -> Grid<2> {
    let [cols, rows] = grid.size;
    let mut across = Grid::filled(grid.size, 0.0);
    for (to, from) in across.values.chunks_exact_mut(cols).zip(grid.values.chunks_exact(cols)) {
        for (x, v) in to.iter_mut().enumerate() {
            *v = weighed(from[x.saturating_sub(1)], from[x], from[(x + 1).min(cols - 1)]);
        }
    }
    let mut out = Grid::filled(grid.size, 0.0);
    for (y, to) in out.values.chunks_exact_mut(cols).enumerate() {
        let row = |y: usize| &across.values[y * cols..][..cols];
        let (above, own, below) = (row(y.saturating_sub(1)), row(y), row((y + 1).min(rows - 1)));
        for (x, v) in to.iter_mut().enumerate() {
            *v = weighed(above[x], own[x], below[x]);
        }
    }
    out
}

#[inline(always)]
fn weighed(before: f64, own: f64, after: f64) -> f64 {
    0.25 * before + 0.5 * own + 0.25 * after
}
