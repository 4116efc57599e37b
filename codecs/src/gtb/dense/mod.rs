//! Stream G2: every post, within a bound, from coarse to fine (specification of GTB, section 5).

use super::companion::Companion;
use super::encode::Profile;
use super::field::{Field, Status};
use super::header::Header;
use crate::Result;
use crate::range::Coder;
use std::cell::Cell;

mod adaptive;
pub(super) mod corners;
mod cubic;
mod planes;
mod predict;
mod refine;
mod residual;

/// Where a stream was left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reached {
    /// The layer that was at work; their number when all are whole.
    pub layer: usize,
    /// Passes of it that are whole.
    pub passes: u32,
    /// Posts of the next pass that are known, in raster order.
    pub posts: usize,
    /// Whether the corners are known: without them there is no surface.
    pub corners: bool,
}

impl Reached {
    /// Nothing yet.
    pub const NOTHING: Reached = Reached { layer: 0, passes: 0, posts: 0, corners: false };
}

/// Told of each pass that is whole, of a layer, by number: `false` stops there.
pub(super) type Mark<'a, C> = &'a mut dyn FnMut(usize, u32, &C) -> Result<bool>;

/// Both directions: an encoder gives the heights of the lattice as `source`, a decoder finds them in the field. `whole` is told of each
/// layer that is whole, by number.
pub(super) fn code<C: Coder, T: Companion<C>>(
    header: &Header,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    companion: &mut T,
    mark: Mark<C>,
    whole: &mut dyn FnMut(usize, &Field),
) -> Result<Reached> {
    if !corners::code(header, source, field, c) {
        return Ok(Reached::NOTHING);
    }
    let stopped = Cell::new(false);
    let mut watched = |layer: usize, number: u32, c: &C| {
        let on = mark(layer, number, c)?;
        stopped.set(!on);
        Ok(on)
    };
    let first = match header.profile {
        Profile::Adaptive => adaptive::code(header, source, field, c, companion, &mut watched)?,
        _ => cubic::code(header, source, field, c, companion, &mut watched)?,
    };
    if first.passes < 2 * header.lattice.n() || c.ended() || stopped.get() && T::ACTIVE {
        return Ok(first);
    }
    companion.finish(c);
    if c.ended() {
        return Ok(first);
    }
    let mut reached = Reached { layer: 1, passes: 0, posts: 0, corners: true };
    whole(0, field);
    let mut models = None;
    for layer in 1..header.layers.len() {
        if stopped.get() {
            break;
        }
        reached = refine::code(header, layer, source, field, c, &mut watched, &mut models)?;
        if reached.layer == layer {
            break;
        }
        whole(layer, field);
    }
    Ok(reached)
}

/// A height as the receiver of a layer of bound `e` has it, for a prediction `base`, and its number of steps from there
/// (specification, section 5).
#[inline(always)]
pub(super) fn quantize(z: i32, base: i32, e: u32) -> i32 {
    let step = 2 * e as i32 + 1;
    (z.wrapping_sub(base).wrapping_add(e as i32)).div_euclid(step)
}

/// Whether a post's height travels.
#[inline(always)]
fn is_coded(field: &Field, at: usize) -> bool {
    field.status.is_empty() || field.status[at] == Status::Coded
}
