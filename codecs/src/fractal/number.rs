//! Symbols of leaves: whole numbers near 0, choices of many, each learnt in its context.

use crate::mixing::{self, Count, Weights};
use crate::range::{Coder, ONE};

/// Decisions of a whole number: zero, sign, 26 lengths, 25 times two leading bits.
const DECISIONS: usize = 2 + 26 + 3 * 26;

/// Whole numbers, mostly small, in three contexts at once.
pub(super) struct Numbers {
    counts: Vec<Count>,
    weights: [Weights<3>; DECISIONS],
    bases: [usize; 3],
    sizes: [usize; 3],
}

impl Numbers {
    /// Numbers whose three contexts have so many values each.
    pub fn new(sizes: [usize; 3]) -> Numbers {
        let bases = [0, sizes[0], sizes[0] + sizes[1]];
        Numbers {
            counts: vec![Count::NEW; sizes.iter().sum::<usize>() * DECISIONS],
            weights: [Weights::new(); DECISIONS],
            bases,
            sizes,
        }
    }

    fn decide<C: Coder>(&mut self, c: &mut C, contexts: [usize; 3], k: usize, bit: bool) -> bool {
        let at =
            std::array::from_fn(|n| (self.bases[n] + contexts[n].min(self.sizes[n] - 1)) * DECISIONS + k);
        mixing::code(c, &mut self.counts, at, &mut self.weights[k], bit)
    }

    /// Codes a number of at most 26 bits.
    pub fn code<C: Coder>(&mut self, c: &mut C, contexts: [usize; 3], value: i32) -> i32 {
        let magnitude = value.unsigned_abs();
        if !self.decide(c, contexts, 0, value != 0) {
            return 0;
        }
        let negative = self.decide(c, contexts, 1, value < 0);
        let length = 32 - magnitude.leading_zeros();
        let mut n = 1;
        while n < 26 && self.decide(c, contexts, 1 + n as usize, length > n) {
            n += 1;
        }
        let mut out = 1;
        for k in (0..n - 1).rev() {
            let bit = magnitude >> k & 1 == 1;
            let lead = n - 2 - k;
            // The two bits after the first one are learnt, by each other.
            let bit = match lead {
                0 => self.decide(c, contexts, 28 + 3 * n as usize - 3, bit),
                1 => self.decide(c, contexts, 28 + 3 * n as usize - 2 + (out & 1) as usize, bit),
                _ => c.bit(ONE / 2, bit),
            };
            out = out << 1 | u32::from(bit);
        }
        if negative { -(out as i32) } else { out as i32 }
    }
}

/// A choice of 2^bits, learnt as a tree.
#[derive(Clone)]
pub(super) struct Choice {
    counts: Vec<Count>,
    bits: u32,
}

impl Choice {
    /// One of 2^bits.
    pub fn new(bits: u32) -> Choice {
        Choice { counts: vec![Count::NEW; 1 << bits], bits }
    }

    /// Codes it.
    pub fn code<C: Coder>(&mut self, c: &mut C, value: u32) -> u32 {
        let mut node = 1;
        for k in (0..self.bits).rev() {
            let bit = self.counts[node as usize].code(c, value >> k & 1 == 1);
            node = node << 1 | u32::from(bit);
        }
        node - (1 << self.bits)
    }
}

/// One of `count`, all as likely.
pub(super) fn uniform<C: Coder>(c: &mut C, count: usize, value: usize) -> usize {
    let (mut from, mut to) = (0, count.max(1));
    while to - from > 1 {
        let middle = from + (to - from) / 2;
        let share = ((to - middle) as u64 * u64::from(ONE) / (to - from) as u64) as u32;
        if c.bit(share.clamp(1, ONE - 1), value >= middle) {
            from = middle;
        } else {
            to = middle;
        }
    }
    from
}

/// The length of a number in bits: how large it is, for contexts.
pub(super) fn length(v: i64) -> usize {
    64 - v.unsigned_abs().leading_zeros() as usize
}
