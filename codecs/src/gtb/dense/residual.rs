//! The steps between a prediction and a height: how they are coded.

use crate::range::{Bit, Coder};

/// Classes of expected magnitude.
const CLASSES: usize = 80;
/// Parts of a unit that a prediction may lie from the middle, folded to one side.
const PARTS: usize = 4;
/// Doubling intervals of magnitudes.
const SIZES: usize = 28;

/// What the first decisions are expected to be, by octaves of classes, in 65536ths: that a residual is zero, and that one is beyond
/// size k (of a class by 4 k lower). Measured over many grids and bounds; what they learn soon outweighs it.
const ZERO: [u16; 21] = [
    65_200, 65_100, 64_800, 64_200, 63_000, 60_600, 55_600, 44_000, 28_400, 16_300, 8_700, 4_500, 2_300,
    1_100, 500, 250, 150, 100, 100, 100, 100,
];
const LARGER: [u16; 21] = [
    600, 600, 600, 600, 700, 900, 1_600, 5_000, 16_400, 33_800, 48_300, 56_800, 61_600, 63_800, 64_700,
    65_100, 65_200, 65_300, 65_300, 65_300, 65_300,
];
/// How many decisions that weighs.
const SURE: u16 = 12;

/// The value of a class, between those of octaves.
fn of_octaves(values: &[u16; 21], class: usize) -> u16 {
    let (a, b) = (usize::from(values[class / 4]), usize::from(values[class / 4 + 1]));
    ((a * (4 - class % 4) + b * (class % 4)) / 4) as u16
}

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
            zero: (0..CLASSES * PARTS).map(|k| Bit::known(of_octaves(&ZERO, k / PARTS), SURE)).collect(),
            sign: vec![Bit::default(); CLASSES * PARTS],
            size: (0..CLASSES * SIZES)
                .map(|k| Bit::known(of_octaves(&LARGER, (k / SIZES).saturating_sub(4 * (k % SIZES))), SURE))
                .collect(),
            within: vec![Bit::known(23_500, 2); CLASSES * SIZES * 4],
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
        while (k as usize) < SIZES - 1 && c.learn(&mut self.size[class * SIZES + k as usize], size > k) {
            k += 1;
        }
        // The two highest bits below the first are learnt, the others are as likely as not.
        let within = &mut self.within[(class * SIZES + k as usize) * 4..][..4];
        let mut v = 1u32;
        for b in (0..k).rev() {
            let bit = m >> b & 1 == 1;
            let bit = match k - 1 - b {
                0 => c.learn(&mut within[0], bit),
                1 => c.learn(&mut within[1 + (v & 1) as usize], bit),
                _ => c.bit(1 << 15, bit),
            };
            v = v << 1 | u32::from(bit);
        }
        if negative { -(v as i32) } else { v as i32 }
    }
}

/// Four classes an octave.
#[inline(always)]
fn class(v: u32) -> usize {
    let size = 31 - v.max(1).leading_zeros();
    let low = if size >= 2 { v >> (size - 2) & 3 } else { v << (2 - size) & 3 };
    ((size << 2 | low) as usize).min(CLASSES - 1)
}
