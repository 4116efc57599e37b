//! Which ranges are split, and which map each gets (specification section 2.2 to 2.4).

use super::encode::Options;
use super::grid::{Grid, points};
use super::ifs::Shape;
use super::matching::{Level, Match, Search};
use super::tree::{MEAN_MAX, Node, Source};
use crate::work::Workers;
use crate::{Error, Result};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Where splitting ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Partition {
    /// At so many maps; the range with the greatest squared error is split first.
    Maps(usize),
    /// Where the root mean square error of a range is at most this, in units.
    Tolerance(f64),
    /// All ranges have this side.
    Const(usize),
    /// Where a bit more takes less than this from the squared error, in units squared.
    Slope(f64),
}

impl Partition {
    /// Refuses tolerances and slopes that are no numbers, or below 0.
    pub(super) fn check(self) -> Result<()> {
        match self {
            Partition::Tolerance(v) | Partition::Slope(v) if !(v >= 0.0 && v.is_finite()) => {
                Err(Error::invalid("partition", format!("{self:?}; a finite number from 0 is needed")))
            }
            _ => Ok(()),
        }
    }
}

/// What a range could be.
#[derive(Clone, Copy, Debug)]
struct Range<const D: usize> {
    /// Squared error of the range by its mean as stored.
    flat: f64,
    /// What the rounding of the mean costs.
    rounding: f64,
    /// Whether its samples differ.
    uneven: bool,
    near: Option<Match<D>>,
    pool: Option<Match<D>>,
    /// Weight of a sample, the mean of the range's.
    weight: f64,
}

/// The ranges of one level.
struct Ranges<const D: usize> {
    means: Vec<i32>,
    candidates: Vec<Range<D>>,
}

/// Ranges, what they are, and their means: what the stream takes.
pub(super) struct Plan<const D: usize> {
    levels: Vec<Vec<Node<D>>>,
    means: Vec<Vec<i32>>,
}

impl<const D: usize> Source<D> for Plan<D> {
    fn mean(&self, level: usize, at: usize) -> i32 {
        self.means[level][at]
    }
    fn node(&self, level: usize, at: usize) -> Node<D> {
        self.levels[level][at]
    }
}

/// Among the maps of a range the price of a bit, as a part of what the last split took for one: maps are counted, bits are not.
const MAP_SLOPE: f64 = 0.3;
/// Bits of a flat range, its kind and its mean: what a range costs at least.
const FLAT_BITS: f64 = 4.0;
/// Bits of a level of s and of the kind of a map.
const SCALE_BITS: f64 = 5.0;

/// What all ranges of a tile could be.
pub(super) struct Candidates<'a, const D: usize> {
    shape: &'a Shape<D>,
    ranges: Vec<Ranges<D>>,
}

impl<'a, const D: usize> Candidates<'a, D> {
    /// Matches the ranges of a padded grid. `weights`: of each sample, 1 for common ones, more in regions of interest, 0 for what is no data; empty: all 1.
    pub fn search(
        shape: &'a Shape<D>,
        grid: &Grid<D>,
        weights: &[f32],
        options: &Options,
        workers: &dyn Workers,
    ) -> Result<Candidates<'a, D>> {
        let half = grid.half();
        let group = shape.group();
        let levels = shape.levels();
        let mut all: Vec<Ranges<D>> = Vec::new();
        for level in 0..levels {
            let domains = shape.domains(level);
            let match_with = Level { grid, half: &half, domains, isometries: &group, scales: shape.scales() };
            let mut ranges = measured(shape, grid, weights, level);
            let wanted: Vec<usize> = match options.partition {
                Some(Partition::Const(_)) if level + 1 < levels => Vec::new(),
                // A range within the tolerance is not split: what it would be split into is not asked.
                Some(Partition::Tolerance(t)) if level > 0 => below(shape, level, &all[level - 1], t),
                _ => (0..ranges.candidates.len()).collect(),
            };
            let (cells, side) = (shape.cells(level), shape.side(level));
            // Nothing is like a range that is even, or of no weight.
            let wanted: Vec<usize> = wanted
                .into_iter()
                .filter(|k| ranges.candidates[*k].weight > 0.0 && ranges.candidates[*k].uneven)
                .collect();
            let corners: Vec<[usize; D]> =
                wanted.iter().map(|k| place(cells, *k).map(|v| v * side)).collect();
            if !domains.is_empty() && side > 1 {
                let part = |half: usize| Part {
                    workers,
                    from: (2 * level + half) as f64 / (2 * levels) as f64,
                    share: 0.5 / levels as f64,
                };
                let near = if let Search::Near(w) = options.search { w } else { shape.near };
                if near > 0 {
                    let found = match_with.search(&corners, Search::Near(near), &part(0))?;
                    wanted.iter().zip(found).for_each(|(k, m)| ranges.candidates[*k].near = m);
                }
                if !matches!(options.search, Search::Near(_)) {
                    let found = match_with.search(&corners, options.search, &part(1))?;
                    wanted.iter().zip(found).for_each(|(k, m)| ranges.candidates[*k].pool = m);
                }
            }
            all.push(ranges);
        }
        Ok(Candidates { shape, ranges: all })
    }

    /// Makes samples count `more` than they did.
    pub fn heed(&mut self, samples: &[[usize; D]], more: f64) {
        for (level, ranges) in self.ranges.iter_mut().enumerate() {
            let (side, cells) = (self.shape.side(level), self.shape.cells(level));
            let share = more / side.pow(D as u32) as f64;
            for p in samples {
                ranges.candidates[number(cells, p.map(|v| v / side))].weight += share;
            }
        }
    }

    /// Splits, and gives each range its map.
    pub fn plan(&self, partition: Partition) -> Result<Plan<D>> {
        let pick = Pick { shape: self.shape, ranges: &self.ranges };
        let (split, slope) = match partition {
            Partition::Maps(n) => pick.greedy(n, 0.0)?,
            // A tolerance asks for the least error, whatever it costs.
            Partition::Tolerance(t) => (pick.greedy(usize::MAX, t * t)?.0, 0.0),
            Partition::Const(_) => (pick.all_split(), 0.0),
            Partition::Slope(slope) => (pick.pruned(slope), slope),
        };
        Ok(pick.plan(split, slope))
    }
}

/// Work that is a part of the whole.
struct Part<'a> {
    workers: &'a dyn Workers,
    from: f64,
    share: f64,
}

impl Workers for Part<'_> {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        self.workers.run(parts, part);
    }
    fn going(&self, share: f64) -> bool {
        self.workers.going(self.from + self.share * share)
    }
}

/// The place of a cell by its number.
fn place<const D: usize>(cells: [usize; D], mut at: usize) -> [usize; D] {
    cells.map(|n| {
        let v = at % n;
        at /= n;
        v
    })
}

fn number<const D: usize>(cells: [usize; D], p: [usize; D]) -> usize {
    (0..D).rev().fold(0, |at, a| at * cells[a] + p[a])
}

/// The children of a cell, by number.
fn children<const D: usize>(shape: &Shape<D>, level: usize, at: usize) -> impl Iterator<Item = usize> {
    let (own, fine) = (shape.cells(level), shape.cells(level + 1));
    let p = place(own, at);
    (0..1_usize << D).map(move |k| number(fine, std::array::from_fn(|a| 2 * p[a] + (k >> a & 1))))
}

/// Means and errors of the ranges of a level.
fn measured<const D: usize>(shape: &Shape<D>, grid: &Grid<D>, weights: &[f32], level: usize) -> Ranges<D> {
    let side = shape.side(level);
    let cells = shape.cells(level);
    let count = side.pow(D as u32);
    let mut block = vec![0.0; count];
    let weight_of = |corner: [usize; D]| {
        if weights.is_empty() {
            return 1.0;
        }
        let mut rows = [side; D];
        rows[0] = 1;
        let sum: f64 = points(rows)
            .map(|p| {
                let at = grid.at(std::array::from_fn(|a| corner[a] + p[a]));
                weights[at..at + side].iter().map(|w| f64::from(*w)).sum::<f64>()
            })
            .sum();
        sum / count as f64
    };
    let mut out = Ranges { means: Vec::new(), candidates: Vec::new() };
    for p in points(cells) {
        let corner = p.map(|v| v * side);
        grid.block(corner, side, &mut block);
        let mean = block.iter().sum::<f64>() / count as f64;
        let max = f64::from(MEAN_MAX);
        let stored = ((mean - shape.origin) / shape.step).round().clamp(-max, max) as i32;
        let off = shape.mean(stored) - mean;
        let rounding = off * off * count as f64;
        let flat = block.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() + rounding;
        let uneven = block.iter().any(|v| *v != block[0]);
        out.means.push(stored);
        out.candidates.push(Range {
            flat,
            rounding,
            uneven,
            near: None,
            pool: None,
            weight: weight_of(corner),
        });
    }
    out
}

/// Ranges whose parents are not within a tolerance.
fn below<const D: usize>(shape: &Shape<D>, level: usize, coarse: &Ranges<D>, tolerance: f64) -> Vec<usize> {
    let count = shape.side(level - 1).pow(D as u32) as f64;
    let mut out: Vec<usize> = (0..coarse.candidates.len())
        .filter(|k| coarse.candidates[*k].least() > tolerance * tolerance * count)
        .flat_map(|k| children(shape, level - 1, k))
        .collect();
    out.sort_unstable();
    out
}

impl<const D: usize> Range<D> {
    /// The least error that a map leaves, by the weights.
    fn least(&self) -> f64 {
        let best = |m: &Option<Match<D>>| m.map_or(f64::INFINITY, |m| m.error + self.rounding);
        self.weight * self.flat.min(best(&self.near)).min(best(&self.pool))
    }
}

/// A leaf in the queue: the greatest error first; of equal ones the larger, then the earlier.
struct Queued {
    error: f64,
    level: usize,
    at: usize,
}

impl Ord for Queued {
    fn cmp(&self, other: &Queued) -> Ordering {
        self.error.total_cmp(&other.error).then(other.level.cmp(&self.level)).then(other.at.cmp(&self.at))
    }
}
impl PartialOrd for Queued {
    fn partial_cmp(&self, other: &Queued) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}
impl PartialEq for Queued {
    fn eq(&self, other: &Queued) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}
impl Eq for Queued {}

/// Bits of one of `n`: the logarithm, straight between powers of two, so that all machines choose alike.
fn bits(n: usize) -> f64 {
    let n = n.max(1);
    f64::from(n.ilog2()) + n as f64 / (1_u64 << n.ilog2()) as f64 - 1.0
}

/// The choice among candidates.
struct Pick<'a, const D: usize> {
    shape: &'a Shape<D>,
    ranges: &'a [Ranges<D>],
}

impl<const D: usize> Pick<'_, D> {
    fn candidates(&self, level: usize, at: usize) -> &Range<D> {
        &self.ranges[level].candidates[at]
    }

    /// Splits the worst range until there are `maps_max`, or every range has a mean squared error of at most `squared`. Returns which ranges are split, and how
    /// much error the last split took for a bit.
    fn greedy(&self, maps_max: usize, squared: f64) -> Result<(Vec<Vec<bool>>, f64)> {
        let roots: usize = self.shape.cells(0).iter().product();
        if roots > maps_max {
            return Err(Error::invalid(
                "maps",
                format!(
                    "{maps_max}; the tile has {roots} ranges of the largest side, {}: ask for at least so many",
                    self.shape.side(0)
                ),
            ));
        }
        let mut split = self.none_split();
        let mut queue: BinaryHeap<Queued> = (0..roots).map(|at| self.queued(0, at)).collect();
        let mut maps = roots;
        let mut slope = 0.0;
        while let Some(q) = queue.pop() {
            let allowed = squared * self.shape.side(q.level).pow(D as u32) as f64;
            if q.error <= allowed || q.level + 1 == self.shape.levels() {
                continue;
            }
            if maps - 1 + (1 << D) > maps_max {
                break;
            }
            split[q.level][q.at] = true;
            maps += (1 << D) - 1;
            let mut left = 0.0;
            for child in children(self.shape, q.level, q.at) {
                let child = self.queued(q.level + 1, child);
                left += child.error;
                queue.push(child);
            }
            slope =
                MAP_SLOPE * (q.error - left).max(0.0) / (((1 << D) - 1) as f64 * self.dearest(q.level + 1));
        }
        Ok((split, slope))
    }

    fn queued(&self, level: usize, at: usize) -> Queued {
        Queued { error: self.candidates(level, at).least(), level, at }
    }

    fn none_split(&self) -> Vec<Vec<bool>> {
        self.ranges.iter().map(|r| vec![false; r.means.len()]).collect()
    }

    /// All ranges but the smallest are split.
    fn all_split(&self) -> Vec<Vec<bool>> {
        let last = self.shape.levels() - 1;
        self.ranges.iter().enumerate().map(|(level, r)| vec![level < last; r.means.len()]).collect()
    }

    /// Bits of a map from the whole pool.
    fn dearest(&self, level: usize) -> f64 {
        FLAT_BITS + SCALE_BITS + self.turn_bits() + bits(self.shape.domains(level).len())
    }

    fn turn_bits(&self) -> f64 {
        bits(self.shape.isometries)
    }

    /// The cheapest of what a range could be: error and bits at a slope, and which.
    fn best(&self, level: usize, at: usize, slope: f64) -> (f64, Node<D>) {
        let c = self.candidates(level, at);
        let mut best = (c.weight * c.flat + slope * FLAT_BITS, Node::Flat);
        let map_bits = FLAT_BITS + SCALE_BITS + self.turn_bits();
        let near_bits = map_bits + bits(self.shape.near) * D as f64;
        for (found, bits) in [(c.near, near_bits), (c.pool, self.dearest(level))] {
            let Some(m) = found else { continue };
            let cost = c.weight * (m.error + c.rounding) + slope * bits;
            if cost < best.0 {
                let node = Node::Map {
                    scale: m.scale,
                    isometry: m.isometry as u8,
                    domain: m.domain.map(|v| v as u16),
                };
                best = (cost, node);
            }
        }
        best
    }

    /// From small to large: a range is split where its parts cost less together.
    fn pruned(&self, slope: f64) -> Vec<Vec<bool>> {
        let mut split = self.none_split();
        let last = self.ranges.len() - 1;
        let mut costs: Vec<f64> =
            (0..self.ranges[last].means.len()).map(|at| self.best(last, at, slope).0).collect();
        for level in (0..last).rev() {
            let mut above = Vec::with_capacity(self.ranges[level].means.len());
            for (at, split) in split[level].iter_mut().enumerate() {
                let whole = self.best(level, at, slope).0;
                // A decision more: most are foreseen.
                let parts: f64 = children(self.shape, level, at).map(|k| costs[k]).sum::<f64>() + slope * 0.5;
                *split = parts < whole;
                above.push(whole.min(parts));
            }
            costs = above;
        }
        split
    }

    /// What the stream takes. The mean of a range that is split is that of its parts.
    fn plan(&self, split: Vec<Vec<bool>>, slope: f64) -> Plan<D> {
        let mut means: Vec<Vec<i32>> = self.ranges.iter().map(|r| r.means.clone()).collect();
        let count = 1 << D;
        for level in (0..self.ranges.len() - 1).rev() {
            for at in (0..split[level].len()).filter(|at| split[level][*at]) {
                let sum: i64 = children(self.shape, level, at).map(|k| i64::from(means[level + 1][k])).sum();
                means[level][at] = (sum + count / 2).div_euclid(count) as i32;
            }
        }
        let levels = split
            .iter()
            .enumerate()
            .map(|(level, split)| {
                split
                    .iter()
                    .enumerate()
                    .map(|(at, split)| if *split { Node::Split } else { self.best(level, at, slope).1 })
                    .collect()
            })
            .collect();
        Plan { levels, means }
    }
}
