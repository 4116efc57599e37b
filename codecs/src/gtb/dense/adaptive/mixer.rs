//! A probability from many: odds weighted by what they were worth.

use super::experts::{EXPERTS, Lanes};
use super::logit::{log2, squash};
use crate::range::{Bit, Coder};

/// Counters that vote beside the experts.
pub(super) const COUNTERS: usize = 3;
const INPUTS: usize = EXPERTS + COUNTERS + 1;
/// Kinds of decisions.
pub(super) const NODES: usize = 128;

/// Weights, by the kind of decision and by two contexts.
pub(super) struct Mixer {
    first: Vec<[f32; INPUTS]>,
    second: Vec<[f32; INPUTS]>,
    counters: Vec<Bit>,
    maps: Vec<[u16; 33]>,
    pub rate: f32,
}

/// What decisions of a post depend on.
pub(super) struct Contexts {
    /// Below 64 each: picks of weights.
    pub weights: [usize; 2],
    /// Contexts of the counters, below `COUNTER_SIZE`.
    pub counters: [usize; COUNTERS],
}

/// Contexts of one counter.
pub(super) const COUNTER_SIZE: usize = 512;

impl Mixer {
    pub fn new() -> Mixer {
        let mut start = [0.0; INPUTS];
        start[..EXPERTS].fill(super::squares::p(22, 0.45) / EXPERTS as f32);
        start[EXPERTS..EXPERTS + COUNTERS].fill(super::squares::p(23, 0.02));
        let maps: [u16; 33] = std::array::from_fn(|k| (squash((k as f32 - 16.0) * 0.75) * 65_535.0) as u16);
        Mixer {
            first: vec![start; 64 * NODES],
            second: vec![start; 64 * NODES],
            counters: vec![Bit::default(); COUNTERS * COUNTER_SIZE * NODES],
            maps: vec![maps; 64 * NODES],
            rate: super::squares::p(20, 0.0008),
        }
    }

    /// One decision. `node`: its kind.
    #[inline(always)]
    pub fn code<C: Coder>(&mut self, c: &mut C, with: &Contexts, node: usize, odds: Lanes, bit: bool) -> bool {
        let mut input = [0.0f32; INPUTS];
        input[..EXPERTS].copy_from_slice(&odds);
        input[INPUTS - 1] = 0.5;
        let mut ps = [32_768.0f32; 4];
        for k in 0..COUNTERS {
            ps[k] = self.counters[(k * COUNTER_SIZE + with.counters[k]) * NODES + node].p() as f32;
        }
        for k in 0..4 {
            input[EXPERTS + k] = log2(ps[k] / (65_536.0 - ps[k]));
        }
        input[INPUTS - 1] = 0.5;
        let a = with.weights[0] * NODES + node;
        let b = with.weights[1] * NODES + node;
        let (wa, wb) = (&mut self.first[a], &mut self.second[b]);
        let mut sum = [0.0f32; 4];
        for k in 0..INPUTS / 4 {
            for l in 0..4 {
                let i = 4 * k + l;
                sum[l] += (wa[i] + wb[i]) * input[i];
            }
        }
        let dot = (sum[0] + sum[2]) + (sum[1] + sum[3]);
        let dot = dot.clamp(-12.0, 12.0);
        let p = squash(dot);
        // The map of what came of such odds.
        let place = (dot + 12.0) * (32.0 / 24.0);
        let cell = (place as usize).min(31);
        let part = place - cell as f32;
        let map = &mut self.maps[a];
        let q = (f32::from(map[cell]) * (1.0 - part) + f32::from(map[cell + 1]) * part) * (1.0 / 65_536.0);
        let mixed = (1.0 - super::squares::p(21, 0.3)) * p + super::squares::p(21, 0.3) * q;
        let bit = c.bit(((mixed * 65_536.0) as u32).clamp(16, 65_520), bit);
        let hit = cell + usize::from(part > 0.5);
        let m = u32::from(map[hit]);
        map[hit] = if bit { m + ((65_535 - m) >> 6) } else { m - (m >> 6) } as u16;
        let err = (if bit { 1.0 } else { 0.0 } - p) * self.rate;
        for k in 0..INPUTS {
            let d = err * input[k];
            wa[k] += d;
            wb[k] += d;
        }
        for k in 0..COUNTERS {
            self.counters[(k * COUNTER_SIZE + with.counters[k]) * NODES + node].update(bit);
        }
        bit
    }
}
