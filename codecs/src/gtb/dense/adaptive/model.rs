//! A post: predictions, what they are expected to be wrong, its decisions, and what all of it learns.

use multiversion::multiversion;

use super::around::{ALL, Places};
use super::bells::{Bells, EXPERTS, Lanes};
use super::logit::{exp2, log2};
use super::mixer::{Contexts, Mixer};
use super::squares::{INPUTS, Row, WIDE, dot};
use super::steps;
use super::window::{Weights, Window};
use crate::gtb::dense::quantize;
use crate::gtb::field::Field;
use crate::lattice::{Kind, Pass, Post};
use crate::range::Coder;

/// Classes of a shape, three or four an octave.
const CLASSES: usize = 64;
/// Predictions that are blended by their recent errors.
const PREDICTIONS: usize = 8;
/// How much each counts for equal errors.
const FAVOUR: [f32; PREDICTIONS] = [1.0, 1.0, 0.3, 0.3, 0.3, 0.3, 0.0, 0.0];
/// Columns beyond the border that hold errors of nothing.
const MARGIN: usize = 4;
/// Posts after which a width follows no more slowly.
const SEEN: f32 = 128.0;
/// Expected steps from which on decisions begin with the sign.
const MANY: f32 = 6.0;

/// How wrong an expert is in a class: the mean distance in steps.
#[derive(Clone, Copy)]
struct Width {
    mean: f32,
    seen: f32,
}

/// All that is learnt but for the least squares. Memory: 4 bytes a post and 2.3 MB.
pub(super) struct Model {
    e: u32,
    step: f32,
    mixer: Mixer,
    /// By kind of pass, expert, class.
    widths: Vec<Width>,
    /// Residual of each post in steps, with its sign.
    residuals: Vec<f32>,
    /// Errors of the predictions in the row before and in this one, by column in steps of the pass.
    before: Vec<[f32; PREDICTIONS]>,
    here: Vec<[f32; PREDICTIONS]>,
}

/// Where a post lies, and how it is predicted there.
pub(super) struct Scene<'a> {
    pub pass: Pass,
    pub post: Post,
    pub places: &'a Places,
    pub weights: &'a Weights,
}

impl Model {
    /// For a lattice of `side` posts and a bound `e`.
    pub fn new(side: usize, e: u32) -> Model {
        let widths = (0..2 * EXPERTS * CLASSES)
            .map(|k| Width { mean: exp2((k % CLASSES) as f32 / 3.0 - 6.6) * 0.5 + 0.02, seen: 0.0 })
            .collect();
        Model {
            e,
            step: (2 * i64::from(e) + 1) as f32,
            mixer: Mixer::new(),
            widths,
            residuals: vec![0.0; side * side],
            before: vec![[0.0; PREDICTIONS]; side + 2 * MARGIN],
            here: vec![[0.0; PREDICTIONS]; side + 2 * MARGIN],
        }
    }

    /// A pass begins.
    pub fn start_pass(&mut self) {
        self.before.fill([0.0; PREDICTIONS]);
        self.here.fill([0.0; PREDICTIONS]);
    }

    /// A row ends.
    pub fn end_row(&mut self) {
        std::mem::swap(&mut self.before, &mut self.here);
    }
}

/// How far `v` lies from 0, in seven classes around 3.
#[inline(always)]
fn lean(v: f32) -> usize {
    let a = v.abs();
    let m = usize::from(a >= 0.3) + usize::from(a >= 0.8) + usize::from(a >= 2.0);
    if v < 0.0 { 3 - m } else { 3 + m }
}

/// The distance that is to be expected where only its being within half a step is known, for a mean of `mean` steps.
#[inline(always)]
fn within(mean: f32) -> f32 {
    mean * 0.5 / (2.0 * mean + 0.5)
}

/// Codes one post, in the widest vectors that the processor has: about 1500 operations and 60 a decision.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub(super) fn code<C: Coder>(
    model: &mut Model,
    window: &mut Window,
    field: &mut Field,
    source: Option<&[i32]>,
    c: &mut C,
    scene: &Scene,
) {
    code_plain(model, window, field, source, c, scene);
}

/// Codes one post.
#[inline(always)]
pub(super) fn code_plain<C: Coder>(
    model: &mut Model,
    window: &mut Window,
    field: &mut Field,
    source: Option<&[i32]>,
    c: &mut C,
    scene: &Scene,
) {
    let Scene { pass, post, places, weights } = scene;
    let at = post[0] * field.lattice.side() + post[1];
    let near = places.of(*post);
    let kind = usize::from(pass.kind == Kind::Edges);

    // Heights around, above the mean of the nearest four; that above the first of them.
    let from = field.z[near[0]];
    let mut d = [0.0f32; ALL];
    for k in 0..ALL {
        d[k] = field.z[near[k]].wrapping_sub(from) as f32;
    }
    let mean = ((d[0] + d[3]) + (d[1] + d[2])) * 0.25;
    for k in 0..ALL {
        d[k] -= mean;
    }

    // Predictions above the mean.
    let mut v: Row = [0.0; WIDE];
    v[0] = d[0] - d[3];
    v[1] = d[1] - d[2];
    v[2] = (d[0] + d[3]) - (d[1] + d[2]);
    v[3..INPUTS].copy_from_slice(&d[4..ALL]);
    let local = dot(&weights.local, &v);
    let broad = dot(&weights.broad, &v);
    let far = ((d[4] + d[5]) + (d[6] + d[7])) + ((d[8] + d[9]) + (d[10] + d[11]));
    let cubic = far * (-1.0 / 32.0);
    let pair = [(d[0] + d[3]) * 0.5, (d[1] + d[2]) * 0.5];
    let most = d[0].max(d[1]).max(d[2]).max(d[3]);
    let least = d[0].min(d[1]).min(d[2]).min(d[3]);
    let middle = (((d[0] + d[1]) + (d[2] + d[3])) - (most + least)) * 0.5;
    let predictions = [local, broad, cubic, middle, pair[0], pair[1], 0.0, 0.0];

    // Their blend, by the inverse fourth power of recent errors.
    let column = post[1] / pass.step + MARGIN;
    let (h, b) = (&model.here, &model.before);
    let west = &h[column - 2];
    let north = match pass.kind {
        Kind::Edges => [&b[column - 1], &b[column + 1], &b[column - 3], &b[column + 3]],
        Kind::Centres => [&b[column], &b[column - 2], &b[column + 2], &h[column - 4]],
    };
    let (mut sum, mut total) = ([0.0f32; PREDICTIONS], [0.0f32; PREDICTIONS]);
    for k in 0..PREDICTIONS {
        let wrong = (west[k] + north[0][k]) * 2.0
            + north[1][k] * 1.5
            + (north[2][k] + north[3][k]) * 0.7
            + 0.1 * model.step;
        let square = wrong * wrong;
        total[k] = FAVOUR[k] / (square * square);
        sum[k] = total[k] * predictions[k];
    }
    let all = |s: [f32; PREDICTIONS]| ((s[0] + s[1]) + (s[2] + s[3])) + (s[4] + s[5]);
    let (sum, total) = (all(sum), all(total));
    let blend = if total > 0.0 { sum / total } else { cubic };
    let place = mean + blend;
    // No height is that far from another.
    let place = if place.abs() < 67_108_864.0 { place } else { 0.0 };
    let floor = (place + 0.5).floor();
    let base = from.wrapping_add(floor as i32);

    // Shapes of what lies around, in steps, and their classes.
    let unit = 1.0 / model.step;
    let old: [f32; 4] = [0, 1, 2, 3].map(|k| model.residuals[near[k]]);
    let own: [f32; 4] = [16, 17, 18, 19].map(|k| model.residuals[near[k]]);
    let share = if kind == 1 { [0.3, 0.3, 0.3, 0.1] } else { [0.35, 0.35, 0.15, 0.15] };
    let ours = (own[0].abs() * share[0] + own[1].abs() * share[1])
        + (own[2].abs() * share[2] + own[3].abs() * share[3]);
    let olds = ((old[0].abs() + old[1].abs()) + (old[2].abs() + old[3].abs())) * 0.25;
    let spread = (most - least) * unit;
    let differ = ((local - broad).abs() + (local - cubic).abs()) * (1.5 * unit);
    let activity = (0.5 * ours + 0.3 * olds) + 0.1 * (spread + differ);
    let shapes = [activity, differ, ours, spread, olds, v[0].abs() * unit, v[1].abs() * unit, 0.0];
    let mut logs = [0.0f32; 8];
    for k in 0..8 {
        logs[k] = log2(shapes[k] + 0.01) + 6.65;
    }
    let class = |k: usize, octave: f32, classes: usize| ((logs[k] * octave) as i32 as usize).min(classes - 1);
    let stretch = ((logs[1] - logs[0] + 3.0) as i32).clamp(0, 3) as usize;
    let classes = [
        class(0, 4.0, CLASSES),
        class(5, 3.0, CLASSES),
        class(6, 3.0, CLASSES),
        class(3, 3.0, CLASSES),
        class(0, 1.5, 16) * 4 + stretch,
        class(2, 3.0, CLASSES),
        class(1, 3.0, CLASSES),
        class(4, 3.0, CLASSES),
    ];

    // The experts.
    let said = [local, pair[0], pair[1], middle, local, local, broad, blend];
    let mut centre: Lanes = [0.0; EXPERTS];
    let mut means: Lanes = [0.0; EXPERTS];
    let mut seens: Lanes = [0.0; EXPERTS];
    for k in 0..EXPERTS {
        centre[k] = ((mean + said[k]) - floor) * unit;
        let width = &model.widths[(kind * EXPERTS + k) * CLASSES + classes[k]];
        (means[k], seens[k]) = (width.mean, width.seen);
    }
    let expected = means[0];
    let scale = (pass.step.trailing_zeros() as usize).min(3);
    let eighth = (((place - floor + 0.5) * 8.0) as i32 as usize).min(7);
    let with = Contexts {
        weights: [class(0, 3.0, 64), kind * 32 + scale * 8 + class(1, 0.8, 8)],
        counters: [
            classes[0] * 8 + eighth,
            classes[3] * 8 + class(2, 0.7, 8),
            (lean(own[0]) * 7 + lean(own[1])) * 7 + lean(own[2]),
        ],
    };
    let start = if expected < MANY { 0 } else { (log2(expected) as i32 as u32).min(24) };
    let q = source.map_or(0, |z| quantize(z[at], base, model.e));
    let q = steps::code(&mut model.mixer, c, &with, Bells::new(centre, means), start, q);
    if c.ended() {
        return;
    }

    // What is learnt from it.
    let z = base.wrapping_add(q.wrapping_mul((2 * model.e).wrapping_add(1) as i32));
    field.z[at] = z;
    let target = z.wrapping_sub(from) as f32 - mean;
    let inside = q == 0 && model.e > 0;
    for k in 0..EXPERTS {
        let far = ((target - said[k]) * unit).abs();
        let far = if inside { within(means[k]) } else { far };
        seens[k] = (seens[k] + 1.0).min(SEEN);
        means[k] = (means[k] + (far - means[k]) / (seens[k] + 0.5)).clamp(0.01, 1e7);
    }
    for k in 0..EXPERTS {
        model.widths[(kind * EXPERTS + k) * CLASSES + classes[k]] = Width { mean: means[k], seen: seens[k] };
    }
    let residual = (target - blend) * unit;
    let fair = within(expected);
    model.residuals[at] = match inside {
        true if residual < 0.0 => -fair,
        true => fair,
        false => residual,
    };
    let wrong = &mut model.here[column];
    for k in 0..PREDICTIONS {
        wrong[k] = (target - predictions[k]).abs();
    }
    // Where much is expected, or one post stands out, a post says less of the ground.
    v[INPUTS] = target;
    let width = (expected + 0.3) * model.step;
    let off = target - local;
    window.learn(&v, 1.0 / (width * width + off * off * 0.25));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lattice::Lattice;
    use crate::range::Encoder;

    type Code = fn(&mut Model, &mut Window, &mut Field, Option<&[i32]>, &mut Encoder, &Scene);

    /// The bytes of a lattice, and all residuals.
    fn coded(code: Code, n: u32, e: u32, z: &[i32]) -> (Vec<u8>, Vec<u32>) {
        let lattice = Lattice::new(n).unwrap();
        let side = lattice.side();
        let mut field = Field { lattice, z: z.to_vec(), status: Vec::new(), selected: Vec::new() };
        let mut model = Model::new(side, e);
        let mut c = Encoder::new();
        for pass in lattice.passes() {
            let mut window = Window::new(side, None, [0.01; WIDE]);
            let places = Places::new(side, pass);
            for y in pass.rows(lattice) {
                let weights = window.start_row();
                for x in pass.columns(lattice, y) {
                    let scene = Scene { pass, post: [y, x], places: &places, weights: &weights };
                    code(&mut model, &mut window, &mut field, Some(z), &mut c, &scene);
                }
                window.end_block(0);
                window.end_row();
                model.end_row();
            }
        }
        assert!(field.z.iter().zip(z).all(|(a, b)| a.abs_diff(*b) <= e));
        (c.finish(), model.residuals.iter().map(|r| r.to_bits()).collect())
    }

    /// Wide vectors give the bits of plain code.
    #[test]
    fn wide_is_plain() {
        let mut state = 7u32;
        for e in [0, 1, 10] {
            for rough in [3, 40, 5000] {
                let z: Vec<i32> = (0..33 * 33)
                    .map(|k| {
                        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                        (k % 33 - 16) * (k / 33 - 9) + ((state >> 8) % rough) as i32
                    })
                    .collect();
                assert!(coded(code::<Encoder>, 5, e, &z) == coded(code_plain::<Encoder>, 5, e, &z));
            }
        }
    }
}
