//! A square picture as wavelet coefficients of three channels, weighted so that a bit plane weighs alike in every band.

use super::colour::{apart, together};
use super::zerotree::{Source, Zerotree};
use crate::lifting::cells::{Band, Wavelet};
use crate::range::Coder;

/// Bits of fraction that cells carry through the transform.
const FRACTION: u32 = 4;

/// The norm of a band's basis functions, in 16ths: details along one axis, along both, and the low band, at level 1. Each further level
/// doubles them.
const NORMS: [i64; 3] = [16, 12, 24];
/// The same for differences of colour, which count less.
const COLOUR: i64 = 2;

/// The number that a coefficient of a band is multiplied by; the product counts in 512ths of a level of lightness.
fn weight(channel: usize, band: Option<Band>, level: u32) -> i64 {
    let norm = match band {
        Some(Band::Hh) => NORMS[1],
        Some(_) => NORMS[0],
        None => NORMS[2],
    } << (level - 1);
    if channel == 0 { norm } else { norm / COLOUR }
}

/// Applies `f(value, weight)` to all coefficients of a channel.
fn weighed(v: &mut [i32], channel: usize, side: usize, levels: u32, f: impl Fn(i64, i64) -> i64) {
    let mut band = |[ys, xs]: [std::ops::Range<usize>; 2], w: i64| {
        for at in ys.flat_map(|y| xs.clone().map(move |x| y * side + x)) {
            v[at] = f(i64::from(v[at]), w).clamp(-(1 << 29), 1 << 29) as i32;
        }
    };
    let low = side >> levels;
    band([0..low, 0..low], weight(channel, None, levels.max(1)));
    for level in 1..=levels {
        for b in Band::ALL {
            band(b.area(side, level), weight(channel, Some(b), level));
        }
    }
}

/// Levels that a picture of a side (a power of two) takes, at most so many.
pub fn levels(side: usize, most: u32) -> u32 {
    side.trailing_zeros().min(most)
}

/// The weighted coefficients of a picture.
pub fn forward(rgb: &[[u8; 3]], side: usize, levels: u32) -> [Vec<i32>; 3] {
    let mut planes = [0, 1, 2].map(|_| Vec::with_capacity(rgb.len()));
    for c in rgb {
        planes.iter_mut().zip(apart(*c)).for_each(|(p, v)| p.push(v << FRACTION));
    }
    for (channel, plane) in planes.iter_mut().enumerate() {
        Wavelet::NineSeven.forward(plane, side, levels);
        weighed(plane, channel, side, levels, |v, w| (v * w + 16) >> 5);
    }
    planes
}

/// A picture of weighted coefficients.
pub fn inverse(mut planes: [Vec<i32>; 3], side: usize, levels: u32) -> Vec<[u8; 3]> {
    for (channel, plane) in planes.iter_mut().enumerate() {
        weighed(plane, channel, side, levels, |v, w| (v * 32 + w / 2).div_euclid(w));
        Wavelet::NineSeven.inverse(plane, side, levels);
    }
    let cell = |v: i32| v.wrapping_add(1 << (FRACTION - 1)) >> FRACTION;
    (0..side * side).map(|k| together([0, 1, 2].map(|ch| cell(planes[ch][k])))).collect()
}

/// The most parts of a picture's zero-trees that fit into so many bytes.
pub fn parts_within(source: &Source, side: usize, levels: u32, bytes: usize) -> u32 {
    let mut c = crate::range::Encoder::new();
    let mut trees = Zerotree::new(side, levels, source.top());
    while trees.done() < trees.parts() && !c.ended() {
        let before = trees.done();
        trees.part(&mut c, Some(source));
        if c.position() > bytes + 8 {
            return before;
        }
    }
    trees.done()
}
