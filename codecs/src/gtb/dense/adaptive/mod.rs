//! Profile `adaptive`: each post predicted by least squares that follow the ground, and its height coded with the odds of
//! several experts, mixed by what they have been worth (specification of GTB, section 5).
//!
//! - [`around`]: which posts
//! - [`squares`], [`window`]: least squares of what lies around
//! - [`bells`]: what experts expect; [`mixer`]: their odds become one; [`steps`]: decisions
//! - [`model`]: all of it for a post
//!
//! Single precision with `+ - * /` and roots, in a fixed order: the same bits on every machine. Whatever a decoder is fed,
//! numbers stay finite.

#![allow(clippy::needless_range_loop, reason = "lanes of vectors go by number")]

use super::super::companion::Companion;
use super::super::field::{Field, Status};
use super::super::header::Header;
use super::{Mark, Reached, is_coded};
use crate::Result;
use crate::lattice::Kind;
use crate::range::Coder;

mod around;
mod bells;
mod logit;
mod mixer;
mod model;
mod squares;
mod steps;
mod window;

use around::Places;
use model::{Model, Scene};
use squares::{Row, WIDE};
use window::Window;

/// Posts of a row that share their weights.
const BLOCK: usize = 8;

/// The weights of the cubic: -1/32 on the eight posts behind the nearest four, above the mean of these.
const CUBIC: Row = {
    let mut w = [0.0; WIDE];
    let mut k = 3;
    while k < 11 {
        w[k] = -1.0 / 32.0;
        k += 1;
    }
    w
};

/// Codes the passes of the first layer. Memory: 8 bytes a post with the heights, 300 bytes a column, 2.3 MB.
pub(super) fn code<C: Coder, T: Companion<C>>(
    header: &Header,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    companion: &mut T,
    mark: Mark<C>,
) -> Result<Reached> {
    let (lattice, side) = (header.lattice, header.lattice.side());
    let mut model = Model::new(side, header.layers[0]);
    let mut last: [Option<Window>; 2] = [None, None];
    for (number, pass) in lattice.passes().enumerate() {
        let reached =
            |passes: u32, posts| Reached { layer: 0, passes: number as u32 + passes, posts, corners: true };
        let kind = usize::from(pass.kind == Kind::Edges);
        let blocks = (side / (2 * pass.step) + 1).div_ceil(BLOCK);
        let mut window = Window::new(blocks, last[kind].as_ref(), CUBIC);
        let places = Places::new(side, pass);
        let mut posts = 0;
        model.start_pass();
        for y in pass.rows(lattice) {
            let mut weights = None;
            let mut solved = usize::MAX;
            let mut count = 0;
            for x in pass.columns(lattice, y) {
                let (at, block) = (y * side + x, count / BLOCK);
                if is_coded(field, at) {
                    let weights = weights.get_or_insert_with(|| window.start_row());
                    if solved != block {
                        weights.local = window.around(block);
                        solved = block;
                    }
                    let scene = Scene { pass, post: [y, x], places: &places, weights };
                    model::code(&mut model, &mut window, field, source, c, &scene);
                    if c.ended() {
                        return Ok(reached(0, posts));
                    }
                } else if field.status(at) != Status::Given {
                    let near = places.of([y, x]);
                    let sum: i64 = near[..4].iter().map(|k| i64::from(field.z[*k])).sum();
                    field.z[at] = ((sum + 2) >> 2) as i32;
                }
                posts += 1;
                count += 1;
                if count % BLOCK == 0 && weights.is_some() {
                    window.end_block(block);
                }
                if T::ACTIVE {
                    companion.after_post(pass, [y, x], c);
                    if c.ended() {
                        return Ok(reached(0, posts));
                    }
                }
            }
            // Rows without a coded post leave no trace.
            if weights.is_some() {
                if count % BLOCK != 0 {
                    window.end_block(count / BLOCK);
                }
                window.end_row();
                model.end_row();
            }
        }
        last[kind] = Some(window);
        if T::ACTIVE {
            companion.after_pass(pass, c);
        }
        if !mark(0, number as u32, c)? {
            return Ok(reached(1, 0));
        }
    }
    Ok(Reached { layer: 0, passes: 2 * lattice.n(), posts: 0, corners: true })
}
