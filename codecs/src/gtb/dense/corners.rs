//! The four corners: differences from one to the next. Exact in the sparse stream, which has steps and no bound.

use super::super::encode::Profile;
use super::super::field::{Field, Status};
use super::super::header::Header;
use super::quantize;
use crate::range::{Bit, Coder};

/// Codes the corners; `false` if the bytes end before.
pub(in super::super) fn code<C: Coder>(
    header: &Header,
    source: Option<&[i32]>,
    field: &mut Field,
    c: &mut C,
) -> bool {
    let side = header.lattice.side();
    let e = if header.profile == Profile::Sparse { 0 } else { header.layers[0] };
    let mut last = 0;
    for [y, x] in header.lattice.corners() {
        let at = y * side + x;
        if field.status(at) == Status::Given {
            last = field.z[at];
            continue;
        }
        // A corner without data carries what lies nearest to it in the grid.
        let q = source.map_or(0, |z| quantize(z[at], last, e));
        let q = number(c, q);
        if c.ended() {
            return false;
        }
        last = last.wrapping_add(q.wrapping_mul(2 * e as i32 + 1));
        field.z[at] = last;
    }
    true
}

/// A signed number: how many bits, the bits, the sign.
fn number<C: Coder>(c: &mut C, v: i32) -> i32 {
    let size = 32 - v.unsigned_abs().leading_zeros();
    let size = c.bits(5, size.min(31));
    if size == 0 {
        return 0;
    }
    let low = c.bits(size - 1, v.unsigned_abs() & ((1 << (size - 1)) - 1));
    let m = (1 << (size - 1) | low) as i32;
    if c.learn(&mut Bit::default(), v < 0) { -m } else { m }
}
