//! Low and high ends of what a prefix may be, on a square lattice, halved step by step by the midpoint rule.
//!
//! Fixed point, 16ths of a unit. A midpoint's low end is rounded down and its high end up: an interval never gets too narrow. Exact
//! for four halvings; a 16th for each more.

use super::super::field::Status;
use multiversion::multiversion;

/// Bits behind the point.
pub(super) const FRACTION: u32 = 4;

/// What a prefix knows of the posts between.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Between {
    /// Centres may or may not have come, edges have not.
    SomeCentres,
    /// Centres have come, edges have not.
    Centres,
    /// Centres have come, edges may have.
    SomeEdges,
    /// None has come.
    Nothing,
}

/// The lattice as it was decoded: `side * side` each.
pub(super) struct Ground<'a> {
    pub side: usize,
    /// Heights in fixed point; of posts that are left out the ends of their midpoint.
    pub low: &'a [i32],
    pub high: &'a [i32],
    /// Empty if none is given.
    pub status: &'a [Status],
}

/// Ends at every `step` of the lattice.
pub(super) struct Hull {
    pub step: usize,
    /// Posts along a side: 2^k + 1.
    pub side: usize,
    pub low: Vec<i32>,
    pub high: Vec<i32>,
}

impl Hull {
    /// All posts of this step have come.
    pub fn known(ground: &Ground, step: usize) -> Hull {
        let side = (ground.side - 1) / step + 1;
        let take = |from: &[i32]| {
            let mut out = Vec::with_capacity(side * side);
            for row in from.chunks_exact(ground.side).step_by(step) {
                out.extend(row.iter().step_by(step));
            }
            out
        };
        Hull { step, side, low: take(ground.low), high: take(ground.high) }
    }

    /// The same at half the step.
    pub fn halved(&self, ground: &Ground, between: Between) -> Hull {
        let side = 2 * self.side - 1;
        let mut out = Hull {
            step: self.step / 2,
            side,
            low: Vec::with_capacity(side * side),
            high: Vec::with_capacity(side * side),
        };
        self.rows(ground, between, |_, low, high| {
            out.low.extend_from_slice(low);
            out.high.extend_from_slice(high);
        });
        out
    }

    /// The rows at half the step, one after the other, with their numbers.
    pub fn rows(&self, ground: &Ground, between: Between, mut take: impl FnMut(usize, &[i32], &[i32])) {
        let fine = 2 * self.side - 1;
        let (mut low, mut high, mut diagonals) = (vec![0; fine], vec![0; fine], vec![0; fine]);
        for y in 0..fine {
            let at = y / 2 * self.side;
            if y % 2 == 0 {
                even(&self.low[at..][..self.side], &mut low, 0);
                even(&self.high[at..][..self.side], &mut high, 1);
            } else {
                let odd_row = (y / 2 % 2) as u32;
                odd(&self.low[at..][..2 * self.side], &mut low, &mut diagonals, odd_row, 0);
                odd(&self.high[at..][..2 * self.side], &mut high, &mut diagonals, odd_row, 1);
            }
            self.settle(ground, between, y, &mut low, &mut high);
            take(y, &low, &high);
        }
    }

    /// Posts of a row between those of the lattice that have come or may have.
    fn settle(&self, ground: &Ground, between: Between, y: usize, low: &mut [i32], high: &mut [i32]) {
        let step = self.step / 2;
        let from = y * step * ground.side;
        let n = low.len();
        match (between, y % 2) {
            (Between::SomeCentres, 1) | (Between::SomeEdges, 0) => widen(low, high, ground, from, step, 1),
            (Between::SomeEdges | Between::Centres, 1) => {
                if between == Between::SomeEdges {
                    widen(low, high, ground, from, step, 0);
                }
                for x in (1..n).step_by(2) {
                    low[x] = ground.low[from + x * step];
                    high[x] = ground.high[from + x * step];
                }
            }
            _ => {}
        }
        if !ground.status.is_empty() {
            let (first, every) = if y.is_multiple_of(2) { (1, 2) } else { (0, 1) };
            for x in (first..n).step_by(every) {
                let at = from + x * step;
                if ground.status[at] == Status::Given {
                    low[x] = ground.low[at];
                    high[x] = ground.high[at];
                }
            }
        }
    }
}

/// Every second post of a row from `first` may be what it was decoded to.
fn widen(low: &mut [i32], high: &mut [i32], ground: &Ground, from: usize, step: usize, first: usize) {
    for x in (first..low.len()).step_by(2) {
        let at = from + x * step;
        low[x] = low[x].min(ground.low[at]);
        high[x] = high[x].max(ground.high[at]);
    }
}

/// A row of the lattice and the midpoints between its posts, `up` by one 16th where they are halves of one.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn even(row: &[i32], out: &mut [i32], up: i32) {
    let n = row.len() - 1;
    for (two, (a, b)) in out.chunks_exact_mut(2).zip(row.iter().zip(&row[1..])) {
        two[0] = *a;
        two[1] = (a + b + up) >> 1;
    }
    out[2 * n] = row[n];
}

/// The row between two of the lattice, which follow each other in `rows`: midpoints of sides and of the diagonals that are
/// hypotenuses (specification, section 1).
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2", "x86_64+sse4.1"))]
fn odd(rows: &[i32], out: &mut [i32], diagonals: &mut [i32], row_is_odd: u32, up: i32) {
    let n = rows.len() / 2 - 1;
    let (top, bottom) = rows.split_at(n + 1);
    let diagonals = &mut diagonals[..n];
    let (left, right) = (top[..n].iter().zip(&bottom[..n]), top[1..].iter().zip(&bottom[1..]));
    for (j, (m, ((a, c), (b, d)))) in diagonals.iter_mut().zip(left.zip(right)).enumerate() {
        let (main, anti) = (a + d, b + c);
        *m = (if (j as u32 ^ row_is_odd) & 1 == 0 { main } else { anti } + up) >> 1;
    }
    for (two, (m, (a, c))) in out.chunks_exact_mut(2).zip(diagonals.iter().zip(top.iter().zip(bottom))) {
        two[0] = (a + c + up) >> 1;
        two[1] = *m;
    }
    out[2 * n] = (top[n] + bottom[n] + up) >> 1;
}
