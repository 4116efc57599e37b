//! What lies around a post: guesses at its height, and how wrong they may be.

use crate::lattice::{Kind, Lattice, Pass, Post};

/// What is known around a post.
pub(super) struct Around {
    /// 32 times its height, as guessed from the posts that its pass was predicted from, from those next to it, and from both.
    pub guesses: [i32; 3],
    /// What the first is likely to be wrong by, in 32nds of a unit.
    pub activity: u32,
}

type Away<const N: usize> = [[isize; 2]; N];

/// Offsets of neighbours in a pass.
pub(super) struct Reach {
    lattice: Lattice,
    s: isize,
    near: Away<4>,
    far: Away<8>,
    own: Away<4>,
    next: Away<4>,
    next_far: Away<8>,
}

const fn edges(s: isize) -> (Away<4>, Away<8>) {
    (
        [[-s, 0], [0, -s], [0, s], [s, 0]],
        [
            [-s, -2 * s],
            [-s, 2 * s],
            [s, -2 * s],
            [s, 2 * s],
            [-2 * s, -s],
            [-2 * s, s],
            [2 * s, -s],
            [2 * s, s],
        ],
    )
}

const fn centres(s: isize) -> (Away<4>, Away<8>) {
    (
        [[-s, -s], [-s, s], [s, -s], [s, s]],
        [
            [-s, -3 * s],
            [-s, 3 * s],
            [s, -3 * s],
            [s, 3 * s],
            [-3 * s, -s],
            [-3 * s, s],
            [3 * s, -s],
            [3 * s, s],
        ],
    )
}

impl Reach {
    pub fn new(lattice: Lattice, pass: Pass) -> Reach {
        let s = pass.step as isize;
        let ((near, far), own) = match pass.kind {
            Kind::Centres => (centres(s), [[0, -2 * s], [-2 * s, 0], [-2 * s, -2 * s], [-2 * s, 2 * s]]),
            Kind::Edges => (edges(s), [[0, -2 * s], [-s, -s], [-s, s], [-2 * s, 0]]),
        };
        let (next, next_far) = match (pass.step, pass.kind) {
            (1, Kind::Edges) => centres(1),
            _ => edges(1),
        };
        Reach { lattice, s, near, far, own, next, next_far }
    }

    /// Looks around. Beyond the border the lattice is mirrored at it.
    pub fn look(&self, z: &[i32], magnitude: &[u16], [y, x]: Post) -> Around {
        let (side, last) = (self.lattice.side(), self.lattice.last() as isize);
        let (y, x) = (y as isize, x as isize);
        let at = |[dy, dx]: [isize; 2]| {
            let mirror = |v: isize| {
                let v = v.abs();
                if v > last { 2 * last - v } else { v }
            };
            mirror(y + dy) as usize * side + mirror(x + dx) as usize
        };
        let near = self.near.map(|d| z[at(d)]);
        let cubic = |near: [i32; 4], far: [i32; 8]| {
            let sum = near.into_iter().fold(0i32, |a, v| a.wrapping_add(v)).wrapping_mul(10);
            far.into_iter().fold(sum, |a, v| a.wrapping_sub(v))
        };
        let first = cubic(near, self.far.map(|d| z[at(d)]));
        let next = self.next.map(|d| z[at(d)]);
        let second = cubic(next, self.next_far.map(|d| z[at(d)]));
        let _ = self.s;
        let third = ((i64::from(first) + i64::from(second)) >> 1) as i32;
        let m = |d: [isize; 2]| u32::from(magnitude[at(d)]);
        let near_m: u32 = self.near.map(m).iter().sum();
        let own_m: u32 = self.own.map(m).iter().sum();
        let most = near.iter().max().copied().unwrap_or(0);
        let least = near.iter().min().copied().unwrap_or(0);
        let spread = most.wrapping_sub(least).max(0) as u32;
        Around { guesses: [first, second, third], activity: near_m * 2 / 4 + own_m * 4 / 4 + spread.min(1 << 20) }
    }
}
