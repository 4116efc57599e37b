//! The two flags of a candidate.

use super::around::Around;
use crate::range::{Bit, Coder};

pub(super) struct Flags {
    needed: Vec<Bit>,
    selected: Vec<Bit>,
}

impl Flags {
    pub fn new() -> Flags {
        Flags { needed: vec![Bit::default(); 1 << 16], selected: vec![Bit::default(); 1 << 16] }
    }

    pub fn needed<C: Coder>(&mut self, c: &mut C, around: &Around, bit: bool) -> bool {
        let at = context(around) * 5 + usize::from(around.debt);
        c.learn(&mut self.needed[at], bit)
    }

    pub fn selected<C: Coder>(&mut self, c: &mut C, around: &Around, bit: bool) -> bool {
        c.learn(&mut self.selected[context(around)], bit)
    }
}

fn context(a: &Around) -> usize {
    let selected = a.apexes.iter().filter(|p| p.selected).count();
    let there = a.apexes.iter().filter(|p| p.there).count();
    let near = usize::from(a.own[0].needed) + 2 * usize::from(a.own[1].needed);
    let size: f32 = a.apexes.iter().map(|p| p.surplus.abs()).sum::<f32>() * a.pass.step as f32;
    (((there - 1) * 3 + selected) * 4 + near) * 16 + class(f64::from(size))
}

/// One class an octave.
pub(super) fn class(v: f64) -> usize {
    let v = (v.min(65_535.0)) as u32;
    (32 - v.leading_zeros()).min(15) as usize
}
