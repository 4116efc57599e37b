//! Sets of level-0 cells, in blocks of 28 x 28: the cells of one level-0 kernel rectangle.

use super::frame::CellRect;
use super::lod::KERNEL;

const K: usize = KERNEL as usize;
const FULL_ROW: u32 = (1 << K) - 1;

/// How much of a rectangle is in a set.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Fill {
    Empty = 0,
    Full = 1,
    Mixed = 2,
}

impl Fill {
    pub fn from_code(code: u8) -> Option<Fill> {
        [Fill::Empty, Fill::Full, Fill::Mixed].into_iter().find(|f| *f as u8 == code)
    }

    /// The fill of a rectangle from the fills of its four quarters.
    pub fn join(quarters: [Fill; 4]) -> Fill {
        if quarters.iter().all(|f| *f == Fill::Full) {
            Fill::Full
        } else if quarters.iter().all(|f| *f == Fill::Empty) {
            Fill::Empty
        } else {
            Fill::Mixed
        }
    }
}

/// The cells of one level-0 kernel rectangle: bit `a` of row `b` is cell (28 i + a, 28 j + b).
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub struct Block(pub [u32; K]);

impl Block {
    pub const EMPTY: Block = Block([0; K]);
    pub const FULL: Block = Block([FULL_ROW; K]);
    /// Bytes on disk.
    pub const BYTES: usize = 4 * K;

    pub fn fill(&self) -> Fill {
        if *self == Block::EMPTY {
            Fill::Empty
        } else if *self == Block::FULL {
            Fill::Full
        } else {
            Fill::Mixed
        }
    }

    pub fn count(&self) -> u32 {
        self.0.iter().map(|r| r.count_ones()).sum()
    }

    pub fn get(&self, a: usize, b: usize) -> bool {
        self.0[b] >> a & 1 == 1
    }

    pub fn clear(&mut self, a: usize, b: usize) {
        self.0[b] &= !(1 << a);
    }

    /// The cells whose 4 x 4 posts around are all valid: core(G) of the block.
    ///
    /// `rows[b]` holds, for posts of row `28 j - 1 + b`, bit `a` = post `28 i - 1 + a` is valid (31 rows of 31 bits).
    pub fn core_of(rows: &[u32; K + 3]) -> Block {
        let mut across = [0u32; K + 3];
        for (out, w) in across.iter_mut().zip(rows) {
            *out = w & (w >> 1) & (w >> 2) & (w >> 3) & FULL_ROW;
        }
        let mut block = Block::EMPTY;
        for (b, row) in block.0.iter_mut().enumerate() {
            *row = across[b] & across[b + 1] & across[b + 2] & across[b + 3];
        }
        block
    }

    /// The set as rectangles of cells (row runs, equal consecutive runs merged), appended to `out`, clipped to `window`.
    pub fn rects(&self, i: i32, j: i32, window: &CellRect, out: &mut Vec<CellRect>) {
        let (ci, cj) = (i64::from(i) * KERNEL, i64::from(j) * KERNEL);
        // Runs still open: (first bit, end bit, first row).
        let mut open: Vec<(u32, u32, usize)> = Vec::new();
        let mut runs: Vec<(u32, u32)> = Vec::new();
        for b in 0..=K {
            runs.clear();
            if b < K {
                let mut w = self.0[b];
                while w != 0 {
                    let s = w.trailing_zeros();
                    let n = (w >> s).trailing_ones();
                    runs.push((s, s + n));
                    w &= !((((1u64 << n) - 1) as u32) << s);
                }
            }
            open.retain(|&(s, e, b0)| {
                if let Some(k) = runs.iter().position(|r| *r == (s, e)) {
                    runs.swap_remove(k);
                    return true;
                }
                let r = CellRect::new(ci + i64::from(s), cj + b0 as i64, ci + i64::from(e), cj + b as i64)
                    .intersect(window);
                if !r.is_empty() {
                    out.push(r);
                }
                false
            });
            open.extend(runs.iter().map(|&(s, e)| (s, e, b)));
        }
    }
}

/// Joins rectangles that share a whole side. Keeps the union and the disjointness; order is canonical.
pub fn merge(rects: &mut Vec<CellRect>) {
    for _ in 0..2 {
        rects.sort_unstable_by_key(|r| (r.j0, r.j1, r.i0));
        rects.dedup_by(|b, a| {
            let join = a.j0 == b.j0 && a.j1 == b.j1 && a.i1 == b.i0;
            if join {
                a.i1 = b.i1;
            }
            join
        });
        rects.sort_unstable_by_key(|r| (r.i0, r.i1, r.j0));
        rects.dedup_by(|b, a| {
            let join = a.i0 == b.i0 && a.i1 == b.i1 && a.j1 == b.j0;
            if join {
                a.j1 = b.j1;
            }
            join
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rects_tile_the_set() {
        let mut b = Block::FULL;
        for (a, r) in [(3, 3), (4, 3), (3, 4), (0, 0), (27, 27), (10, 20)] {
            b.clear(a, r);
        }
        let everything = CellRect::new(-1000, -1000, 1000, 1000);
        let mut rects = Vec::new();
        b.rects(-1, 2, &everything, &mut rects);
        merge(&mut rects);
        let mut seen = Block::EMPTY;
        let mut area = 0;
        for r in &rects {
            area += r.width() * r.height();
            for j in r.j0..r.j1 {
                for i in r.i0..r.i1 {
                    seen.0[(j - 56) as usize] |= 1 << (i + 28);
                }
            }
        }
        assert_eq!(seen, b);
        assert_eq!(area as u32, b.count());
    }

    #[test]
    fn core_needs_sixteen_posts() {
        let mut rows = [(1u32 << 31) - 1; K + 3];
        assert_eq!(Block::core_of(&rows), Block::FULL);
        rows[10] &= !(1 << 12);
        let b = Block::core_of(&rows);
        // Post (12, 10) of the window is a corner of the 4 x 4 posts of cells 9..=12, 7..=10.
        assert_eq!(b.count(), 28 * 28 - 16);
        assert!(!b.get(9, 7) && !b.get(12, 10) && b.get(8, 8) && b.get(13, 10));
    }
}
