//! Layers: each refines every height inside the interval that the one before left (specification, section 5).
//!
//! Posts come in the order of the first layer: corners, then passes from coarse to fine. What a post's digit will be is guessed
//! from posts that are refined already (coarser ones, and to the west and north of its own pass) and from those that are not.

mod around;
mod digits;

use super::super::field::Field;
use super::super::header::Header;
use super::{Mark, Reached, is_coded};
use crate::Result;
use crate::range::Coder;
use around::Reach;
pub(super) use digits::Digits;

/// Codes one further layer; the next one is reached if all of it is there. A prefix that ends in it has the posts before at the
/// layer's bound, the others at the one before.
pub(super) fn code<C: Coder>(
    header: &Header,
    layer: usize,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    mark: Mark<C>,
    models: &mut Option<Digits>,
) -> Result<Reached> {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let bounds = (header.layers[layer - 1], header.layers[layer]);
    let digits = match models.take() {
        Some(models) => models.next(bounds.0, bounds.1),
        None => Digits::new(bounds.0, bounds.1),
    };
    let digits = models.insert(digits);
    // What the first guess was wrong by, in quarters of a unit.
    let mut wrong = vec![0i16; side * side];
    for [y, x] in lattice.corners() {
        let at = y * side + x;
        if field.status(at) != super::Status::Given {
            let d = digits.plain(c, source.map(|z| z[at].wrapping_sub(field.z[at])));
            if c.ended() {
                return Ok(Reached { layer, passes: 0, posts: 0, corners: true });
            }
            field.z[at] = field.z[at].wrapping_add(d);
        }
    }
    for (number, pass) in lattice.passes().enumerate() {
        let number = number as u32;
        let reach = Reach::new(lattice, pass);
        for (k, post) in pass.posts(lattice).enumerate() {
            let at = post[0] * side + post[1];
            if !is_coded(field, at) {
                continue;
            }
            let around = reach.look(&field.z, &wrong, post);
            let own = field.z[at];
            let d = digits.code(c, pass, &around, own, source.map(|z| z[at].wrapping_sub(own)));
            if c.ended() {
                return Ok(Reached { layer, passes: number, posts: k, corners: true });
            }
            let z = own.wrapping_add(d);
            field.z[at] = z;
            let r = z.wrapping_mul(32).wrapping_sub(around.guesses[0]) / 8;
            wrong[at] = r.clamp(-32_767, 32_767) as i16;
        }
        if !mark(layer, number, c)? && number + 1 < 2 * lattice.n() {
            return Ok(Reached { layer, passes: number + 1, posts: 0, corners: true });
        }
    }
    Ok(Reached { layer: layer + 1, passes: 0, posts: 0, corners: true })
}
