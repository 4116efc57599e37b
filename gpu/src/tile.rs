//! A tile as the walk reads it: flat arrays.

use bytemuck::{Pod, Zeroable};
use terraquilt_codecs::fractal::isometry::{Isometry, group};
use terraquilt_codecs::{Error, Result};

/// The longest side of a tile, in cells: a place of 2^-32 parts of a cell is then exact in 64 bits of floating point.
pub const SIDE_MAX: u32 = 1 << 20;

/// A range with its map: `value = scale * (value at the point of the domain) + offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// First column and row of the range, in cells of the zoom-1 grid.
    pub range: [u32; 2],
    /// First column and row of the domain, which is twice as wide. Not read if `scale` is 0.
    pub domain: [u32; 2],
    /// Side of the range.
    pub side: u32,
    /// Number of the isometry: transposed if `& 4`, then turned by 90 degrees counter-clockwise `& 3` times.
    pub isometry: u8,
    /// s, -1 to 1.
    pub scale: f64,
    /// o = m - s * mean(domain) at the attractor.
    pub offset: f64,
}

/// A fractal tile ready to be walked.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Columns and rows of the zoom-1 grid.
    pub size: [u32; 2],
    /// Side of the smallest range: a power of two.
    pub cell: u32,
    /// For each square of `cell` cells, row by row, the leaf that holds it. The last squares may reach beyond the grid.
    pub index: Vec<u32>,
    /// The leaves.
    pub leaves: Vec<Leaf>,
    /// The attractor at zoom 1, row by row.
    pub seed: Vec<f64>,
}

/// As `Shape` of walk.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Shape {
    size: [u32; 2],
    across: u32,
    shift: u32,
}

/// As `Leaf` of walk.wgsl.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Map {
    range: [u32; 2],
    domain: [u32; 2],
    side: u32,
    turn: u32,
    scale: f32,
    offset: f32,
}

/// Numbers as the GPU takes them: heights as shares of their range, so that 24 bits serve the range and not the height above the sea.
pub(crate) struct Words {
    pub shape: Shape,
    pub maps: Vec<Map>,
    pub seed: Vec<f32>,
    /// Height of share 0, and how much higher share 1 is.
    pub low: f64,
    pub span: f64,
}

impl Tile {
    /// Entries in a row and in a column of the index.
    pub fn squares(&self) -> [usize; 2] {
        self.size.map(|n| n.div_ceil(self.cell) as usize)
    }

    /// Holds the arrays against each other, so that no step of the walk leaves them.
    ///
    /// # Errors
    /// Invalid, naming the leaf or the square; Limit for a side beyond [`SIDE_MAX`].
    pub fn check(&self) -> Result<()> {
        let wrong = |reason: String| Err(Error::invalid("fractal tile", reason));
        let [cols, rows] = self.size;
        if let Some(n) = self.size.into_iter().find(|n| *n > SIDE_MAX) {
            return Err(Error::Limit { what: "side of a tile", limit: SIDE_MAX.into(), wanted: n.into() });
        }
        if cols == 0 || rows == 0 || !self.cell.is_power_of_two() {
            return wrong(format!(
                "{cols} x {rows} cells, smallest range {}; sides are above 0, ranges powers of two",
                self.cell
            ));
        }
        let [across, down] = self.squares();
        let (cells, squares) = (cols as usize * rows as usize, across * down);
        if self.seed.len() != cells || self.index.len() != squares {
            return wrong(format!(
                "{} samples and {} index entries; {cols} x {rows} cells have {cells} and {squares}",
                self.seed.len(),
                self.index.len()
            ));
        }
        if let Some(k) = self.seed.iter().position(|v| !v.is_finite()) {
            return wrong(format!("sample {k} is {}; every sample is a number", self.seed[k]));
        }
        for (k, l) in self.leaves.iter().enumerate() {
            let fits = |at: u32, n: u32| u64::from(at) + 2 * u64::from(l.side) <= u64::from(n);
            let domain = l.scale == 0.0 || (fits(l.domain[0], cols) && fits(l.domain[1], rows));
            if !domain
                || l.side == 0
                || l.isometry > 7
                || l.scale.is_nan()
                || l.scale.abs() > 1.0
                || !l.offset.is_finite()
            {
                return wrong(format!(
                    "leaf {k} is {l:?}; its domain lies in the tile, isometries are 0 to 7, scales -1 to 1"
                ));
            }
        }
        for (k, leaf) in self.index.iter().enumerate() {
            let at = [k % across, k / across].map(|p| p as u64 * u64::from(self.cell));
            let Some(l) = self.leaves.get(*leaf as usize) else {
                return wrong(format!("square {k} names leaf {leaf} of {}", self.leaves.len()));
            };
            let end = |a: usize| u64::from(l.range[a]) + u64::from(l.side);
            if (0..2).any(|a| at[a] < u64::from(l.range[a]) || at[a] + u64::from(self.cell) > end(a)) {
                return wrong(format!("square {k} names leaf {leaf}, whose range does not hold it"));
            }
        }
        Ok(())
    }

    /// The numbers for the GPU.
    ///
    /// # Errors
    /// As [`check`](Tile::check).
    pub(crate) fn words(&self) -> Result<Words> {
        self.check()?;
        let low = self.seed.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.seed.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let span = if high > low { high - low } else { 1.0 };
        let turns: Vec<u32> = group::<2>(8)?.iter().map(turn).collect();
        let maps = self.leaves.iter().map(|l| Map {
            range: l.range,
            domain: l.domain,
            side: l.side,
            turn: turns[usize::from(l.isometry)],
            scale: l.scale as f32,
            // low + span v = s (low + span w) + o
            offset: ((l.offset + l.scale * low - low) / span) as f32,
        });
        let maps: Vec<Map> = maps.collect();
        if let Some(k) = maps.iter().position(|m| !m.offset.is_finite()) {
            let (offset, reach) = (self.leaves[k].offset, [low, high]);
            let reason = format!(
                "leaf {k} has offset {offset} where samples reach from {reach:?}; it is far beyond them"
            );
            return Err(Error::invalid("fractal tile", reason));
        }
        Ok(Words {
            shape: Shape {
                size: self.size,
                across: self.squares()[0] as u32,
                shift: self.cell.trailing_zeros(),
            },
            maps,
            seed: self.seed.iter().map(|v| ((v - low) / span) as f32).collect(),
            low,
            span,
        })
    }
}

/// What `walk` of walk.wgsl does to find the point that is read.
fn turn(i: &Isometry<2>) -> u32 {
    let [(first, column_back), (_, row_back)] = i.of;
    first as u32 | u32::from(column_back) << 1 | u32::from(row_back) << 2
}
