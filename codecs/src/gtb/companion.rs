//! What travels between the heights (specification of GTB, section 6.6): after each post the codes of the texture triangles that
//! the post makes.

use crate::lattice::{Lattice, Pass, Post};
use crate::range::Coder;

/// Takes its turns in the stream of heights; the same calls in the same order on both sides.
pub trait Companion<C: Coder> {
    /// `false` lets the loops over posts leave the calls out.
    const ACTIVE: bool = true;

    /// n of the cells of the texture that it writes or reads; `None`: none. A stream whose head says otherwise is refused: what the
    /// companion does not take would be read as heights.
    fn texture(&self) -> Option<u32> {
        None
    }

    /// Once, before the corners.
    fn start(&mut self, _lattice: Lattice, _c: &mut C) {}

    /// After a post of the first layer; its two triangles are cut in two where it lies.
    fn after_post(&mut self, _pass: Pass, _post: Post, _c: &mut C) {}

    /// After the last post of a pass of the first layer.
    fn after_pass(&mut self, _pass: Pass, _c: &mut C) {}

    /// After the first layer: all that is left.
    fn finish(&mut self, _c: &mut C) {}
}

/// Heights alone.
pub struct Alone;

impl<C: Coder> Companion<C> for Alone {
    const ACTIVE: bool = false;
}
