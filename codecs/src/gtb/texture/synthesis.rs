//! More of the same: a pattern whose wavelet coefficients have changed places (specification of GTB, section 6.7).
//!
//! Runs at the receiver, with the sums of [`super::isodata`] in one order and nothing but + - * / and roots: the same seed gives
//! the same bytes on every machine.

use super::isodata::{Bounds, classify};
use super::labels::features;
use super::patterns::PATTERN;
use crate::lifting::cells::{Band, Wavelet};

/// Levels of a pattern's pyramid.
const LEVELS: u32 = 4;
/// Swaps in each band.
const SWAPS: usize = 50;
/// Numbers of a place: colours and energies.
const AXES: usize = 6;

/// Numbers that look random: splitmix64.
pub struct Random(pub u64);

impl Random {
    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number below `n`, which is above 0.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.bits()) * n as u128) >> 64) as usize
    }
}

/// A pattern's pyramid, its places sorted into classes.
pub struct Pyramid {
    planes: [Vec<i32>; 3],
    /// Of each level, from 1: lists of places that may change with each other.
    alike: Vec<Vec<Vec<usize>>>,
}

impl Pyramid {
    /// Of a pattern of `PATTERN * PATTERN` cells.
    pub fn new(rgb: &[[u8; 3]]) -> Pyramid {
        let planes = [0, 1, 2].map(|ch| rgb.iter().map(|c| i32::from(c[ch])).collect::<Vec<i32>>());
        let mut alike = vec![Vec::new(); LEVELS as usize];
        let mut above: Option<(usize, Vec<usize>)> = None;
        for level in (1..=LEVELS).rev() {
            let width = PATTERN >> level;
            let own = classify(&features(&planes, PATTERN, level), AXES, &Bounds::default()).labels;
            let parent = |k: usize| {
                above.as_ref().map_or(0, |(w, labels)| labels[(k / width / 2) * w + k % width / 2])
            };
            let mut lists: std::collections::BTreeMap<(usize, usize), Vec<usize>> = Default::default();
            (0..width * width).for_each(|k| lists.entry((own[k], parent(k))).or_default().push(k));
            alike[level as usize - 1] = lists.into_values().filter(|l| l.len() > 1).collect();
            above = Some((width, own));
        }
        let mut lifted = planes;
        lifted.iter_mut().for_each(|p| Wavelet::FiveThree.forward(p, PATTERN, LEVELS));
        Pyramid { planes: lifted, alike }
    }

    /// Another pattern with the same look.
    pub fn synthesise(&self, seed: u64) -> Vec<[u8; 3]> {
        let mut planes = self.planes.clone();
        let mut random = Random(seed);
        for level in 1..=LEVELS {
            let width = PATTERN >> level;
            let lists = &self.alike[level as usize - 1];
            if lists.is_empty() {
                continue;
            }
            let places: usize = lists.iter().map(Vec::len).sum();
            for band in Band::ALL {
                let [ys, xs] = band.area(PATTERN, level);
                for _ in 0..SWAPS {
                    // Any place, with any of its list.
                    let mut pick = random.below(places);
                    let list = lists.iter().find(|l| {
                        let here = pick < l.len();
                        if !here {
                            pick -= l.len();
                        }
                        here
                    });
                    let Some(list) = list else { continue };
                    let other = list[random.below(list.len())];
                    let at = |k: usize| (ys.start + k / width) * PATTERN + xs.start + k % width;
                    planes.iter_mut().for_each(|p| p.swap(at(list[pick]), at(other)));
                }
            }
        }
        planes.iter_mut().for_each(|p| Wavelet::FiveThree.inverse(p, PATTERN, LEVELS));
        (0..PATTERN * PATTERN).map(|k| [0, 1, 2].map(|ch| planes[ch][k].clamp(0, 255) as u8)).collect()
    }
}
