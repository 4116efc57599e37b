//! What a range gains at most by each domain of a strip, in f32.
//!
//! Let c be the greatest |correlation| of a range of length r with a domain of length d over the isometries, and x = s d / r. Then
//! E / r^2 = 1 - g with g = x (2 c - x): the **gain**. Of the levels of s that which is nearest to c r / d gains most, and the most grows with c.
//!
//! # Bound
//! Let u = 2^-24. Both blocks have length 1 but for roundings of their numbers (u each), and in f32 a sum of k products is wrong by at most k u
//! times the sum of their magnitudes (to first order), which is at most 1 (Cauchy-Schwarz). So c is found within e = (k + 8) u, where k are the
//! additions of one sum; the room of 8 u is for the numbers, the mirrors' sums and second order. What is screened is c + 2 e:
//! - The level is that of s which is wrong by at most 4 u of itself, and not 0 where the true one is not: the room e is more than 4 u. A
//!   neighbour taken for the nearest, near the half, costs less than 16 u.
//! - x is wrong by at most 4 u of itself and at most 2, so that g is wrong by less than 60 u.
//!
//! [`ROOM`] is 128 u: what the plain form finds of a pair is at most `gain + ROOM`, and the gain is above 0 where the level is not 0.

use super::poses::Poses;
use super::sought::Range;
use super::strip::{LANES, Strip};
use crate::fractal::scale::SCALE_MAX;
use multiversion::multiversion;

/// By how much a gain may be too small.
pub const ROOM: f64 = 128.0 / 16_777_216.0;

/// The levels of s, as f32.
const LEVELS: f32 = SCALE_MAX as f32;

/// What the gain of a correlation depends on, besides the domain.
#[derive(Clone, Copy)]
pub struct Measure {
    /// Levels of s times the length of the range.
    levels: f32,
    /// The inverse of it.
    inverse: f32,
    /// What is added to a correlation: twice its error.
    error: f32,
}

impl Measure {
    /// For a range of this length.
    pub fn new(poses: &Poses, length: f32) -> Measure {
        let sum = poses.rows / poses.parts + poses.parts;
        let levels = LEVELS * length;
        Measure { levels, inverse: 1.0 / levels, error: (sum + 8) as f32 / 8_388_608.0 }
    }

    /// What is gained at most with a domain, by its length and the inverse of that; 0 only if s is 0.
    #[inline(always)]
    pub fn gain(&self, correlation: f32, length: f32, inverse: f32) -> f32 {
        // Between 2^23 and 2^24 the whole numbers are all there is: to add and take away rounds.
        const WHOLE: f32 = 8_388_608.0;
        let c = correlation + self.error;
        let level = (c * (self.levels * inverse)).min(LEVELS);
        let level = (level + WHOLE) - WHOLE;
        let x = level * (length * self.inverse);
        x * ((c - x) + c)
    }
}

/// What a range gains at most with each of the lanes of a strip from `at`, in the given poses; returns the greatest of them.
pub fn gains(
    poses: &Poses,
    range: &Range,
    chosen: &[usize],
    measure: Measure,
    strip: &Strip,
    at: usize,
    out: &mut [f32],
) -> f32 {
    match (poses.mirrors, poses.parts) {
        (false, _) => sums(&range.poses, chosen, measure, strip, at, out),
        (true, 4) => square(&range.poses, chosen, measure, strip, at, out),
        _ => cube(&range.poses, chosen, measure, strip, at, out),
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn sums(poses: &[f32], chosen: &[usize], m: Measure, strip: &Strip, at: usize, out: &mut [f32]) -> f32 {
    all(poses, chosen, m, strip, at, out, |[a, b, c, d]: [f32; 4]| ((a + b) + (c + d)).abs())
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn square(poses: &[f32], chosen: &[usize], m: Measure, strip: &Strip, at: usize, out: &mut [f32]) -> f32 {
    all(poses, chosen, m, strip, at, out, mirrored)
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn cube(poses: &[f32], chosen: &[usize], m: Measure, strip: &Strip, at: usize, out: &mut [f32]) -> f32 {
    all(poses, chosen, m, strip, at, out, |p: [f32; 8]| {
        let sum = [p[0] + p[4], p[1] + p[5], p[2] + p[6], p[3] + p[7]];
        let difference = [p[0] - p[4], p[1] - p[5], p[2] - p[6], p[3] - p[7]];
        mirrored(sum).max(mirrored(difference))
    })
}

/// The greatest magnitude of four products under two mirrors.
#[inline(always)]
fn mirrored(p: [f32; 4]) -> f32 {
    let both = (p[0] + p[3]).abs() + (p[1] + p[2]).abs();
    let one = (p[0] - p[3]).abs() + (p[1] - p[2]).abs();
    both.max(one)
}

/// `joined` makes the correlation of the products of the parts.
#[inline(always)]
fn all<const P: usize>(
    poses: &[f32],
    chosen: &[usize],
    measure: Measure,
    strip: &Strip,
    at: usize,
    out: &mut [f32],
    joined: impl Fn([f32; P]) -> f32 + Copy,
) -> f32 {
    let rows = strip.samples.len() / strip.stride;
    let mut greatest = [0.0_f32; LANES];
    for (g, out) in out.chunks_exact_mut(LANES).enumerate() {
        let at = at + g * LANES;
        let mut best = [0.0_f32; LANES];
        let (two, one) = chosen.as_chunks::<2>();
        for two in two {
            let products = products::<P, 2>(two.map(|p| &poses[p * rows..][..rows]), strip, at);
            for products in products {
                join(&products, &mut best, joined);
            }
        }
        for p in one {
            let [products] = products::<P, 1>([&poses[p * rows..][..rows]], strip, at);
            join(&products, &mut best, joined);
        }
        let (lengths, inverses) = (&strip.lengths[at..][..LANES], &strip.inverses[at..][..LANES]);
        for l in 0..LANES {
            out[l] = measure.gain(best[l], lengths[l], inverses[l]);
            greatest[l] = greatest[l].max(out[l]);
        }
    }
    greatest.into_iter().fold(0.0, f32::max)
}

#[inline(always)]
fn join<const P: usize>(
    products: &[[f32; LANES]; P],
    best: &mut [f32; LANES],
    joined: impl Fn([f32; P]) -> f32,
) {
    for l in 0..LANES {
        best[l] = best[l].max(joined(std::array::from_fn(|p| products[p][l])));
    }
}

/// The products of poses with the domains of [`LANES`] lanes, part by part.
#[inline(always)]
fn products<const P: usize, const Q: usize>(
    poses: [&[f32]; Q],
    strip: &Strip,
    at: usize,
) -> [[[f32; LANES]; P]; Q] {
    let mut sums = [[[0.0; LANES]; P]; Q];
    let mut from = at;
    for k in 0..poses[0].len() / P {
        for p in 0..P {
            let domains = &strip.samples[from..][..LANES];
            for q in 0..Q {
                let range = poses[q][k * P + p];
                for l in 0..LANES {
                    sums[q][p][l] += range * domains[l];
                }
            }
            from += strip.stride;
        }
    }
    sums
}
