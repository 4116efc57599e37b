//! In a bicubic database corrections are of class C2, too: across the lines of their nodes no slope and no curvature
//! jumps.

use super::{heights, helens, normals, world_of};
use crate::certified::reference::World;
use crate::certified::worlds::Ask;
use crate::support::{Random, seeds};
use terraquilt::db::Policy;
use terraquilt::height::patch::Kind;
use terraquilt::height::surface::Seams;

/// Steps across a line in cells: each half of the one before.
const STEPS: [f64; 4] = [0.04, 0.02, 0.01, 0.005];
/// Heights carry this much rounding, metres.
const ROUNDING: f64 = 2e-8;

/// Points on lines of nodes (half cells) of the crater beside a dome, with the cell across the line.
fn lines(w: &World, count: usize) -> Vec<([f64; 2], [f64; 2])> {
    let mut r = Random::new(seeds(1)[0] + 71_000);
    let s = &w.surveys[0];
    let mut out = Vec::new();
    for (p, d) in normals(&w.surveys[1], count) {
        let t = r.unit() * 60.0;
        let cell = s.spot([p[0] + t * d[0], p[1] + t * d[1]]).cell;
        let axis = r.below(2) as usize;
        let mut part = [0.05 + 0.4 * r.unit(), 0.05 + 0.4 * r.unit()];
        part[axis] = if r.chance(0.5) { 0.0 } else { 0.5 };
        let mut far = part;
        far[axis] += 0.25;
        let (p, q) = (s.point(cell, part), s.point(cell, far));
        out.push((p, [0, 1].map(|k| (q[k] - p[k]) * 4.0)));
    }
    out
}

/// By line and step: how far the slopes, and the second differences, of the corrections on both sides are apart, metres a cell
/// and a squared cell.
fn jumps(w: &World, ask: &Ask, lines: &[([f64; 2], [f64; 2])]) -> Vec<[[f64; 4]; 2]> {
    let at = |p: &[f64; 2], d: &[f64; 2], t: f64| [0, 1].map(|a| p[a] + t * d[a]);
    let points: Vec<[f64; 2]> = lines
        .iter()
        .flat_map(|(p, d)| STEPS.iter().flat_map(move |h| (-3..=3).map(move |k| at(p, d, f64::from(k) * h))))
        .collect();
    let c: Vec<f64> = heights(w, ask, Seams::All, &points)
        .iter()
        .map(|e| e.as_ref().map_or(f64::NAN, |e| e.correction_m))
        .collect();
    c.chunks_exact(7 * STEPS.len())
        .filter(|c| c.iter().all(|c| c.is_finite()) && c.iter().any(|c| c.abs() > 0.1))
        .map(|c| {
            let of = |n: usize| (&c[7 * n..7 * n + 7], STEPS[n]);
            let slope = |n: usize| {
                let (f, h) = of(n);
                ((f[4] - f[3]) - (f[3] - f[2])).abs() / h
            };
            let bend = |n: usize| {
                let (f, h) = of(n);
                ((f[3] - 2.0 * f[4] + f[5]) - (f[1] - 2.0 * f[2] + f[3])).abs() / (h * h)
            };
            [std::array::from_fn(slope), std::array::from_fn(bend)]
        })
        .collect()
}

fn quantile(j: &[[[f64; 4]; 2]], which: usize, q: f64) -> [f64; 4] {
    std::array::from_fn(|n| {
        let mut column: Vec<f64> = j.iter().map(|j| j[which][n]).collect();
        column.sort_by(f64::total_cmp);
        column[((column.len() - 1) as f64 * q) as usize]
    })
}

#[test]
fn bicubic_corrections_have_no_kink_at_their_nodes() {
    for z in [0.0, 5.0] {
        let ask = Ask::Metres(z);
        let [rough, smooth] = Kind::ALL.map(|k| {
            let w = world_of(k, &helens(&[0, 3]), Policy::Newest);
            jumps(&w, &ask, &lines(&w, 1500))
        });
        println!("z = {z}: {} and {} lines", rough.len(), smooth.len());
        assert!(rough.len() > 100 && smooth.len() > 100);
        for (which, name) in ["slope", "bend"].into_iter().enumerate() {
            for q in [0.5, 0.9] {
                let (a, b) = (quantile(&rough, which, q), quantile(&smooth, which, q));
                println!("    {name}, quantile {q}: bilinear {a:?}, bicubic {b:?}");
                let rounding = ROUNDING / STEPS[3].powi(1 + which as i32);
                // Halved with the step, as of a function of class C2; a kink of a bilinear field stays.
                assert!(b[3] <= 1.3 * b[0] * STEPS[3] / STEPS[0] + rounding, "{name} {q}: {b:?}");
                // Bilinear fields bend in the line alone, not beside it.
                assert!(which == 1 || a[3] > 0.5 * a[0], "{name} {q}: {a:?}");
            }
        }
    }
}
