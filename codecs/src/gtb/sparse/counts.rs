//! Probabilities from counts in contexts that grow finer: a fine one begins where the coarser one stands, so that few decisions teach
//! enough.

use crate::range::{Coder, ONE};

/// How many decisions the coarser probability counts for, level by level.
const TRUST: [f32; LEVELS] = [1.0, 8.0, 16.0, 24.0, 32.0, 48.0];
/// Counts are halved when they have come to so many.
const MOST: f32 = 1000.0;
/// Levels of contexts.
pub(super) const LEVELS: usize = 6;

/// The models of one kind of decision.
pub(super) struct Counts {
    /// Of each level, of each context: ones, and all decisions.
    levels: [Vec<[f32; 2]>; LEVELS],
    /// How many values each part of the context has.
    sizes: [usize; LEVELS],
}

impl Counts {
    /// Models for contexts of parts that have so many values each.
    pub fn new(sizes: [usize; LEVELS]) -> Counts {
        let mut contexts = 1;
        let levels = sizes.map(|size| {
            contexts *= size;
            vec![[0.0; 2]; contexts]
        });
        Counts { levels, sizes }
    }

    /// One decision. `parts`: of the context, the one that says most first; each below its size.
    pub fn code<C: Coder>(&mut self, c: &mut C, parts: [usize; LEVELS], bit: bool) -> bool {
        let mut at = 0;
        let mut p = 0.5;
        let mut places = [0; LEVELS];
        for k in 0..LEVELS {
            at = at * self.sizes[k] + parts[k];
            places[k] = at;
            let [ones, all] = self.levels[k][at];
            p = (ones + TRUST[k] * p) / (all + TRUST[k]);
        }
        let bit = c.bit(((p * ONE as f32) as u32).clamp(32, ONE - 32), bit);
        for (level, place) in self.levels.iter_mut().zip(places) {
            let [ones, all] = &mut level[place];
            if *all >= MOST {
                *ones *= 0.5;
                *all *= 0.5;
            }
            *all += 1.0;
            *ones += f32::from(u8::from(bit));
        }
        bit
    }
}
