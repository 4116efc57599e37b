//! Profile `cubic`: each post predicted from twelve around it, integers alone.

use super::super::companion::Companion;
use super::super::field::Field;
use super::super::header::Header;
use super::residual::{Around, Residuals};
use super::{Mark, Reached, is_coded, quantize};
use crate::Result;
use crate::lattice::{Kind, Pass, Post};
use crate::range::Coder;

/// Codes the passes of the first layer.
pub(super) fn code<C: Coder, T: Companion<C>>(
    header: &Header,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
    companion: &mut T,
    mark: Mark<C>,
) -> Result<Reached> {
    let (lattice, side, e) = (header.lattice, header.lattice.side(), header.layers[0]);
    let step = 2 * e as i32 + 1;
    let mut residuals = Residuals::new(e);
    let mut magnitude = vec![0u16; side * side];
    for (number, pass) in lattice.passes().enumerate() {
        let number = number as u32;
        for (k, post) in pass.posts(lattice).enumerate() {
            let at = post[0] * side + post[1];
            let (p32, around) = predict(field, &magnitude, pass, post);
            let base = (p32 + 16) >> 5;
            if is_coded(field, at) {
                let q = source.map_or(0, |z| quantize(z[at], base, e));
                let q = residuals.code(c, &around, p32 - (base << 5), q);
                if c.ended() {
                    return Ok(Reached { layer: 0, passes: number, posts: k, corners: true });
                }
                field.z[at] = base.wrapping_add(q.wrapping_mul(step));
                let r = (field.z[at].wrapping_mul(32).wrapping_sub(p32)).unsigned_abs() / 8;
                magnitude[at] = r.min(65_535) as u16;
            } else if field.status(at) != super::Status::Given {
                field.z[at] = base;
            }
            if T::ACTIVE {
                companion.after_post(pass, post, c);
                if c.ended() {
                    return Ok(Reached { layer: 0, passes: number, posts: k + 1, corners: true });
                }
            }
        }
        if T::ACTIVE {
            companion.after_pass(pass, c);
        }
        if !mark(0, number, c)? {
            return Ok(Reached { layer: 0, passes: number + 1, posts: 0, corners: true });
        }
    }
    Ok(Reached { layer: 0, passes: 2 * lattice.n(), posts: 0, corners: true })
}

/// 32 times the prediction of a post, and what its residual will be like.
fn predict(field: &Field, magnitude: &[u16], pass: Pass, [y, x]: Post) -> (i32, Around) {
    let side = field.lattice.side();
    let s = pass.step as isize;
    type Away<const N: usize> = [[isize; 2]; N];
    let (near, far, own): (Away<4>, Away<8>, Away<4>) = match pass.kind {
        Kind::Centres => (
            [[-s, -s], [-s, s], [s, -s], [s, s]],
            [
                [-s, -3 * s],
                [-s, 3 * s],
                [s, -3 * s],
                [s, 3 * s],
                [-3 * s, -s],
                [-3 * s, s],
                [3 * s, -s],
                [3 * s, s],
            ],
            [[0, -2 * s], [-2 * s, 0], [-2 * s, -2 * s], [-2 * s, 2 * s]],
        ),
        Kind::Edges => (
            [[-s, 0], [0, -s], [0, s], [s, 0]],
            [
                [-s, -2 * s],
                [-s, 2 * s],
                [s, -2 * s],
                [s, 2 * s],
                [-2 * s, -s],
                [-2 * s, s],
                [2 * s, -s],
                [2 * s, s],
            ],
            [[0, -2 * s], [-s, -s], [-s, s], [-2 * s, 0]],
        ),
    };
    let inside = |[dy, dx]: [isize; 2]| {
        let (v, u) = (y as isize + dy, x as isize + dx);
        (v >= 0 && u >= 0 && v < side as isize && u < side as isize).then(|| v as usize * side + u as usize)
    };
    let mut there = near.iter().filter_map(|d| inside(*d)).map(|k| field.z[k]);
    let first = there.next().unwrap_or(0);
    let (mut sum, mut count, mut least, mut most) = (first, 1, first, first);
    for z in there {
        sum = sum.wrapping_add(z);
        count += 1;
        least = least.min(z);
        most = most.max(z);
    }
    // A missing neighbour counts as the mean of the nearest that exist.
    let mean = |n: i32| (sum.wrapping_mul(n)) / count;
    let mut p32 = 0i32;
    let missing = 4 - count;
    p32 = p32.wrapping_add(sum.wrapping_mul(10)).wrapping_add(mean(10 * missing));
    let mut outer = 0i32;
    let mut missing = 0;
    for d in far {
        match inside(d) {
            Some(k) => outer = outer.wrapping_add(field.z[k]),
            None => missing += 1,
        }
    }
    p32 = p32.wrapping_sub(outer).wrapping_sub(mean(missing));
    let m = |d: [isize; 2]| inside(d).map_or(0, |k| u32::from(magnitude[k]));
    let spread = most.wrapping_sub(least).max(0) as u32;
    (p32, Around { near: near.map(m), own: own.map(m), spread })
}
