//! The least magnitude of the steps of a pass: what a selection by rank leaves out need not be told apart again.

use crate::lattice::Pass;
use crate::range::{Bit, Coder};

/// Doubling intervals of the difference; magnitudes are below 2^28.
const SIZES: usize = 30;

/// Codes the least magnitudes.
pub(super) struct Least {
    least: u32,
    step: usize,
    models: [Bit; 1 + SIZES],
}

impl Least {
    pub fn new() -> Least {
        Least { least: 0, step: 1, models: [Bit::default(); 1 + SIZES] }
    }

    /// Before a pass: as a difference to what the last pass lets expect of surpluses times the step of their pass.
    pub fn code<C: Coder>(&mut self, c: &mut C, pass: Pass, least: u32) -> u32 {
        let expected = (u64::from(self.least) * self.step as u64).div_ceil(pass.step as u64) as u32;
        let away = least.wrapping_sub(expected) as i32;
        let negative = c.learn(&mut self.models[0], away < 0);
        let magnitude = self.magnitude(c, away.unsigned_abs());
        self.least = expected.wrapping_add(if negative { magnitude.wrapping_neg() } else { magnitude });
        self.step = pass.step;
        self.least
    }

    /// The interval (0; 1 to 2; 3 to 6; ...), one decision each, then the bits within.
    fn magnitude<C: Coder>(&mut self, c: &mut C, magnitude: u32) -> u32 {
        let v = magnitude.wrapping_add(1);
        let size = 31 - v.max(1).leading_zeros();
        let mut k = 0;
        while (k as usize) < SIZES - 1 && c.learn(&mut self.models[1 + k as usize], size > k) {
            k += 1;
        }
        (1 << k | c.bits(k, v & ((1 << k) - 1))) - 1
    }
}
