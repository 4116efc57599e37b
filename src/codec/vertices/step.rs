//! Whole numbers stand for heights.

use super::code::WHOLE_MAX;

/// The finest step, metres: 2^-21.
pub const FINEST: f64 = 1.0 / (1u64 << 21) as f64;
/// The most that a vertex may be off its step, in finest steps: 2^20 m.
pub const REST_MAX: f64 = (1u64 << 41) as f64;
/// Bits of a height in finest steps below a step of 1 m.
const FINEST_BITS: i64 = 21;
const BINARY: std::ops::RangeInclusive<i8> = -21..=20;
const DECIMALS: std::ops::RangeInclusive<i8> = 1..=6;

/// How a whole number becomes a height: samples are `q 2^exponent`, or `q / 10^exponent` rounded to float32; heights are
/// samples, or samples times `scale` plus `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    pub decimal: bool,
    pub exponent: i8,
    pub scale: f64,
    pub offset: f64,
}

fn power_of_ten(n: i8) -> f64 {
    10f64.powi(i32::from(n))
}

/// 2^n for n of [`BINARY`], without a call for each vertex.
fn power_of_two(n: i8) -> f64 {
    f64::from_bits(((1023 + i64::from(n)) as u64) << 52)
}

/// The nearest whole number, halves away from 0; `|v|` below 2^52.
#[inline]
pub fn rounded_whole(v: f64) -> i64 {
    let whole = v as i64;
    let rest = v - whole as f64;
    whole + i64::from(rest >= 0.5) - i64::from(rest <= -0.5)
}

impl Step {
    /// The step with which heights take the fewest bits, by a rough count: bits of a step for each, and those of a rest for each that lies between.
    pub fn of(z: impl Iterator<Item = f64>, scale: f64, offset: f64) -> Step {
        let usable = scale.is_finite() && scale != 0.0 && offset.is_finite();
        let (scale, offset) = if usable { (scale, offset) } else { (1.0, 0.0) };
        let mut step = Step { decimal: false, exponent: 0, scale, offset };
        // Samples; a height that is none (a fill) is looked at as it is.
        let samples: Vec<Option<f64>> = z.map(|z| step.sample_of(z)).collect();
        let mut finest = [0i64; 42];
        for s in samples.iter().flatten() {
            finest[(lowest_bit(*s).clamp(-21, 20) + 21) as usize] += 1;
        }
        let (all, mut fit) = (samples.len() as i64, 0);
        let mut least = i64::MAX;
        for e in BINARY.rev() {
            fit += finest[(e + 21) as usize];
            let cost = all * -i64::from(e) + (all - fit) * (FINEST_BITS + 2 + i64::from(e));
            if cost < least {
                (least, step.exponent) = (cost, e);
            }
        }
        for d in DECIMALS {
            // log2(10) is 3.32.
            let bits = (i64::from(d) * 332 + 50) / 100;
            if all * bits >= least {
                // Even if every sample fits; more decimals cost more.
                break;
            }
            let p = power_of_ten(d);
            let fit =
                samples.iter().flatten().filter(|s| rounded((**s * p).round() / p) == **s).count() as i64;
            let cost = all * bits + (all - fit) * (FINEST_BITS + 2 - bits);
            if cost < least {
                (least, step.decimal, step.exponent) = (cost, true, d);
            }
        }
        step
    }

    pub fn scaled(&self) -> bool {
        self.scale != 1.0 || self.offset != 0.0
    }

    /// The sample that a height was made of, if it was made of one: a float32 holds those of most surveys.
    fn sample_of(&self, z: f64) -> Option<f64> {
        if !self.scaled() {
            return Some(z);
        }
        let s = (z - self.offset) / self.scale;
        [rounded(s), s.round()].into_iter().find(|s| s * self.scale + self.offset == z)
    }

    /// The height of a whole number.
    pub fn height(&self, q: i64) -> f64 {
        let sample = if self.decimal {
            rounded(q as f64 / power_of_ten(self.exponent))
        } else {
            q as f64 * power_of_two(self.exponent)
        };
        if self.scaled() { sample * self.scale + self.offset } else { sample }
    }

    /// The whole number whose height is nearest, if it is small enough.
    pub fn nearest(&self, z: f64) -> Option<i64> {
        let s = if self.scaled() { (z - self.offset) / self.scale } else { z };
        let q = if self.decimal { s * power_of_ten(self.exponent) } else { s * power_of_two(-self.exponent) };
        (q.abs() <= WHOLE_MAX as f64 - 1.0).then(|| rounded_whole(q))
    }

    /// Whether it is one that packed vertices may have.
    pub fn is_sound(&self) -> bool {
        let known = if self.decimal { DECIMALS } else { BINARY };
        known.contains(&self.exponent) && self.scale.is_finite() && self.offset.is_finite()
    }
}

fn rounded(v: f64) -> f64 {
    f64::from(v as f32)
}

/// Exponent of the lowest bit of a number that is set; large for 0.
fn lowest_bit(v: f64) -> i32 {
    let bits = v.to_bits() & !(1 << 63);
    if bits == 0 {
        return 1000;
    }
    let (exponent, fraction) = ((bits >> 52) as i32, bits & ((1 << 52) - 1));
    match exponent {
        0 => fraction.trailing_zeros() as i32 - 1074,
        _ => (fraction | 1 << 52).trailing_zeros() as i32 + exponent - 1075,
    }
}
