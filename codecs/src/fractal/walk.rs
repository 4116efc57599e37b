//! The inverse walk: the height at any point, at any depth, without its neighbours.

use super::grid::{Grid, points, strides};
use super::ifs::{Ifs, Leaf, SAMPLES_MAX, Shape};
use super::isometry::Isometry;
use super::iterate::Stop;
use crate::{Error, Result};

/// Greatest depth of a walk: a sample is divided 2^24 times along each axis.
pub const DEPTH_MAX: u32 = 24;

/// Places in a walk are whole numbers of 2 to this parts of a sample: half the finest cell.
const PARTS_LOG: u32 = DEPTH_MAX + 1;

/// In an index: the ground is flat here, and the sample at zoom 1 says how high.
pub const FLAT: u32 = u32::MAX;

/// A leaf with a map, as a walk meets it: `value(p) = offset + scale * value(domain + 2 iso(p - range))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step<const D: usize> {
    /// Corner of the range, in samples at zoom 1.
    pub range: [u32; D],
    /// Corner of the domain.
    pub domain: [u32; D],
    /// Side of the range.
    pub side: u32,
    /// Number of the isometry in its group.
    pub isometry: u8,
    /// s.
    pub scale: f64,
    /// o = m - s * mean(domain), at the fixed point.
    pub offset: f64,
}

/// A tile ready to be asked anywhere. Memory: 48 bytes a map in the plane and 60 in space, 8 a sample for its grid and at most 1 for the index; flat leaves
/// take none.
#[derive(Clone, Debug)]
pub struct Walk<const D: usize> {
    shape: Shape<D>,
    /// Those with a map.
    leaves: Vec<Leaf<D>>,
    hops: Vec<Hop<D>>,
    index: Grid32<D>,
    /// The cells of the index have a side of 2 to this, in samples.
    cell_log: u32,
    grid: Grid<D>,
    group: Vec<Isometry<D>>,
}

/// A leaf as [`Walk::value`] takes it: along axis a the next point is `shift + sign * p[axis]`. 32 bytes in the plane, so that most are met in a near cache.
#[derive(Clone, Copy, Debug)]
#[repr(align(8))]
struct Hop<const D: usize> {
    offset: f64,
    scale: f64,
    shift: [i32; D],
    sign: [i8; D],
    axis: [u8; D],
}

impl<const D: usize> Hop<D> {
    fn of(step: &Step<D>, isometry: &Isometry<D>) -> Hop<D> {
        let mut hop =
            Hop { offset: step.offset, scale: step.scale, shift: [0; D], sign: [2; D], axis: [0; D] };
        for (a, (axis, back)) in isometry.of.into_iter().enumerate() {
            let (domain, range) = (step.domain[a] as i32, step.range[axis] as i32);
            hop.axis[a] = axis as u8;
            hop.sign[a] = if back { -2 } else { 2 };
            hop.shift[a] = if back { domain + 2 * (step.side as i32 + range) } else { domain - 2 * range };
        }
        hop
    }
}

/// A leaf with its numbers in samples.
fn step<const D: usize>(shape: &Shape<D>, leaf: &Leaf<D>, offset: f64) -> Step<D> {
    let side = shape.side(usize::from(leaf.level)) as u32;
    Step {
        range: leaf.cell.map(|c| u32::from(c) * side),
        domain: leaf.domain.map(|p| u32::from(p) * shape.jump as u32),
        side,
        isometry: leaf.isometry,
        scale: shape.scales().scale(leaf.scale),
        offset,
    }
}

#[derive(Clone, Debug)]
struct Grid32<const D: usize> {
    size: [usize; D],
    of: Vec<u32>,
}

impl<const D: usize> Walk<D> {
    /// Prepares a tile: its fixed point at zoom 1, and the leaf of every place.
    pub fn new(ifs: &Ifs<D>) -> Result<Walk<D>> {
        let shape = &ifs.shape;
        let grid = ifs.iterate([1, 1], shape.mean(0), Stop::TIGHT, &mut || true)?.grid;
        Ok(Walk::of(ifs, grid))
    }

    fn of(ifs: &Ifs<D>, grid: Grid<D>) -> Walk<D> {
        let shape = ifs.shape.clone();
        let group = shape.group();
        let half = grid.half();
        let mapped = || ifs.leaves.iter().filter(|l| l.scale != 0);
        let mut leaves = Vec::with_capacity(mapped().count());
        leaves.extend(mapped().copied());
        // Samples of their own, and flat ranges, need no entry.
        let smallest = leaves.iter().map(|l| shape.side(usize::from(l.level))).min();
        let smallest = smallest.unwrap_or(shape.side(0));
        let cell_log = smallest.trailing_zeros();
        let cells = shape.padded().map(|n| n >> cell_log);
        let mut index = Grid32 { size: cells, of: vec![FLAT; cells.iter().product()] };
        let mut hops = Vec::with_capacity(leaves.len());
        let mut block = Vec::new();
        for leaf in &leaves {
            let side = shape.side(usize::from(leaf.level));
            block.resize(side.pow(D as u32), 0.0);
            let mut step = step(&shape, leaf, 0.0);
            half.block(step.domain.map(|v| v as usize / 2), side, &mut block);
            step.offset =
                shape.mean(leaf.mean) - step.scale * (block.iter().sum::<f64>() / block.len() as f64);
            let corner = step.range.map(|v| v as usize >> cell_log);
            let mut rows = [side >> cell_log; D];
            let row = rows[0];
            rows[0] = 1;
            for p in points(rows) {
                let at = (0..D).rev().fold(0, |at, a| at * index.size[a] + corner[a] + p[a]);
                index.of[at..at + row].fill(hops.len() as u32);
            }
            hops.push(Hop::of(&step, &group[usize::from(leaf.isometry)]));
        }
        Walk { shape, leaves, hops, index, cell_log, grid, group }
    }

    /// Samples of the tile along each axis.
    pub fn size(&self) -> [usize; D] {
        self.shape.size
    }

    /// The samples at zoom 1, in whole ranges of the largest side: what walks end in.
    pub fn grid(&self) -> &Grid<D> {
        &self.grid
    }

    /// The leaves with a map. All other ground is flat: every sample at zoom 1 its own height.
    pub fn steps(&self) -> impl ExactSizeIterator<Item = Step<D>> + '_ {
        self.leaves.iter().zip(&self.hops).map(|(leaf, hop)| step(&self.shape, leaf, hop.offset))
    }

    /// The number of the leaf of each cell of [`cell_side`](Walk::cell_side) samples, over the same box as [`grid`](Walk::grid); [`FLAT`] where
    /// there is none.
    pub fn index(&self) -> &[u32] {
        &self.index.of
    }

    /// Side of the cells of the index: that of the smallest range with a map.
    pub fn cell_side(&self) -> usize {
        1 << self.cell_log
    }

    /// Its isometries, by number.
    pub fn group(&self) -> &[Isometry<D>] {
        &self.group
    }

    /// The value at a point, in samples from the corner of the tile: sample (i, j) covers i to i + 1 and j to j + 1. At depth k it is that of
    /// the cell of side 2^-k that holds the point. Points outside are moved to the border.
    ///
    /// Depth 0 is the sample itself. Whatever comes below it is synthetic.
    #[inline]
    pub fn value(&self, point: [f64; D], depth: u32) -> f64 {
        let depth = depth.min(DEPTH_MAX);
        let cells = f64::from(1_u32 << depth);
        // The centre of the cell, in whole parts of a sample: mirrors keep it off edges, where the open end of a range becomes the closed one.
        let mut p: [i64; D] = std::array::from_fn(|a| {
            // A point on the far border belongs to the last sample; NaN to the first.
            let inside = point[a].max(0.0).min(self.shape.size[a] as f64 - 1e-9);
            ((inside * cells) as i64) << (PARTS_LOG - depth) | 1 << (PARTS_LOG - 1 - depth)
        });
        let (mut sum, mut factor) = (0.0, 1.0);
        for _ in 0..depth {
            let cell = |a: usize| (p[a] >> (PARTS_LOG + self.cell_log)) as usize;
            let at = (0..D).rev().fold(0, |at, a| at * self.index.size[a] + cell(a));
            // No list is as long as FLAT.
            let Some(hop) = self.hops.get(self.index.of[at] as usize) else { break };
            sum += factor * hop.offset;
            factor *= hop.scale;
            p = std::array::from_fn(|a| {
                // A choice, not an index: the point stays in registers.
                let mut along = p[0];
                for (axis, v) in p.iter().enumerate().skip(1) {
                    along = if usize::from(hop.axis[a]) == axis { *v } else { along };
                }
                (i64::from(hop.shift[a]) << PARTS_LOG) + i64::from(hop.sign[a]) * along
            });
        }
        let at = (0..D).rev().fold(0, |at, a| at * self.grid.size[a] + (p[a] >> PARTS_LOG) as usize);
        sum + factor * self.grid.values[at]
    }

    /// The depth at which a walk is as fine as samples `wanted` apart are: 0 if the tile's own are `step` apart and that is finer.
    pub fn depth(step: f64, wanted: f64) -> u32 {
        let mut depth = 0;
        let mut reached = step;
        while reached > wanted && depth < DEPTH_MAX {
            reached /= 2.0;
            depth += 1;
        }
        depth
    }

    /// All samples at zoom 2^k: k passes of single fetches, each from the one before. The whole box in whole ranges.
    pub fn doubled(&self, k: u32) -> Result<Grid<D>> {
        let samples = self.grid.values.len() as u64;
        let wanted =
            samples.saturating_mul(1_u64.checked_shl(k.saturating_mul(D as u32)).unwrap_or(u64::MAX));
        if wanted > 2 * SAMPLES_MAX {
            return Err(Error::Limit {
                what: "samples of a decoded tile; take a smaller zoom or a window",
                limit: 2 * SAMPLES_MAX,
                wanted,
            });
        }
        let mut grid = self.grid.clone();
        for pass in 0..k {
            grid = self.twice(&grid, 1 << pass);
        }
        Ok(grid)
    }

    /// From zoom z to 2z.
    fn twice(&self, from: &Grid<D>, zoom: usize) -> Grid<D> {
        let mut out = Grid::filled(from.size.map(|n| 2 * n), 0.0);
        let to_strides = strides(out.size);
        // What is flat stays as high as it is.
        let mut rows = out.size;
        let row = rows[0];
        rows[0] = 1;
        for (p, to) in points(rows).zip(out.values.chunks_exact_mut(row)) {
            let at = from.at(p.map(|v| v / 2));
            for (to, v) in to.chunks_exact_mut(2).zip(&from.values[at..at + row / 2]) {
                to.fill(*v);
            }
        }
        for step in self.steps() {
            let side = step.side as usize * 2 * zoom;
            let (start, steps) = self.group[usize::from(step.isometry)].steps(strides(from.size), side);
            let start = (from.at(step.domain.map(|v| v as usize * zoom)) + start) as isize;
            let to = out.at(step.range.map(|v| v as usize * 2 * zoom));
            let mut rows = [side; D];
            rows[0] = 1;
            for p in points(rows) {
                let at = to + (1..D).map(|a| p[a] * to_strides[a]).sum::<usize>();
                let row = start + (1..D).map(|a| p[a] as isize * steps[a]).sum::<isize>();
                let out = &mut out.values[at..at + side];
                for (x, v) in out.iter_mut().enumerate() {
                    *v = step.offset + step.scale * from.values[(row + x as isize * steps[0]) as usize];
                }
            }
        }
        out
    }
}
