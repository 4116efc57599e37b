//! The triangles of a selection of posts: closure, count, triangles, strips (specification of GTB, section 2).
//!
//! A triangle of the tree is an apex and the two ends of its hypotenuse. It is split where the post in the middle of the
//! hypotenuse is *needed*. A post is needed if it is selected, or if it is an apex of a needed post: so the triangles on both
//! sides of an edge agree, and no crack opens. Posts that are needed but not selected are *fictitious*: they take the midpoint of
//! their hypotenuse ([`surface::fill`](super::surface::fill)), so they change the triangles and never the surface.
//!
//! A post is a number here: `row * side + column`. Corners are always needed.

use super::strips;
use crate::lattice::{Lattice, Post};

/// Marks every needed post: the closure of `selected` (`side * side` marks, corners may be left out).
///
/// One pass over the posts, fine to coarse; one byte a post.
pub fn needed(lattice: Lattice, selected: &[bool]) -> Vec<bool> {
    let side = lattice.side();
    let mut needed = selected.to_vec();
    lattice.corners().into_iter().for_each(|[y, x]| needed[y * side + x] = true);
    for pass in lattice.passes().rev() {
        for post in pass.posts(lattice) {
            if needed[post[0] * side + post[1]] {
                let (_, apexes) = pass.parents(lattice, post);
                apexes.into_iter().flatten().for_each(|[y, x]| needed[y * side + x] = true);
            }
        }
    }
    needed
}

/// Marks the posts whose height is not the midpoint of their hypotenuse: the smallest selection with exactly the surface `z`
/// (`side * side` heights; a void that is not a number is not marked). One pass over the posts.
pub fn bent(lattice: Lattice, z: &[f64]) -> Vec<bool> {
    let side = lattice.side();
    let mut bent = vec![false; side * side];
    for pass in lattice.passes() {
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            let ([a, b], _) = pass.parents(lattice, post);
            let middle = (z[a[0] * side + a[1]] + z[b[0] * side + b[1]]) / 2.0;
            bent[at] = z[at] != middle && !z[at].is_nan();
        }
    }
    bent
}

/// How many triangles a closure has: 2, and 2 more for each inner needed post, 1 for each on the border.
pub fn count(lattice: Lattice, needed: &[bool]) -> u64 {
    let side = lattice.side();
    let in_row = |row: &[bool]| row.iter().filter(|n| **n).count() as u64;
    let all: u64 = needed.chunks_exact(side).map(in_row).sum();
    let [north, south] = [0, side - 1].map(|y| in_row(&needed[y * side..][..side]));
    let across = (1..side - 1).map(|y| u64::from(needed[y * side]) + u64::from(needed[y * side + side - 1]));
    let border = north + south + across.sum::<u64>();
    2 + 2 * (all - border) + (border - 4)
}

/// The triangles of a closure, three posts each, root by root along the curve of Sierpinski: each shares an edge with the next
/// of its root.
///
/// All run counter-clockwise as seen from above with columns to the east and rows to the south. Linear in the triangles; the stack
/// holds at most 2n + 1 of them.
pub fn triangles(lattice: Lattice, needed: &[bool]) -> Vec<[u32; 3]> {
    let mut out = Vec::with_capacity(count(lattice, needed) as usize);
    for root in roots(lattice) {
        walk(lattice, needed, root, |t| out.push(t));
    }
    out
}

/// The triangles as strips, one of each root, for `TRIANGLE_STRIP`: each post from the third on closes a triangle with the two
/// before it, of the odd ones these two change places. A post that is there twice in three makes none: the strip turns.
///
/// 1.45 posts a triangle and less on selections of terrain, measured. The orientation is that of [`triangles`]. Linear; 24 bytes a
/// triangle and 4 a post of the lattice while it works.
pub fn strips(lattice: Lattice, needed: &[bool]) -> Vec<Vec<u32>> {
    let strip = |root| {
        let mut triangles = Vec::new();
        walk(lattice, needed, root, |t| triangles.push(t));
        strips::strip(lattice.side() * lattice.side(), &triangles)
    };
    roots(lattice).map(strip).to_vec()
}

/// Some of the [`triangles`] as one strip, as [`strips`] makes them: those that are drawn where posts lack data.
pub fn strip(lattice: Lattice, triangles: &[[u32; 3]]) -> Vec<u32> {
    strips::strip(lattice.side() * lattice.side(), triangles)
}

/// Apex, and the ends of the hypotenuse: counter-clockwise.
type Triangle = [Post; 3];

/// The two triangles on the diagonal from north-west to south-east.
fn roots(lattice: Lattice) -> [Triangle; 2] {
    let n = lattice.last();
    [[[0, n], [0, 0], [n, n]], [[n, 0], [n, n], [0, 0]]]
}

/// Visits the triangles below a root that are not split. Which child comes first alternates from level to level, so that the
/// second begins where the first ends.
fn walk(lattice: Lattice, needed: &[bool], root: Triangle, mut visit: impl FnMut([u32; 3])) {
    let number = |[y, x]: Post| y * lattice.side() + x;
    let mut stack = vec![(root, false)];
    while let Some((triangle, turned)) = stack.pop() {
        let [apex, a, b] = triangle;
        let middle = [a[0] + b[0], a[1] + b[1]];
        let splits = (middle[0] | middle[1]) & 1 == 0 && needed[number(middle.map(|v| v / 2))];
        if !splits {
            visit(triangle.map(|p| number(p) as u32));
            continue;
        }
        let middle = middle.map(|v| v / 2);
        let (first, second) = ([middle, apex, a], [middle, b, apex]);
        let (first, second) = if turned { (second, first) } else { (first, second) };
        stack.push((second, !turned));
        stack.push((first, !turned));
    }
}
