//! The steps between a prediction and a height: how they are coded.

use crate::range::{Bit, Coder};

/// Classes of expected magnitude.
const CLASSES: usize = 64;
/// Parts of a unit that a prediction may lie from the middle, folded to one side.
const PARTS: usize = 4;
/// Doubling intervals of magnitudes.
const SIZES: usize = 26;

/// The models of residuals.
pub(super) struct Residuals {
    /// 2^33 / (2E + 1).
    per_step: u64,
    exact: bool,
    zero: Vec<Bit>,
    sign: Vec<Bit>,
    size: Vec<Bit>,
    within: Vec<Bit>,
}

impl Residuals {
    /// Models for a bound `e`.
    pub fn new(e: u32) -> Residuals {
        Residuals {
            per_step: (1 << 33) / u64::from(2 * e + 1),
            exact: e < 3,
            zero: vec![Bit::default(); CLASSES * PARTS],
            sign: vec![Bit::default(); CLASSES * PARTS],
            size: vec![Bit::default(); CLASSES * PARTS * SIZES],
            within: vec![Bit::default(); CLASSES * SIZES * 4],
        }
    }

    /// Codes `q` steps of 2E + 1 units. `activity`: what is expected, in 32nds of a unit; `part`: 32 times what the prediction lies
    /// above the middle of step 0, -16 to 15.
    #[inline(always)]
    pub fn code<C: Coder>(&mut self, c: &mut C, activity: u32, part: i32, q: i32) -> i32 {
        let class = class(((u64::from(activity) * self.per_step) >> 32) as u32 + 1);
        if !self.exact {
            return self.magnitude(c, class, 0, q);
        }
        let fold = (part.unsigned_abs() as usize * PARTS / 17).min(PARTS - 1);
        let v = self.magnitude(c, class, fold, if part < 0 { -q } else { q });
        if part < 0 { -v } else { v }
    }

    #[inline(always)]
    fn magnitude<C: Coder>(&mut self, c: &mut C, class: usize, part: usize, q: i32) -> i32 {
        let at = class * PARTS + part;
        if c.learn(&mut self.zero[at], q == 0) {
            return 0;
        }
        self.beyond(c, class, at, q)
    }

    /// A number that is not zero.
    fn beyond<C: Coder>(&mut self, c: &mut C, class: usize, at: usize, q: i32) -> i32 {
        let negative = c.learn(&mut self.sign[at], q < 0);
        let m = q.unsigned_abs();
        let size = 31 - m.max(1).leading_zeros();
        let mut k = 0;
        let sizes = class * PARTS + if negative { PARTS / 2 } else { 0 };
        while (k as usize) < SIZES - 1 && c.learn(&mut self.size[sizes * SIZES + k as usize], size > k) {
            k += 1;
        }
        let mut v = 1u32;
        for b in (0..k).rev() {
            let bit = m >> b & 1 == 1;
            let depth = k - 1 - b;
            v = v << 1
                | u32::from(match depth {
                    0 => c.learn(&mut self.within[(class * SIZES + k as usize) * 4], bit),
                    1 => c.learn(
                        &mut self.within[(class * SIZES + k as usize) * 4 + 1 + (v & 1) as usize],
                        bit,
                    ),
                    _ => c.bit(1 << 15, bit),
                });
        }
        if negative { -(v as i32) } else { v as i32 }
    }
}

/// Four classes an octave.
fn class(v: u32) -> usize {
    let size = 31 - v.max(1).leading_zeros();
    let low = if size >= 2 { v >> (size - 2) & 3 } else { v << (2 - size) & 3 };
    ((size << 2 | low) as usize).min(CLASSES - 1)
}
