//! What lies around a post: guesses at its height, and how wrong they may be.

use crate::lattice::{Kind, Lattice, Pass, Post};

/// What is known around a post.
pub(super) struct Around {
    /// 32 times its height, as guessed from the posts that its pass was predicted from; from those next to it; and by the mean of
    /// both, corrected by half of what the first was wrong by before it in the pass.
    pub guesses: [i32; 4],
    /// What the first is likely to be wrong by, in 32nds of a unit.
    pub activity: u32,
}

/// Rows and columns from a post.
type Away<const N: usize> = [[isize; 2]; N];

/// The posts looked at: four nearest and eight outer ones of the passes before, four of the own pass that come before; four and eight
/// next to the post.
const POSTS: usize = 48;
/// Twenty posts next to the post.
const SMOOTH: usize = 28;
const OUTER: usize = 4;
const OWN: usize = 12;
const NEXT: usize = 16;
const NEXT_OUTER: usize = 20;

/// The twenty posts within sqrt(5), by distance.
const RINGS: Away<20> = [
    [-1, 0],
    [0, -1],
    [0, 1],
    [1, 0],
    [-1, -1],
    [-1, 1],
    [1, -1],
    [1, 1],
    [-2, 0],
    [0, -2],
    [0, 2],
    [2, 0],
    [-2, -1],
    [-2, 1],
    [-1, -2],
    [-1, 2],
    [1, -2],
    [1, 2],
    [2, -1],
    [2, 1],
];

/// Offsets of neighbours in a pass.
pub(super) struct Reach {
    last: isize,
    side: usize,
    away: Away<POSTS>,
    /// The same in the raster of the lattice.
    flat: [isize; POSTS],
    /// Posts at least so far from the border see no mirror.
    inner: isize,
}

/// The four nearest and eight outer posts whose cubic is the height between them: ten times the near ones less the outer ones is 32
/// times the height (specification, section 5).
const fn around(kind: Kind, s: isize) -> Away<12> {
    match kind {
        Kind::Edges => [
            [-s, 0],
            [0, -s],
            [0, s],
            [s, 0],
            [-s, -2 * s],
            [-s, 2 * s],
            [s, -2 * s],
            [s, 2 * s],
            [-2 * s, -s],
            [-2 * s, s],
            [2 * s, -s],
            [2 * s, s],
        ],
        Kind::Centres => [
            [-s, -s],
            [-s, s],
            [s, -s],
            [s, s],
            [-s, -3 * s],
            [-s, 3 * s],
            [s, -3 * s],
            [s, 3 * s],
            [-3 * s, -s],
            [-3 * s, s],
            [3 * s, -s],
            [3 * s, s],
        ],
    }
}

impl Reach {
    pub fn new(lattice: Lattice, pass: Pass) -> Reach {
        let s = pass.step as isize;
        let own = match pass.kind {
            Kind::Centres => [[0, -2 * s], [-2 * s, 0], [-2 * s, -2 * s], [-2 * s, 2 * s]],
            Kind::Edges => [[0, -2 * s], [-s, -s], [-s, s], [-2 * s, 0]],
        };
        // The last pass has its own four nearest next to it: the diagonal ones are news.
        let next = if s == 1 && pass.kind == Kind::Edges { Kind::Centres } else { Kind::Edges };
        let mut away = [[0; 2]; POSTS];
        away[..OWN].copy_from_slice(&around(pass.kind, s));
        away[OWN..NEXT].copy_from_slice(&own);
        away[NEXT..SMOOTH].copy_from_slice(&around(next, 1));
        away[SMOOTH..POSTS].copy_from_slice(&RINGS);
        let side = lattice.side();
        let flat = away.map(|[y, x]| y * side as isize + x);
        Reach { last: lattice.last() as isize, side, away, flat, inner: 3 * s }
    }

    /// Looks around. Beyond the border the lattice is mirrored at it.
    #[inline(always)]
    pub fn look(&self, z: &[i32], wrong: &[i16], [y, x]: Post) -> Around {
        let (v, u) = (y as isize, x as isize);
        let inside = self.inner..=self.last - self.inner;
        if inside.contains(&v) && inside.contains(&u) {
            let at = y * self.side + x;
            look(z, wrong, |k| at.wrapping_add_signed(self.flat[k]))
        } else {
            self.look_at_the_border(z, wrong, [v, u])
        }
    }

    #[cold]
    fn look_at_the_border(&self, z: &[i32], wrong: &[i16], [y, x]: [isize; 2]) -> Around {
        // Three posts a side: what is mirrored at one border may lie beyond the other.
        let mirror = |v: isize| if v.abs() > self.last { 2 * self.last - v.abs() } else { v }.unsigned_abs();
        look(z, wrong, |k| mirror(y + self.away[k][0]) * self.side + mirror(x + self.away[k][1]))
    }
}

#[inline(always)]
fn look(z: &[i32], wrong: &[i16], at: impl Fn(usize) -> usize) -> Around {
    let cubic = |near: [i32; 4], outer: usize| {
        let sum = near.into_iter().fold(0i32, |a, v| a.wrapping_add(v)).wrapping_mul(10);
        (outer..outer + 8).fold(sum, |a, k| a.wrapping_sub(z[at(k)]))
    };
    let near = [0, 1, 2, 3].map(|k| z[at(k)]);
    let first = cubic(near, OUTER);
    let second = cubic([0, 1, 2, 3].map(|k| z[at(NEXT + k)]), NEXT_OUTER);
    let own_z = near[0];
    let ring = |from: usize, n: usize| {
        (from..from + n).map(|k| i64::from(z[at(SMOOTH + k)].wrapping_sub(own_z))).sum::<i64>()
    };
    let smooth = 208 * ring(0, 4) + 144 * ring(4, 4) + 12 * ring(8, 4) - 54 * ring(12, 8);
    let smooth = own_z.wrapping_mul(32).wrapping_add((smooth >> 5) as i32);
    let own = [0, 1, 2, 3].map(|k| i32::from(wrong[at(OWN + k)]));
    let both = ((i64::from(first) + i64::from(second)) >> 1) as i32;
    let third = both.wrapping_add(own.into_iter().sum());
    let far_wrong: u32 = (0..4).map(|k| u32::from(wrong[at(k)].unsigned_abs())).sum();
    let own_wrong: u32 = own.into_iter().map(i32::unsigned_abs).sum();
    let most = near[0].max(near[1]).max(near[2].max(near[3]));
    let least = near[0].min(near[1]).min(near[2].min(near[3]));
    let spread = most.wrapping_sub(least).max(0) as u32;
    Around {
        guesses: [first, second, third, smooth],
        activity: far_wrong / 2 + own_wrong + spread.min(1 << 20),
    }
}
