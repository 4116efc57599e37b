//! The plain form of the search: every pair in f64. What the quick form must equal, and what is left for ranges beyond the reach of f32.

use super::super::grid::points;
use super::frame::Frame;
use super::sought::{Best, Sought};
use super::{Match, Search};

/// The best match of a range, by its corner.
pub fn search<const D: usize>(frame: &Frame<D>, range: [usize; D], search: Search) -> Option<Match<D>> {
    let level = frame.level;
    let side = level.domains.side;
    let (mut r, mut d) = (vec![0.0; frame.samples], vec![0.0; frame.samples]);
    let mut turned = d.clone();
    level.grid.block(range, side, &mut r);
    let class = frame.classes.as_ref().map(|c| c.of(&r));
    let rr = centre(&mut r);
    let width = if let Search::Near(w) = search { w } else { usize::MAX };
    let mut best: Option<Match<D>> = None;
    let (first, count) = level.domains.near(range, width);
    for p in points(count) {
        let mut place = first;
        (0..D).for_each(|a| place[a] += p[a]);
        level.half.block(level.domains.corner(place).map(|v| v / 2), side, &mut d);
        let met = frame.classes.as_ref().zip(class).map(|(c, class)| c.met(class, c.of(&d)));
        let dd = centre(&mut d);
        for (isometry, places) in frame.places.iter().enumerate() {
            if met.is_some_and(|m| !m.contains(&isometry)) {
                continue;
            }
            turned.iter_mut().zip(places).for_each(|(t, p)| *t = r[*p as usize]);
            let rd = turned.iter().zip(&d).map(|(a, b)| a * b).sum::<f64>();
            let scale = level.scales.nearest(rd, dd);
            let error = level.scales.error(scale, rr, rd, dd);
            if scale != 0 && error < best.map_or(rr, |b| b.error) {
                best = Some(Match { domain: place, isometry, scale, error });
            }
        }
    }
    best
}

/// The same, put down as the best of a range that is sought.
pub fn settle<const D: usize>(frame: &Frame<D>, sought: &mut Sought<D>, of: Search) {
    sought.best = search(frame, sought.range, of).map(|m| Best {
        error: m.error,
        domain: frame.number(m.domain),
        isometry: m.isometry,
        scale: m.scale,
    });
}

/// Takes the mean away; returns the sum of squares that is left.
pub fn centre(block: &mut [f64]) -> f64 {
    let mean = block.iter().sum::<f64>() / block.len() as f64;
    block.iter_mut().for_each(|v| *v -= mean);
    block.iter().map(|v| *v * *v).sum()
}
