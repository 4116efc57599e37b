//! The triangles of the texture: the bintree over the cells of a picture, with a class each (specification of GTB, section 6.4).
//!
//! A triangle of depth d has the midpoint of its hypotenuse in pass d of the lattice of the cells' corners; with the apex on one of
//! its two sides that names it. Its children have their right angle at the midpoint.

use crate::lattice::{Lattice, Pass, Post};

/// A triangle: the midpoint of its hypotenuse, and which of the two apexes there is its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// The midpoint.
    pub middle: Post,
    /// 0 or 1, as [`Pass::parents`] tells apexes.
    pub side: usize,
}

/// What is known of the triangles.
pub struct Tree {
    /// The corners of the cells.
    pub lattice: Lattice,
    /// Of each triangle: 0 if it is not there, else [`THERE`], [`OPEN`] and its class.
    state: Vec<u8>,
}

const THERE: u8 = 128;
const OPEN: u8 = 64;
/// Classes at most, with that of cells without a picture.
pub const CLASSES_MAX: usize = 64;

impl Tree {
    /// No triangle yet; `n` is at least 1.
    pub fn new(lattice: Lattice) -> Tree {
        Tree { lattice, state: vec![0; 2 * lattice.side() * lattice.side()] }
    }

    /// The two halves of the square.
    pub fn roots(&self) -> [Triangle; 2] {
        let middle = [self.lattice.last() / 2; 2];
        [0, 1].map(|side| Triangle { middle, side })
    }

    /// The pass that cuts a triangle: its depth.
    pub fn depth(&self, t: Triangle) -> u32 {
        self.lattice.pass_of(t.middle).map_or(0, |p| self.lattice.number(p))
    }

    /// The ends of the hypotenuse and the apex. The triangle must lie in the lattice.
    pub fn corners(&self, t: Triangle) -> ([Post; 2], Post) {
        let pass =
            self.lattice.pass_of(t.middle).unwrap_or(Pass { step: 1, kind: crate::lattice::Kind::Edges });
        let (ends, apexes) = pass.parents(self.lattice, t.middle);
        (ends, apexes[t.side].unwrap_or(t.middle))
    }

    /// Whether the lattice has a triangle on that side.
    pub fn is_inside(&self, pass: Pass, t: Triangle) -> bool {
        pass.parents(self.lattice, t.middle).1[t.side].is_some()
    }

    /// The halves of a triangle: that of the first end of the hypotenuse, then that of the other; `None` at the last depth.
    pub fn children(&self, t: Triangle) -> Option<[Triangle; 2]> {
        if self.depth(t) + 1 >= 2 * self.lattice.n() {
            return None;
        }
        let (ends, apex) = self.corners(t);
        Some(ends.map(|end| {
            let middle = [0, 1].map(|k| (end[k] + apex[k]) / 2);
            let first = self.lattice.pass_of(middle).map(|p| p.parents(self.lattice, middle).1[0]);
            Triangle { middle, side: usize::from(first != Some(Some(t.middle))) }
        }))
    }

    /// Which child holds the centre of a cell; on the edge between them the first.
    pub fn child_of(&self, t: Triangle, [y, x]: Post) -> usize {
        let (ends, _) = self.corners(t);
        let away = |[v, u]: Post| {
            let d = |a: usize, b: usize| (2 * a as i64 - 2 * b as i64 - 1).pow(2);
            d(v, y) + d(u, x)
        };
        usize::from(away(ends[0]) > away(ends[1]))
    }

    /// Which root holds the centre of a cell: that north-east of the diagonal, and on it, is the first.
    pub fn root_of(&self, [y, x]: Post) -> usize {
        usize::from(y > x)
    }

    fn at(&self, t: Triangle) -> usize {
        2 * (t.middle[0] * self.lattice.side() + t.middle[1]) + t.side
    }

    /// Notes the class of a triangle, and whether its children follow.
    pub fn set(&mut self, t: Triangle, class: usize, open: bool) {
        let at = self.at(t);
        self.state[at] = THERE | if open { OPEN } else { 0 } | (class % CLASSES_MAX) as u8;
    }

    /// Class of a triangle and whether its children follow, if it is known.
    pub fn get(&self, t: Triangle) -> Option<(usize, bool)> {
        let s = self.state[self.at(t)];
        (s & THERE != 0).then_some((usize::from(s) % CLASSES_MAX, s & OPEN != 0))
    }

    /// The class of each cell, as far as triangles are known; 0 where none is.
    pub fn labels(&self) -> Vec<u8> {
        let n = self.lattice.last();
        let mut out = vec![0; n * n];
        let cells = (0..n).flat_map(|y| (0..n).map(move |x| [y, x]));
        for (out, cell) in out.iter_mut().zip(cells) {
            let mut t = self.roots()[self.root_of(cell)];
            while let Some((class, open)) = self.get(t) {
                *out = class as u8;
                match self.children(t).filter(|_| open) {
                    Some(children) => t = children[self.child_of(t, cell)],
                    None => break,
                }
            }
        }
        out
    }
}
