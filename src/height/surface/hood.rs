//! v of section 9: how far inside the measured cells of a survey a point is.

use super::Real;
use crate::height::cells::Block;
use crate::height::lod::KERNEL;
use crate::height::patch::Kind;

/// The cells of core' of one level-0 block and of the ring of one cell around it.
#[derive(Clone, Debug, PartialEq)]
pub enum Hood {
    Empty,
    Full,
    /// Bit `a` of row `b`: cell (28 i - 1 + a, 28 j - 1 + b).
    Mixed(Box<[u32; KERNEL as usize + 2]>),
}

impl Hood {
    /// From the block and its eight neighbours, row by row from the lowest indices.
    pub fn of(blocks: &[Block; 9]) -> Hood {
        if blocks.iter().all(|b| *b == Block::FULL) {
            return Hood::Full;
        }
        const K: usize = KERNEL as usize;
        let mut rows = Box::new([0u32; K + 2]);
        for (b, row) in rows.iter_mut().enumerate() {
            let (band, r) = match b {
                0 => (0, K - 1),
                b if b == K + 1 => (2, 0),
                b => (1, b - 1),
            };
            let (w, m, e) = (blocks[band * 3].0[r], blocks[band * 3 + 1].0[r], blocks[band * 3 + 2].0[r]);
            *row = (w >> (K - 1) & 1) | m << 1 | (e & 1) << (K + 1);
        }
        if rows.iter().all(|r| *r == 0) { Hood::Empty } else { Hood::Mixed(rows) }
    }

    #[inline]
    fn has(&self, a: usize, b: usize) -> bool {
        match self {
            Hood::Empty => false,
            Hood::Full => true,
            Hood::Mixed(rows) => rows[b] >> a & 1 == 1,
        }
    }
}

/// 1 - v at a point: `x`, `y` in cells from the block's corner, `0 <= x, y <= 28`. Exactly 0 on core', exactly 1 from
/// one cell away; complements are multiplied, so no digit is lost near core'.
pub fn outside<T: Real>(hood: &Hood, kind: Kind, x: T, y: T) -> T {
    match hood {
        Hood::Empty => return T::constant(1.0),
        Hood::Full => return T::constant(0.0),
        Hood::Mixed(_) => {}
    }
    let last = (KERNEL - 1) as f64;
    let (ci, cj) = (x.value().floor().clamp(0.0, last), y.value().floor().clamp(0.0, last));
    let (fx, fy) = (x - T::constant(ci), y - T::constant(cj));
    let (a, b) = (ci as usize + 1, cj as usize + 1);
    if hood.has(a, b) {
        return T::constant(0.0);
    }
    let one = T::constant(1.0);
    // Complement of the ramp towards a neighbour: 0 on the shared side, 1 one cell away.
    let ease = |t: T| if kind == Kind::Bilinear { t } else { t.ramp(kind) };
    let away_x = [ease(fx), T::constant(0.0), ease(one - fx)];
    let away_y = [ease(fy), T::constant(0.0), ease(one - fy)];
    let mut product = one;
    for (m, ay) in away_y.iter().enumerate() {
        for (k, ax) in away_x.iter().enumerate() {
            if hood.has(a + k - 1, b + m - 1) {
                // 1 - (1 - ax)(1 - ay)
                product = product * (*ax + (one - *ax) * *ay);
            }
        }
    }
    product
}

#[cfg(test)]
mod tests {
    use super::*;

    const LINEAR: Kind = Kind::Bilinear;

    #[test]
    fn v_is_one_on_core_and_fades_over_one_cell() {
        let mut b = Block::EMPTY;
        b.0[10] = 1 << 10;
        let mut blocks = [Block::EMPTY; 9];
        blocks[4] = b;
        let h = Hood::of(&blocks);
        assert_eq!(outside(&h, LINEAR, 10.5, 10.5), 0.0);
        assert_eq!(outside(&h, LINEAR, 11.0, 10.5), 0.0);
        assert_eq!(outside(&h, LINEAR, 11.25, 10.5), 0.25);
        assert_eq!(outside(&h, LINEAR, 12.0, 10.5), 1.0);
        assert_eq!(outside(&h, LINEAR, 11.5, 11.5), 0.75);
        assert_eq!(outside(&h, LINEAR, 20.0, 20.0), 1.0);
    }

    #[test]
    fn neighbours_reach_over_the_border_of_a_block() {
        let mut blocks = [Block::EMPTY; 9];
        blocks[3] = Block::FULL;
        let h = Hood::of(&blocks);
        assert_eq!(outside(&h, LINEAR, 0.0, 5.0), 0.0);
        // On the line between two cells of the neighbour, half a cell away: 1/2 for each of them.
        assert_eq!(outside(&h, LINEAR, 0.5, 5.0), 0.25);
        assert_eq!(outside(&h, LINEAR, 1.5, 5.0), 1.0);
        assert_eq!(Hood::of(&[Block::FULL; 9]), Hood::Full);
        assert_eq!(Hood::of(&[Block::EMPTY; 9]), Hood::Empty);
    }

    #[test]
    fn smooth_ramps_are_zero_on_core_and_nowhere_else() {
        let mut b = Block::EMPTY;
        b.0[10] = 1 << 10;
        let mut blocks = [Block::EMPTY; 9];
        blocks[4] = b;
        let h = Hood::of(&blocks);
        let at = |x: f64, y: f64| outside(&h, Kind::Bicubic, x, y);
        assert_eq!((at(10.5, 10.5), at(11.0, 10.5), at(10.0, 11.0)), (0.0, 0.0, 0.0));
        assert_eq!((at(11.5, 10.5), at(12.0, 10.5), at(11.5, 11.5)), (0.5, 1.0, 0.75));
        let hair = at(11.0 + 1e-9, 10.5);
        assert!(hair > 0.0 && hair < 1.1e-26);
    }
}
