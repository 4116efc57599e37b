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
    for [bot, top] in &mut live {
        *bot = if *bot <= floor { 0.0 } else { quarter(*bot, false) };
        *top = quarter(*top, true);
    }
    join(live)
}

/// The tolerances that are in any of several lists.
pub fn union(lists: &[Spans]) -> Spans {
    join(lists.iter().flat_map(|s| s.iter().copied()).collect())
}

fn join(mut all: Vec<[f32; 2]>) -> Spans {
    all.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
    let mut out: Vec<[f32; 2]> = Vec::new();
    for [bot, top] in all {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_join_what_touches_and_fade_beside_it() {
        let s = spans(vec![[40.0, 50.0], [1.0, 4.0], [4.0, 9.0]], 1.0);
        assert_eq!(s.len(), 2);
        assert!(s[0][0] == 0.0 && s[0][1] >= 9.0 && s[1][0] <= 40.0 && s[1][1] >= 50.0);
        assert_eq!(union(&[s.clone(), s.clone()]), s);
        assert_eq!(union(&[s.clone(), spans(vec![[9.0, 41.0]], 0.0)]).len(), 1);
        let at = |z: f64| shown(&s, z, |t: f64| t.clamp(0.0, 1.0));
        assert_eq!((at(0.0), at(9.0), at(20.0), at(45.0), at(1000.0)), (1.0, 1.0, 0.0, 1.0, 0.0));
        let (lo, hi) = (f64::from(s[0][1]), f64::from(s[0][1]) * KAPPA);
        assert!(at((lo + hi) / 2.0) > 0.4 && at((lo + hi) / 2.0) < 0.6 && at(hi + 1e-9) == 0.0);
        assert_eq!(shown(&spans(vec![[3.0, f32::INFINITY]], 3.0), f64::INFINITY, |t| t), 1.0);
        assert_eq!(shown(&spans(Vec::new(), 1.0), 0.0, |t| t), 0.0);
    }
}
