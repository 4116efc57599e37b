//! The correction of one survey over one level-0 place.

use super::spans::shown;
use super::{BAND, NODES, Piece, REACH_MAX, Spans, ramp, square};
use crate::height::surface::Real;

/// What a node is to the better surveys.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Spot {
    /// In none of their cores, or without a height of its own.
    Outside,
    /// Inside: what the better one has above this one there, and whether both say otherwise.
    Inside { gap: f64, contradicted: bool },
}

/// The part of a field that comes from pieces with the same spans.
#[derive(Clone, Debug)]
struct Channel {
    spans: Spans,
    /// Corrections at the nodes, metres, row by row.
    nodes: Vec<f32>,
    contradicted: Vec<bool>,
}

/// The correction of one survey over one level-0 place.
#[derive(Clone, Debug, Default)]
pub struct Field {
    channels: Vec<Channel>,
    /// Nodes beyond the place on each side: 1 where splines need them.
    ring: usize,
}

/// Borders around a place: corner in cells from the place's own, pieces, how far each gap is carried.
pub type Near<'a> = ([f64; 2], &'a [Piece], &'a [f64]);

impl Field {
    /// Computes the field of a place. `near` in the order of rows, then columns, of places. `spot` is asked for nodes near
    /// the border, by half steps from the place's corner. With `smooth`, one more ring of nodes is made, for cubic splines.
    ///
    /// Costs one evaluation a node and piece. Equal bits at the nodes that two places share.
    pub fn new<E>(
        near: &[Near],
        smooth: bool,
        mut spot: impl FnMut(i64, i64) -> Result<Spot, E>,
    ) -> Result<Field, E> {
        struct Source {
            corner: [f64; 2],
            at: [f64; 2],
            length: f64,
            ease2: f64,
            gap: f64,
            reach: f64,
            contradicted: bool,
            channel: usize,
        }
        let ring = usize::from(smooth);
        let (lo, hi) = (-(ring as f64) / 2.0 - REACH_MAX, REACH_MAX * 2.0 + ring as f64 / 2.0);
        let mut channels: Vec<Channel> = Vec::new();
        let mut sources: Vec<Source> = Vec::new();
        let side = NODES + 2 * ring;
        for (corner, pieces, reaches) in near {
            for (p, reach) in pieces.iter().zip(*reaches) {
                let at = [corner[0] + p.at[0], corner[1] + p.at[1]];
                if !at.iter().all(|c| (lo..=hi).contains(c)) {
                    continue;
                }
                let channel = channels.iter().position(|c| c.spans == p.spans).unwrap_or_else(|| {
                    channels.push(Channel {
                        spans: p.spans.clone(),
                        nodes: vec![0.0; side * side],
                        contradicted: vec![false; side * side],
                    });
                    channels.len() - 1
                });
                sources.push(Source {
                    corner: *corner,
                    at: p.at,
                    length: p.length,
                    ease2: p.ease * p.ease,
                    gap: p.gap,
                    reach: *reach,
                    contradicted: p.contradicted,
                    channel,
                });
            }
        }
        if sources.is_empty() {
            return Ok(Field::default());
        }
        let n = channels.len();
        let (mut carried, mut share, mut flagged) = (vec![0.0; n], vec![0.0; n], vec![false; n]);
        let r2_max = REACH_MAX * REACH_MAX;
        for b in 0..side {
            for a in 0..side {
                let half = [a as i64 - ring as i64, b as i64 - ring as i64];
                let p = half.map(|k| k as f64 / 2.0);
                carried.fill(0.0);
                share.fill(0.0);
                flagged.fill(false);
                let (mut anchored, mut shares, mut nearest) = (0.0, 0.0, f64::INFINITY);
                for s in &sources {
                    // Nodes lie exactly where they lie from any corner: the same digits whatever place asks.
                    let r2 = square([p[0] - s.corner[0], p[1] - s.corner[1]], s.at);
                    if r2 >= r2_max {
                        continue;
                    }
                    nearest = nearest.min(r2);
                    let t = 1.0 - r2 / r2_max;
                    let w = s.length * t * t * t / (r2 + s.ease2);
                    share[s.channel] += w;
                    shares += w;
                    if s.gap.is_nan() {
                        continue;
                    }
                    anchored += w;
                    if r2 < s.reach * s.reach {
                        carried[s.channel] += w * s.gap * (1.0 - ramp(r2.sqrt() / s.reach));
                        flagged[s.channel] |= s.contradicted;
                    }
                }
                if nearest.is_infinite() {
                    continue;
                }
                let distance = nearest.sqrt();
                let inside =
                    if distance < BAND[0] + BAND[1] { spot(half[0], half[1])? } else { Spot::Outside };
                for (k, c) in channels.iter_mut().enumerate() {
                    let mut v = if anchored > 0.0 { carried[k] / anchored } else { 0.0 };
                    let mut contradicted = flagged[k];
                    if let Spot::Inside { gap, contradicted: claim } = inside {
                        let near = 1.0 - ramp((distance - BAND[0]) / BAND[1]);
                        v = (1.0 - near) * v + near * gap * (share[k] / shares);
                        contradicted |= claim && near > 0.0 && share[k] > 0.0;
                    }
                    c.nodes[b * side + a] = v as f32;
                    c.contradicted[b * side + a] = contradicted;
                }
            }
        }
        channels.retain(|c| c.nodes.iter().any(|v| *v != 0.0));
        Ok(Field { channels, ring })
    }

    /// Bytes it holds, for caches.
    pub fn weight(&self) -> u64 {
        64 + self.channels.iter().map(|c| 64 + 5 * c.nodes.len() as u64).sum::<u64>()
    }

    pub fn is_flat(&self) -> bool {
        self.channels.is_empty()
    }

    /// The correction at (x, y) in cells from the place's corner at a tolerance, and whether contradicting surveys made it.
    /// `ease` is the ramp of the weights along the tolerance. Bilinear between nodes, or cubic B-splines (of class
    /// C2, within the range of the nodes) if the field was made with a ring for them.
    pub fn at<T: Real>(&self, x: T, y: T, z: T, ease: impl Fn(T) -> T) -> (T, bool) {
        let mut sum = T::constant(0.0);
        let mut contradicted = false;
        if self.channels.is_empty() {
            return (sum, contradicted);
        }
        let cell = |v: T| {
            let t = v.scale(2.0);
            let k = t.value().floor().clamp(0.0, (NODES - 2) as f64);
            (k as usize, t - T::constant(k))
        };
        let ((a, s), (b, t)) = (cell(x), cell(y));
        let side = NODES + 2 * self.ring;
        for c in &self.channels {
            let part = shown(&c.spans, z, &ease);
            if part.value() <= 0.0 {
                continue;
            }
            let v = if self.ring == 0 {
                let at = |m: usize, n: usize| T::constant(f64::from(c.nodes[(b + n) * side + a + m]));
                let left = at(0, 0) + (at(0, 1) - at(0, 0)) * t;
                let right = at(1, 0) + (at(1, 1) - at(1, 0)) * t;
                left + (right - left) * s
            } else {
                let (ws, wt) = (basis(s), basis(t));
                let mut v = T::constant(0.0);
                for (n, wt) in wt.iter().enumerate() {
                    let mut row = T::constant(0.0);
                    for (m, ws) in ws.iter().enumerate() {
                        row = row + ws.scale(f64::from(c.nodes[(b + n) * side + a + m]));
                    }
                    v = v + row * *wt;
                }
                v
            };
            sum = sum + part * v;
            let (p, q) = (a + self.ring, b + self.ring);
            contradicted |= (0..2).any(|n| (0..2).any(|m| c.contradicted[(q + n) * side + p + m]));
        }
        (sum, contradicted)
    }

    /// The correction at tolerance 0.
    pub fn whole(&self, x: f64, y: f64) -> f64 {
        self.at(x, y, 0.0, |t: f64| t.clamp(0.0, 1.0)).0
    }
}

/// The four cubic B-splines over a cell, `0 <= t <= 1`.
fn basis<T: Real>(t: T) -> [T; 4] {
    let c = T::constant;
    let u = c(1.0) - t;
    let (t2, u2) = (t * t, u * u);
    [
        (u2 * u).scale(1.0 / 6.0),
        (t2 * (t.scale(3.0) - c(6.0)) + c(4.0)).scale(1.0 / 6.0),
        (u2 * (u.scale(3.0) - c(6.0)) + c(4.0)).scale(1.0 / 6.0),
        (t2 * t).scale(1.0 / 6.0),
    ]
}
