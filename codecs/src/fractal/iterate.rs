//! From maps to samples: all leaves applied again and again, until nothing changes.
//!
//! One application at zoom z commutes with the mean over 2 x 2 samples, so what is found at half the zoom is the half of what would be
//! found at the whole one: passes are made there, and the last step up is one more.

use super::grid::{Grid, points, strides};
use super::ifs::{Ifs, Leaf};
use super::isometry::Isometry;
use super::scale::scale;
use crate::{Error, Result};

/// When passes end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    /// The mean change of a sample by one pass is below this, in units.
    pub change: f64,
    /// So many passes were made.
    pub passes_max: usize,
}

impl Stop {
    /// As published: 0.002 units.
    pub const PUBLISHED: Stop = Stop { change: 0.002, passes_max: 64 };
    /// As near to the fixed point as doubles come: what zooms above 1 begin with.
    pub const TIGHT: Stop = Stop { change: 1e-10, passes_max: 200 };

    /// A number of passes, whatever they change.
    pub fn passes(n: usize) -> Stop {
        Stop { change: 0.0, passes_max: n }
    }
}

/// What passes came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Iterated<const D: usize> {
    /// The samples: the padded size times the zoom.
    pub grid: Grid<D>,
    /// Passes made.
    pub passes: usize,
    /// The mean change by the last pass, in units.
    pub change: f64,
    /// Whether `going` let it end.
    pub finished: bool,
}

/// Leaves between two questions whether to go on.
const LEAVES: usize = 4096;

impl<const D: usize> Ifs<D> {
    /// Whether every range and every domain is whole samples at the zoom a / b.
    pub fn zooms(&self, [a, b]: [usize; 2]) -> bool {
        let s = &self.shape;
        let smallest = if self.units.is_empty() { self.smallest() } else { 1 };
        a > 0
            && b > 0
            && smallest * a % b == 0
            && (s.jump / 2 * a).is_multiple_of(b)
            && s.padded().iter().all(|n| n * a % b == 0)
    }

    fn smallest(&self) -> usize {
        self.leaves.iter().map(|l| self.shape.side(usize::from(l.level))).min().unwrap_or(1)
    }

    /// Iterates at zoom a / b from a flat seed. `going` is asked every few thousand leaves; when it says no, what is there is returned.
    ///
    /// Any zoom works at which ranges and domains are whole samples ([`zooms`](Ifs::zooms)); with the default jump of 4 multiples of 1/2 for
    /// ranges of 2 and more. Memory: 10 bytes a sample of the result beside the leaves.
    pub fn iterate(
        &self,
        zoom: [usize; 2],
        seed: f64,
        stop: Stop,
        going: &mut dyn FnMut() -> bool,
    ) -> Result<Iterated<D>> {
        let [a, b] = zoom;
        if !self.zooms(zoom) {
            return Err(Error::invalid(
                "zoom",
                format!(
                    "{a}/{b}; ranges of {} samples and domains every {} are not whole there; take a multiple of 1/2, or ask point by point",
                    if self.units.is_empty() { self.smallest() } else { 1 },
                    self.shape.jump
                ),
            ));
        }
        let size = self.zoomed(zoom)?;
        if zoom == [1, 1] && self.halves() {
            let half = self.passes([1, 2], Grid::filled(size.map(|n| n / 2), seed), stop, going);
            return Ok(self.step_up(half, going));
        }
        Ok(self.passes(zoom, Grid::filled(size, seed), stop, going))
    }

    /// Iterates on from samples at zoom 1 that are there, as an earlier call gave them.
    pub fn iterate_on(
        &self,
        seed: Grid<D>,
        stop: Stop,
        going: &mut dyn FnMut() -> bool,
    ) -> Result<Iterated<D>> {
        if seed.size != self.shape.padded() {
            return Err(Error::invalid(
                "seed",
                format!(
                    "{:?} samples; {:?} are needed, the size in whole ranges",
                    seed.size,
                    self.shape.padded()
                ),
            ));
        }
        Ok(self.passes([1, 1], seed, stop, going))
    }

    fn zoomed(&self, [a, b]: [usize; 2]) -> Result<[usize; D]> {
        let size = self.shape.padded().map(|n| n as u64 * a as u64 / b as u64);
        let samples = size.iter().fold(1, |n: u64, s| n.saturating_mul(*s));
        if samples > super::ifs::SAMPLES_MAX * 2 {
            return Err(Error::Limit {
                what: "samples of a decoded tile; take a smaller zoom or a window",
                limit: super::ifs::SAMPLES_MAX * 2,
                wanted: samples,
            });
        }
        Ok(size.map(|n| n as usize))
    }

    /// Whether passes can be made at half the zoom: domains begin at multiples of 4. Ranges of single samples are constants there.
    fn halves(&self) -> bool {
        self.shape.jump % 4 == 0
    }

    fn step_up(&self, half: Iterated<D>, going: &mut dyn FnMut() -> bool) -> Iterated<D> {
        let mut grid = Grid::filled(self.shape.padded(), 0.0);
        self.constants([1, 1], &mut grid);
        let group = self.shape.group();
        let mut finished = half.finished;
        for part in self.leaves.chunks(LEAVES) {
            finished &= going();
            for leaf in part.iter().filter(|l| l.scale != 0) {
                // Beyond the time that there is, flat.
                let isometry = finished.then(|| &group[usize::from(leaf.isometry)]);
                self.apply(leaf, [1, 1], isometry, &half.grid, &mut grid);
            }
        }
        Iterated { grid, passes: half.passes + 1, change: half.change, finished }
    }

    fn passes(
        &self,
        zoom: [usize; 2],
        mut grid: Grid<D>,
        stop: Stop,
        going: &mut dyn FnMut() -> bool,
    ) -> Iterated<D> {
        let group = self.shape.group();
        self.constants(zoom, &mut grid);
        let mut half = grid.half();
        let count = grid.values.len() as f64;
        let (mut passes, mut change) = (0, f64::INFINITY);
        while passes < stop.passes_max && (change >= stop.change || passes == 0) {
            if passes > 0 {
                grid.half_into(&mut half.values);
            }
            let mut sum = 0.0;
            for part in self.leaves.chunks(LEAVES) {
                if !going() {
                    return Iterated { grid, passes, change, finished: false };
                }
                for leaf in part.iter().filter(|l| l.scale != 0) {
                    sum += self.apply(leaf, zoom, Some(&group[usize::from(leaf.isometry)]), &half, &mut grid);
                }
            }
            change = sum / count;
            passes += 1;
        }
        Iterated { grid, passes, change, finished: true }
    }

    /// Writes what no pass changes: flat ranges, and single samples.
    fn constants(&self, [a, b]: [usize; 2], grid: &mut Grid<D>) {
        for leaf in self.leaves.iter().filter(|l| l.scale == 0) {
            let side = self.shape.side(usize::from(leaf.level)) * a / b;
            fill(grid, leaf.cell.map(|c| usize::from(c) * side), side, self.shape.mean(leaf.mean));
        }
        for (corner, means) in self.units.iter().zip(self.unit_means.chunks_exact(1 << D)) {
            let corner = corner.map(usize::from);
            if 2 * a == b {
                let sum: f64 = means.iter().map(|m| self.shape.mean(*m)).sum();
                let at = grid.at(corner);
                grid.values[at] = sum / (1 << D) as f64;
                continue;
            }
            for (k, mean) in means.iter().enumerate() {
                let cell: [usize; D] = std::array::from_fn(|x| (2 * corner[x] + (k >> x & 1)) * a / b);
                fill(grid, cell, a / b, self.shape.mean(*mean));
            }
        }
    }

    /// Applies one map; without isometry the range becomes flat. Returns by how much its samples changed together.
    #[inline]
    fn apply(
        &self,
        leaf: &Leaf<D>,
        [a, b]: [usize; 2],
        isometry: Option<&Isometry<D>>,
        half: &Grid<D>,
        out: &mut Grid<D>,
    ) -> f64 {
        let side = self.shape.side(usize::from(leaf.level)) * a / b;
        let corner = leaf.cell.map(|c| usize::from(c) * side);
        let mean = self.shape.mean(leaf.mean);
        let Some(isometry) = isometry else {
            fill(out, corner, side, mean);
            return 0.0;
        };
        let s = scale(leaf.scale);
        let domain = leaf.domain.map(|p| usize::from(p) * (self.shape.jump / 2) * a / b);
        let (from, steps) = isometry.steps(strides(half.size), side);
        let from = (half.at(domain) + from) as isize;
        let to = out.at(corner);
        let to_steps = strides(out.size);
        let third = if D > 2 { side } else { 1 };
        let (step, to_step) =
            (|a: usize| if a < D { steps[a] } else { 0 }, |a: usize| if a < D { to_steps[a] } else { 0 });
        let mut sum = 0.0;
        for z in 0..third {
            for y in 0..side {
                let row = from + z as isize * step(2) + y as isize * step(1);
                for x in 0..side {
                    sum += half.values[(row + x as isize * step(0)) as usize];
                }
            }
        }
        let cells = (side * side * third) as f64;
        let offset = mean - s * (sum / cells);
        let mut change = 0.0;
        for z in 0..third {
            for y in 0..side {
                let row = from + z as isize * step(2) + y as isize * step(1);
                let start = to + z * to_step(2) + y * to_step(1);
                for (x, v) in out.values[start..start + side].iter_mut().enumerate() {
                    let new = offset + s * half.values[(row + x as isize * step(0)) as usize];
                    change += (new - *v).abs();
                    *v = new;
                }
            }
        }
        change
    }
}

/// Fills a cube.
fn fill<const D: usize>(grid: &mut Grid<D>, corner: [usize; D], side: usize, value: f64) {
    let mut rows = [side; D];
    rows[0] = 1;
    for p in points(rows) {
        let mut q = corner;
        (0..D).for_each(|a| q[a] += p[a]);
        let at = grid.at(q);
        grid.values[at..at + side].fill(value);
    }
}
