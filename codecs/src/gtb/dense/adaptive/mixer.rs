//! One probability from many: odds of experts and of counters, weighted by what they have been worth.

use super::bells::{EXPERTS, Lanes};
use super::logit::{log2, squash};
use crate::range::{Bit, Coder, ONE};

/// Counters that vote beside the experts.
pub(super) const COUNTERS: usize = 3;
/// Contexts of one counter.
pub(super) const COUNTER_SIZE: usize = 512;
/// Kinds of decisions.
pub(super) const NODES: usize = 128;
/// Picks of weights.
pub(super) const PICKS: usize = 64;
/// Experts, counters and one input that never changes.
const INPUTS: usize = EXPERTS + COUNTERS + 1;
/// Odds beyond 2^±12 count as these.
const FAR: f32 = 12.0;
/// Cells of a map of probabilities.
const CELLS: usize = 32;
/// What the map says counts so much.
const MAPPED: f32 = 0.3;
/// How fast weights follow.
const RATE: f32 = 0.001_2;

/// Weights, counters and maps of all decisions. Memory: 2.1 MB.
pub(super) struct Mixer {
    /// Weights are the sum of two, each picked by another context.
    first: Vec<[f32; INPUTS]>,
    second: Vec<[f32; INPUTS]>,
    counters: Vec<Bit>,
    /// What came of odds, by odds: in 65536ths.
    maps: Vec<[u16; CELLS + 1]>,
}

/// What the decisions of a post depend on.
pub(super) struct Contexts {
    /// Picks of weights; the first picks the map, too. Below [`PICKS`].
    pub weights: [usize; 2],
    /// Contexts of the counters, below [`COUNTER_SIZE`].
    pub counters: [usize; COUNTERS],
}

impl Mixer {
    /// Nothing learnt: experts count alike.
    pub fn new() -> Mixer {
        let mut start = [0.0; INPUTS];
        start[..EXPERTS].fill(0.45 / EXPERTS as f32);
        start[EXPERTS..EXPERTS + COUNTERS].fill(0.02);
        let width = 2.0 * FAR / CELLS as f32;
        let map = std::array::from_fn(|k| (squash(k as f32 * width - FAR) * 65_535.0) as u16);
        Mixer {
            first: vec![start; PICKS * NODES],
            second: vec![start; PICKS * NODES],
            counters: vec![Bit::default(); COUNTERS * COUNTER_SIZE * NODES],
            maps: vec![map; PICKS * NODES],
        }
    }

    /// One decision of kind `node` for which the experts give `odds`.
    #[inline(always)]
    pub fn code<C: Coder>(
        &mut self,
        c: &mut C,
        with: &Contexts,
        node: usize,
        odds: Lanes,
        bit: bool,
    ) -> bool {
        let places: [usize; COUNTERS] =
            [0, 1, 2].map(|k| (k * COUNTER_SIZE + with.counters[k]) * NODES + node);
        let mut p = [(ONE / 2) as f32; COUNTERS + 1];
        for k in 0..COUNTERS {
            p[k] = self.counters[places[k]].p() as f32;
        }
        let mut input = [0.0f32; INPUTS];
        input[..EXPERTS].copy_from_slice(&odds);
        for k in 0..COUNTERS + 1 {
            input[EXPERTS + k] = log2(p[k] / (ONE as f32 - p[k]));
        }
        input[INPUTS - 1] = 0.5;
        let a = with.weights[0] * NODES + node;
        let (first, second) = (&mut self.first[a], &mut self.second[with.weights[1] * NODES + node]);
        let mut sum = [0.0f32; 4];
        for k in 0..INPUTS / 4 {
            for l in 0..4 {
                let i = 4 * k + l;
                sum[l] += (first[i] + second[i]) * input[i];
            }
        }
        let dot = ((sum[0] + sum[2]) + (sum[1] + sum[3])).clamp(-FAR, FAR);
        let p = squash(dot);
        let place = (dot + FAR) * (CELLS as f32 / (2.0 * FAR));
        let cell = (place as i32 as usize).min(CELLS - 1);
        let part = place - cell as f32;
        let map = &mut self.maps[a];
        let mapped = f32::from(map[cell]) * (1.0 - part) + f32::from(map[cell + 1]) * part;
        let both = p * (65_536.0 * (1.0 - MAPPED)) + mapped * MAPPED;
        let bit = c.bit((both as i32 as u32).clamp(16, ONE - 16), bit);
        // Everyone learns.
        let near = &mut map[cell + usize::from(part > 0.5)];
        let goal = if bit { 65_535 } else { 0 };
        *near = (i32::from(*near) + ((goal - i32::from(*near)) >> 6)) as u16;
        let step = ((if bit { 1.0 } else { 0.0 }) - p) * RATE;
        for k in 0..INPUTS {
            let d = step * input[k];
            first[k] += d;
            second[k] += d;
        }
        for at in places {
            self.counters[at].update(bit);
        }
        bit
    }
}
