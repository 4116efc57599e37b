//! From maps to samples: all leaves applied again and again, until nothing changes.
//!
//! One application at zoom z commutes with the mean over 2 x 2 samples, so what is found at half the zoom is the half of what would be
//! found at the whole one: passes are made there, and the last step up is one more. Where domains begin at odd samples of the half zoom,
//! means are taken of the boxes at all places, not only at even ones.

use super::grid::{Grid, points, strides};
use super::ifs::{Ifs, Leaf};
use super::isometry::Isometry;
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

/// A zoom in lowest terms.
fn lowest([a, b]: [usize; 2]) -> [usize; 2] {
    let (mut divisor, mut rest) = (a, b);
    while rest > 0 {
        (divisor, rest) = (rest, divisor % rest);
    }
    [a / divisor.max(1), b / divisor.max(1)]
}

/// Leaves between two questions whether to go on.
const LEAVES: usize = 4096;

impl<const D: usize> Ifs<D> {
    /// Whether every range and every domain is whole samples at the zoom a / b.
    pub fn zooms(&self, zoom: [usize; 2]) -> bool {
        let s = &self.shape;
        let [a, b] = lowest(zoom);
        // Four samples of their own are one at half the zoom.
        let smallest = match [a, b] {
            [1, 2] => self.smallest(),
            _ if self.units.is_empty() => self.smallest(),
            _ => 1,
        };
        // In lowest terms a times n is whole bs where n is.
        a > 0 && b > 0 && [smallest, s.jump].into_iter().chain(s.padded()).all(|n| n.is_multiple_of(b))
    }

    fn smallest(&self) -> usize {
        self.leaves.iter().map(|l| self.shape.side(usize::from(l.level))).min().unwrap_or(2)
    }

    /// Iterates at zoom a / b from a flat seed. `going` is asked every few thousand leaves; when it says no, what is there is returned.
    ///
    /// Any zoom works at which ranges and domains are whole samples ([`zooms`](Ifs::zooms)); with the default jump of 4 multiples of 1/2 for
    /// ranges of 2 and more. Memory: 10 bytes a sample of the result beside the leaves, 12 at zoom 1 where the jump is no multiple of 4.
    pub fn iterate(
        &self,
        zoom: [usize; 2],
        seed: f64,
        stop: Stop,
        going: &mut dyn FnMut() -> bool,
    ) -> Result<Iterated<D>> {
        let zoom = lowest(zoom);
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
        if zoom == [1, 1] {
            let half = self.passes([1, 2], Grid::filled(size.map(|n| n / 2), seed), stop, going);
            let mut grid = Grid::filled(size, 0.0);
            let finished = self.step_up(&half, &mut grid.values, &mut |v, new| *v = new, going);
            return Ok(Iterated { grid, passes: half.passes + 1, change: half.change, finished });
        }
        Ok(self.passes(zoom, Grid::filled(size, seed), stop, going))
    }

    /// The samples at zoom 1 rounded to whole units, in whole ranges of the largest side; a half goes away from zero. Memory: 7 bytes a sample
    /// beside the leaves.
    pub fn rounded(&self, seed: f64, stop: Stop) -> Result<Vec<i32>> {
        let size = self.zoomed([1, 1])?;
        let mut out = vec![0; size.iter().product()];
        self.rounded_onto(seed, stop, 0, &mut out)?;
        Ok(out)
    }

    /// As [`rounded`](Ifs::rounded), each sample plus `step` times what stands in its place in `out`. Memory beside that and the leaves: 2.5 bytes
    /// a sample, 4 where the jump is no multiple of 4.
    ///
    /// # Errors
    /// Invalid if `out` has another length.
    pub(super) fn rounded_onto(&self, seed: f64, stop: Stop, step: i64, out: &mut [i32]) -> Result<()> {
        let size = self.zoomed([1, 1])?;
        let wanted = size.iter().product();
        if out.len() != wanted {
            return Err(Error::invalid("samples", format!("{}; {wanted} are needed", out.len())));
        }
        let half = self.passes([1, 2], Grid::filled(size.map(|n| n / 2), seed), stop, &mut || true);
        let mut put = |v: &mut i32, new: f64| {
            let sum = i64::from(new.round() as i32) + i64::from(*v) * step;
            *v = sum.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
        };
        self.step_up(&half, out, &mut put, &mut || true);
        Ok(())
    }

    /// Iterates on from samples at zoom 1 that are there, as an earlier call gave them.
    pub fn iterate_on(
        &self,
        seed: Grid<D>,
        stop: Stop,
        going: &mut dyn FnMut() -> bool,
    ) -> Result<Iterated<D>> {
        if seed.size != self.shape.padded() || seed.values.len() != seed.size.iter().product() {
            return Err(Error::invalid(
                "seed",
                format!(
                    "{:?} samples in {} values; {:?} are needed, the size in whole ranges",
                    seed.size,
                    seed.values.len(),
                    self.shape.padded()
                ),
            ));
        }
        Ok(self.passes([1, 1], seed, stop, going))
    }

    fn zoomed(&self, [a, b]: [usize; 2]) -> Result<[usize; D]> {
        let size = self.shape.padded().map(|n| (n as u64).saturating_mul(a as u64) / b as u64);
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

    /// The samples at zoom 1, of half of them: each leaf once. `put` gets each sample and its value.
    fn step_up<T: Copy>(
        &self,
        half: &Iterated<D>,
        out: &mut [T],
        put: &mut impl FnMut(&mut T, f64),
        going: &mut dyn FnMut() -> bool,
    ) -> bool {
        let mut to = Target { size: self.shape.padded(), zoom: [1, 1], out };
        self.constants(&mut to, put);
        let group = self.shape.group();
        let mut finished = half.finished;
        for part in self.leaves.chunks(LEAVES) {
            finished &= going();
            for leaf in part.iter().filter(|l| l.scale != 0) {
                // Beyond the time that there is, flat.
                let isometry = finished.then(|| &group[usize::from(leaf.isometry)]);
                self.apply(leaf, isometry, &Means { of: &half.grid, apart: 1 }, &mut to, put);
            }
        }
        finished
    }

    fn passes(
        &self,
        zoom: [usize; 2],
        mut grid: Grid<D>,
        stop: Stop,
        going: &mut dyn FnMut() -> bool,
    ) -> Iterated<D> {
        let group = self.shape.group();
        let size = grid.size;
        self.constants(&mut Target { size, zoom, out: &mut grid.values }, &mut |v, new| *v = new);
        // Domains that begin between the boxes of two by two.
        let odd = !(self.shape.jump / 2 * zoom[0]).is_multiple_of(zoom[1]);
        let mut means = if odd { grid.boxes() } else { grid.half() };
        let count = grid.values.len() as f64;
        let (mut passes, mut change) = (0, f64::INFINITY);
        while passes < stop.passes_max && (change >= stop.change || passes == 0) {
            if passes > 0 && odd {
                grid.boxes_into(&mut means.values);
            } else if passes > 0 {
                grid.half_into(&mut means.values);
            }
            let mut sum = 0.0;
            let mut put = |v: &mut f64, new: f64| {
                sum += (new - *v).abs();
                *v = new;
            };
            for part in self.leaves.chunks(LEAVES) {
                if !going() {
                    return Iterated { grid, passes, change, finished: false };
                }
                let mut to = Target { size, zoom, out: &mut grid.values };
                let from = Means { of: &means, apart: if odd { 2 } else { 1 } };
                for leaf in part.iter().filter(|l| l.scale != 0) {
                    self.apply(leaf, Some(&group[usize::from(leaf.isometry)]), &from, &mut to, &mut put);
                }
            }
            change = sum / count;
            passes += 1;
        }
        Iterated { grid, passes, change, finished: true }
    }

    /// Writes what no pass changes: flat ranges, and single samples.
    fn constants<T: Copy>(&self, to: &mut Target<'_, T, D>, put: &mut impl FnMut(&mut T, f64)) {
        let [a, b] = to.zoom;
        for leaf in self.leaves.iter().filter(|l| l.scale == 0) {
            let side = self.shape.side(usize::from(leaf.level)) * a / b;
            let value = self.shape.mean(leaf.mean);
            to.fill(leaf.cell.map(|c| usize::from(c) * side), side, |v| put(v, value));
        }
        for (corner, means) in self.units.iter().zip(self.unit_means.chunks_exact(1 << D)) {
            let corner = corner.map(usize::from);
            if 2 * a == b {
                let sum: f64 = means.iter().map(|m| self.shape.mean(*m)).sum();
                to.fill(corner, 1, |v| put(v, sum / (1 << D) as f64));
                continue;
            }
            for (k, mean) in means.iter().enumerate() {
                let cell: [usize; D] = std::array::from_fn(|x| (2 * corner[x] + (k >> x & 1)) * a / b);
                to.fill(cell, a / b, |v| put(v, self.shape.mean(*mean)));
            }
        }
    }

    /// Applies one map; without isometry the range becomes flat.
    #[inline]
    fn apply<T: Copy>(
        &self,
        leaf: &Leaf<D>,
        isometry: Option<&Isometry<D>>,
        half: &Means<'_, D>,
        to: &mut Target<'_, T, D>,
        put: &mut impl FnMut(&mut T, f64),
    ) {
        let [a, b] = to.zoom;
        let side = self.shape.side(usize::from(leaf.level)) * a / b;
        let corner = leaf.cell.map(|c| usize::from(c) * side);
        let mean = self.shape.mean(leaf.mean);
        let Some(isometry) = isometry else {
            return to.fill(corner, side, |v| put(v, mean));
        };
        let s = self.shape.scales().scale(leaf.scale);
        let domain = leaf.domain.map(|p| usize::from(p) * (self.shape.jump / 2) * half.apart * a / b);
        let (from, steps) = isometry.steps(strides(half.of.size).map(|n| n * half.apart), side);
        let from = (half.of.at(domain) + from) as isize;
        let half = &half.of.values;
        let to_steps = strides(to.size);
        let first: usize = (0..D).map(|a| corner[a] * to_steps[a]).sum();
        let third = if D > 2 { side } else { 1 };
        let step = |a: usize| if a < D { steps[a] } else { 0 };
        let to_step = |a: usize| if a < D { to_steps[a] } else { 0 };
        let mut sum = 0.0;
        for z in 0..third {
            for y in 0..side {
                let row = from + z as isize * step(2) + y as isize * step(1);
                for x in 0..side {
                    sum += half[(row + x as isize * step(0)) as usize];
                }
            }
        }
        let offset = mean - s * (sum / (side * side * third) as f64);
        for z in 0..third {
            for y in 0..side {
                let row = from + z as isize * step(2) + y as isize * step(1);
                let start = first + z * to_step(2) + y * to_step(1);
                for (x, v) in to.out[start..start + side].iter_mut().enumerate() {
                    put(v, offset + s * half[(row + x as isize * step(0)) as usize]);
                }
            }
        }
    }
}

/// Means over 2 x 2 samples: of every second box, or of all, where those that a domain reads are two apart.
struct Means<'a, const D: usize> {
    of: &'a Grid<D>,
    apart: usize,
}

/// Samples that are made, at the zoom a / b.
struct Target<'a, T, const D: usize> {
    size: [usize; D],
    zoom: [usize; 2],
    out: &'a mut [T],
}

impl<T, const D: usize> Target<'_, T, D> {
    /// Visits the samples of a cube.
    fn fill(&mut self, corner: [usize; D], side: usize, mut put: impl FnMut(&mut T)) {
        let mut rows = [side; D];
        rows[0] = 1;
        for p in points(rows) {
            let at = (0..D).rev().fold(0, |at, a| at * self.size[a] + corner[a] + p[a]);
            self.out[at..at + side].iter_mut().for_each(&mut put);
        }
    }
}
