//! The surface of a prefix at every post: midpoints of hypotenuses where nothing is known (specification of GTB, section 2).
//!
//! Which triangles are drawn is no matter: the midpoint rule is linear interpolation within any triangle that is not split, so
//! one pass from coarse to fine evaluates the surface.

use crate::lattice::Lattice;

/// Fills the posts that are not `known` with the midpoint of their hypotenuse. Exact: 26 bits of height and 26 halvings fit a
/// double. `side * side` each; corners must be known.
pub fn fill(lattice: Lattice, z: &mut [f64], known: impl Fn(usize) -> bool) {
    let side = lattice.side();
    for pass in lattice.passes() {
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            if !known(at) {
                let ([a, b], _) = pass.parents(lattice, post);
                z[at] = (z[a[0] * side + a[1]] + z[b[0] * side + b[1]]) / 2.0;
            }
        }
    }
}
