//! By how many steps a selected height differs from its midpoint.
//!
//! A surplus is guessed from what lies around; the [`Shape`] around the guess, less what the pass's least magnitude rules out, gives
//! the probability of each decision: zero, sign, doubling intervals, halves of the interval.

use super::around::Around;
use super::guess::Guess;
use super::least::Least;
use super::shape::{Mixture, Shape, Side, chance};
use crate::lattice::{Kind, Pass};
use crate::range::Coder;

/// Magnitudes beyond the least are below four times this.
const FAR: u32 = 1 << 26;

/// The models of steps.
pub(super) struct Steps {
    /// Units a step.
    step: f64,
    least: Least,
    /// The least magnitude in this pass.
    from: u32,
    guesses: [Guess; 2],
    mixture: Mixture,
}

/// Where steps lie as surpluses, in units.
struct Scale {
    step: f64,
    /// The surplus of 0 steps: midpoints are rounded.
    zero: f64,
}

impl Scale {
    /// The lower end of what rounds to `q` steps.
    fn edge(&self, q: f64) -> f64 {
        (q - 0.5) * self.step + self.zero
    }

    /// The mass of magnitudes from `m` on.
    fn beyond(&self, shape: &Shape, side: Side, m: f64) -> f64 {
        match side {
            Side::Below => shape.mass(self.edge(1.0 - m), side),
            Side::Above => shape.mass(self.edge(m), side),
        }
    }
}

impl Steps {
    /// Models for steps of so many units.
    pub fn new(step: u32) -> Steps {
        Steps {
            step: f64::from(step),
            least: Least::new(),
            from: 0,
            guesses: [Kind::Centres, Kind::Edges].map(Guess::new),
            mixture: Mixture::new(),
        }
    }

    /// Begins a pass.
    pub fn start<C: Coder>(&mut self, c: &mut C, pass: Pass, least: u32) {
        self.from = self.least.code(c, pass, least);
    }

    /// Codes the steps of a post from its midpoint `middle`.
    pub fn code<C: Coder>(&mut self, c: &mut C, around: &Around, middle: f64, q: i32) -> i32 {
        let scale = Scale { step: self.step, zero: f64::from(super::base(middle)) - middle };
        let activity = around.activity() + (0.3 + 0.25 * f64::from(self.from)) * self.step;
        let guess = &mut self.guesses[usize::from(around.pass.kind == Kind::Edges)];
        let shape = self.mixture.shape(guess.of(&around.features), activity, self.step);
        let first = self.from.max(1);
        let gap = [scale.edge(1.0 - f64::from(first)), scale.edge(f64::from(first))];
        let [below, above] = [shape.mass(gap[0], Side::Below), shape.mass(gap[1], Side::Above)];
        if self.from == 0 && c.bit(chance(1.0 - below - above, below + above), q == 0) {
            return 0;
        }
        let negative = c.bit(chance(below, above), q < 0);
        let (side, mass) = if negative { (Side::Below, below) } else { (Side::Above, above) };
        let wanted = q.unsigned_abs().wrapping_sub(first);
        let more =
            magnitude(c, wanted, mass, |m| scale.beyond(&shape, side, f64::from(first) + f64::from(m)));
        let magnitude = first.wrapping_add(more) as i32;
        let q = if negative { magnitude.wrapping_neg() } else { magnitude };
        self.mixture.learn(&shape, [scale.edge(f64::from(q)), scale.edge(f64::from(q) + 1.0)], gap);
        guess.learn(&around.features, f64::from(q) * self.step + scale.zero, activity);
        q
    }
}

/// Codes a number from 0: whether it lies in the first 1, the next 2, the next 4 and so on; then in which half, down to one.
/// `mass`: of all; `beyond`: from a number on.
fn magnitude<C: Coder>(c: &mut C, wanted: u32, mut mass: f64, beyond: impl Fn(u32) -> f64) -> u32 {
    let (mut low, mut width) = (0u32, 1u32);
    let mut top;
    loop {
        top = beyond(low + width);
        if low >= FAR || !c.bit(chance(top, mass - top), wanted >= low + width) {
            break;
        }
        mass = top;
        low += width;
        width *= 2;
    }
    while width > 1 {
        width /= 2;
        let half = beyond(low + width);
        if c.bit(chance(half - top, mass - half), wanted >= low + width) {
            low += width;
            mass = half;
        } else {
            top = half;
        }
    }
    low
}
