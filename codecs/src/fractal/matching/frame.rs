//! What is common to all ranges of a level.

use super::super::grid::{points, strides};
use super::classes::Classes;
use super::poses::Poses;
use super::sought::{Range, Sought};
use super::{Level, Search, plain};

/// Lengths, in units of the greatest magnitude of the grid, between which a range is screened in f32.
const RANGE_MIN: f64 = 1e-20;
/// Shorter domains than this, in the same unit, change no error of such a range by as much as its last bit.
const DOMAIN_MIN: f64 = 1e-37;

/// What is common to all ranges of a level.
pub struct Frame<'a, const D: usize> {
    /// The level.
    pub level: &'a Level<'a, D>,
    /// Samples of a range.
    pub samples: usize,
    /// For each isometry: the sample of the range that meets each sample of the domain.
    pub places: Vec<Vec<u32>>,
    /// Where the samples of a domain lie in the half grid, from its first.
    pub offsets: Vec<usize>,
    /// The orientations as they are screened.
    pub poses: Poses,
    /// The order of quadrants, where it decides who meets.
    pub classes: Option<Classes>,
    /// The greatest magnitude of the grid becomes 1 by it.
    unit: f64,
}

impl<'a, const D: usize> Frame<'a, D> {
    /// Of a level, for one kind of search.
    pub fn new(level: &'a Level<'a, D>, search: Search) -> Frame<'a, D> {
        let side = level.domains.side;
        let strides = strides(level.half.size);
        let finite = level.grid.values.iter().map(|v| v.abs()).filter(|v| v.is_finite());
        let greatest = finite.fold(0.0, f64::max);
        let classes = search == Search::Classes;
        Frame {
            level,
            samples: side.pow(D as u32),
            places: level.isometries.iter().map(|i| i.inverse().places(side)).collect(),
            offsets: points([side; D]).map(|p| (0..D).map(|a| p[a] * strides[a]).sum()).collect(),
            poses: Poses::new(level.isometries, side, !classes),
            classes: classes.then(|| Classes::new(level.isometries, side)),
            unit: 1.0 / greatest,
        }
    }

    /// The place of a domain among the others, by its number.
    pub fn place(&self, mut number: usize) -> [usize; D] {
        self.level.domains.count.map(|n| {
            let p = number % n;
            number /= n;
            p
        })
    }

    /// The number of a domain, in the order of their places.
    pub fn number(&self, place: [usize; D]) -> usize {
        let count = self.level.domains.count;
        (0..D).rev().fold(0, |n, a| n * count[a] + place[a])
    }

    /// Where a domain begins in the half grid, by its number.
    pub fn first(&self, number: usize) -> usize {
        self.level.half.at(self.level.domains.corner(self.place(number)).map(|v| v / 2))
    }

    /// The samples of a domain, by its number.
    pub fn raw(&self, number: usize) -> Vec<f64> {
        let values = &self.level.half.values[self.first(number)..];
        self.offsets.iter().map(|o| values[*o]).collect()
    }

    /// The length of a domain in f32, by the sum of its squares; `None` if it cannot match a range that is screened.
    pub fn length(&self, squares: f64) -> Option<f32> {
        let length = squares.sqrt() * self.unit;
        (squares > 0.0 && length > DOMAIN_MIN && length < 1.0 / DOMAIN_MIN).then_some(length as f32)
    }

    /// Those of the ranges that may have a match; settled at once are those that f32 does not reach. `first` is the number of the first.
    pub fn sought(&self, first: usize, ranges: &[[usize; D]], search: Search) -> Vec<Sought<D>> {
        let mut block = vec![0.0; self.samples];
        let mut out = Vec::new();
        for (k, range) in ranges.iter().enumerate() {
            self.level.grid.block(*range, self.level.domains.side, &mut block);
            let squares = plain::centre(&mut block);
            if squares > 0.0 {
                let length = squares.sqrt() * self.unit;
                let screened = length > RANGE_MIN && length < 1.0 / RANGE_MIN;
                let mut sought = Sought { index: first + k, range: *range, squares, screened, best: None };
                if !screened {
                    plain::settle(self, &mut sought, search);
                }
                out.push(sought);
            }
        }
        out
    }

    /// A range as it is screened.
    pub fn range(&self, sought: &Sought<D>) -> Range {
        let mut block = vec![0.0; self.samples];
        self.level.grid.block(sought.range, self.level.domains.side, &mut block);
        let class = self.classes.as_ref().map_or(0, |c| c.of(&block));
        plain::centre(&mut block);
        let length = sought.squares.sqrt();
        let poses = self.poses.of(&block, length);
        Range { block, class, poses, length: (length * self.unit) as f32 }
    }
}
