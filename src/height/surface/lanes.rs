//! The formula of the surface for many points at once: the same operations, in the same order for each point, as
//! [`Sheet::evaluate`](super::Sheet) does one by one, so the same bits. Points lie side by side in arrays of [`RUN`]; loops over
//! them become vector instructions, as wide as the processor has (`multiversion` chooses when the program runs). No
//! sum runs across points and nothing is fused, so width does not show in the result.

// Loops run over several arrays side by side: by index they read as the formula does.
#![allow(clippy::needless_range_loop)]

use super::SurveyField;
use super::eval::SHARE_MIN;
use super::real::Real;
use crate::height::lod::{KERNEL, MARGIN, SIDE};
use crate::height::patch::{Kind, Vertices};
use multiversion::multiversion;

/// Points of a run, at most.
pub const RUN: usize = 64;
/// Runs are worked on in whole multiples of these: one vector of the widest kind.
pub const WIDTH: usize = 8;

/// One number for each point of a run.
pub type Lane = [f64; RUN];

/// Half a domain, in cells of the patch.
const HALF: f64 = (KERNEL / 2 + MARGIN) as f64;

/// Index coordinates of points in a survey.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn index(survey: &SurveyField, x: &Lane, y: &Lane, count: usize, i: &mut Lane, j: &mut Lane) {
    for k in 0..count.min(RUN) {
        [i[k], j[k]] = survey.index([x[k], y[k]]);
    }
}

/// Lowest and highest of some numbers, none of them NaN.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn range(v: &[f64]) -> [f64; 2] {
    let (mut lo, mut hi) = ([f64::INFINITY; WIDTH], [f64::NEG_INFINITY; WIDTH]);
    let whole = v.chunks_exact(WIDTH);
    for v in whole.remainder() {
        (lo[0], hi[0]) = (if *v < lo[0] { *v } else { lo[0] }, if *v > hi[0] { *v } else { hi[0] });
    }
    for v in whole {
        for k in 0..WIDTH {
            lo[k] = if v[k] < lo[k] { v[k] } else { lo[k] };
            hi[k] = if v[k] > hi[k] { v[k] } else { hi[k] };
        }
    }
    [lo.into_iter().fold(f64::INFINITY, f64::min), hi.into_iter().fold(f64::NEG_INFINITY, f64::max)]
}

/// Where points are in a patch along one index coordinate, and what it weighs there.
#[derive(Clone)]
pub struct Along {
    /// The cell: 0 to 31, also for points outside.
    pub cell: [u32; RUN],
    /// The position in it.
    pub x: Lane,
    /// The weight in this direction; 0 or less outside the domain.
    pub weight: Lane,
}

impl Along {
    pub const NONE: Along = Along { cell: [0; RUN], x: [0.0; RUN], weight: [0.0; RUN] };
}

/// `first`: the index coordinate at which the domain begins; `per_cell`: cells of the patch in one of level 0.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn along(index: &Lane, count: usize, first: f64, per_cell: f64, kind: Kind, to: &mut Along) {
    match kind {
        Kind::Bilinear => along_of(index, count, first, per_cell, Kind::Bilinear, to),
        Kind::Bicubic => along_of(index, count, first, per_cell, Kind::Bicubic, to),
    }
}

/// The same in plain numbers, or in the vectors of whoever it is part of.
#[inline(always)]
pub fn along_of(index: &Lane, count: usize, first: f64, per_cell: f64, kind: Kind, to: &mut Along) {
    const LAST: f64 = (SIDE - 2) as f64;
    for k in 0..count.min(RUN) {
        let s = (index[k] - first) * per_cell;
        let t = s * (1.0 / HALF) - 1.0;
        let inwards = if t < 0.0 { 1.0 + t } else { 1.0 - t };
        to.weight[k] = inwards.bump(kind);
        // As `patch::cell` does.
        let whole = s.floor();
        let whole = if whole > 0.0 { whole } else { 0.0 };
        let whole = if whole < LAST { whole } else { LAST };
        to.x[k] = s - whole;
        to.cell[k] = whole as u32;
    }
}

/// Weights of a patch: the product of those in both directions and two factors, 0 outside the domain.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn weights(a: &Along, b: &Along, count: usize, volume: f64, level: f64, to: &mut Lane) {
    for k in 0..count.min(RUN) {
        let (wa, wb) = (a.weight[k], b.weight[k]);
        let w = (wa * wb) * volume * level;
        to[k] = if wa > 0.0 && wb > 0.0 && w > 0.0 { w } else { 0.0 };
    }
}

/// Multiplies weights; what is not above 0 becomes 0.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn fade(weights: &mut Lane, by: &Lane, count: usize) {
    for k in 0..count.min(RUN) {
        let w = weights[k] * by[k];
        weights[k] = if w > 0.0 { w } else { 0.0 };
    }
}

/// Heights of a bilinear patch.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn bilinear(z: &Vertices, a: &Along, b: &Along, count: usize, to: &mut Lane) {
    for k in 0..count.min(RUN) {
        // The last cell's; also keeps every index within the patch.
        const LAST: usize = (SIDE - 2) * SIDE + SIDE - 2;
        let at = (b.cell[k] as usize * SIDE + a.cell[k] as usize).min(LAST);
        let (x, y) = (a.x[k], b.x[k]);
        let (z00, z10, z01, z11) = (z[at], z[at + 1], z[at + SIDE], z[at + SIDE + 1]);
        let left = z00 + (z01 - z00) * y;
        let right = z10 + (z11 - z10) * y;
        to[k] = left + (right - left) * x;
    }
}

/// The sums over the patches at each point of a run.
#[derive(Clone)]
pub struct Sums {
    /// Height of the first contributor: sums are taken relative to it.
    pub zero: Lane,
    pub weights: Lane,
    pub sum: Lane,
}

impl Sums {
    pub const NONE: Sums = Sums { zero: [0.0; RUN], weights: [0.0; RUN], sum: [0.0; RUN] };
}

/// Adds a patch with its weights (0 where it does not contribute) and heights.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn add(sums: &mut Sums, weights: &Lane, heights: &Lane, count: usize) {
    for k in 0..count.min(RUN) {
        add_one(sums, k, weights[k], heights[k]);
    }
}

#[inline(always)]
pub fn add_one(sums: &mut Sums, k: usize, w: f64, f: f64) {
    // Weights of contributors are above 0.
    let zero = if sums.weights[k] > 0.0 { sums.zero[k] } else { f };
    let on = w > 0.0;
    let sum = sums.sum[k] + w * (f - zero);
    let total = sums.weights[k] + w;
    sums.zero[k] = if on { zero } else { sums.zero[k] };
    sums.sum[k] = if on { sum } else { sums.sum[k] };
    sums.weights[k] = if on { total } else { sums.weights[k] };
}

/// The heights that come out; NaN where no patch contributed.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn heights(sums: &Sums, count: usize, to: &mut Lane) {
    for k in 0..count.min(RUN) {
        let z = sums.zero[k] + sums.sum[k] / sums.weights[k];
        to[k] = if sums.weights[k] > 0.0 { z } else { f64::NAN };
    }
}

/// Raises errors to `bound` where a patch has more than a rounding error's share of the weights.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl", "x86_64+avx2"))]
pub fn raise(errors: &mut Lane, sums: &Sums, weights: &Lane, bound: f64, count: usize) {
    for k in 0..count.min(RUN) {
        let counts = weights[k] > SHARE_MIN * sums.weights[k] && bound > errors[k];
        errors[k] = if counts { bound } else { errors[k] };
    }
}
