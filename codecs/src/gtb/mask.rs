//! The mask of voids: on the same lattice, before the heights.

use super::field::{Field, Status};
use super::header::Header;
use crate::lattice::{Kind, Lattice, Pass, Post};
use crate::mixing::{self, Count, Weights};
use crate::range::Coder;

/// Posts whose marks are looked at: four nearest, eight outer ones, all of earlier passes; four of the own pass.
const POSTS: usize = 16;
/// Marks of the outer eight.
const OUTER: usize = 0xff0;
/// Contexts: the nearest, the own pass's and two outer ones by the group of the pass; the nearest and outer ones; the nearest and the own
/// pass's by pass.
const TABLES: [usize; 3] = [1024 * 8, 4096 * 2, 256 * 26];

/// Codes which posts of the grid are voids and notes them in the field. Returns `false` if the bytes end before.
///
/// From coarse to fine, each post by the marks around it. Where all of them are the same, one probability of the pass is enough. Posts
/// outside the grid count as voids, those outside the lattice as what lies opposite: it is mirrored at its border.
pub(super) fn code<C: Coder>(header: &Header, field: &mut Field, void: Option<&[bool]>, c: &mut C) -> bool {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let mut models = Models::new();
    for [y, x] in lattice.corners() {
        let at = y * side + x;
        if field.status(at) == Status::Coded {
            let bit = void.is_some_and(|v| v[y * header.cols + x]);
            if c.bit(1 << 15, bit) {
                field.status[at] = Status::Free;
            }
        }
    }
    for (number, pass) in lattice.passes().enumerate() {
        let reach = Reach::new(lattice, pass);
        for y in pass.rows(lattice).take_while(|y| *y < header.rows) {
            for x in pass.columns(lattice, y).take_while(|x| *x < header.cols) {
                let at = y * side + x;
                if field.status[at] != Status::Coded {
                    continue;
                }
                let marks = reach.marks(&field.status, [y, x]);
                let bit = void.is_some_and(|v| v[y * header.cols + x]);
                if models.code(c, number, pass, marks, bit) {
                    field.status[at] = Status::Free;
                }
                if c.ended() {
                    return false;
                }
            }
        }
    }
    !c.ended()
}

/// What is learnt of marks.
struct Models {
    /// Of a pass: all marks around are void; none is.
    same: [[Count; 2]; 26],
    counts: Vec<Count>,
    weights: [[Weights<3>; 5]; 2],
}

impl Models {
    fn new() -> Models {
        Models {
            same: [[Count::NEW; 2]; 26],
            counts: vec![Count::NEW; TABLES.iter().sum()],
            weights: [[Weights::new(); 5]; 2],
        }
    }

    #[inline(always)]
    fn code<C: Coder>(&mut self, c: &mut C, number: usize, pass: Pass, marks: usize, bit: bool) -> bool {
        if marks == 0 || marks == (1 << POSTS) - 1 {
            return self.same[number][usize::from(marks == 0)].code(c, bit);
        }
        let edges = usize::from(pass.kind == Kind::Edges);
        let size = pass.step.ilog2().min(3) as usize;
        let (near, own) = (marks & 15, marks >> 12);
        let contexts = [
            (size * 2 + edges) << 10 | (marks >> 4 & 3) << 8 | own << 4 | near,
            TABLES[0] + (edges << 12 | marks & 15 | marks & OUTER),
            TABLES[0] + TABLES[1] + (number << 8 | own << 4 | near),
        ];
        let weights = &mut self.weights[edges][near.count_ones() as usize];
        mixing::code(c, &mut self.counts, contexts, weights, bit)
    }
}

/// Offsets of the posts that are looked at.
struct Reach {
    last: isize,
    side: usize,
    away: [[isize; 2]; POSTS],
    /// The same in the raster of the lattice.
    flat: [isize; POSTS],
    /// Posts at least so far from the border see no mirror.
    inner: isize,
}

impl Reach {
    fn new(lattice: Lattice, pass: Pass) -> Reach {
        let s = pass.step as isize;
        #[rustfmt::skip]
        let away: [[isize; 2]; POSTS] = match pass.kind {
            Kind::Centres => [
                [-1, -1], [-1, 1], [1, -1], [1, 1],
                [3, 1], [1, 3], [3, -1], [-1, 3], [1, -3], [-3, 1], [-1, -3], [-3, -1],
                [0, -2], [-2, 0], [-2, -2], [-2, 2],
            ],
            Kind::Edges => [
                [-1, 0], [0, -1], [0, 1], [1, 0],
                [2, 1], [1, 2], [2, -1], [-1, 2], [1, -2], [-2, 1], [-1, -2], [-2, -1],
                [-1, -1], [-1, 1], [0, -2], [-2, 0],
            ],
        };
        let away = away.map(|[y, x]| [y * s, x * s]);
        let side = lattice.side();
        let flat = away.map(|[y, x]| y * side as isize + x);
        Reach { last: lattice.last() as isize, side, away, flat, inner: 3 * s }
    }

    /// The marks around a post, the first in the lowest bit.
    #[inline(always)]
    fn marks(&self, status: &[Status], [y, x]: Post) -> usize {
        let (v, u) = (y as isize, x as isize);
        let inside = self.inner..=self.last - self.inner;
        let mark = |at: usize, k: usize| usize::from(status[at] == Status::Free) << k;
        if inside.contains(&v) && inside.contains(&u) {
            let at = y * self.side + x;
            (0..POSTS).map(|k| mark(at.wrapping_add_signed(self.flat[k]), k)).sum()
        } else {
            let mirror =
                |v: isize| if v.abs() > self.last { 2 * self.last - v.abs() } else { v }.unsigned_abs();
            let at = |[dy, dx]: [isize; 2]| mirror(v + dy) * self.side + mirror(u + dx);
            self.away.iter().enumerate().map(|(k, away)| mark(at(*away), k)).sum()
        }
    }
}
