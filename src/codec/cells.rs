//! Sets of level-0 cells over a square of places: a quadtree of full, empty and mixed parts, drawn in `docs/payload.md`.

use super::bits::{BitReader, BitWriter};
use crate::base::{Error, Result};
use crate::height::cells::{Block, Fill};
use crate::height::lod::KERNEL;

/// Cells across a leaf of the tree: a quarter of a place.
const LEAF: usize = KERNEL as usize / 4;
/// The largest square, as a level: 16 x 16 places. Larger ones travel in parts, or as wholly full.
pub const LEVEL_MAX: u8 = 4;
/// More bytes than any square packs to.
pub const BYTES_MAX: usize = 1 << 16;

/// The places of a square, row by row; `1 << level` of them in a row.
pub type Places = Vec<Block>;

/// Packs a square of places, of a level of at most [`LEVEL_MAX`]. Empty if every cell is in the set.
pub fn pack(level: u8, places: &[Block]) -> Vec<u8> {
    let side = 1 << level;
    assert!(level <= LEVEL_MAX && places.len() == side * side, "a square of places of level {level}");
    if places.iter().all(|b| *b == Block::FULL) {
        return Vec::new();
    }
    let mut w = BitWriter::default();
    put(&mut w, &Square { side, places }, 0, 0, side * KERNEL as usize);
    w.end()
}

struct Square<'a> {
    side: usize,
    places: &'a [Block],
}

impl Square<'_> {
    fn row(&self, x: usize, y: usize, cells: usize) -> u32 {
        const K: usize = KERNEL as usize;
        let row = self.places[y / K * self.side + x / K].0[y % K];
        row >> (x % K) & ((1 << cells) - 1)
    }

    /// How full a square of cells is, its corner at (x, y).
    fn fill(&self, x: usize, y: usize, cells: usize) -> Fill {
        const K: usize = KERNEL as usize;
        let mut found: Option<Fill> = None;
        let wide = cells.min(K);
        for y in y..y + cells {
            for x in (x..x + cells).step_by(wide) {
                let now = match self.row(x, y, wide) {
                    0 => Fill::Empty,
                    r if r == (1 << wide) - 1 => Fill::Full,
                    _ => return Fill::Mixed,
                };
                if *found.get_or_insert(now) != now {
                    return Fill::Mixed;
                }
            }
        }
        found.unwrap_or(Fill::Empty)
    }
}

/// Empty: 0; full: 1 0; mixed: 1 1, then the four quarters, or the cells of a leaf row by row.
fn put(w: &mut BitWriter, square: &Square, x: usize, y: usize, cells: usize) {
    match square.fill(x, y, cells) {
        Fill::Empty => w.put(0, 1),
        Fill::Full => w.put(0b10, 2),
        Fill::Mixed => {
            w.put(0b11, 2);
            if cells == LEAF {
                for b in 0..LEAF {
                    let row = square.row(x, y + b, LEAF);
                    (0..LEAF).for_each(|a| w.put(u64::from(row >> a & 1), 1));
                }
                return;
            }
            let half = cells / 2;
            for (a, b) in [(0, 0), (half, 0), (0, half), (half, half)] {
                put(w, square, x + a, y + b, half);
            }
        }
    }
}

/// Unpacks a square of places of a level.
///
/// # Errors
/// If the bytes are none that [`pack`] makes, or the level is above [`LEVEL_MAX`] and not every cell is in the set.
pub fn unpack(level: u8, bytes: &[u8]) -> Result<Places> {
    if level > LEVEL_MAX || bytes.len() > BYTES_MAX {
        let what = format!("{} bytes for a square of level {level}", bytes.len());
        return Err(Error::corrupt("mask", "cells", what));
    }
    let side = 1usize << level;
    let mut places = vec![Block::EMPTY; side * side];
    if bytes.is_empty() {
        places.fill(Block::FULL);
        return Ok(places);
    }
    let mut r = BitReader::new(bytes);
    take(&mut r, &mut places, side, 0, 0, side * KERNEL as usize)?;
    r.end()?;
    Ok(places)
}

fn take(
    r: &mut BitReader,
    places: &mut [Block],
    side: usize,
    x: usize,
    y: usize,
    cells: usize,
) -> Result<()> {
    const K: usize = KERNEL as usize;
    if r.take(1)? == 0 {
        return Ok(());
    }
    if r.take(1)? == 0 {
        let wide = cells.min(K);
        for y in y..y + cells {
            for x in (x..x + cells).step_by(wide) {
                places[y / K * side + x / K].0[y % K] |= ((1 << wide) - 1) << (x % K);
            }
        }
        return Ok(());
    }
    if cells == LEAF {
        for b in y..y + LEAF {
            for a in x..x + LEAF {
                places[b / K * side + a / K].0[b % K] |= (r.take(1)? as u32) << (a % K);
            }
        }
        return Ok(());
    }
    let half = cells / 2;
    for (a, b) in [(0, 0), (half, 0), (0, half), (half, half)] {
        take(r, places, side, x + a, y + b, half)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cells below a slanted line, with a hole.
    fn slanted(level: u8) -> Places {
        let side = 1usize << level;
        let mut places = vec![Block::EMPTY; side * side];
        let n = side * KERNEL as usize;
        for y in 0..n {
            for x in 0..n {
                if 3 * x + 7 * y < 5 * n && (x, y) != (2, 1) {
                    places[y / 28 * side + x / 28].0[y % 28] |= 1 << (x % 28);
                }
            }
        }
        places
    }

    #[test]
    fn squares_come_back() {
        for level in 0..=LEVEL_MAX {
            let places = slanted(level);
            let bytes = pack(level, &places);
            assert_eq!(unpack(level, &bytes).unwrap(), places);
            assert!(bytes.len() < 120 << level, "{level}: {}", bytes.len());
        }
        let full = vec![Block::FULL; 16];
        assert!(pack(2, &full).is_empty());
        assert_eq!(unpack(2, &[]).unwrap(), full);
        let none = vec![Block::EMPTY; 16];
        assert_eq!(pack(2, &none), [0]);
        assert_eq!(unpack(2, &[0]).unwrap(), none);
    }

    #[test]
    fn the_bytes_are_as_drawn() {
        // Place of level 0, only cell (2, 1): mixed, mixed, mixed, then row 0: 0000000, row 1: 0010000, ...
        let mut b = Block::EMPTY;
        b.0[1] = 1 << 2;
        let bytes = pack(0, &[b]);
        // 11 11 11 0000000 0010000 and 35 zeros, then three empty quarters, twice.
        assert_eq!(bytes, [0xfc, 0x01, 0x00, 0, 0, 0, 0, 0], "{bytes:02x?}");
        assert_eq!(unpack(0, &bytes).unwrap(), [b]);
    }

    #[test]
    fn damaged_bytes_are_refused_or_are_other_cells() {
        let bytes = pack(2, &slanted(2));
        for n in 1..bytes.len() {
            assert!(unpack(2, &bytes[..n]).is_err(), "{n} bytes");
        }
        for k in 0..bytes.len() * 8 {
            let mut b = bytes.clone();
            b[k / 8] ^= 1 << (k % 8);
            if let Ok(p) = unpack(2, &b) {
                assert_eq!(p.len(), 16);
            }
        }
        assert!(unpack(5, &[]).is_err() && unpack(0, &vec![0; 70_000]).is_err());
    }
}
