//! The border before the triangulation: rings become vertices and edges, split where the field bends.

use std::collections::HashMap;

use super::{Field, FieldSample, Polygon};
use crate::base::{Error, Result};

/// Vertices (x, y, z) on the grid and directed edges with the region on their left.
pub(super) struct Border {
    pub knots: Vec<[f64; 3]>,
    pub edges: Vec<[u32; 2]>,
}

/// Edges are sampled in batches of about so many points.
const BATCH_POINTS: usize = 1 << 16;

/// Snaps the rings to the grid and splits each edge, worst point first, until the field along it is
/// within `bound` of the straight line, looked at every quarter of a step.
pub(super) fn border(
    field: &dyn Field,
    region: &[Polygon],
    (unit, step, bound): (f64, f64, f64),
) -> Result<Border> {
    let snap = |v: f64| (v / unit).round() * unit;
    let mut index: HashMap<[u64; 2], u32> = HashMap::new();
    let mut plane: Vec<[f64; 2]> = Vec::new();
    let mut add = |p: [f64; 2], plane: &mut Vec<[f64; 2]>| {
        *index.entry(p.map(|v| (v + 0.0).to_bits())).or_insert_with(|| {
            plane.push(p);
            plane.len() as u32 - 1
        })
    };
    let mut edges = Vec::new();
    for ring in region.iter().flat_map(Polygon::rings) {
        let ring: Vec<u32> = ring.iter().map(|p| add(p.map(|v| snap(v) + 0.0), &mut plane)).collect();
        edges.extend(
            ring.iter().zip(ring.iter().cycle().skip(1)).map(|(a, b)| [*a, *b]).filter(|e| e[0] != e[1]),
        );
    }
    let mut knots: Vec<[f64; 3]> = Vec::with_capacity(plane.len());
    let samples = sample_surely(field, &plane, unit, step)?;
    knots.extend(plane.iter().zip(&samples).map(|(p, s)| [p[0], p[1], s.z]));

    // A batch of edges at a time: sample them all, then split each on its own.
    let mut out = Vec::with_capacity(edges.len());
    let mut next = 0;
    while next < edges.len() {
        let (mut points, mut spans) = (Vec::new(), Vec::new());
        while next < edges.len() && points.len() < BATCH_POINTS {
            let [a, b] = edges[next].map(|v| knots[v as usize]);
            let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
            let count = (dx.hypot(dy) / (step / 4.0)).ceil().max(2.0) as usize;
            let start = points.len();
            for k in 1..count {
                let t = k as f64 / count as f64;
                points.push([snap(a[0] + t * dx) + 0.0, snap(a[1] + t * dy) + 0.0]);
            }
            spans.push((edges[next], start..points.len()));
            next += 1;
        }
        let inward: Vec<[f64; 2]> = spans
            .iter()
            .flat_map(|(edge, span)| {
                let [a, b] = edge.map(|v| knots[v as usize]);
                let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
                let length = dx.hypot(dy);
                std::iter::repeat_n([-dy / length, dx / length], span.len())
            })
            .collect();
        let heights = sample_along(field, &points, &inward, unit, step);
        for ([a, b], span) in spans {
            let mut chain: Vec<[f64; 3]> = vec![knots[a as usize]];
            let known = points[span.clone()].iter().zip(&heights[span]);
            chain.extend(known.filter_map(|(p, z)| z.map(|z| [p[0], p[1], z])));
            chain.push(knots[b as usize]);
            let mut last = a;
            let weights: Vec<f64> = chain.iter().map(|p| 1.0 / field.share([p[0], p[1]])).collect();
            for i in split(&chain, &weights, bound) {
                let p = chain[i];
                let v = add([p[0], p[1]], &mut plane);
                if v as usize == knots.len() {
                    knots.push(p);
                }
                out.push([last, v]);
                last = v;
            }
            out.push([last, b]);
        }
    }
    out.retain(|e| e[0] != e[1]);
    Ok(Border { knots, edges: out })
}

/// The points of a chain at which it must be broken, in order; errors count by their weights.
fn split(chain: &[[f64; 3]], weights: &[f64], bound: f64) -> Vec<usize> {
    let mut breaks = Vec::new();
    let mut todo = vec![(0, chain.len() - 1)];
    while let Some((i, j)) = todo.pop() {
        let (a, b) = (chain[i], chain[j]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let squared = dx * dx + dy * dy;
        let mut worst = (bound, 0);
        for (k, p) in chain.iter().enumerate().take(j).skip(i + 1) {
            let t = ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / squared;
            let error = (a[2] + t * (b[2] - a[2]) - p[2]).abs() * weights[k];
            if error > worst.0 {
                worst = (error, k);
            }
        }
        if worst.1 > 0 {
            breaks.push(worst.1);
            todo.extend([(i, worst.1), (worst.1, j)]);
        }
    }
    breaks.sort_unstable();
    breaks
}

/// Heights at points of the border; where the field has none, a little to the inside.
pub(super) fn sample_along(
    field: &dyn Field,
    points: &[[f64; 2]],
    inward: &[[f64; 2]],
    unit: f64,
    step: f64,
) -> Vec<Option<f64>> {
    let mut out = Vec::new();
    field.sample(points, &mut out);
    for reach in reaches(unit, step) {
        let missing: Vec<usize> = (0..points.len()).filter(|&i| out[i].is_none()).collect();
        if missing.is_empty() {
            break;
        }
        let moved: Vec<[f64; 2]> = missing
            .iter()
            .map(|&i| [points[i][0] + reach * inward[i][0], points[i][1] + reach * inward[i][1]])
            .collect();
        let mut found = Vec::new();
        field.sample(&moved, &mut found);
        missing.iter().zip(found).for_each(|(&i, s)| out[i] = s);
    }
    out.into_iter().map(|s| s.map(|s| s.z)).collect()
}

/// How far from the border the field is asked where it has no answer on it.
fn reaches(unit: f64, step: f64) -> [f64; 4] {
    [2.0 * unit, 1e-3 * step, 1e-2 * step, 0.1 * step]
}

/// The field at vertices; where it has no answer, at the nearest of some points around.
///
/// # Errors
/// [`Error::Invalid`] if there is none within a tenth of a step.
pub(super) fn sample_surely(
    field: &dyn Field,
    points: &[[f64; 2]],
    unit: f64,
    step: f64,
) -> Result<Vec<FieldSample>> {
    let mut out = Vec::with_capacity(points.len());
    field.sample(points, &mut out);
    let mut missing: Vec<usize> = (0..points.len()).filter(|&i| out[i].is_none()).collect();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let ways = [
        [1.0, 0.0],
        [0.0, 1.0],
        [-1.0, 0.0],
        [0.0, -1.0],
        [half, half],
        [-half, half],
        [-half, -half],
        [half, -half],
    ];
    for reach in reaches(unit, step) {
        for way in ways {
            if missing.is_empty() {
                break;
            }
            let moved: Vec<[f64; 2]> = missing
                .iter()
                .map(|&i| [points[i][0] + reach * way[0], points[i][1] + reach * way[1]])
                .collect();
            let mut found = Vec::new();
            field.sample(&moved, &mut found);
            missing.iter().zip(found).for_each(|(&i, s)| out[i] = s);
            missing.retain(|&i| out[i].is_none());
        }
    }
    let gap = missing.first().map(|&i| points[i]);
    if let Some([x, y]) = gap {
        return Err(Error::invalid("mesh", format!("no height at the border near {x},{y}")));
    }
    Ok(out.into_iter().flatten().collect())
}
