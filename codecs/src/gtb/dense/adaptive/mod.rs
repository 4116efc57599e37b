//! Profile `adaptive`: each post predicted by least squares that follow the ground.

use multiversion::multiversion;
use super::super::companion::Companion;
use super::super::field::{Field, Status};
use super::super::header::Header;
use super::{Mark, Reached, is_coded, quantize};
use crate::Result;
use crate::lattice::{Kind, Pass};
use crate::range::Coder;

mod around;
mod experts;
mod logit;
mod mixer;
mod squares;

use around::{ALL, Places};
use experts::{Bells, EXPERTS, Lanes};
use logit::log2;
use mixer::{Contexts, Mixer};
use squares::{INPUTS, Row, Squares, WIDE, p};

/// Posts of a row that share their weights.
const BLOCK: usize = 8;
const CLASSES: usize = 64;
const BLENDED: usize = 8;
const FAVOUR: [f32; BLENDED] = [1.0, 1.0, 1.0, 0.3, 0.3, 0.3, 0.3, 0.3];

#[derive(Clone, Copy)]
struct Width {
    mean: f32,
    seen: f32,
}

struct Model {
    e: u32,
    step: f32,
    mixer: Mixer,
    widths: Vec<Width>,
    /// Residual of each post, in steps; signed.
    err: Vec<f32>,
    above: Vec<[f32; BLENDED]>,
    here: Vec<[f32; BLENDED]>,
}

#[inline(always)]
fn signed(v: f32, by: f32) -> usize {
    let a = v.abs() * by;
    let m = usize::from(a >= 0.3) + usize::from(a >= 0.8) + usize::from(a >= 2.0);
    if v < 0.0 { 3 - m } else { 3 + m }
}

/// Codes the passes of the first layer.
pub(super) fn code<C: Coder, T: Companion<C>>(
    header: &Header,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    companion: &mut T,
    mark: Mark<C>,
) -> Result<Reached> {
    let (lattice, side, e) = (header.lattice, header.lattice.side(), header.layers[0]);
    let mut model = Model {
        e,
        step: (2 * e + 1) as f32,
        mixer: Mixer::new(),
        widths: vec![Width { mean: 1.0, seen: 0.0 }; 2 * EXPERTS * CLASSES],
        err: vec![0.0; side * side],
        above: vec![[0.0; BLENDED]; side + 16],
        here: vec![[0.0; BLENDED]; side + 16],
    };
    for w in 0..2 * EXPERTS {
        for k in 0..CLASSES {
            model.widths[w * CLASSES + k].mean = logit::exp2(k as f32 / 3.0 - 6.6) * 0.5 + 0.02;
        }
    }
    let mut last: [Option<Squares>; 2] = [None, None];
    for (number, pass) in lattice.passes().enumerate() {
        let number = number as u32;
        let kind = usize::from(pass.kind == Kind::Edges);
        let mut prior = [0.0; WIDE];
        prior[3..11].fill(-1.0 / 32.0);
        let blocks = (side / (2 * pass.step) + 1).div_ceil(BLOCK);
        let mut squares = Squares::new(blocks, last[kind].as_ref(), prior);
        let places = Places::new(side, pass);
        let mut posts = 0;
        for a in &mut model.above {
            *a = [0.0; BLENDED];
        }
        for y in pass.rows(lattice) {
            squares.row();
            let mut weights = [prior; squares::WINDOWS + 1];
            let mut count = 0;
            for x in pass.columns(lattice, y) {
                if count % BLOCK == 0 {
                    weights = squares.weights(count / BLOCK);
                }
                let at = y * side + x;
                if is_coded(field, at) {
                    post_of(&mut model, field, source, c, pass, &places, [y, x], &weights, &mut squares);
                    if c.ended() {
                        return Ok(Reached { layer: 0, passes: number, posts, corners: true });
                    }
                } else if field.status(at) != Status::Given {
                    let near = places.of([y, x]);
                    let mut sum = 0i64;
                    for k in 0..4 {
                        sum += i64::from(field.z[near[k]]);
                    }
                    field.z[at] = ((sum + 2) >> 2) as i32;
                }
                posts += 1;
                count += 1;
                if count % BLOCK == 0 {
                    squares.block(count / BLOCK - 1);
                }
                if T::ACTIVE {
                    companion.after_post(pass, [y, x], c);
                    if c.ended() {
                        return Ok(Reached { layer: 0, passes: number, posts, corners: true });
                    }
                }
            }
            if count % BLOCK != 0 {
                squares.block(count / BLOCK);
            }
            squares.row_end();
            std::mem::swap(&mut model.above, &mut model.here);
        }
        last[kind] = Some(squares);
        if T::ACTIVE {
            companion.after_pass(pass, c);
        }
        if !mark(0, number, c)? {
            return Ok(Reached { layer: 0, passes: number + 1, posts: 0, corners: true });
        }
    }
    Ok(Reached { layer: 0, passes: 2 * lattice.n(), posts: 0, corners: true })
}

#[allow(clippy::too_many_arguments)]
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
    fn post_of<C: Coder>(
        model: &mut Model,
        field: &mut Field,
        source: Option<&[i32]>,
        c: &mut C,
        pass: Pass,
        places: &Places,
        post: [usize; 2],
        weights: &[Row; squares::WINDOWS + 1],
        squares: &mut Squares,
    ) {
        let side = field.lattice.side();
        let at = post[0] * side + post[1];
        let near = places.of(post);
        let kind = usize::from(pass.kind == Kind::Edges);
        let from = field.z[near[0]];
        let mut d = [0.0f32; ALL];
        for k in 0..ALL {
            d[k] = field.z[near[k]].wrapping_sub(from) as f32;
        }
        let mut err = [0.0f32; 8];
        for k in 0..4 {
            err[k] = model.err[near[k]];
            err[4 + k] = model.err[near[16 + k]];
        }
        let mean = ((d[0] + d[3]) + (d[1] + d[2])) * 0.25;
        for k in 0..ALL {
            d[k] -= mean;
        }
        let mut v: Row = [0.0; WIDE];
        v[0] = d[0] - d[3];
        v[1] = d[1] - d[2];
        v[2] = (d[0] + d[3]) - (d[1] + d[2]);
        v[3..INPUTS].copy_from_slice(&d[4..ALL]);
        let mut far = 0.0;
        for k in 4..12 {
            far += d[k];
        }
        let most = d[0].max(d[1]).max(d[2]).max(d[3]);
        let least = d[0].min(d[1]).min(d[2]).min(d[3]);
        let inner = (d[0] + d[1] + d[2] + d[3] - most - least) * 0.5;
        let tight = squares::dot(&weights[0], &v);
        let mid = squares::dot(&weights[1], &v);
        let broad = squares::dot(&weights[2], &v);
        let cubic = far * (-1.0 / 32.0);
        let pair0 = (d[0] + d[3]) * 0.5;
        let pair1 = (d[1] + d[2]) * 0.5;
        let preds = [tight, mid, broad, cubic, inner, pair0, pair1, d[16]];
        // Recent errors of each.
        let column = post[1] / pass.step + 4;
        let (h, a) = (&model.here, &model.above);
        let (w, n) = if kind == 1 {
            (&h[column - 2], [&a[column - 1], &a[column + 1], &a[column - 3], &a[column + 3]])
        } else {
            (&h[column - 2], [&a[column], &a[column - 2], &a[column + 2], &h[column - 4]])
        };
        let mut parts = [0.0; BLENDED];
        for k in 0..BLENDED {
            let e = w[k] * 2.0 + n[0][k] * 2.0 + n[1][k] * 1.5 + n[2][k] * 0.7 + n[3][k] * 0.7 + 0.1 * model.step;
            let e2 = e * e;
            parts[k] = FAVOUR[k] / (e2 * e2);
        }
        let mut sum = 0.0;
        let mut total = 0.0;
        for k in 0..BLENDED {
            sum += parts[k] * preds[k];
            total += parts[k];
        }
        let blend = if total > 0.0 && total.is_finite() { sum / total } else { cubic };
        let step = model.step;
        let unit = 1.0 / step;
        // Activities in steps.
        let m = |k: usize| err[k].abs();
        let own = if kind == 1 {
            m(4) * 0.3 + m(5) * 0.3 + m(6) * 0.3 + m(7) * 0.1
        } else {
            m(4) * 0.35 + m(5) * 0.35 + m(6) * 0.15 + m(7) * 0.15
        };
        let old = (m(0) + m(1) + m(2) + m(3)) * 0.25;
        let spread = (most - least) * unit;
        let differ = ((tight - broad).abs() + (mid - cubic).abs() + (mid - broad).abs()) * unit;
        let activity = 0.5 * own + 0.3 * old + 0.1 * spread + 0.1 * differ;
        let shapes =
            [activity, differ, own, spread, old, (d[0] - d[3]).abs() * unit, (d[1] - d[2]).abs() * unit, 1.0];
        let mut logs = [0.0; 8];
        for k in 0..8 {
            logs[k] = log2(shapes[k] + 0.01) + 6.65;
        }
        let class = |k: usize, per: f32| ((logs[k] * per) as i32 as usize).min(CLASSES - 1);
        let ca = class(0, 4.0);
        let cb = class(1, 3.0);
        let cc = class(2, 3.0);
        let cd = class(3, 3.0);
        let ce = class(4, 3.0);
        let cf = class(0, 1.5).min(15) * 4 + ((logs[1] - logs[0] + 3.0) as i32).clamp(0, 3) as usize;
        let p0 = class(5, 3.0);
        let p1 = class(6, 3.0);
        let centre = [mid, pair0, pair1, inner, mid, tight, broad, blend];
        let classes = [ca, p0, p1, cd, cf, cc, cb, ce];
        let place = mean + blend;
        let place = if place.abs() < 67_108_864.0 { place } else { 0.0 };
        let floor = (place + 0.5).floor();
        let base = from.wrapping_add(floor as i32);
        let q = source.map_or(0, |z| quantize(z[at], base, model.e));
        let mut lanes: Lanes = [0.0; EXPERTS];
        let mut means: Lanes = [0.0; EXPERTS];
        let mut seens: Lanes = [0.0; EXPERTS];
        let mut widths = [0; EXPERTS];
        for k in 0..EXPERTS {
            widths[k] = (kind * EXPERTS + k) * CLASSES + classes[k];
            let w = model.widths[widths[k]];
            means[k] = w.mean;
            seens[k] = w.seen;
        }
        for k in 0..EXPERTS {
            lanes[k] = ((mean + centre[k]) - floor) * unit;
        }
        let part = place - floor;
        let parts = (((part + 0.5) * 8.0) as i32 as usize).min(7);
        let scale = (pass.step.trailing_zeros() as usize).min(3);
        let with = Contexts {
            weights: [class(0, 3.0).min(63), kind * 32 + scale * 8 + class(1, 0.8).min(7)],
            counters: [
                ca * 8 + parts,
                cd * 8 + class(2, 0.7).min(7),
                (signed(err[4], 1.0) * 7 + signed(err[5], 1.0)) * 7 + signed(err[6], 1.0),
            ],
        };
        let size = if means[0] < p(30, 6.0) { 0 } else { (log2(means[0]) as u32).min(24) };
        let q = model.steps(c, &with, Bells::new(lanes, means), size, q);
        if c.ended() {
            return;
        }
        let z = base.wrapping_add(q.wrapping_mul(2 * model.e as i32 + 1));
        field.z[at] = z;
        let target = z.wrapping_sub(from) as f32 - mean;
        let inside = q == 0 && model.e > 0;
        for k in 0..EXPERTS {
            let r = ((target - centre[k]) * unit).abs();
            let r = if inside { means[k] * 0.5 / (2.0 * means[k] + 0.5) } else { r };
            seens[k] = (seens[k] + 1.0).min(128.0);
            means[k] += (r - means[k]) / (seens[k] + 0.5);
            means[k] = means[k].clamp(0.01, 1e7);
        }
        let own_mean = means[0];
        for k in 0..EXPERTS {
            model.widths[widths[k]] = Width { mean: means[k], seen: seens[k] };
        }
        let mut r = (target - blend) * unit;
        if inside {
            let m = own_mean;
            r = if r < 0.0 { -1.0 } else { 1.0 } * m * 0.5 / (2.0 * m + 0.5);
        }
        model.err[at] = r;
        let mut errs = [0.0; BLENDED];
        for k in 0..BLENDED {
            errs[k] = (target - preds[k]).abs();
        }
        model.here[column] = errs;
        v[INPUTS] = target;
        let width = (own_mean + 0.3) * step;
        let r = target - mid;
        let weight = 1.0 / (width * width + r * r * 0.25);
        squares.learn(&v, weight);
    }

impl Model {
    #[inline(always)]
    fn steps<C: Coder>(&mut self, c: &mut C, with: &Contexts, mut bells: Bells, start: u32, q: i32) -> i32 {
        let mixer = &mut self.mixer;
        if start > 0 {
            return wide(mixer, c, with, bells, start, q);
        }
        if mixer.code(c, with, 0, bells.zero(), q == 0) {
            return 0;
        }
        let negative = mixer.code(c, with, 1, bells.negative(), q < 0);
        bells.side(negative, false);
        let m = q.unsigned_abs();
        let size = 31 - m.max(1).leading_zeros();
        let mut k = 0u32;
        while k < 28 {
            let odds = bells.beyond((2u32 << k) as f32 - 0.5);
            if !mixer.code(c, with, 2 + k.min(23) as usize, odds, size > k) || c.ended() {
                break;
            }
            bells.go_on();
            k += 1;
        }
        let mut v = 1u32;
        for b in (0..k).rev() {
            let bit = m >> b & 1 == 1;
            let at = ((2 * v + 1) << b) as f32 - 0.5;
            let (odds, mid) = bells.upper(at);
            let node = match k - 1 - b {
                0 => 26 + k.min(23) as usize,
                1 => 50 + 2 * k.min(23) as usize + (v & 1) as usize,
                n => 98 + (n as usize).min(13),
            };
            let bit = mixer.code(c, with, node, odds, bit);
            if c.ended() {
                break;
            }
            bells.take(bit, mid);
            v = v << 1 | u32::from(bit);
        }
        if negative { -(v as i32) } else { v as i32 }
    }
}

#[inline(always)]
fn wide<C: Coder>(mixer: &mut Mixer, c: &mut C, with: &Contexts, mut bells: Bells, start: u32, q: i32) -> i32 {
    let negative = mixer.code(c, with, 112, bells.below(), q < 0);
    bells.side(negative, true);
    let m = if q < 0 { !q } else { q } as u32;
    let shift = if negative { 0.5 } else { -0.5 };
    let size = (32 - m.leading_zeros()).max(start);
    let mut k = start;
    while k < 30 {
        let odds = bells.beyond((1u32 << k) as f32 + shift);
        if !mixer.code(c, with, 113 + (k - start).min(7) as usize, odds, size > k) || c.ended() {
            break;
        }
        bells.go_on();
        k += 1;
    }
    let (mut v, count) = if k == start { (0u32, k) } else { (1, k - 1) };
    for b in (0..count).rev() {
        let bit = m >> b & 1 == 1;
        let at = ((2 * v + 1) << b) as f32 + shift;
        let (odds, mid) = bells.upper(at);
        let node = match count - 1 - b {
            0 => 121 + usize::from(k > start),
            1 => 123 + (v & 1) as usize,
            n => 123 + (n as usize).min(4),
        };
        let bit = mixer.code(c, with, node, odds, bit);
        if c.ended() {
            break;
        }
        bells.take(bit, mid);
        v = v << 1 | u32::from(bit);
    }
    if negative { !(v as i32) } else { v as i32 }
}
