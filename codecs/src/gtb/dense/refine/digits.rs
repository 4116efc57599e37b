//! The digits of a layer: in which part of its interval a height lies.

use super::around::Around;
use crate::lattice::{Kind, Pass};
use crate::mixing::{self, Count, Weights};
use crate::range::Coder;

/// Contexts that speak on a decision: a guess each, and the first two together.
const OPINIONS: usize = 5;
/// Classes of what a guess is likely to be wrong by: two an octave.
const CLASSES: usize = 16;
/// Places of a boundary against a guess, of one and the joint context.
const PLACES: usize = 64;
/// Places in the width of the interval that a decision divides.
const FINE: i64 = 24;
/// The same for the joint context, which has half the places each way and half the classes.
const ROUGH: i64 = 6;
/// Contexts of guesses of a shape.
const SINGLE: usize = 4 * CLASSES * PLACES;
/// Contexts of a shape of decisions.
const SHAPE: usize = SINGLE + CLASSES / 2 * PLACES / 2 * PLACES / 2;
/// Shapes: the interval has three parts, two, more.
const SHAPES: usize = 3;
/// Groups of passes whose weights learn alone.
const GROUPS: usize = 6;

/// The models of a layer's digits.
pub(in super::super) struct Digits {
    /// Parts of an interval: odd.
    parts: i32,
    /// Units of a part.
    step: i32,
    counts: Vec<Count>,
    weights: Vec<Weights<OPINIONS>>,
    /// Of an interval of n parts: places of its width for a 64th of a unit, times 2^26; fine and rough.
    scale: Vec<[i64; 2]>,
}

impl Digits {
    /// Of a layer of bound `fine` after one of bound `coarse`.
    pub fn new(coarse: u32, fine: u32) -> Digits {
        let step = 2 * fine as i32 + 1;
        let parts = (2 * coarse as i32 + 1) / step;
        let scale = |n: i64| [FINE, ROUGH].map(|per| (per << 26) / (64 * n.max(1) * i64::from(step)));
        Digits {
            parts,
            step,
            counts: vec![Count::NEW; SHAPES * SHAPE],
            weights: vec![Weights::new(); SHAPES * GROUPS],
            scale: (0..=i64::from(parts)).map(scale).collect(),
        }
    }

    /// Of the next layer: what was learnt of this one is a first opinion, for all is in parts of an interval.
    pub fn next(self, coarse: u32, fine: u32) -> Digits {
        let mut next = Digits::new(coarse, fine);
        next.weights = self.weights;
        next.counts = self.counts;
        next.counts.iter_mut().for_each(Count::doubt);
        next
    }

    /// The part that a height `wanted` units above the middle of the interval lies in.
    fn part(&self, wanted: i32) -> i32 {
        let part = wanted.wrapping_add(self.step / 2).div_euclid(self.step).wrapping_add(self.parts / 2);
        part.clamp(0, self.parts - 1)
    }

    /// A digit without a guess: all parts as likely. Takes what the height lies above the middle and returns what the middle of
    /// its part does.
    pub(super) fn plain<C: Coder>(&self, c: &mut C, wanted: Option<i32>) -> i32 {
        let part = wanted.map_or(0, |w| self.part(w));
        let (mut low, mut high) = (0, self.parts);
        while high - low > 1 {
            let cut = (low + high) / 2;
            let p = (65_536 * (high - cut) / (high - low)) as u32;
            if c.bit(p, part >= cut) { low = cut } else { high = cut }
        }
        (low - self.parts / 2) * self.step
    }

    /// A digit of a post of height `own`, by decisions that divide the interval until one part is left. All is mirrored so that
    /// the first guess lies above the middle; of three parts the one above comes first. Takes and returns as [`Digits::plain`].
    #[inline(always)]
    pub(super) fn code<C: Coder>(
        &mut self,
        c: &mut C,
        pass: Pass,
        around: &Around,
        own: i32,
        wanted: Option<i32>,
    ) -> i32 {
        let away = around.guesses.map(|g| g.wrapping_sub(own.wrapping_mul(32)));
        let flip = away[0] < 0;
        let away = away.map(|a| 2 * i64::from(if flip { a.wrapping_neg() } else { a }));
        let part = wanted.map_or(0, |w| self.part(if flip { -w } else { w }));
        let class = class(4 * around.activity / self.step as u32);
        let group = group(pass);
        let (mut low, mut high) = (0, self.parts);
        while high - low > 1 {
            let n = high - low;
            let (cut, shape) = match n {
                3 => (low + 2, 0),
                2 => (low + 1, 1),
                _ => (low + n / 2, 2),
            };
            let boundary = i64::from(2 * cut - self.parts) * i64::from(self.step) * 32;
            let [fine, rough] = self.scale[n as usize];
            let place = |k: usize, scale: i64, half: i64| {
                ((((boundary - away[k]) * scale) >> 26) + half).clamp(0, 2 * half - 1) as usize
            };
            let base = shape * SHAPE;
            let single = |k: usize| base + (k * CLASSES + class) * PLACES + place(k, fine, PLACES as i64 / 2);
            let half = PLACES as i64 / 4;
            let joint =
                (class / 2 * (PLACES / 2) + place(0, rough, half)) * (PLACES / 2) + place(1, rough, half);
            let contexts = [single(0), single(1), single(2), single(3), base + SINGLE + joint];
            let weights = &mut self.weights[shape * GROUPS + group];
            if mixing::code(c, &mut self.counts, contexts, weights, part >= cut) {
                low = cut;
            } else {
                high = cut;
            }
        }
        let d = (low - self.parts / 2) * self.step;
        if flip { -d } else { d }
    }
}

/// The passes of steps 1 and 2 each alone, those of step 4, those before.
fn group(pass: Pass) -> usize {
    match (pass.step, pass.kind) {
        (1, Kind::Edges) => 0,
        (1, Kind::Centres) => 1,
        (2, Kind::Edges) => 2,
        (2, Kind::Centres) => 3,
        (4, _) => 4,
        _ => 5,
    }
}

/// Two classes an octave.
fn class(v: u32) -> usize {
    let size = (v + 1).ilog2();
    let low = if size > 0 { (v + 1) >> (size - 1) & 1 } else { 0 };
    ((size << 1 | low) as usize).min(CLASSES - 1)
}
