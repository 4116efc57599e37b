//! What experts expect of a post: each a bell around its own prediction, as wide as that prediction has been wrong.
//!
//! The bell is Student's t with four degrees. With u = x / sqrt(1 + x^2), x = distance / (2 mean distance), the part
//! above x is (1 - u)^2 (2 + u) / 4: no table, no exponential, the same bits on every machine.

use super::logit::log2;

/// Experts: lanes of a vector.
pub(super) const EXPERTS: usize = 8;
/// A number of each.
pub(super) type Lanes = [f32; EXPERTS];

/// One bell an expert. Everything is in steps of 2E + 1 units, from the middle of step 0, on the side that was chosen.
pub(super) struct Bells {
    centre: Lanes,
    narrow: Lanes,
    /// Part above 1/2.
    above: Lanes,
    /// Part below -1/2.
    below: Lanes,
    /// Parts above the interval's lower end and above its upper end, on the side that was chosen.
    low: Lanes,
    high: Lanes,
}

/// Part of each bell above `at`; `sign` -1 mirrors the bells.
#[inline(always)]
fn tail(at: f32, sign: f32, centre: &Lanes, narrow: &Lanes) -> Lanes {
    let mut out = [0.0; EXPERTS];
    for k in 0..EXPERTS {
        let x = (at - sign * centre[k]) * narrow[k];
        let u = x / (1.0 + x * x).sqrt();
        let v = 1.0 - u;
        out[k] = v * v * (2.0 + u) * 0.25;
    }
    out
}

/// log2 of the odds of `yes` against `no`, within 12 of even. Where a bell has next to nothing left, it does not care.
#[inline(always)]
fn odds(yes: f32, no: f32) -> f32 {
    let ratio = (yes + 1e-7) / (no + 1e-7);
    let ratio = if ratio > 1.0 / 4096.0 { ratio } else { 1.0 / 4096.0 };
    let ratio = if ratio < 4096.0 { ratio } else { 4096.0 };
    log2(ratio)
}

impl Bells {
    /// `centre` in steps; `mean`: the mean distance from it, in steps.
    #[inline(always)]
    pub fn new(centre: Lanes, mean: Lanes) -> Bells {
        let mut narrow = [0.0; EXPERTS];
        for k in 0..EXPERTS {
            narrow[k] = 0.5 / mean[k];
        }
        let above = tail(0.5, 1.0, &centre, &narrow);
        let below = tail(0.5, -1.0, &centre, &narrow);
        Bells { centre, narrow, above, below, low: above, high: above }
    }

    /// Odds that a post is in step 0.
    #[inline(always)]
    pub fn zero(&self) -> Lanes {
        let mut out = [0.0; EXPERTS];
        for k in 0..EXPERTS {
            let other = self.above[k] + self.below[k];
            out[k] = odds(1.0 - other, other);
        }
        out
    }

    /// Odds that it lies below, if it does not lie in step 0.
    #[inline(always)]
    pub fn negative(&self) -> Lanes {
        let mut out = [0.0; EXPERTS];
        for k in 0..EXPERTS {
            out[k] = odds(self.below[k], self.above[k]);
        }
        out
    }

    /// Odds that it lies below, step 0 counted above.
    #[inline(always)]
    pub fn below(&self) -> Lanes {
        let mut out = [0.0; EXPERTS];
        for k in 0..EXPERTS {
            out[k] = odds(self.below[k], 1.0 - self.below[k]);
        }
        out
    }

    /// Chooses the side; `zero`: step 0 belongs to the upper one.
    #[inline(always)]
    pub fn side(&mut self, negative: bool, zero: bool) {
        if negative {
            self.low = self.below;
            for k in 0..EXPERTS {
                self.centre[k] = -self.centre[k];
            }
        } else if zero {
            for k in 0..EXPERTS {
                self.low[k] = 1.0 - self.below[k];
            }
        } else {
            self.low = self.above;
        }
    }

    /// Odds that it lies above `at` (in steps from the middle of step 0), if it lies above the last answer of yes.
    #[inline(always)]
    pub fn beyond(&mut self, at: f32) -> Lanes {
        self.high = tail(at, 1.0, &self.centre, &self.narrow);
        let mut out = [0.0; EXPERTS];
        for k in 0..EXPERTS {
            out[k] = odds(self.high[k], self.low[k] - self.high[k]);
        }
        out
    }

    /// The answer to [`beyond`](Bells::beyond) was yes.
    #[inline(always)]
    pub fn go_on(&mut self) {
        self.low = self.high;
    }

    /// Odds of the upper part of the interval, from `at`; and the answer by `take`.
    #[inline(always)]
    pub fn upper(&mut self, at: f32) -> (Lanes, Lanes) {
        let mid = tail(at, 1.0, &self.centre, &self.narrow);
        let mut out = [0.0; EXPERTS];
        for k in 0..EXPERTS {
            out[k] = odds(mid[k] - self.high[k], self.low[k] - mid[k]);
        }
        (out, mid)
    }

    /// Takes a part of the interval.
    #[inline(always)]
    pub fn take(&mut self, upper: bool, mid: Lanes) {
        if upper {
            self.low = mid;
        } else {
            self.high = mid;
        }
    }
}
