//! The posts around a post, all known when its turn comes.

use crate::lattice::{Kind, Pass, Post};

/// Steps down and east.
pub(super) type Away = [i32; 2];

/// Neighbours of a kind of pass, in steps: opposite pairs of the nearest are 0 and 3, 1 and 2.
pub(super) struct Around {
    pub near: [Away; 4],
    pub far: [Away; 12],
    /// Of the same pass, known already: first those whose residuals tell most.
    pub own: [Away; 8],
}

pub(super) const CENTRES: Around = Around {
    near: [[-1, -1], [-1, 1], [1, -1], [1, 1]],
    far: [
        [-1, -3],
        [-1, 3],
        [1, -3],
        [1, 3],
        [-3, -1],
        [-3, 1],
        [3, -1],
        [3, 1],
        [-3, -3],
        [-3, 3],
        [3, -3],
        [3, 3],
    ],
    own: [[0, -2], [-2, 0], [-2, -2], [-2, 2], [0, -4], [-4, 0], [-2, -4], [-2, 4]],
};

pub(super) const EDGES: Around = Around {
    near: [[-1, 0], [0, -1], [0, 1], [1, 0]],
    far: [
        [-1, -2],
        [-1, 2],
        [1, -2],
        [1, 2],
        [-2, -1],
        [-2, 1],
        [2, -1],
        [2, 1],
        [-3, 0],
        [3, 0],
        [0, -3],
        [0, 3],
    ],
    own: [[0, -2], [-1, -1], [-1, 1], [-2, 0], [-1, -3], [-1, 3], [-2, -2], [-2, 2]],
};

pub(super) const ALL: usize = 24;

/// Places of the neighbours of posts of one pass.
pub(super) struct Places {
    side: usize,
    step: usize,
    offsets: [isize; ALL],
    away: [Away; ALL],
}

impl Places {
    pub fn new(side: usize, pass: Pass) -> Places {
        let around = match pass.kind {
            Kind::Centres => &CENTRES,
            Kind::Edges => &EDGES,
        };
        let mut away = [[0; 2]; ALL];
        away[..4].copy_from_slice(&around.near);
        away[4..16].copy_from_slice(&around.far);
        away[16..].copy_from_slice(&around.own);
        let s = pass.step as isize;
        let offsets = away.map(|[dy, dx]| s * (dy as isize * side as isize + dx as isize));
        Places { side, step: pass.step, offsets, away }
    }

    /// Nearest, farther, own; beyond the border posts of other passes are mirrored, of the pass the first stands in.
    #[inline(always)]
    pub fn of(&self, [y, x]: Post) -> [usize; ALL] {
        let at = y * self.side + x;
        let margin = 4 * self.step;
        let last = self.side - 1;
        if y >= margin && x >= margin && y + margin <= last && x + margin <= last {
            return self.offsets.map(|o| at.wrapping_add_signed(o));
        }
        let mut out = [0; ALL];
        for (k, [dy, dx]) in self.away.iter().enumerate() {
            let (s, end) = (self.step as isize, last as isize);
            let (v, u) = (y as isize + *dy as isize * s, x as isize + *dx as isize * s);
            let mirror = |v: isize| {
                let v = v.abs();
                if v > end { (2 * end - v).abs() } else { v }
            };
            let (mv, mu) = (mirror(v), mirror(u));
            out[k] =
                if k >= 16 && (mv, mu) != (v, u) { out[0] } else { mv as usize * self.side + mu as usize };
        }
        out
    }
}
