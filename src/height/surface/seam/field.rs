//! The correction of one survey over one level-0 place.

use super::spans::shown;
use super::{BAND, NODES, Piece, REACH_MAX, STEP_LOG2, Spans, ramp, square};
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
#[derive(Clone, Debug, PartialEq)]
pub struct Channel {
    pub spans: Spans,
    /// Corrections at the nodes, metres, row by row: whole numbers of steps of [`STEP_LOG2`].
    pub nodes: Vec<f32>,
    pub contradicted: Vec<bool>,
}

/// The correction of one survey over one level-0 place.
#[derive(Clone, Debug, Default, PartialEq)]
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
        let per_metre = f64::from(STEP_LOG2).exp2();
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
                    c.nodes[b * side + a] = ((v * per_metre).round() / per_metre) as f32;
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

    /// A field of these channels, each of 57 x 57 nodes, 59 x 59 with `smooth`.
    pub fn of(channels: Vec<Channel>, smooth: bool) -> Field {
        let ring = usize::from(smooth);
        let n = (NODES + 2 * ring).pow(2);
        assert!(channels.iter().all(|c| c.nodes.len() == n && c.contradicted.len() == n), "{n} nodes");
        Field { channels, ring }
    }

    pub fn channels(&self) -> &[Channel] {
        &self.channels
    }

    /// Whether it is made of splines between its nodes.
    pub fn is_smooth(&self) -> bool {
        self.ring > 0
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

#[cfg(test)]
mod tests {
    use super::super::{Border, spans};
    use super::*;
    use crate::height::surface::Dual;

    /// A straight border along y = 14 with a gap that varies, seen from the place beside it, too.
    fn border() -> Border {
        let piece = |k: i32| Piece {
            at: [(f64::from(k) + 0.5) / 5.0, 14.0],
            length: 0.2,
            ease: 0.1,
            gap: 5.0 + f64::from(k % 9 - 4),
            contradicted: k < 20,
            spans: spans(vec![[0.5, if k < 70 { 30.0 } else { f32::INFINITY }]], 0.5),
        };
        Border { pieces: (0..140).map(piece).collect() }
    }

    fn field(corner: f64, smooth: bool) -> Field {
        let b = border();
        let reaches = vec![20.0; b.pieces.len()];
        let near: Vec<Near> = vec![([corner, 0.0], &b.pieces, &reaches)];
        // The better survey lies below the border.
        let spot = |_: i64, b: i64| {
            let inside = Spot::Inside { gap: 5.0, contradicted: false };
            Ok::<_, ()>(if b < 28 { inside } else { Spot::Outside })
        };
        Field::new(&near, smooth, spot).unwrap()
    }

    fn at(f: &Field, x: f64, y: f64, z: f64) -> f64 {
        f.at(x, y, z, |t: f64| t.clamp(0.0, 1.0)).0
    }

    #[test]
    fn places_agree_bit_for_bit_where_they_touch() {
        let (here, beside) = (field(0.0, false), field(-28.0, false));
        for k in 0..57 {
            let y = f64::from(k) / 2.0;
            assert_eq!(at(&here, 28.0, y, 1.0).to_bits(), at(&beside, 0.0, y, 1.0).to_bits());
        }
        assert!(at(&here, 28.0, 16.0, 1.0) > 1.0 && field(-60.0, false).is_flat());
    }

    #[test]
    fn a_correction_is_the_gap_at_the_border_and_fades() {
        let f = field(0.0, false);
        // The mean of the nearest gaps: 7 and 8.
        assert!((at(&f, 14.0, 14.0, 0.0) - 7.5).abs() < 1.0);
        assert!((at(&f, 14.0, 12.0, 0.0) - 5.0).abs() < 1e-6);
        let away: Vec<f64> = (0..28).map(|k| at(&f, 14.0, 14.0 + f64::from(k) / 2.0, 0.0)).collect();
        assert!(away[2..].windows(2).all(|w| w[1] <= w[0] + 1e-6), "{away:?}");
        assert!(away.iter().all(|v| (0.0..=9.0).contains(v)));
        // Where the better survey is not shown any more, nothing is left to be bent.
        assert_eq!(at(&f, 2.0, 15.0, 1000.0).min(0.5), at(&f, 2.0, 15.0, 40.0).min(0.5));
        assert!(at(&f, 1.0, 15.0, 40.0) < 0.5 * at(&f, 1.0, 15.0, 20.0));
        assert!(f.at(1.0, 15.0, 0.0, |t: f64| t).1 && !f.at(27.0, 27.0, 0.0, |t: f64| t).1);
    }

    #[test]
    fn splines_stay_within_the_nodes_and_have_continuous_slopes() {
        let (here, beside, plain) = (field(0.0, true), field(-28.0, true), field(0.0, false));
        let slope = |f: &Field, x: f64, y: f64| {
            let (x, y) = (Dual { v: x, x: 1.0, y: 0.0 }, Dual { v: y, x: 0.0, y: 1.0 });
            f.at(x, y, Dual { v: 1.0, x: 0.0, y: 0.0 }, |t: Dual| t).0
        };
        for k in 1..56 {
            let y = f64::from(k) / 2.0;
            let (a, b) = (slope(&here, 28.0, y), slope(&beside, 0.0, y));
            assert!((a.v - b.v).abs() < 1e-6 && (a.x - b.x).abs() < 1e-5 && (a.y - b.y).abs() < 1e-5);
            let (a, b) = (slope(&here, 10.0 - 1e-7, y), slope(&here, 10.0 + 1e-7, y));
            assert!((a.x - b.x).abs() < 1e-5, "a kink between nodes");
            let h = 1e-5;
            let central = (at(&here, 9.3 + h, y, 1.0) - at(&here, 9.3 - h, y, 1.0)) / (2.0 * h);
            assert!((slope(&here, 9.3, y).x - central).abs() < 1e-5);
            assert!((at(&here, 9.3, y, 1.0) - at(&plain, 9.3, y, 1.0)).abs() < 1.0);
        }
    }
}
