//! An iterated function system: leaves with their maps, and what their numbers mean.

use super::domains::Domains;
use super::isometry::{self, Isometry};
use super::scale::{BITS, Scales};
use crate::{Error, Result};

/// Greatest side of ranges, as a power of two.
pub const RANGE_LOG_MAX: u32 = 5;
/// Greatest distance of neighbouring domains.
pub const JUMP_MAX: usize = 64;
/// Greatest count of domains along an axis among which near ones are chosen.
pub const NEAR_MAX: usize = 64;
/// Most samples along an axis of a tile in the plane.
pub const SIDE_MAX: usize = 16_384;
/// Most samples along an axis of a tile in space.
pub const VOLUME_SIDE_MAX: usize = 512;
/// Most samples of a plane or of a volume.
pub const SAMPLES_MAX: u64 = 1 << 27;

/// Greatest origin and step of means: far beyond any height in units, so that nothing runs out of the numbers.
const VALUE_MAX: f64 = (1_u64 << 40) as f64;
/// Samples beyond a quarter of a tile's own that whole ranges may add.
const PADDING: u64 = 4096;

/// What the numbers of leaves mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape<const D: usize> {
    /// Samples along each axis.
    pub size: [usize; D],
    /// The largest ranges have a side of 2 to this.
    pub range_max_log: u32,
    /// The smallest.
    pub range_min_log: u32,
    /// Distance of neighbouring domains: even.
    pub jump: usize,
    /// Isometries in their group.
    pub isometries: usize,
    /// Along each axis so many domains round a range have short numbers; 0: none has.
    pub near: usize,
    /// Bits of a level of s.
    pub scale_bits: u32,
    /// A mean is `origin + step * number`.
    pub step: f64,
    /// See `step`.
    pub origin: f64,
}

impl<const D: usize> Shape<D> {
    /// Refuses what no tile can be.
    pub fn check(&self) -> Result<()> {
        let side_max = if D == 2 { SIDE_MAX } else { VOLUME_SIDE_MAX };
        for n in self.size {
            if n == 0 || n > side_max {
                return Err(Error::Limit {
                    what: "samples along an axis of a fractal tile (at least 1)",
                    limit: side_max as u64,
                    wanted: n as u64,
                });
            }
        }
        if self.samples() > SAMPLES_MAX {
            return Err(Error::Limit {
                what: "samples of a fractal tile",
                limit: SAMPLES_MAX,
                wanted: self.samples(),
            });
        }
        let (max, min) = (self.range_max_log, self.range_min_log);
        if !(1..=RANGE_LOG_MAX).contains(&max) || min > max {
            return Err(Error::invalid(
                "ranges",
                format!(
                    "sides from 2^{min} to 2^{max}; the greatest is 2 to 32, the smallest 1 or more, not above it"
                ),
            ));
        }
        let padded = self.padded().iter().fold(1, |n: u64, s| n.saturating_mul(*s as u64));
        // A row of posts has ranges of 2, and as many samples again.
        if max > 1 && padded > self.samples() + self.samples() / 4 + PADDING {
            return Err(Error::invalid(
                "ranges",
                format!(
                    "sides of 2^{max} make {padded} samples of the tile's {}; take smaller ranges for such a tile",
                    self.samples()
                ),
            ));
        }
        if self.jump < 2 || !self.jump.is_multiple_of(2) || self.jump > JUMP_MAX {
            return Err(Error::invalid("jump", format!("{}; an even number up to {JUMP_MAX}", self.jump)));
        }
        if self.near > NEAR_MAX {
            return Err(Error::invalid("near", format!("{} domains; at most {NEAR_MAX}", self.near)));
        }
        if !BITS.contains(&self.scale_bits) {
            return Err(Error::invalid(
                "bits of s",
                format!("{}; {} to {}", self.scale_bits, BITS.start(), BITS.end()),
            ));
        }
        isometry::group::<D>(self.isometries)?;
        if !(self.step > 0.0 && self.step <= VALUE_MAX && self.origin.abs() <= VALUE_MAX) {
            return Err(Error::invalid(
                "means",
                format!(
                    "step {}, origin {}; up to {VALUE_MAX} either way are allowed, the step above 0",
                    self.step, self.origin
                ),
            ));
        }
        Ok(())
    }

    /// Samples of the tile.
    pub fn samples(&self) -> u64 {
        self.size.iter().fold(1, |n: u64, s| n.saturating_mul(*s as u64))
    }

    /// The size in whole ranges of the largest side; what is beyond the tile is decoded and dropped.
    pub fn padded(&self) -> [usize; D] {
        self.size.map(|n| n.next_multiple_of(1 << self.range_max_log))
    }

    /// Sides of ranges: how many.
    pub fn levels(&self) -> usize {
        (self.range_max_log - self.range_min_log + 1) as usize
    }

    /// The side of ranges of a level, 0 the coarsest.
    pub fn side(&self, level: usize) -> usize {
        1 << (self.range_max_log as usize - level)
    }

    /// Ranges of a level along each axis.
    pub fn cells(&self, level: usize) -> [usize; D] {
        self.padded().map(|n| n / self.side(level))
    }

    /// The domains of a level.
    pub fn domains(&self, level: usize) -> Domains<D> {
        Domains::new(self.padded(), self.side(level), self.jump)
    }

    /// The levels of s.
    pub fn scales(&self) -> Scales {
        Scales::of_bits(self.scale_bits)
    }

    /// Its isometries.
    pub fn group(&self) -> Vec<Isometry<D>> {
        isometry::group(self.isometries).unwrap_or_else(|_| vec![Isometry::identity()])
    }

    /// The mean of a number.
    #[inline(always)]
    pub fn mean(&self, number: i32) -> f64 {
        self.origin + self.step * f64::from(number)
    }
}

/// A range with its map: `R = m + s (iso(D) - mean(D))`. 16 bytes in the plane, 20 in space.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Leaf<const D: usize> {
    /// Number of the mean.
    pub mean: i32,
    /// Corner of the range, in its own sides.
    pub cell: [u16; D],
    /// The domain's place among the domains of this level.
    pub domain: [u16; D],
    /// Level of the tree: the side is that of the largest ranges halved so often.
    pub level: u8,
    /// Number of the isometry in the group.
    pub isometry: u8,
    /// Level of s. 0: a flat range, domain and isometry say nothing.
    pub scale: i8,
}

/// Leaves that cover a tile.
#[derive(Clone, Debug, PartialEq)]
pub struct Ifs<const D: usize> {
    /// What their numbers mean.
    pub shape: Shape<D>,
    /// Ranges of a side of 2 and more, from large to small.
    pub leaves: Vec<Leaf<D>>,
    /// Ranges of side 2 that are stored sample by sample, as ranges of side 1: their corners in sides of 2.
    pub units: Vec<[u16; D]>,
    /// The means of those samples, 2 x 2 (x 2) by 2 x 2, the first axis fastest.
    pub unit_means: Vec<i32>,
    /// Whether nothing was missing. What is missing is flat, with the mean of what it is a part of.
    pub complete: bool,
}

impl<const D: usize> Ifs<D> {
    /// Maps: leaves of any side.
    pub fn maps(&self) -> usize {
        self.leaves.len() + self.unit_means.len()
    }
}
