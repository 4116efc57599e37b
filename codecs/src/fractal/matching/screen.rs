//! What a range gains at most by each domain of a strip, in f32.
//!
//! Let c be the greatest |correlation| of a range of length r with a domain of length d over the isometries, and x = s d / r. Then
//! E / r^2 = 1 - g with g = x (2 c - x): the **gain**. Of the levels of s that which is nearest to c r / d gains most, and the most grows with c.
//!
//! # Bound
//! Let u = 2^-24. Both blocks have length 1 but for roundings of their numbers (u each), and in f32 a sum of k products is wrong by at most k u
//! times the sum of their magnitudes (to first order), which is at most 1 (Cauchy-Schwarz). So c is found within e = (k + 8) u, where k are the
//! additions of one sum; the room of 8 u is for the numbers, the mirrors' sums and second order. What is screened is c + 2 e:
//! - c r / d is wrong by at most 8 u of itself, less than the room e. So the level is not 0 where the true one is not, and a neighbour taken for
//!   the nearest, near the half, costs at most 32 u.
//! - x is at most 2 and wrong by at most 6 u of itself: 24 u of the gain; the rest of the arithmetic less than 16 u.
//!
//! [`ROOM`] is 128 u: the gain that the plain form finds of a pair is at most the gain here and `ROOM`; and the gain here is above 0 where
//! the level is not 0.

use super::poses::Poses;
use super::strip::{LANES, Strip};
use crate::fractal::scale::Scales;
use multiversion::multiversion;

/// By how much a gain may be too small.
pub const ROOM: f64 = 128.0 / 16_777_216.0;

/// What the gain of a correlation depends on, besides the domain.
#[derive(Clone, Copy)]
pub struct Measure {
    /// The greatest level of s.
    max: f32,
    /// Levels of s times the length of the range.
    levels: f32,
    /// The inverse of it.
    inverse: f32,
    /// What is added to a correlation: twice its error.
    error: f32,
}

impl Measure {
    /// For a range of this length.
    pub fn new(poses: &Poses, length: f32, scales: Scales) -> Measure {
        let sum = poses.rows / poses.parts + poses.parts;
        let max = f32::from(scales.max());
        let levels = max * length;
        Measure { max, levels, inverse: 1.0 / levels, error: (sum + 8) as f32 / 8_388_608.0 }
    }

    /// What is gained at most with a domain, by its length and the inverse of that; 0 only if s is 0.
    #[inline(always)]
    pub fn gain(&self, correlation: f32, length: f32, inverse: f32) -> f32 {
        // Between 2^23 and 2^24 the whole numbers are all there is: to add and take away rounds.
        const WHOLE: f32 = 8_388_608.0;
        let c = correlation + self.error;
        let level = (c * (self.levels * inverse)).min(self.max);
        let level = (level + WHOLE) - WHOLE;
        let x = level * (length * self.inverse);
        x * ((c - x) + c)
    }

    /// What is gained at most with domains that are neither shorter nor longer than these two. Between the lengths that some level makes equal to
    /// the range's the gain of each level rises or falls, so that the most is at an end.
    #[inline]
    pub fn most(&self, short: f32, long: f32) -> f32 {
        // Room for the roundings.
        let (low, high) = (self.levels / long * 0.999_99, self.levels / short * 1.000_01);
        let level = high.min(self.max) as i32;
        if level >= 1 && level as f32 >= low {
            return f32::INFINITY;
        }
        self.gain(1.0, short, 1.0 / short).max(self.gain(1.0, long, 1.0 / long))
    }
}

/// What is asked of some lanes of a strip.
pub struct Question<'a> {
    /// The poses of the range, one after the other.
    pub poses: &'a [f32],
    /// The poses that are meant.
    pub chosen: &'a [usize],
    /// How the range gains.
    pub measure: Measure,
    /// The strip.
    pub strip: &'a Strip,
    /// The first lane.
    pub at: usize,
    /// What is not enough.
    pub needed: f32,
}

/// What was found.
#[derive(Default)]
pub struct Answer {
    /// What the range gains at most with each lane.
    pub gains: Vec<f32>,
    /// Where in `gains` there are [`LANES`] with one that is enough.
    pub enough: Vec<usize>,
}

impl Question<'_> {
    /// Answers it for the first so many lanes, and some more up to a multiple of [`LANES`].
    pub fn answer(&self, poses: &Poses, lanes: usize, answer: &mut Answer) {
        answer.gains.resize(lanes.next_multiple_of(LANES), 0.0);
        answer.enough.clear();
        match (poses.mirrors, poses.parts) {
            (false, _) => sums(self, answer),
            (true, 4) => square(self, answer),
            _ => cube(self, answer),
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn sums(question: &Question, answer: &mut Answer) {
    all(question, answer, |[a, b, c, d]: [f32; 4]| ((a + b) + (c + d)).abs());
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn square(question: &Question, answer: &mut Answer) {
    all(question, answer, mirrored);
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn cube(question: &Question, answer: &mut Answer) {
    all(question, answer, |p: [f32; 8]| {
        let sum = [p[0] + p[4], p[1] + p[5], p[2] + p[6], p[3] + p[7]];
        let difference = [p[0] - p[4], p[1] - p[5], p[2] - p[6], p[3] - p[7]];
        mirrored(sum).max(mirrored(difference))
    });
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
fn all<const P: usize>(question: &Question, answer: &mut Answer, joined: impl Fn([f32; P]) -> f32 + Copy) {
    let Question { strip, measure, needed, .. } = *question;
    let rows = strip.samples.len() / strip.stride;
    let pose = |p: &usize| &question.poses[p * rows..][..rows];
    for (g, out) in answer.gains.as_chunks_mut::<LANES>().0.iter_mut().enumerate() {
        let at = question.at + g * LANES;
        let mut best = [0.0_f32; LANES];
        let (two, one) = question.chosen.as_chunks::<2>();
        for [p, q] in two {
            for products in products::<P, 2>([pose(p), pose(q)], strip, at) {
                join(&products, &mut best, joined);
            }
        }
        for p in one {
            let [products] = products::<P, 1>([pose(p)], strip, at);
            join(&products, &mut best, joined);
        }
        let (lengths, inverses) = (&strip.lengths[at..][..LANES], &strip.inverses[at..][..LANES]);
        let mut enough = false;
        for l in 0..LANES {
            out[l] = measure.gain(best[l], lengths[l], inverses[l]);
            enough |= out[l] > needed;
        }
        if enough {
            answer.enough.push(g * LANES);
        }
    }
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
    let poses = poses.map(|p| p.as_chunks::<P>().0);
    let count = poses[0].len();
    let poses = poses.map(|p| &p[..count]);
    let mut rows = strip.samples.chunks_exact(strip.stride);
    for k in 0..count {
        let ranges = poses.map(|p| &p[k]);
        for p in 0..P {
            let Some(row) = rows.next() else { return sums };
            let domains = &row[at..at + LANES];
            for q in 0..Q {
                for l in 0..LANES {
                    sums[q][p][l] += ranges[q][p] * domains[l];
                }
            }
        }
    }
    sums
}
