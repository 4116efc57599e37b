//! The distribution of a surplus: a mixture over scales, whose weights are learnt.
//!
//! Each part is Student's t with six degrees of freedom: its tail is algebraic, so `+ - * /` and `sqrt` give the same probabilities on
//! every machine.

use crate::range::ONE;

/// Scales of a mixture, each twice the one before.
const SCALES: usize = 6;
/// Classes of activity, two an octave, and one for all.
const CLASSES: usize = 48;
/// The weights to begin with: what most ground comes to.
const PRIOR: [f64; SCALES] = [0.04, 0.10, 0.33, 0.38, 0.12, 0.03];
/// The smallest scale in parts of the activity.
const SMALLEST: f64 = 0.25;
/// How many posts the coarser weights count for.
const TRUST: f64 = 20.0;
/// Counts are halved when they have come to so many.
const MOST: f64 = 400.0;
/// Less is no mass: what cannot be can still be coded.
const NOTHING: f64 = 1e-12;

/// What was learnt about scales.
pub(super) struct Mixture {
    counts: [[f64; SCALES]; CLASSES + 1],
    seen: [f64; CLASSES + 1],
}

/// The distribution for one post.
pub(super) struct Shape {
    class: usize,
    middle: f64,
    scales: [f64; SCALES],
    weights: [f64; SCALES],
}

/// One side of the distribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Side {
    Below,
    Above,
}

impl Mixture {
    pub fn new() -> Mixture {
        Mixture { counts: [[0.0; SCALES]; CLASSES + 1], seen: [0.0; CLASSES + 1] }
    }

    /// The distribution around `middle` where surpluses are about as large as `activity`, both in units; `activity > 0`, `step` units
    /// a step.
    pub fn shape(&self, middle: f64, activity: f64, step: f64) -> Shape {
        let class = class(activity / step);
        let mut weights = PRIOR;
        for at in [CLASSES, class] {
            for (w, n) in weights.iter_mut().zip(self.counts[at]) {
                *w = (n + TRUST * *w) / (self.seen[at] + TRUST);
            }
        }
        let mut scale = activity * SMALLEST;
        let scales = [(); SCALES].map(|()| {
            let now = scale;
            scale *= 2.0;
            now
        });
        Shape { class, middle, scales, weights }
    }

    /// Learns that a surplus fell between `low` and `high`, when it could only fall below `gap[0]` or above `gap[1]`.
    pub fn learn(&mut self, shape: &Shape, [low, high]: [f64; 2], gap: [f64; 2]) {
        let mut likely = [0.0; SCALES];
        let mut sum = 0.0;
        for (k, likely) in likely.iter_mut().enumerate() {
            // From the side where the difference of tails keeps its digits.
            let here = if low >= gap[1] {
                shape.part(k, low, Side::Above) - shape.part(k, high, Side::Above)
            } else {
                shape.part(k, high, Side::Below) - shape.part(k, low, Side::Below)
            };
            let all = shape.part(k, gap[0], Side::Below) + shape.part(k, gap[1], Side::Above);
            *likely = shape.weights[k] * here.max(NOTHING) / all.max(NOTHING);
            sum += *likely;
        }
        for at in [shape.class, CLASSES] {
            if self.seen[at] >= MOST {
                self.seen[at] *= 0.5;
                self.counts[at].iter_mut().for_each(|n| *n *= 0.5);
            }
            self.seen[at] += 1.0;
            for (n, l) in self.counts[at].iter_mut().zip(likely) {
                *n += l / sum;
            }
        }
    }
}

impl Shape {
    /// The mass on one side of x.
    pub fn mass(&self, x: f64, side: Side) -> f64 {
        let mut sum = 0.0;
        for k in 0..SCALES {
            sum += self.weights[k] * self.part(k, x, side);
        }
        sum
    }

    fn part(&self, k: usize, x: f64, side: Side) -> f64 {
        let x = (x - self.middle) / self.scales[k];
        tail(if side == Side::Above { x } else { -x })
    }
}

/// The mass of t with six degrees of freedom above x times the square root of six.
fn tail(x: f64) -> f64 {
    let a = x.abs();
    let root = (1.0 + a * a).sqrt();
    let (u, rest) = (a / root, 1.0 / (root * (root + a)));
    let tail = rest * rest * rest * (8.0 + u * (9.0 + 3.0 * u)) / 16.0;
    if x > 0.0 { tail } else { 1.0 - tail }
}

/// The probability of one of two masses, for the range coder.
pub(super) fn chance(one: f64, other: f64) -> u32 {
    let (one, other) = (one.max(NOTHING), other.max(NOTHING));
    ((one / (one + other) * f64::from(ONE)) as u32).clamp(32, ONE - 32)
}

/// Two classes an octave.
fn class(v: f64) -> usize {
    let (mut class, mut limit) = (0, 0.5);
    while v > limit && class < CLASSES - 1 {
        limit *= 1.414;
        class += 1;
    }
    class
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against the distribution's density, summed.
    #[test]
    fn tails_are_those_of_t() {
        let density = |x: f64| 0.9375 / 6.0_f64.sqrt() / (1.0 + x * x).powf(3.5) * 6.0_f64.sqrt();
        for from in [-3.0, -1.0, 0.0, 0.3, 2.0, 10.0] {
            let step = 1e-4;
            let sum: f64 = (0..2_000_000).map(|k| density(from + (f64::from(k) + 0.5) * step) * step).sum();
            assert!((sum - tail(from)).abs() < 1e-6, "above {from}: {sum}, {}", tail(from));
        }
    }

    #[test]
    fn far_tails_stay_positive_and_chances_in_range() {
        let shape = Mixture::new().shape(0.0, 0.3, 1.0);
        let masses = [1.0, 1e3, 1e6, 4e9].map(|x| shape.mass(x, Side::Above));
        assert!(masses.windows(2).all(|m| m[0] > m[1]) && masses[3] > 0.0, "{masses:?}");
        assert_eq!([chance(0.0, 1.0), chance(1.0, 0.0), chance(0.0, -1.0)], [32, ONE - 32, ONE / 2]);
    }
}
