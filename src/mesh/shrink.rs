//! Vertices that the bound does not need are moved into a neighbour, which may move up or down for it.
//!
//! H. Hoppe: Progressive Meshes, SIGGRAPH 1996 (half-edge collapse); the bound is that of J. Cohen et al.: Simplification
//! Envelopes, SIGGRAPH 1996, here for a height field: when a vertex goes into its neighbour `u`, all new triangles meet at `u`.
//! At every point the distance from the field is linear in the height of `u`, so each post and each point of a side bounds the
//! move of `u` by an interval, and the vertex may go if the intervals have a move in common.

use super::flat::{Flat, Vertex, area, previous};
use super::grow::Ground;
use super::posts::Slope;

/// A vertex with more neighbours stays, and none gets more.
const NEIGHBOURS_MAX: usize = 20;

/// By how much a vertex may move up or down, metres.
#[derive(Clone, Copy, Debug)]
struct Moves {
    low: f64,
    high: f64,
}

impl Moves {
    /// Leaves the moves that keep a distance `d` (field less mesh), of which a share `part` of the move is taken, in the bound.
    #[inline]
    fn keep(&mut self, d: f64, part: f64, bound: f64) {
        if part > 1e-9 {
            let over = 1.0 / part;
            self.low = self.low.max((d - bound) * over);
            self.high = self.high.min((d + bound) * over);
        }
    }
    fn empty(&self) -> bool {
        self.low > self.high
    }
    fn has_zero(&self) -> bool {
        self.low <= 0.0 && self.high >= 0.0
    }
}

pub(super) struct Shrink<'a> {
    pub flat: Flat,
    pub ground: Ground<'a>,
    star: Vec<u32>,
    other: Vec<u32>,
}

impl<'a> Shrink<'a> {
    pub fn new(flat: Flat, ground: Ground<'a>) -> Shrink<'a> {
        Shrink { flat, ground, star: Vec::new(), other: Vec::new() }
    }

    /// What a triangle allows its first corner.
    fn triangle(&self, at: [&Vertex; 3], moves: &mut Moves) {
        let (plane, part) = (Slope::through(at), Slope::of(at, [1.0, 0.0, 0.0]));
        let (grid, bound) = (self.ground.grid, self.ground.bound);
        grid.rows_in(at, |row, west, east| {
            let (from, share) = (plane.at(0.0, row as f64), part.at(0.0, row as f64));
            let heights = &grid.heights[row * grid.cols..][..grid.cols];
            for (col, z) in heights.iter().enumerate().take(east + 1).skip(west) {
                let i = col as f64;
                moves.keep(z - (from + plane.di * i), share + part.di * i, bound);
            }
        });
    }

    /// What a side allows its first end.
    fn side(&self, a: &Vertex, b: &Vertex, moves: &mut Moves) {
        let bound = self.ground.bound;
        self.ground.grid.along_side(a, b, |piece| {
            moves.keep(piece.d1, 1.0 - piece.t1, bound);
            if let Some((t, d)) = piece.top() {
                moves.keep(d, 1.0 - t, bound);
            }
            !moves.empty()
        });
    }

    fn free(&self, v: &Vertex) -> Moves {
        if v.fixed {
            return Moves { low: 0.0, high: 0.0 };
        }
        let d = v.field - v.z;
        Moves { low: d - self.ground.bound, high: d + self.ground.bound }
    }

    /// Whether a triangle and its sides from the first corner are within the bound.
    fn holds(&self, at: [&Vertex; 3]) -> bool {
        let bound = self.ground.bound;
        self.ground.grid.farthest_post(at).error <= bound
            && self.ground.grid.farthest_on_side(at[0], at[1]).error <= bound
            && self.ground.grid.farthest_on_side(at[0], at[2]).error <= bound
    }

    /// Takes a vertex out, if that can be. Returns the neighbour that it went into.
    pub fn take(&mut self, v: u32) -> Option<u32> {
        let mut star = std::mem::take(&mut self.star);
        self.flat.star(v, &mut star);
        let found = self.best(v, &star);
        let into = found.map(|(m, z)| {
            let u = self.flat.ends(star[m]).1;
            self.flat.collapse(&star, m);
            self.flat.vertices[u as usize].z = z;
            u
        });
        self.star = star;
        into
    }

    fn best(&mut self, v: u32, star: &[u32]) -> Option<(usize, f64)> {
        let n = star.len();
        if n > NEIGHBOURS_MAX || self.flat.vertex(v).fixed {
            return None;
        }
        let mut ring =
            [Vertex { x: 0, y: 0, i: 0.0, j: 0.0, z: 0.0, field: 0.0, fixed: false }; NEIGHBOURS_MAX];
        for (k, h) in star.iter().enumerate() {
            ring[k] = *self.flat.vertex(self.flat.ends(*h).1);
        }
        let mut best: Option<(f64, usize, f64)> = None;
        for m in 0..n {
            let u = &ring[m];
            let fan = |k: usize| (&ring[(m + k) % n], &ring[(m + k + 1) % n]);
            if (1..n - 1).any(|k| area(u, fan(k).0, fan(k).1) <= 0) {
                continue;
            }
            let mut moves = self.free(u);
            for k in 1..n - 1 {
                let (a, b) = fan(k);
                self.triangle([u, a, b], &mut moves);
                if k > 1 {
                    self.side(u, a, &mut moves);
                }
                if moves.empty() {
                    break;
                }
            }
            if moves.empty() {
                continue;
            }
            if moves.has_zero() {
                let slack = moves.high.min(-moves.low);
                if best.is_none_or(|b| 1e6 + slack > b.0) {
                    best = Some((1e6 + slack, m, u.z));
                }
                continue;
            }
            if best.is_some_and(|b| b.0 > 1e5) {
                continue;
            }
            // Its other triangles and sides must agree to the move.
            let mut other = std::mem::take(&mut self.other);
            let id = self.flat.ends(star[m]).1;
            self.flat.star(id, &mut other);
            for h in &other {
                let (_, to) = self.flat.ends(*h);
                let third = self.flat.corners[previous(*h) as usize];
                if to != v {
                    self.side(u, self.flat.vertex(to), &mut moves);
                    if third != v {
                        self.triangle([u, self.flat.vertex(to), self.flat.vertex(third)], &mut moves);
                    }
                }
                if moves.empty() {
                    break;
                }
            }
            if !moves.empty() && other.len() + n <= NEIGHBOURS_MAX + 4 {
                let z = f64::from((u.z + (moves.low + moves.high) / 2.0) as f32);
                let moved = Vertex { z, ..*u };
                let new = (1..n - 1).all(|k| self.holds([&moved, fan(k).0, fan(k).1]));
                let old = || {
                    other.iter().all(|h| {
                        let (to, third) = (self.flat.ends(*h).1, self.flat.corners[previous(*h) as usize]);
                        to == v
                            || third == v
                            || self.holds([&moved, self.flat.vertex(to), self.flat.vertex(third)])
                    })
                };
                if new && old() {
                    let slack = (moves.high - moves.low) / 2.0;
                    if best.is_none_or(|b| slack > b.0) {
                        best = Some((slack, m, z));
                    }
                }
            }
            self.other = other;
        }
        best.map(|(_, m, z)| (m, z))
    }
}
