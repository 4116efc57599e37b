//! The steps between a prediction and a height: how they are coded.

use crate::range::{Bit, Coder};

/// What lies around a post, by which its residual is guessed.
pub(super) struct Around {
    /// Magnitudes of the residuals of the four nearest posts, in quarters of a unit.
    pub near: [u32; 4],
    /// Of the posts of the same pass to the west and north.
    pub own: [u32; 4],
    /// Greatest less least height of the four nearest.
    pub spread: u32,
}

/// Classes of expected magnitude.
const CLASSES: usize = 64;
/// Parts of a unit that a prediction may lie from the middle, folded to one side.
const PARTS: usize = 4;
/// Doubling intervals of magnitudes.
const SIZES: usize = 26;

/// The models of residuals.
pub(super) struct Residuals {
    step: u32,
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
            step: 2 * e + 1,
            exact: e < 3,
            zero: vec![Bit::default(); CLASSES * PARTS],
            sign: vec![Bit::default(); CLASSES * PARTS],
            size: vec![Bit::default(); CLASSES * PARTS * SIZES],
            within: vec![Bit::default(); CLASSES * SIZES * 4],
        }
    }

    /// Codes `q` steps of 2E + 1 units; `part` is 32 times what the prediction lies above the middle of step 0, -16 to 15.
    pub fn code<C: Coder>(&mut self, c: &mut C, around: &Around, part: i32, q: i32) -> i32 {
        let near: u32 = around.near.iter().sum();
        let own: u32 = around.own.iter().sum();
        // In 32nds of a unit.
        let activity = (near * 2 + own * 4) + around.spread * 6 / 2;
        let class = class(activity * 2 / self.step + 1);
        let flip = part < 0;
        let part = if self.exact { (part.unsigned_abs() as usize * PARTS / 17).min(PARTS - 1) } else { 0 };
        let q = if flip { -q } else { q };
        let v = self.magnitude(c, class, part, q);
        if flip { -v } else { v }
    }

    fn magnitude<C: Coder>(&mut self, c: &mut C, class: usize, part: usize, q: i32) -> i32 {
        let at = class * PARTS + part;
        if c.learn(&mut self.zero[at], q == 0) {
            return 0;
        }
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
