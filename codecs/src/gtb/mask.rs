//! The mask of voids: on the same lattice, before the heights.

use super::field::{Field, Status};
use super::header::Header;
use crate::lattice::{Kind, Pass, Post};
use crate::range::{Bit, Coder};

/// Codes which posts of the grid are voids and notes them in the field. Returns `false` if the bytes end before.
///
/// From coarse to fine, each post by the marks of its four nearest known posts, two more of its own pass, and whether those agree
/// farther out. Posts outside count as voids.
pub(super) fn code<C: Coder>(header: &Header, field: &mut Field, void: Option<&[bool]>, c: &mut C) -> bool {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let mut models = vec![Bit::default(); 2 * 14 * 1024];
    // Void, not void; outside the lattice void.
    let mut code = |field: &mut Field, post: Post, pass: Option<Pass>, c: &mut C| {
        let [y, x] = post;
        let at = y * side + x;
        if field.status(at) != Status::Coded {
            return true;
        }
        let context = pass.map_or(0, |pass| context(field, pass, post));
        let bit = void.is_some_and(|v| v[y * header.cols + x]);
        let bit = c.learn(&mut models[context], bit);
        if bit {
            field.status[at] = Status::Free;
        }
        !c.ended()
    };
    for corner in lattice.corners() {
        if !code(field, corner, None, c) {
            return false;
        }
    }
    for pass in lattice.passes() {
        for post in pass.posts(lattice) {
            if !code(field, post, Some(pass), c) {
                return false;
            }
        }
    }
    true
}

/// The marks around a post, as a number: four nearest, west and two north of the pass, four farther known ones.
fn context(field: &Field, pass: Pass, [y, x]: Post) -> usize {
    let side = field.lattice.side();
    let s = pass.step as isize;
    type Away<const N: usize> = [[isize; 2]; N];
    let (near, own, far): (Away<4>, Away<3>, Away<2>) = match pass.kind {
        Kind::Centres => (
            [[-s, -s], [-s, s], [s, -s], [s, s]],
            [[0, -2 * s], [-2 * s, 0], [-2 * s, 2 * s]],
            [[s, 3 * s], [3 * s, s]],
        ),
        Kind::Edges => {
            ([[-s, 0], [s, 0], [0, -s], [0, s]], [[-s, -s], [-s, s], [0, -2 * s]], [[s, 2 * s], [2 * s, s]])
        }
    };
    let mark = |[dy, dx]: [isize; 2]| {
        let (v, u) = (y as isize + dy, x as isize + dx);
        let inside = v >= 0 && u >= 0 && v < side as isize && u < side as isize;
        usize::from(!inside || field.status[v as usize * side + u as usize] == Status::Free)
    };
    let bits = near.into_iter().chain(own).chain(far).fold(0, |n, d| n << 1 | mark(d));
    1 + ((pass.step.trailing_zeros() as usize).min(12) << 10
        | usize::from(pass.kind == Kind::Edges) << 9
        | bits)
}
