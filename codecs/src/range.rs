//! The range coder: binary decisions with probabilities, in and out of bytes that may be cut anywhere.
//!
//! One function describes a model for both directions: it takes a [`Coder`] and hands it each decision with the probability
//! that it is a one. The [`Encoder`] writes it; the [`Decoder`] answers with what was written.
//!
//! A decoder of a prefix knows exactly how far it can see: the bytes that are missing could be anything, so a decision
//! holds only if it comes out the same for the least and the greatest of them. At the first that does not, the decoder has
//! [`ended`](Coder::ended): it answers `false` from then on and the caller drops what it was about to decode.
//!
//! State: `low` and `range`, 64 bits. A decision takes `range / 65536 * p` of the range for a one. Whenever the range falls below
//! 2^32, four bytes leave. A carry runs back into bytes that have left.

/// Probabilities are in 65536ths.
pub const ONE: u32 = 1 << 16;

/// Takes or gives binary decisions.
pub trait Coder {
    /// One decision; `p` of 65536 is the probability that it is `true`, `1..=65535`. The encoder writes `bit` and returns it; a
    /// decoder ignores `bit` and returns what was written, or `false` once it has ended.
    fn bit(&mut self, p: u32, bit: bool) -> bool;

    /// Whether the bytes ended before the last decision was certain. Always `false` for an encoder.
    fn ended(&self) -> bool;

    /// `count` bits of `value`, high bit first, as likely as not.
    fn bits(&mut self, count: u32, value: u32) -> u32 {
        (0..count).rev().fold(0, |v, k| v << 1 | u32::from(self.bit(ONE / 2, value >> k & 1 == 1)))
    }

    /// A decision by a model that learns from it.
    #[inline(always)]
    fn learn(&mut self, model: &mut Bit, bit: bool) -> bool {
        let b = self.bit(model.p(), bit);
        model.update(b);
        b
    }
}

/// The probability of a decision, learnt: quickly at first, then more and more slowly.
#[derive(Clone, Copy, Debug)]
pub struct Bit {
    p: u16,
    seen: u16,
}

/// How much of the difference a decision takes, in 65536ths, after 0, 1, 2 ... decisions; the last holds from then on.
const RATES: [u32; 128] = rates();

const fn rates() -> [u32; 128] {
    let mut out = [0; 128];
    let mut k = 0;
    while k < out.len() {
        out[k] = 131_072 / (2 * k as u32 + 3);
        k += 1;
    }
    out
}

impl Bit {
    /// A model that expects a one with `p` of 65536.
    pub const fn new(p: u16) -> Bit {
        Bit { p, seen: 0 }
    }

    /// A model that expects a one with `p` of 65536 as if it had learnt that from `seen` decisions.
    pub const fn known(p: u16, seen: u16) -> Bit {
        Bit { p, seen }
    }

    /// The probability of a one, `32..=65504`.
    #[inline(always)]
    pub fn p(&self) -> u32 {
        u32::from(self.p).clamp(32, ONE - 32)
    }

    /// Learns.
    #[inline(always)]
    pub fn update(&mut self, bit: bool) {
        let (p, rate) = (u32::from(self.p), RATES[usize::from(self.seen)]);
        self.p = if bit { p + (((65_535 - p) * rate) >> 16) } else { p - ((p * rate) >> 16) } as u16;
        self.seen = (self.seen + 1).min(RATES.len() as u16 - 1);
    }
}

impl Default for Bit {
    fn default() -> Bit {
        Bit::new(1 << 15)
    }
}

/// Writes decisions.
pub struct Encoder {
    low: u64,
    range: u64,
    out: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Encoder {
        Encoder::new()
    }
}

impl Encoder {
    /// An encoder without any output yet.
    pub fn new() -> Encoder {
        Encoder { low: 0, range: u64::MAX, out: Vec::new() }
    }

    /// Bytes after which every decision so far is certain for a decoder, whatever follows.
    pub fn position(&self) -> usize {
        self.out.len() + 8
    }

    fn carry(&mut self) {
        for b in self.out.iter_mut().rev() {
            *b = b.wrapping_add(1);
            if *b != 0 {
                break;
            }
        }
    }

    /// The bytes. Zeros at the end are left out: a decoder that knows that nothing is missing reads zeros there.
    pub fn finish(mut self) -> Vec<u8> {
        // The value in low..low + range with the most zeros at its end.
        let last = u128::from(self.low) + u128::from(self.range) - 1;
        let mut value = last;
        for zeros in (0..=64).rev() {
            let v = last >> zeros << zeros;
            if v >= u128::from(self.low) {
                value = v;
                break;
            }
        }
        if value >> 64 != 0 {
            self.carry();
        }
        self.out.extend_from_slice(&(value as u64).to_be_bytes());
        while self.out.last() == Some(&0) {
            self.out.pop();
        }
        self.out
    }
}

impl Coder for Encoder {
    #[inline(always)]
    fn bit(&mut self, p: u32, bit: bool) -> bool {
        let bound = (self.range >> 16) * u64::from(p);
        if bit {
            self.range = bound;
        } else {
            let (low, over) = self.low.overflowing_add(bound);
            self.low = low;
            self.range -= bound;
            if over {
                self.carry();
            }
        }
        if self.range >> 32 == 0 {
            self.out.extend_from_slice(&((self.low >> 32) as u32).to_be_bytes());
            self.low <<= 32;
            self.range <<= 32;
        }
        bit
    }

    #[inline(always)]
    fn ended(&self) -> bool {
        false
    }
}

/// Reads decisions back from a prefix.
pub struct Decoder<'a> {
    /// What was written, less what has been taken from it; of missing bytes the least that they could be.
    code: u64,
    /// How much more the missing bytes could make of it.
    doubt: u64,
    range: u64,
    bytes: &'a [u8],
    at: usize,
    whole: bool,
    ended: bool,
}

impl<'a> Decoder<'a> {
    /// Decodes what `bytes` hold; `whole` if nothing is missing behind them.
    pub fn new(bytes: &'a [u8], whole: bool) -> Decoder<'a> {
        let mut d = Decoder { code: 0, doubt: 0, range: u64::MAX, bytes, at: 0, whole, ended: false };
        for _ in 0..2 {
            d.refill();
        }
        d
    }

    /// Bytes that have been looked at.
    pub fn position(&self) -> usize {
        self.at.min(self.bytes.len())
    }

    #[inline(always)]
    fn refill(&mut self) {
        match self.bytes.get(self.at..self.at + 4) {
            Some(four) => {
                self.code =
                    self.code << 32 | u64::from(u32::from_be_bytes([four[0], four[1], four[2], four[3]]));
                self.doubt <<= 32;
                self.at += 4;
            }
            None => self.refill_at_the_end(),
        }
    }

    #[cold]
    fn refill_at_the_end(&mut self) {
        for _ in 0..4 {
            let byte = self.bytes.get(self.at).copied();
            self.code = self.code << 8 | u64::from(byte.unwrap_or(0));
            self.doubt = self.doubt << 8 | if byte.is_none() && !self.whole { 255 } else { 0 };
            self.at = self.at.saturating_add(1);
        }
    }

    #[cold]
    fn end(&mut self) -> bool {
        self.ended = true;
        // Whatever comes: a range that never runs low.
        self.code = 0;
        self.doubt = 0;
        self.range = u64::MAX;
        false
    }
}

impl Coder for Decoder<'_> {
    #[inline(always)]
    fn bit(&mut self, p: u32, _: bool) -> bool {
        let bound = (self.range >> 16) * u64::from(p);
        let bit = self.code < bound;
        if bit != (self.code.saturating_add(self.doubt) < bound) || self.ended {
            return self.end();
        }
        if bit {
            self.range = bound;
        } else {
            self.code -= bound;
            self.range -= bound;
        }
        if self.range >> 32 == 0 {
            self.range <<= 32;
            self.refill();
        }
        bit
    }

    #[inline(always)]
    fn ended(&self) -> bool {
        self.ended
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn written(decisions: &[(u16, bool)]) -> Vec<u8> {
        let mut e = Encoder::new();
        for (p, bit) in decisions {
            e.bit(u32::from(*p).max(1), *bit);
        }
        e.finish()
    }

    proptest! {
        #[test]
        fn what_went_in_comes_out(decisions in prop::collection::vec((any::<u16>(), any::<bool>()), 0..2000)) {
            let bytes = written(&decisions);
            let mut d = Decoder::new(&bytes, true);
            for (p, bit) in &decisions {
                prop_assert_eq!(d.bit(u32::from(*p).max(1), false), *bit);
            }
            prop_assert!(!d.ended());
        }

        /// Every decision that a prefix gives is the one that was written; a longer prefix gives no fewer.
        #[test]
        fn a_prefix_never_lies(decisions in prop::collection::vec((any::<u16>(), any::<bool>()), 1..400)) {
            let bytes = written(&decisions);
            let mut last = 0;
            for cut in 0..=bytes.len() {
                let mut d = Decoder::new(&bytes[..cut], false);
                let mut certain = 0;
                for (p, bit) in &decisions {
                    let got = d.bit(u32::from(*p).max(1), false);
                    if d.ended() {
                        break;
                    }
                    prop_assert_eq!(got, *bit);
                    certain += 1;
                }
                prop_assert!(certain >= last);
                last = certain;
            }
        }
    }

    /// Carries run through long rows of 255, and sixteen bytes of any value decode to something.
    #[test]
    fn carries_and_rubbish() {
        let decisions: Vec<(u16, bool)> = (0..5000).map(|k| (65_535, k % 4999 != 4998)).collect();
        let bytes = written(&decisions);
        let mut d = Decoder::new(&bytes, true);
        for (p, bit) in &decisions {
            assert_eq!(d.bit(u32::from(*p), false), *bit);
        }
        let mut d = Decoder::new(&[255; 16], true);
        (0..10_000).for_each(|k| {
            d.bit(1 + k % 65_535, false);
        });
    }
}
