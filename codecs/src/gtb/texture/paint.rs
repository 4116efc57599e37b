//! The picture at the receiver: patterns repeated by class, and the details that were not sent painted over the part that was
//! (specification of GTB, section 6.7). Integers, but for the classes of [`super::synthesis`].

use super::patterns::PATTERN;
use super::planes;
use super::synthesis::{Pyramid, Random};
use crate::lifting::cells::Band;

/// Different syntheses of a pattern.
const VARIANTS: usize = 4;
/// Levels of details that are synthesised where nothing was sent.
pub const SYNTHETIC_LEVELS: u32 = 2;
/// Amplitudes are powers of two by this part of an octave.
const OCTAVE: u32 = 16;

/// What a class looks like, as far as it is known.
pub enum Look {
    /// A colour.
    Flat([u8; 3]),
    /// A pattern of `PATTERN * PATTERN` cells.
    Pattern(Vec<[u8; 3]>),
}

/// Fills each cell with the look of its class; `seed` chooses which synthesis lies where.
pub fn fill(labels: &[u8], side: usize, looks: &[Look], seed: u64) -> Vec<[u8; 3]> {
    let variants: Vec<Vec<Vec<[u8; 3]>>> = looks
        .iter()
        .enumerate()
        .map(|(class, look)| match look {
            Look::Flat(_) => Vec::new(),
            Look::Pattern(rgb) => {
                let pyramid = Pyramid::new(rgb);
                let seed = |v: usize| Random(seed ^ (class * VARIANTS + v) as u64).bits();
                (0..VARIANTS).map(|v| pyramid.synthesise(seed(v))).collect()
            }
        })
        .collect();
    (0..side * side)
        .map(|k| {
            let (y, x) = (k / side, k % side);
            let class = usize::from(labels[k]);
            match looks.get(class) {
                None => [0; 3],
                Some(Look::Flat(rgb)) => *rgb,
                Some(Look::Pattern(_)) => {
                    let block = ((y / PATTERN) as u64) << 32 | (x / PATTERN) as u64;
                    let chosen = Random(seed ^ Random(block ^ (class as u64) << 56).bits()).below(VARIANTS);
                    variants[class][chosen][y % PATTERN * PATTERN + x % PATTERN]
                }
            }
        })
        .collect()
}

/// How strong synthetic details are: of each class, channel, level and band the root of their mean square, as a step. Step 0 paints nothing,
/// step 64 is one, 16 more are twice that. Empty: nothing is painted.
#[derive(Clone, Debug, Default)]
pub struct Amplitudes {
    steps: Vec<u8>,
}

impl Amplitudes {
    /// Numbers a class takes.
    pub const OF_CLASS: usize = 3 * 3 * SYNTHETIC_LEVELS as usize;

    /// Of these steps, [`Amplitudes::OF_CLASS`] a class.
    pub fn new(steps: Vec<u8>) -> Amplitudes {
        Amplitudes { steps }
    }

    /// The steps.
    pub fn steps(&self) -> &[u8] {
        &self.steps
    }

    fn index(class: usize, channel: usize, level: u32, band: usize) -> usize {
        class * Amplitudes::OF_CLASS + (channel * SYNTHETIC_LEVELS as usize + level as usize - 1) * 3 + band
    }

    fn step(&self, class: usize, channel: usize, level: u32, band: usize) -> u8 {
        self.steps.get(Self::index(class, channel, level, band)).copied().unwrap_or(0)
    }
}

impl Amplitudes {
    /// By class, what the details of a band are multiplied by, in 65536ths.
    fn factors(
        &self,
        details: &[i32],
        labels: &[u8],
        side: usize,
        channel: usize,
        level: u32,
        band: usize,
    ) -> Vec<i64> {
        let classes = self.steps.len() / Amplitudes::OF_CLASS;
        let found = strengths(details, labels, side, level, Band::ALL[band], classes);
        let of = |(class, (places, energy))| factor(self.step(class, channel, level, band), places, energy);
        found.into_iter().enumerate().map(of).collect()
    }
}

/// 2^((step - 64) / 16).
fn root(step: u8) -> f64 {
    /// 2^(k / 16) in 65536ths.
    const PARTS: [f64; OCTAVE as usize] = [
        65536.0, 68438.0, 71468.0, 74632.0, 77936.0, 81386.0, 84990.0, 88752.0, 92682.0, 96785.0, 101070.0,
        105545.0, 110218.0, 115098.0, 120194.0, 125515.0,
    ];
    let (octave, part) = (u32::from(step) / OCTAVE, u32::from(step) % OCTAVE);
    PARTS[part as usize] * f64::from(1u32 << octave) / (65_536.0 * f64::from(1u32 << (64 / OCTAVE)))
}

/// What details of so many places and so much energy are multiplied by to have a step's strength, in 65536ths.
fn factor(step: u8, places: u64, energy: u64) -> i64 {
    let wanted = root(step) * root(step) * places as f64;
    if step == 0 || energy == 0 { 0 } else { ((wanted / energy as f64).sqrt() * 65_536.0).min(1e9) as i64 }
}

/// Places and energy of each class in a band of a channel.
fn strengths(
    details: &[i32],
    labels: &[u8],
    side: usize,
    level: u32,
    band: Band,
    classes: usize,
) -> Vec<(u64, u64)> {
    let mut out = vec![(0u64, 0u64); classes];
    for (at, cell) in places(side, level, band) {
        let Some(s) = out.get_mut(usize::from(labels[cell])) else { continue };
        s.0 += 1;
        s.1 = s.1.saturating_add(u64::from(details[at].unsigned_abs()).pow(2));
    }
    out
}

/// Places of a synthetic band, with the label of the cell in the middle of each.
fn places(side: usize, level: u32, band: Band) -> impl Iterator<Item = (usize, usize)> {
    let [ys, xs] = band.area(side, level);
    let (top, left) = (ys.start, xs.start);
    let cell = move |v: usize| (v << level) + (1 << (level - 1));
    ys.flat_map(move |y| xs.clone().map(move |x| (y * side + x, cell(y - top) * side + cell(x - left))))
}

/// The picture of coefficients that were sent, with details of the painted picture where nothing was.
pub fn complete(
    mut sent: [Vec<i32>; 3],
    painted: &[[u8; 3]],
    labels: &[u8],
    side: usize,
    levels: u32,
    amplitudes: &Amplitudes,
) -> Vec<[u8; 3]> {
    if !amplitudes.steps.is_empty() {
        let details = planes::forward(painted, side, levels);
        for channel in 0..3 {
            for level in 1..=SYNTHETIC_LEVELS.min(levels) {
                for (k, band) in Band::ALL.into_iter().enumerate() {
                    let factors = amplitudes.factors(&details[channel], labels, side, channel, level, k);
                    for (at, cell) in places(side, level, band) {
                        if sent[channel][at] == 0 {
                            let f = factors.get(usize::from(labels[cell])).copied().unwrap_or(0);
                            sent[channel][at] = scaled(details[channel][at], f);
                        }
                    }
                }
            }
        }
    }
    planes::inverse(sent, side, levels)
}

/// Of each class and band that is painted: its place in words, its energy in the source, and in what a receiver paints.
pub fn energies(
    source: &[Vec<i32>; 3],
    painted: &[[u8; 3]],
    labels: &[u8],
    side: usize,
    levels: u32,
    amplitudes: &Amplitudes,
) -> Vec<(String, f64, f64)> {
    let details = planes::forward(painted, side, levels);
    let square = |v: i32| f64::from(v) * f64::from(v);
    let mut out = Vec::new();
    for channel in 0..3 {
        for level in 1..=SYNTHETIC_LEVELS.min(levels) {
            for (k, band) in Band::ALL.into_iter().enumerate() {
                let factors = amplitudes.factors(&details[channel], labels, side, channel, level, k);
                for (class, f) in factors.into_iter().enumerate().filter(|(_, f)| *f != 0) {
                    let (mut wanted, mut got) = (0.0, 0.0);
                    for (at, _) in
                        places(side, level, band).filter(|(_, cell)| usize::from(labels[*cell]) == class)
                    {
                        wanted += square(source[channel][at]);
                        got += square(scaled(details[channel][at], f));
                    }
                    out.push((
                        format!("class {class}, channel {channel}, level {level}, {band:?}"),
                        wanted,
                        got,
                    ));
                }
            }
        }
    }
    out
}

/// A detail times an amplitude.
fn scaled(detail: i32, factor: i64) -> i32 {
    ((i64::from(detail) * factor + (1 << 15)) >> 16).clamp(-(1 << 28), 1 << 28) as i32
}

/// Details fainter than this, an eighth of a level of lightness, are not worth painting.
const FAINT: f64 = 64.0;

/// What painted details may add to the squared error of the part that was sent, in parts of it.
const ADDED: f64 = 0.04;

/// The amplitudes that give a class and band the energy that it has in the source, where nothing of it was sent: those that add least to
/// the error first, until they would add more than [`ADDED`] together.
pub fn amplitudes(
    source: &[Vec<i32>; 3],
    sent: &[Vec<i32>; 3],
    painted: &[[u8; 3]],
    labels: &[u8],
    side: usize,
    levels: u32,
) -> Amplitudes {
    let classes = usize::from(labels.iter().copied().max().unwrap_or(0)) + 1;
    let details = planes::forward(painted, side, levels);
    let square = |v: i32| f64::from(v) * f64::from(v);
    let error: f64 = (0..3).flat_map(|ch| source[ch].iter().zip(&sent[ch])).map(|(a, b)| square(a - b)).sum();
    // Energy in the source, places, and where it goes.
    let mut found: Vec<(f64, f64, usize)> = Vec::new();
    for channel in 0..3 {
        for level in 1..=SYNTHETIC_LEVELS.min(levels) {
            for (k, band) in Band::ALL.into_iter().enumerate() {
                let mut energies = vec![(0.0, 0.0, 0.0, false); classes];
                for (at, cell) in places(side, level, band) {
                    let e = &mut energies[usize::from(labels[cell])];
                    e.0 += square(source[channel][at]);
                    e.1 += square(details[channel][at]);
                    e.2 += 1.0;
                    e.3 |= sent[channel][at] != 0;
                }
                let empty = energies
                    .into_iter()
                    .enumerate()
                    .skip(1)
                    .filter(|(_, e)| !e.3 && e.0 > FAINT * FAINT * e.2 && e.1 > 0.0);
                found.extend(empty.map(|(class, e)| (e.0, e.2, Amplitudes::index(class, channel, level, k))));
            }
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.2.cmp(&b.2)));
    let mut steps = vec![0; classes * Amplitudes::OF_CLASS];
    let mut added = 0.0;
    for (wanted, places, at) in found {
        added += wanted;
        if added > ADDED * error {
            break;
        }
        let wanted = (wanted / places).sqrt();
        let off = |s: u8| (root(s) / wanted - 1.0).abs();
        steps[at] = (1..=255u8).min_by(|a, b| off(*a).total_cmp(&off(*b))).unwrap_or(0);
    }
    Amplitudes::new(steps)
}
