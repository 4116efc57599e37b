//! At which tolerances a survey is shown.

use crate::height::surface::{KAPPA, Real};
use std::sync::Arc;

/// Tolerances at which a survey is shown somewhere: disjoint, ascending, from each bottom to its top.
pub type Spans = Arc<[[f32; 2]]>;

/// The spans of the live patches (bottom, top) that hold a place; the floor of the survey is shown down to 0.
///
/// Ends are rounded outwards to powers of 2^(1/4), so that few different spans meet in one block.
pub fn spans(mut live: Vec<[f32; 2]>, floor: f32) -> Spans {
    let quarter = |x: f32, up: bool| -> f32 {
        if x <= 0.0 || x.is_infinite() {
            return x;
        }
        let t = f64::from(x).log2() * 4.0;
        ((if up { t.ceil() } else { t.floor() }) / 4.0).exp2() as f32
    };
    live.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut out: Vec<[f32; 2]> = Vec::new();
    for [bot, top] in live {
        let bot = if bot <= floor { 0.0 } else { quarter(bot, false) };
        let top = quarter(top, true);
        match out.last_mut() {
            Some(last) if bot <= last[1] => last[1] = last[1].max(top),
            _ => out.push([bot, top]),
        }
    }
    out.into()
}

/// How much of a survey is shown at a tolerance: 1 in its spans, fading like the weights of patches beside them.
pub(super) fn shown<T: Real>(spans: &[[f32; 2]], z: T, ease: impl Fn(T) -> T) -> T {
    let one = T::constant(1.0);
    let mut sum = T::constant(0.0);
    for [bot, top] in spans.iter().map(|s| s.map(f64::from)) {
        let up = if bot == 0.0 || z.value().is_infinite() {
            one
        } else {
            ease((z - T::constant(bot)).scale(1.0 / ((KAPPA - 1.0) * bot)))
        };
        let down = if top.is_infinite() {
            one
        } else {
            one - ease((z - T::constant(top)).scale(1.0 / ((KAPPA - 1.0) * top)))
        };
        sum = sum + up * down;
    }
    if sum.value() > 1.0 { one } else { sum }
}
