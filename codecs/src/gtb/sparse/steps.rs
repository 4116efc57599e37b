//! How many steps a selected height is from its midpoint.

use super::around::Around;
use super::guess::Guess;
use crate::lattice::{Kind, Pass};
use crate::range::{Bit, Coder, ONE};

const SIZES: usize = 27;
const SCALES: usize = 6;
const CLASSES: usize = 48;

pub(super) struct Steps {
    step: f64,
    least: u32,
    last: (u32, usize),
    least_models: Vec<Bit>,
    guesses: [Guess; 2],
    mixes: Vec<Mix>,
}

/// How likely each scale is.
#[derive(Clone)]
struct Mix {
    weights: [f64; SCALES],
    seen: f64,
}

/// The distribution of a surplus: a mixture of Student's t with two degrees of freedom.
struct Shape<'a> {
    weights: &'a [f64; SCALES],
    middle: f64,
    scales: [f64; SCALES],
}

impl Steps {
    pub fn new(step: u32) -> Steps {
        Steps {
            step: f64::from(step),
            least: 0,
            last: (0, 1),
            least_models: vec![Bit::default(); 1 + SIZES],
            guesses: [Guess::new(), Guess::new()],
            mixes: vec![Mix { weights: [1.0 / SCALES as f64; SCALES], seen: 1.0 }; CLASSES],
        }
    }

    /// Begins a pass with the least magnitude in it, as it differs from what the last one lets expect.
    pub fn start<C: Coder>(&mut self, c: &mut C, pass: Pass, least: u32) {
        let expected = (u64::from(self.last.0) * self.last.1 as u64).div_ceil(pass.step as u64) as u32;
        let away = least.wrapping_sub(expected) as i32;
        let models = &mut self.least_models;
        let negative = c.learn(&mut models[0], away < 0);
        let m = away.unsigned_abs();
        let m = magnitude(c, &mut models[1..], m);
        let away = if negative { m.wrapping_neg() } else { m };
        self.least = expected.wrapping_add(away);
        self.last = (self.least, pass.step);
    }

    pub fn code<C: Coder>(&mut self, c: &mut C, around: &Around, middle: f64, q: i32) -> i32 {
        let off = f64::from(super::base(middle)) - middle;
        let guess = &mut self.guesses[usize::from(around.pass.kind == Kind::Edges)];
        let p = guess.of(&around.features);
        let activity = around.activity() + 0.3 * self.step + 0.25 * f64::from(self.least) * self.step;
        let mix = &mut self.mixes[class(activity / self.step)];
        let mut scales = [0.0; SCALES];
        let mut scale = activity * 0.5;
        for s in &mut scales {
            *s = scale;
            scale *= 2.0;
        }
        let shape = Shape { weights: &mix.weights, middle: p, scales };
        let step = self.step;
        // Lower end of step q; the upper one is the next's.
        let edge = |q: f64| (q - 0.5) * step + off;
        let first = f64::from(self.least.max(1));
        if self.least == 0 {
            let (below, above) = (shape.below(edge(0.0)), shape.above(edge(1.0)));
            if c.bit(part(1.0 - below - above, below + above), q == 0) {
                return 0;
            }
        }
        let (negative, positive) = (shape.below(edge(1.0 - first)), shape.above(edge(first)));
        let is_negative = c.bit(part(negative, positive), q < 0);
        // Mass from magnitude m on.
        let from = |m: f64| if is_negative { shape.below(edge(1.0 - m)) } else { shape.above(edge(m)) };
        let wanted = q.unsigned_abs().wrapping_sub(self.least.max(1));
        let (mut low, mut width) = (0u32, 1u32);
        let mut mass = if is_negative { negative } else { positive };
        loop {
            let beyond = from(first + f64::from(low) + f64::from(width));
            if low >= 1 << 26 || !c.bit(part(beyond, mass - beyond), wanted >= low + width) {
                mass -= beyond;
                break;
            }
            mass = beyond;
            low += width;
            width *= 2;
        }
        let mut top = from(first + f64::from(low) + f64::from(width));
        while width > 1 {
            width /= 2;
            let half = from(first + f64::from(low + width));
            let upper = c.bit(part(half - top, mass - (half - top)), wanted >= low + width);
            if upper {
                low += width;
                mass = half - top;
            } else {
                mass -= half - top;
                top = half;
            }
        }
        let m = self.least.max(1).wrapping_add(low);
        // Which scale it was.
        let m_real = f64::from(m);
        let (one, two) = if is_negative { (1.0 - m_real, -m_real) } else { (m_real, m_real + 1.0) };
        let mut likely = [0.0; SCALES];
        let mut sum = 0.0;
        for k in 0..SCALES {
            let of =
                |x: f64, up: bool| if up { above((x - p) / scales[k]) } else { above((p - x) / scales[k]) };
            let here = if is_negative {
                of(edge(one), false) - of(edge(two), false)
            } else {
                of(edge(one), true) - of(edge(two), true)
            };
            let here = here.max(1e-12);
            let allowed = (of(edge(1.0 - first), false) + of(edge(first), true)).max(1e-12);
            likely[k] = mix.weights[k] * here / allowed;
            sum += likely[k];
        }
        mix.seen = (mix.seen + 1.0).min(400.0);
        let rate = 1.0 / (mix.seen + 2.0);
        for k in 0..SCALES {
            mix.weights[k] += rate * (likely[k] / sum - mix.weights[k]);
        }
        let q = if is_negative { (m as i32).wrapping_neg() } else { m as i32 };
        let surplus = f64::from(q) * self.step + off;
        guess.learn(&around.features, surplus, activity);
        q
    }
}

impl Shape<'_> {
    fn above(&self, x: f64) -> f64 {
        let mut sum = 0.0;
        for k in 0..SCALES {
            sum += self.weights[k] * above((x - self.middle) / self.scales[k]);
        }
        sum
    }
    fn below(&self, x: f64) -> f64 {
        let mut sum = 0.0;
        for k in 0..SCALES {
            sum += self.weights[k] * above((self.middle - x) / self.scales[k]);
        }
        sum
    }
}

/// The mass of t with two degrees of freedom above x.
fn above(x: f64) -> f64 {
    let a = x.abs();
    let root = (1.0 + a * a).sqrt();
    let (u, rest) = (a / root, 1.0 / (root * (root + a)));
    let tail = rest * rest * rest * (8.0 + u * (9.0 + 3.0 * u)) / 16.0;
    if x > 0.0 { tail } else { 1.0 - tail }
}

/// The probability of one of two masses.
fn part(one: f64, other: f64) -> u32 {
    let (one, other) = (one.max(1e-12), other.max(1e-12));
    ((one / (one + other) * f64::from(ONE)) as u32).clamp(32, ONE - 32)
}

/// Two classes an octave.
fn class(v: f64) -> usize {
    let mut k = 0;
    let mut limit = 0.5;
    while v > limit && k < CLASSES - 1 {
        limit *= 1.414;
        k += 1;
    }
    k
}

/// A number: its size by doubling intervals (0; 1 to 2; 3 to 6; ...).
fn magnitude<C: Coder>(c: &mut C, size: &mut [Bit], m: u32) -> u32 {
    let v = m.wrapping_add(1);
    let bits = 31 - v.max(1).leading_zeros();
    let mut k = 0;
    while (k as usize) < SIZES - 1 && c.learn(&mut size[k as usize], bits > k) {
        k += 1;
    }
    let mut out = 1u32;
    for b in (0..k).rev() {
        out = out << 1 | u32::from(c.bit(1 << 15, v >> b & 1 == 1));
    }
    out - 1
}
