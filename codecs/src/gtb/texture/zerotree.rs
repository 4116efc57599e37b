//! Wavelet coefficients of a picture, bit plane by bit plane, by zero-trees: any beginning is a picture (specification of GTB,
//! section 6.5; after Shapiro's embedded zero-trees, with learnt contexts).

use crate::lifting::cells::Band;
use crate::range::{Bit, Coder};

/// Highest bit plane of a coefficient.
pub const PLANE_MAX: u32 = 20;
/// Contexts of a channel: by neighbours, parent, band.
const CONTEXTS: usize = 4 * 3 * 4;

/// Magnitude bits that are known, and the sign.
const NEGATIVE: i32 = 1 << 30;

/// One channel of coefficients, `side * side`, in the layout of [`crate::lifting::cells`].
struct Channel {
    /// What is known: magnitude, [`NEGATIVE`].
    known: Vec<i32>,
    /// No descendant is significant in the plane at work.
    dead: Vec<bool>,
    significant: Vec<Bit>,
    tree: Vec<Bit>,
    refine: Vec<Bit>,
}

/// The coefficients of three channels while they are coded; the same on both sides.
pub struct Zerotree {
    side: usize,
    levels: u32,
    top: u32,
    channels: Vec<Channel>,
    /// Parts that are coded.
    done: u32,
}

/// What the sender has: coefficients, and the greatest magnitude among each one's descendants.
pub struct Source {
    values: [Vec<i32>; 3],
    below: [Vec<i32>; 3],
}

impl Source {
    /// Coefficients of three channels, `side * side` each, of so many levels.
    pub fn new(values: [Vec<i32>; 3], side: usize, levels: u32) -> Source {
        let below = [0, 1, 2].map(|k| below(&values[k], side, levels));
        Source { values, below }
    }

    /// The highest bit plane that any coefficient has.
    pub fn top(&self) -> u32 {
        let most = self.values.iter().flatten().map(|v| v.unsigned_abs()).max().unwrap_or(0);
        (32 - most.leading_zeros()).saturating_sub(1).min(PLANE_MAX)
    }
}

/// The greatest magnitude among the descendants of each coefficient.
fn below(v: &[i32], side: usize, levels: u32) -> Vec<i32> {
    let mut out = vec![0; side * side];
    for level in 2..=levels {
        for band in Band::ALL {
            let [ys, xs] = band.area(side, level);
            for (y, x) in ys.flat_map(|y| xs.clone().map(move |x| (y, x))) {
                let four = [(2 * y, 2 * x), (2 * y, 2 * x + 1), (2 * y + 1, 2 * x), (2 * y + 1, 2 * x + 1)];
                let of = |(y, x): (usize, usize)| v[y * side + x].abs().max(out[y * side + x]);
                out[y * side + x] = four.into_iter().map(of).max().unwrap_or(0);
            }
        }
    }
    out
}

impl Zerotree {
    /// Nothing known of `side * side` coefficients (a power of two) of `levels` levels, whose highest plane is `top`.
    pub fn new(side: usize, levels: u32, top: u32) -> Zerotree {
        let channel = || Channel {
            known: vec![0; side * side],
            dead: vec![false; side * side],
            significant: vec![Bit::new(6_000); CONTEXTS],
            tree: vec![Bit::new(50_000); CONTEXTS],
            refine: vec![Bit::new(28_000); 4],
        };
        let channels = (0..3).map(|_| channel()).collect();
        Zerotree { side, levels, top: top.min(PLANE_MAX), channels, done: 0 }
    }

    /// Parts of a plane: each channel by bands, the low one first, then those of the highest level.
    pub fn parts_of_plane(&self) -> u32 {
        3 * self.parts_of_channel()
    }

    fn parts_of_channel(&self) -> u32 {
        1 + 3 * self.levels
    }

    /// All parts of all planes.
    pub fn parts(&self) -> u32 {
        (self.top + 1) * self.parts_of_plane()
    }

    /// Parts that are coded.
    pub fn done(&self) -> u32 {
        self.done
    }

    /// Codes the next part; the sender gives the source. Nothing is left when [`Zerotree::parts`] are done, or the coder has ended.
    pub fn part<C: Coder>(&mut self, c: &mut C, source: Option<&Source>) {
        if self.done >= self.parts() || c.ended() {
            return;
        }
        let of_plane = self.parts_of_plane();
        let plane = self.top - self.done / of_plane;
        let part = self.done % of_plane;
        let (at, step) = ((part / self.parts_of_channel()) as usize, part % self.parts_of_channel());
        let values = source.map(|s| (&s.values[at][..], &s.below[at][..]));
        let (side, levels) = (self.side, self.levels);
        let ch = &mut self.channels[at];
        if step == 0 {
            ch.dead.fill(false);
            let low = side >> levels;
            ch.area([0..low, 0..low], side, plane, 3, None, values, c);
        } else {
            let level = levels - (step - 1) / 3;
            let band = (step - 1) as usize % 3;
            ch.area(Band::ALL[band].area(side, level), side, plane, band, Some(level == levels), values, c);
        }
        if !c.ended() {
            self.done += 1;
        }
    }

    /// The plane below which nothing is known of a part of a channel: 0 the low band, else bands from the highest level.
    fn floor(&self, channel: usize, step: u32) -> u32 {
        let whole = self.done / self.parts_of_plane();
        let part = channel as u32 * self.parts_of_channel() + step;
        (self.top + 1).saturating_sub(whole + u32::from(part < self.done % self.parts_of_plane()))
    }

    /// The coefficients of a channel as far as they are known, each near the middle of what it may be.
    pub fn coefficients(&self, channel: usize) -> Vec<i32> {
        let mut out = vec![0; self.side * self.side];
        let known = &self.channels[channel].known;
        let mut take = |ys: std::ops::Range<usize>, xs: std::ops::Range<usize>, step: u32| {
            let half = (3 << self.floor(channel, step)) / 8;
            for at in ys.flat_map(|y| xs.clone().map(move |x| y * self.side + x)) {
                let m = known[at] & !NEGATIVE;
                let m = if m == 0 { 0 } else { m + half };
                out[at] = if known[at] & NEGATIVE != 0 { -m } else { m };
            }
        };
        let low = self.side >> self.levels;
        take(0..low, 0..low, 0);
        for level in 1..=self.levels {
            for (k, band) in Band::ALL.into_iter().enumerate() {
                let [ys, xs] = band.area(self.side, level);
                take(ys, xs, 1 + 3 * (self.levels - level) + k as u32);
            }
        }
        out
    }
}

impl Channel {
    /// Codes the plane's bits of an area. `highest`: whether the band is of the highest level (its parents are none); `None`: the
    /// low band, which has no trees.
    #[allow(clippy::too_many_arguments)]
    fn area<C: Coder>(
        &mut self,
        [ys, xs]: [std::ops::Range<usize>; 2],
        side: usize,
        plane: u32,
        band: usize,
        highest: Option<bool>,
        source: Option<(&[i32], &[i32])>,
        c: &mut C,
    ) {
        let threshold = 1i32 << plane;
        for y in ys.clone() {
            for x in xs.clone() {
                let at = y * side + x;
                let parent = (y / 2) * side + x / 2;
                let has_parent = highest == Some(false);
                let known = self.known[at];
                let value = source.map(|(v, _)| v[at]);
                if known & !NEGATIVE != 0 {
                    let large = usize::from((known & !NEGATIVE) >= 4 * threshold);
                    let bit = value.is_some_and(|v| v.abs() & threshold != 0);
                    if c.learn(&mut self.refine[2 * large + usize::from(band == 3)], bit) && !c.ended() {
                        self.known[at] |= threshold;
                    }
                } else {
                    if has_parent && self.dead[parent] {
                        self.dead[at] = true;
                        continue;
                    }
                    let is = |y: usize, x: usize| usize::from(self.known[y * side + x] & !NEGATIVE != 0);
                    let mut near = 0;
                    if x > xs.start {
                        near += is(y, x - 1);
                    }
                    if x + 1 < xs.end {
                        near += is(y, x + 1);
                    }
                    if y > ys.start {
                        near += is(y - 1, x);
                    }
                    if y + 1 < ys.end {
                        near += is(y + 1, x);
                    }
                    let up =
                        if has_parent { 1 + usize::from(self.known[parent] & !NEGATIVE != 0) } else { 0 };
                    let context = (near.min(3) * 3 + up) * 4 + band;
                    let bit = value.is_some_and(|v| v.abs() >= threshold);
                    if c.learn(&mut self.significant[context], bit) {
                        let negative = c.bit(1 << 15, value.is_some_and(|v| v < 0));
                        if !c.ended() {
                            self.known[at] = threshold | if negative { NEGATIVE } else { 0 };
                        }
                    } else if highest.is_some() && 2 * ys.end <= side && 2 * xs.end <= side {
                        let none = source.is_some_and(|(_, below)| below[at] < threshold);
                        self.dead[at] = c.learn(&mut self.tree[context], none);
                    }
                }
                if c.ended() {
                    return;
                }
            }
        }
    }
}
