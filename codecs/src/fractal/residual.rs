//! What a bounded tile adds to its maps: whole multiples of 2E + 1 (specification section 3).

use super::number::{Numbers, length};
use crate::range::Coder;

/// Codes the multiples row by row, by those before; voids have none. `q` has rows of `stride`, of which `cols` are the tile's. Returns `false` if the
/// bytes end before; what is missing stays 0.
pub(super) fn code<C: Coder>(
    q: &mut [i32],
    stride: usize,
    [cols, rows]: [usize; 2],
    void: &[bool],
    c: &mut C,
) -> bool {
    let mut numbers = Numbers::new([24, 81, 24 * 24]);
    for y in 0..rows {
        for x in 0..cols {
            if void.get(y * cols + x).copied().unwrap_or(false) {
                continue;
            }
            let at = y * stride + x;
            let old = |dx: isize, dy: usize| {
                let inside = y >= dy && (0..cols as isize).contains(&(x as isize + dx));
                if inside { i64::from(q[(at - dy * stride).wrapping_add_signed(dx)]) } else { 0 }
            };
            let (w, n, nw, ne) = (old(-1, 0), old(0, 1), old(-1, 1), old(1, 1));
            let (ww, nn) = (old(-2, 0), old(0, 2));
            let sign = |v: i64| (v.signum() + 1) as usize;
            let contexts = [
                length(2 * w.abs() + 2 * n.abs() + nw.abs() + ne.abs()).min(23),
                ((sign(w) * 3 + sign(n)) * 3 + sign(nw)) * 3 + sign(ne),
                length(w + n).min(23) * 24 + length(ww.abs() + nn.abs() + nw.abs() + ne.abs()).min(23),
            ];
            let value = numbers.code(c, contexts, q[at]);
            if c.ended() {
                return false;
            }
            q[at] = value;
        }
    }
    true
}
