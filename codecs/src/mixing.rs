//! Several opinions on one decision, weighed against each other: the weights learn which of them is right.
//!
//! Each opinion is the learnt probability of one context. Their logits are added with weights; the sum's logistic is the
//! probability that is coded. Integers and two fixed tables.

use crate::range::{Coder, ONE};

/// Logits are in 256ths, within this either way.
pub(crate) const LOGIT_MAX: i32 = 2047;

/// 65536 / (1 + e^(-x / 256)), rounded, for x from -2048 to 2047.
static LOGISTIC: [u16; 4096] = logistic();

/// The logit of (16 k + 8) / 65536, k from 0 to 4095: the number of entries of [`LOGISTIC`] below it, less 2048.
static LOGIT: [i16; 4096] = logit();

/// e^(-x / 256) for x in 0..=2048 by powers of e^(-1/256), whose series is cut after six terms.
const fn logistic() -> [u16; 4096] {
    let h = 1.0 / 256.0;
    let root = 1.0 - h * (1.0 - h / 2.0 * (1.0 - h / 3.0 * (1.0 - h / 4.0 * (1.0 - h / 5.0))));
    let mut out = [0; 4096];
    let mut power: f64 = 1.0;
    let mut x = 0;
    while x <= 2048 {
        let high = 65536.0 / (1.0 + power);
        if x < 2048 {
            out[2048 + x] = (high + 0.5) as u16;
        }
        out[2048 - x] = (65536.0 - high + 0.5) as u16;
        power *= root;
        x += 1;
    }
    out
}

const fn logit() -> [i16; 4096] {
    let table = logistic();
    let mut out = [0; 4096];
    let (mut k, mut x) = (0, 0);
    while k < 4096 {
        while x < 4095 && (table[x] as usize) < 16 * k + 8 {
            x += 1;
        }
        out[k] = x as i16 - 2048;
        k += 1;
    }
    out
}

/// Decisions seen after which a [`Count`] learns no slower.
const SEEN_MAX: u32 = 250;

/// Decisions that a [`Count`] keeps of an earlier subject.
const DOUBT: u32 = 20;

/// The probability of a one in a context: 22 bits, and in the low 10 how many decisions were seen.
#[derive(Clone, Copy)]
pub(crate) struct Count(u32);

/// 65536 / (n + 1.6), rounded down.
static RATES: [u16; SEEN_MAX as usize + 1] = {
    let mut out = [0; SEEN_MAX as usize + 1];
    let mut n = 0;
    while n <= SEEN_MAX {
        out[n as usize] = (655_360 / (10 * n + 16)) as u16;
        n += 1;
    }
    out
};

impl Count {
    /// As likely as not.
    pub const NEW: Count = Count(1 << 31);

    /// From here on it learns as after [`DOUBT`] decisions, if it has seen more.
    pub fn doubt(&mut self) {
        self.0 = self.0 & !1023 | (self.0 & 1023).min(DOUBT);
    }

    /// Codes one decision by this context alone.
    #[inline(always)]
    pub fn code<C: Coder>(&mut self, c: &mut C, bit: bool) -> bool {
        let bit = c.bit((self.0 >> 16).clamp(4, ONE - 4), bit);
        self.update(bit);
        bit
    }

    #[inline(always)]
    fn logit(self) -> i32 {
        i32::from(LOGIT[(self.0 >> 20) as usize])
    }

    #[inline(always)]
    fn update(&mut self, bit: bool) {
        let (p, n) = ((self.0 >> 10) as i32, self.0 & 1023);
        let to = if bit { (1 << 22) - 1 } else { 0 };
        let p = p + ((i64::from(to - p) * i64::from(RATES[n as usize])) >> 16) as i32;
        self.0 = (p as u32) << 10 | (n + 1).min(SEEN_MAX);
    }
}

/// Weights stay within this either way.
const WEIGHT_MAX: i32 = 8 << 16;

/// Weights of `N` opinions, in 65536ths.
#[derive(Clone, Copy)]
pub(crate) struct Weights<const N: usize> {
    of: [i32; N],
    seen: u32,
}

impl<const N: usize> Weights<N> {
    /// All the same, their sum a little above one.
    pub fn new() -> Weights<N> {
        Weights { of: [(ONE as i32 * 5 / 4) / N as i32; N], seen: 0 }
    }
}

/// Codes one decision by `N` contexts, which learn, as do the weights.
#[inline(always)]
pub(crate) fn code<C: Coder, const N: usize>(
    c: &mut C,
    counts: &mut [Count],
    contexts: [usize; N],
    weights: &mut Weights<N>,
    bit: bool,
) -> bool {
    let logits = contexts.map(|k| counts[k].logit());
    let sum: i64 = logits.iter().zip(&weights.of).map(|(l, w)| i64::from(*l) * i64::from(*w)).sum();
    let x = ((sum >> 16) as i32).clamp(-LOGIT_MAX, LOGIT_MAX);
    let p = i32::from(LOGISTIC[(x + 2048) as usize]);
    let bit = c.bit((p as u32).clamp(32, ONE - 32), bit);
    let error = if bit { ONE as i32 - p } else { -p };
    let rate = 2 + 14 * 64 / (64 + weights.seen as i32);
    weights.seen = (weights.seen + 1).min(4096);
    for (w, logit) in weights.of.iter_mut().zip(logits) {
        *w = (*w + ((logit * (error >> 2) * rate + (1 << 15)) >> 16)).clamp(-WEIGHT_MAX, WEIGHT_MAX);
    }
    for k in contexts {
        counts[k].update(bit);
    }
    bit
}
