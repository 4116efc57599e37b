//! Layers: each refines every height inside the interval that the one before left (specification, section 5).
//!
//! Posts come in the order of the first layer: corners, then passes from coarse to fine. What a post's digit will be is guessed
//! from posts that are refined already (coarser ones, and to the west and north of its own pass) and from those that are not.

mod around;
mod mixing;

use super::super::field::Field;
use super::super::header::Header;
use super::{Mark, Reached, is_coded};
use crate::Result;
use crate::lattice::{Pass};
use crate::range::Coder;
use around::{Around, Reach};
use mixing::{Count, Weights};

/// Places of a boundary against a prediction.
const PLACES: usize = 64;
/// Classes of activity.
const CLASSES: usize = 16;
/// Contexts that speak on a decision.
const OPINIONS: usize = 4;

/// Codes one further layer. A prefix that ends in it has the posts before at the layer's bound, the others at the one before.
pub(super) fn code<C: Coder>(
    header: &Header,
    layer: usize,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    mark: Mark<C>,
) -> Result<Reached> {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let mut digits = Digits::new(header.layers[layer - 1], header.layers[layer]);
    let mut magnitude = vec![0u16; side * side];
    for [y, x] in lattice.corners() {
        let at = y * side + x;
        if field.status(at) != super::Status::Given {
            let d = digits.plain(c, source.map(|z| z[at].wrapping_sub(field.z[at])));
            if c.ended() {
                return Ok(Reached { layer, passes: 0, posts: 0, corners: true });
            }
            field.z[at] = field.z[at].wrapping_add(d);
        }
    }
    for (number, pass) in lattice.passes().enumerate() {
        let number = number as u32;
        let reach = Reach::new(lattice, pass);
        for (k, post) in pass.posts(lattice).enumerate() {
            let at = post[0] * side + post[1];
            if !is_coded(field, at) {
                continue;
            }
            let around = reach.look(&field.z, &magnitude, post);
            let own = field.z[at];
            let d = digits.code(c, pass, &around, own, source.map(|z| z[at].wrapping_sub(own)));
            if c.ended() {
                return Ok(Reached { layer, passes: number, posts: k, corners: true });
            }
            let z = own.wrapping_add(d);
            field.z[at] = z;
            let r = z.wrapping_mul(32).wrapping_sub(around.guesses[0]).unsigned_abs() / 8;
            magnitude[at] = r.min(65_535) as u16;
        }
        if !mark(layer, number, c)? {
            return Ok(Reached { layer, passes: number + 1, posts: 0, corners: true });
        }
    }
    Ok(Reached { layer, passes: 2 * lattice.n(), posts: 0, corners: true })
}

/// The models of a layer's digits.
struct Digits {
    /// Digits that an interval is divided in.
    count: i32,
    /// Units of one.
    step: i32,
    counts: Vec<Count>,
    weights: Vec<Weights<OPINIONS>>,
    /// Of n digits: `(1 << 26) * PER / (64 * n * step)`.
    scale: Vec<i64>,
}

/// Places in the width of the interval that a decision divides.
const PER: i64 = 24;

impl Digits {
    fn new(coarse: u32, fine: u32) -> Digits {
        let step = 2 * fine as i32 + 1;
        let count = (2 * coarse as i32 + 1) / step;
        let scale = (0..=i64::from(count)).map(|n| (PER << 26) / (64 * n.max(1) * i64::from(step))).collect();
        Digits {
            count,
            step,
            counts: vec![Count::NEW; 3 * (OPINIONS + 16) * PLACES * CLASSES],
            weights: vec![Weights::new(); 3 * 8],
            scale,
        }
    }

    /// A digit without any guess. Takes and returns what it adds to the height.
    fn plain<C: Coder>(&mut self, c: &mut C, wanted: Option<i32>) -> i32 {
        let (mut low, mut high) = (0, self.count);
        let digit = wanted.map_or(0, |w| self.digit(w));
        while high - low > 1 {
            let cut = (low + high) / 2;
            let p = (65_536 * (high - cut) / (high - low)) as u32;
            if c.bit(p, digit >= cut) { low = cut } else { high = cut }
        }
        (low - self.count / 2) * self.step
    }

    fn digit(&self, wanted: i32) -> i32 {
        (wanted.wrapping_add(self.step / 2).div_euclid(self.step).wrapping_add(self.count / 2)).clamp(0, self.count - 1)
    }

    /// One digit of a post of height `own`. Takes and returns what it adds to the height.
    fn code<C: Coder>(&mut self, c: &mut C, pass: Pass, around: &Around, own: i32, wanted: Option<i32>) -> i32 {
        let (count, step) = (self.count, self.step);
        let away = around.guesses.map(|g| g.wrapping_sub(own.wrapping_mul(32)));
        let flip = away[0] < 0;
        let away = away.map(|a| i64::from(if flip { a.wrapping_neg() } else { a }));
        let digit = wanted.map_or(0, |w| self.digit(if flip { -w } else { w }));
        let class = class(around.activity * 4 / step as u32);
        let kind = match (pass.step, pass.kind) {
            (1, crate::lattice::Kind::Edges) => 0,
            (1, _) => 1,
            (2, crate::lattice::Kind::Edges) => 2,
            (2, _) => 3,
            (4, _) => 4,
            _ => 5,
        };
        let (mut low, mut high) = (0, count);
        while high - low > 1 {
            let n = high - low;
            let (cut, shape) = match n {
                3 => (low + 2, 0),
                2 => (low + 1, 1),
                _ => (low + n / 2, 2),
            };
            // The boundary less the guess, in 64ths of a unit.
            let boundary = i64::from(2 * cut - count) * i64::from(step) * 32;
            let scale = self.scale[n as usize];
            let place = |k: usize, per: i64| {
                let v = ((boundary - 2 * away[k]) * scale * per / PER) >> 26;
                (v + 32).clamp(0, 63) as usize
            };
            let base = shape * (OPINIONS + 16) * PLACES * CLASSES;
            let context = |table: usize, place: usize, class: usize| {
                base + (table * CLASSES + class) * PLACES + place
            };
            let joint = ((place(0, 12) >> 1) & 31) * 32 + ((place(1, 12) >> 1) & 31);
            let contexts = [
                context(0, place(0, PER), class),
                context(1, place(1, PER), class),
                context(2, place(2, PER), class),
                base + (OPINIONS + (class / 2).min(7) ) * PLACES * CLASSES + joint,
            ];
            let weights = &mut self.weights[shape * 8 + kind];
            if mixing::code(c, &mut self.counts, contexts, weights, digit >= cut) {
                low = cut;
            } else {
                high = cut;
            }
        }
        let d = (low - count / 2) * step;
        if flip { -d } else { d }
    }
}

/// Two classes an octave.
fn class(v: u32) -> usize {
    let v = v + 1;
    let size = 31 - v.leading_zeros();
    let low = if size >= 1 { v >> (size - 1) & 1 } else { 0 };
    ((size << 1 | low) as usize).min(CLASSES - 1)
}
