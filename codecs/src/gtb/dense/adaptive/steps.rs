//! The number of steps between a prediction and a height, as decisions.
//!
//! Where little is expected: whether it is 0; its sign; how often its magnitude can be halved, one decision each; the
//! magnitude's lower bits, high bit first. Where much is expected (`start` > 0 bits): whether it is negative (then -1
//! counts as 0, -2 as 1 and so on); whether it takes more than `start` bits, than `start` + 1 and so on; its bits.

use super::bells::Bells;
use super::mixer::{Contexts, Mixer};
use crate::range::Coder;

/// Codes `q`; 0 or rubbish after the bytes have ended.
#[inline(always)]
pub(super) fn code<C: Coder>(
    mixer: &mut Mixer,
    c: &mut C,
    with: &Contexts,
    bells: Bells,
    start: u32,
    q: i32,
) -> i32 {
    if start == 0 { near(mixer, c, with, bells, q) } else { far(mixer, c, with, bells, start, q) }
}

#[inline(always)]
fn near<C: Coder>(mixer: &mut Mixer, c: &mut C, with: &Contexts, mut bells: Bells, q: i32) -> i32 {
    if mixer.code(c, with, 0, bells.zero(), q == 0) {
        return 0;
    }
    let negative = mixer.code(c, with, 1, bells.negative(), q < 0);
    bells.side(negative, false);
    let m = q.unsigned_abs();
    let size = 31 - m.max(1).leading_zeros();
    let mut k = 0u32;
    while k < 28 {
        let odds = bells.beyond((2u32 << k) as f32 - 0.5);
        if !mixer.code(c, with, 2 + k.min(23) as usize, odds, size > k) || c.ended() {
            break;
        }
        bells.go_on();
        k += 1;
    }
    let mut v = 1u32;
    for b in (0..k).rev() {
        let (odds, mid) = bells.upper(((2 * v + 1) << b) as f32 - 0.5);
        let node = match k - 1 - b {
            0 => 26 + k.min(23) as usize,
            1 => 50 + 2 * k.min(23) as usize + (v & 1) as usize,
            n => 98 + n.min(13) as usize,
        };
        let bit = mixer.code(c, with, node, odds, m >> b & 1 == 1);
        bells.take(bit, mid);
        v = v << 1 | u32::from(bit);
    }
    if negative { -(v as i32) } else { v as i32 }
}

#[inline(always)]
fn far<C: Coder>(mixer: &mut Mixer, c: &mut C, with: &Contexts, mut bells: Bells, start: u32, q: i32) -> i32 {
    let negative = mixer.code(c, with, 112, bells.below(), q < 0);
    bells.side(negative, true);
    let m = if q < 0 { !q } else { q } as u32;
    let shift = if negative { 0.5 } else { -0.5 };
    let size = 32 - m.leading_zeros();
    let mut k = start;
    while k < 29 {
        let odds = bells.beyond((1u32 << k) as f32 + shift);
        let node = 113 + (k - start).min(7) as usize;
        if !mixer.code(c, with, node, odds, size > k) || c.ended() {
            break;
        }
        bells.go_on();
        k += 1;
    }
    let (mut v, bits) = if k == start { (0u32, k) } else { (1, k - 1) };
    for b in (0..bits).rev() {
        let (odds, mid) = bells.upper(((2 * v + 1) << b) as f32 + shift);
        let node = match bits - 1 - b {
            0 => 121 + usize::from(k > start),
            1 => 123 + (v & 1) as usize,
            n => 123 + n.min(4) as usize,
        };
        let bit = mixer.code(c, with, node, odds, m >> b & 1 == 1);
        bells.take(bit, mid);
        v = v << 1 | u32::from(bit);
    }
    if negative { !(v as i32) } else { v as i32 }
}
