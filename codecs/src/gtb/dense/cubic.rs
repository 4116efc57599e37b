//! Profile `cubic`: each post predicted from twelve around it, integers alone.

use super::super::companion::Companion;
use super::super::field::{Field, Status};
use super::super::header::Header;
use super::planes::Planes;
use super::predict::{Guess, MAGNITUDE_MAX, OWN, Row, predict};
use super::residual::Residuals;
use super::{Mark, Reached, quantize};
use crate::Result;
use crate::lattice::{Kind, Pass};
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
    let (lattice, side) = (header.lattice, header.lattice.side());
    let corners = lattice.corners().map(|[y, x]| field.z[y * side + x]);
    let mut work = Work {
        z: Planes::new(corners),
        magnitudes: Planes::new([0; 4]),
        residuals: Residuals::new(header.layers[0]),
        guess: Guess::default(),
        e: header.layers[0],
    };
    let mut reached = Reached { corners: true, ..Reached::NOTHING };
    for (number, pass) in lattice.passes().enumerate() {
        if number > 0 && pass.kind == Kind::Centres {
            work.z = work.z.finer();
            work.magnitudes = work.magnitudes.finer();
        }
        let posts = work.pass(pass, source, field, c, companion);
        let whole = !c.ended();
        reached.passes = number as u32 + u32::from(whole);
        reached.posts = if whole { 0 } else { posts };
        if !whole {
            break;
        }
        if T::ACTIVE {
            companion.after_pass(pass, c);
        }
        if !mark(0, number as u32, c)? {
            break;
        }
    }
    let Work { z, magnitudes, .. } = work;
    drop(magnitudes);
    // A lattice of corners alone has no step.
    if lattice.n() > 0 {
        z.write(lattice, &mut field.z);
    }
    Ok(reached)
}

struct Work {
    z: Planes<i32>,
    /// Of residuals, in quarters of a unit.
    magnitudes: Planes<u16>,
    residuals: Residuals,
    guess: Guess,
    e: u32,
}

impl Work {
    /// Codes a pass; returns the posts of it that are known.
    fn pass<C: Coder, T: Companion<C>>(
        &mut self,
        pass: Pass,
        source: Option<&[i32]>,
        field: &Field,
        c: &mut C,
        companion: &mut T,
    ) -> usize {
        let mut posts = 0;
        for (k, y) in pass.rows(field.lattice).enumerate() {
            let row = match pass.kind {
                Kind::Centres => Row::Centres(k),
                Kind::Edges if k % 2 == 0 => Row::Even(k / 2),
                Kind::Edges => Row::Odd(k / 2),
            };
            predict(&self.z, &self.magnitudes, row, &mut self.guess);
            posts += if field.status.is_empty() {
                self.row::<C, T, false>(pass, row, y, source, field, c, companion)
            } else {
                self.row::<C, T, true>(pass, row, y, source, field, c, companion)
            };
            if c.ended() {
                break;
            }
        }
        posts
    }

    /// Codes a row that is predicted; returns the posts of it that are known.
    #[allow(clippy::too_many_arguments)]
    fn row<C: Coder, T: Companion<C>, const SKIPS: bool>(
        &mut self,
        pass: Pass,
        row: Row,
        y: usize,
        source: Option<&[i32]>,
        field: &Field,
        c: &mut C,
        companion: &mut T,
    ) -> usize {
        let (z, r) = match row {
            Row::Centres(i) => (self.z.c.row_mut(i), self.magnitudes.c.row_mut(i)),
            Row::Even(i) => (self.z.h.row_mut(i), self.magnitudes.h.row_mut(i)),
            Row::Odd(i) => (self.z.v.row_mut(i), self.magnitudes.v.row_mut(i)),
        };
        let n = z.len();
        let (p32, still, r) = (&self.guess.p32[..n], &self.guess.still[..n], &mut r[..n]);
        let (e, step) = (self.e, 2 * self.e as i32 + 1);
        let first = if matches!(row, Row::Odd(_)) { 0 } else { pass.step };
        let mut west = 0;
        for j in 0..n {
            let base = p32[j].wrapping_add(16) >> 5;
            let x = first + 2 * pass.step * j;
            let at = y * field.lattice.side() + x;
            if SKIPS && field.status[at] != Status::Coded {
                z[j] = if field.status[at] == Status::Given { field.z[at] } else { base };
                west = 0;
            } else {
                let part = p32[j].wrapping_sub(base << 5);
                let q = source.map_or(0, |s| quantize(s[at], base, e));
                let q = self.residuals.code(c, still[j].wrapping_add(west * OWN), part, q);
                if c.ended() {
                    return j;
                }
                let height = base.wrapping_add(q.wrapping_mul(step));
                z[j] = height;
                west = (height.wrapping_mul(32).wrapping_sub(p32[j]).unsigned_abs() / 8).min(MAGNITUDE_MAX);
                r[j] = west as u16;
            }
            if T::ACTIVE {
                companion.after_post(pass, [y, x], c);
                if c.ended() {
                    return j + 1;
                }
            }
        }
        n
    }
}
