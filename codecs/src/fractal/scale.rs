//! The steps in which contrast is stored.

/// Fewest and most bits of a level of s.
pub const BITS: std::ops::RangeInclusive<u32> = 2..=8;

/// The levels of s: as many on each side of zero, up to -1 and 1. With 5 bits they are fifteenths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scales {
    max: i8,
}

impl Scales {
    /// Levels of so many bits, zero included; within [`BITS`].
    pub fn of_bits(bits: u32) -> Scales {
        Scales { max: ((1_i32 << (bits.clamp(*BITS.start(), *BITS.end()) - 1)) - 1) as i8 }
    }

    /// The greatest level: s = 1.
    #[inline(always)]
    pub fn max(self) -> i8 {
        self.max
    }

    /// s of a level.
    #[inline(always)]
    pub fn scale(self, level: i8) -> f64 {
        f64::from(level) / f64::from(self.max)
    }

    /// The level whose s leaves the least error: the nearest to `<R, D> / <D, D>`; 0 where the domain is flat.
    #[inline(always)]
    pub fn nearest(self, product: f64, domain: f64) -> i8 {
        if domain <= 0.0 {
            return 0;
        }
        let max = f64::from(self.max);
        // Halves go away from zero, as `round` does it.
        (product / domain * max).clamp(-max, max).round() as i8
    }

    /// The squared error of a range without its mean: `<R, R> - 2 s <R, D> + s^2 <D, D>`, at least 0.
    #[inline(always)]
    pub fn error(self, level: i8, range: f64, product: f64, domain: f64) -> f64 {
        let s = self.scale(level);
        (range - 2.0 * s * product + s * s * domain).max(0.0)
    }
}
