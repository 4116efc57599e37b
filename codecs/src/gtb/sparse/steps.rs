//! How many steps a selected height is from its midpoint.

use super::around::Around;
use crate::lattice::Pass;
use crate::range::{Bit, Coder};

const SIZES: usize = 27;

pub(super) struct Steps {
    least: u32,
    last: (u32, usize),
    least_models: Vec<Bit>,
    sign: Vec<Bit>,
    size: Vec<Bit>,
    within: Vec<Bit>,
}

impl Steps {
    pub fn new() -> Steps {
        Steps {
            least: 0,
            last: (0, 1),
            least_models: vec![Bit::default(); 2 + SIZES],
            sign: vec![Bit::default(); 64],
            size: vec![Bit::default(); 64 * SIZES],
            within: vec![Bit::default(); SIZES * 4],
        }
    }

    /// Begins a pass with the least magnitude in it, as it differs from what the last one lets expect.
    pub fn start<C: Coder>(&mut self, c: &mut C, pass: Pass, least: u32) {
        let expected = (u64::from(self.last.0) * self.last.1 as u64).div_ceil(pass.step as u64) as u32;
        let away = least.wrapping_sub(expected) as i32;
        let models = &mut self.least_models;
        let negative = c.learn(&mut models[0], away < 0);
        let m = away.unsigned_abs();
        let m = magnitude(c, &mut models[2..], &mut [], m);
        let away = if negative { m.wrapping_neg() } else { m };
        self.least = expected.wrapping_add(away);
        self.last = (self.least, pass.step);
    }

    pub fn code<C: Coder>(&mut self, c: &mut C, around: &Around, middle: f64, q: i32) -> i32 {
        let part = middle - middle.floor();
        let own = around.own.iter().map(|p| p.surplus.abs()).fold(0.0, f32::max);
        let apexes = around.apexes.iter().map(|p| p.surplus.abs()).fold(0.0, f32::max);
        let class = super::flags::class(f64::from(own + apexes));
        let m = q.unsigned_abs().wrapping_sub(self.least);
        let m = magnitude(c, &mut self.size[class * SIZES..][..SIZES], &mut self.within, m);
        let m = m.wrapping_add(self.least);
        let e: f64 = around.twist + f64::from(around.apexes[0].surplus + around.apexes[1].surplus) / 2.0;
        let lean = class_signed(e);
        let at = lean * 3
            + if part == 0.0 {
                0
            } else if part < 0.5 {
                1
            } else {
                2
            };
        if m != 0 && c.learn(&mut self.sign[at], q < 0) { (m as i32).wrapping_neg() } else { m as i32 }
    }
}

fn class_signed(e: f64) -> usize {
    let c = super::flags::class(e.abs()).min(7);
    if e < 0.0 { 8 + c } else { c }
}

/// A number: its size by doubling intervals (0; 1 to 2; 3 to 6; ...), the two high bits learnt.
fn magnitude<C: Coder>(c: &mut C, size: &mut [Bit], within: &mut [Bit], m: u32) -> u32 {
    let v = m.wrapping_add(1);
    let bits = 31 - v.max(1).leading_zeros();
    let mut k = 0;
    while (k as usize) < SIZES - 1 && c.learn(&mut size[k as usize], bits > k) {
        k += 1;
    }
    let mut out = 1u32;
    for b in (0..k).rev() {
        let bit = v >> b & 1 == 1;
        let depth = k - 1 - b;
        let bit = if depth < 2 && !within.is_empty() {
            c.learn(&mut within[k as usize * 4 + if depth == 0 { 0 } else { 1 + (out & 1) as usize }], bit)
        } else {
            c.bit(1 << 15, bit)
        };
        out = out << 1 | u32::from(bit);
    }
    out - 1
}
