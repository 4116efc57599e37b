//! A fractal tile as it was read: asked for its samples at any zoom, or point by point.

use super::colour;
use super::grid::Grid;
use super::header::{Header, Kind, Shapes};
use super::ifs::{Ifs, Shape};
use super::iterate::Stop;
use super::walk::Walk;
use super::{mask, residual, tree};
use crate::blocks::unblocked;
use crate::heights::Heights;
use crate::range::{Coder, Decoder};
use crate::{Error, Result};

/// A file, or the beginning of one.
pub struct Tile {
    /// The head.
    pub header: Header,
    /// Maps of planes: of the heights, the brightness, or Y, I and Q.
    pub planes: Vec<Ifs<2>>,
    /// Maps of the volume.
    pub volume: Option<Ifs<3>>,
    /// Which samples are voids; empty if none is.
    pub void: Vec<bool>,
    /// Multiples of 2E + 1, in rows of the padded plane; empty without a bound.
    residual: Vec<i32>,
    /// Whether nothing is missing and all checksums hold.
    pub complete: bool,
    /// A block with a wrong checksum, by its place in the body; nothing from there on was used.
    pub damaged: Option<u64>,
    /// Bytes of the file.
    pub bytes: u64,
    /// What they went to.
    pub parts: Parts,
}

/// Bytes that parts of a file took, as far as it is there; a few bytes belong to two of them.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Parts {
    /// The mask of voids.
    pub mask: u64,
    /// Maps, by plane; of a volume one number.
    pub maps: Vec<u64>,
    /// What a bound adds.
    pub residual: u64,
}

/// Bytes a pixel, row by row.
pub struct Picture {
    /// Pixels in a row.
    pub cols: usize,
    /// Rows.
    pub rows: usize,
    /// 1 or 3.
    pub channels: usize,
    /// Samples.
    pub samples: Vec<u8>,
}

impl Tile {
    /// Reads a file or any prefix of one. An error where the head is not there or is damaged; whatever follows, the answer is a tile: what is missing is
    /// flat.
    pub fn read(bytes: &[u8]) -> Result<Tile> {
        Tile::read_within(u64::MAX, bytes)
    }

    /// As [`read`](Tile::read), for bytes that nobody vouches for: a tile of more samples is an [`Error::Limit`], before anything is allocated for it.
    /// Memory: at most 12 bytes a sample, and the bytes. What is beyond the tile in whole ranges counts.
    pub fn read_within(samples_max: u64, bytes: &[u8]) -> Result<Tile> {
        let (header, head) = Header::read(bytes)?;
        if header.samples() > samples_max {
            return Err(Error::Limit {
                what: "samples of the tile",
                limit: samples_max,
                wanted: header.samples(),
            });
        }
        let read = unblocked(&bytes[head..], header.body);
        let mut c = Decoder::new(&read.bytes, read.whole);
        let mut tile = Tile {
            planes: Vec::new(),
            volume: None,
            void: Vec::new(),
            residual: Vec::new(),
            complete: false,
            damaged: read.damaged,
            bytes: bytes.len() as u64,
            parts: Parts::default(),
            header,
        };
        let h = &tile.header;
        let mut from = 0;
        let mut since = |c: &Decoder| {
            let to = c.position().min(read.bytes.len()) as u64;
            to - std::mem::replace(&mut from, to)
        };
        if h.mask {
            tile.void = vec![false; h.samples() as usize];
            mask::code(&mut tile.void, h.size[0], &mut c);
            tile.parts.mask = since(&c);
        }
        match &h.shapes {
            Shapes::Planes(shapes) => {
                for s in shapes {
                    tile.planes.push(tree::code(s, &tree::Unknown, &mut c));
                    tile.parts.maps.push(since(&c));
                }
            }
            Shapes::Volume(s) => {
                tile.volume = Some(tree::code(s, &tree::Unknown, &mut c));
                tile.parts.maps.push(since(&c));
            }
        }
        if h.bound.is_some() {
            let [cols, rows] = tile.planes[0].shape.padded();
            tile.residual = vec![0; cols * rows];
            residual::code(&mut tile.residual, cols, [h.size[0], h.size[1]], &tile.void, &mut c);
            tile.parts.residual = since(&c);
        }
        tile.complete = read.whole && !c.ended();
        Ok(tile)
    }

    /// A tile that is not whole cannot say how wrong it is.
    pub fn error_known(&self) -> bool {
        self.complete
    }

    fn only(&self, kinds: &[Kind], what: &'static str) -> Result<()> {
        if kinds.contains(&self.header.kind) {
            return Ok(());
        }
        Err(Error::invalid(what, format!("this tile holds {:?}; ask for that", self.header.kind)))
    }

    /// A plane at zoom 1, in its own size; what a bound adds is not in it.
    pub fn plane(&self, k: usize) -> Result<Grid<2>> {
        let ifs = self
            .planes
            .get(k)
            .ok_or_else(|| Error::invalid("plane", format!("{k}; the tile has {}", self.planes.len())))?;
        let whole = ifs.iterate([1, 1], self.header.seed(), Stop::PUBLISHED, &mut || true)?.grid;
        Ok(cropped(whole, ifs.shape.size))
    }

    /// Heights at zoom 1, in whole units: within the bound where there is one. Memory: 12.5 bytes a post in whole ranges beside the tile;
    /// [`into_heights`](Tile::into_heights) needs less.
    pub fn heights(&self) -> Result<Heights> {
        self.only(&[Kind::Heights], "heights")?;
        self.heights_onto(self.residual.clone(), self.void.clone())
    }

    /// As [`heights`](Tile::heights), the tile given up for it. Memory: at most 12 bytes a post in whole ranges in all, 14 where the jump is no
    /// multiple of 4; a quarter of the posts at most is added by whole ranges.
    pub fn into_heights(mut self) -> Result<Heights> {
        self.only(&[Kind::Heights], "heights")?;
        let (residual, void) = (std::mem::take(&mut self.residual), std::mem::take(&mut self.void));
        self.heights_onto(residual, void)
    }

    fn heights_onto(&self, mut z: Vec<i32>, void: Vec<bool>) -> Result<Heights> {
        let ifs = &self.planes[0];
        let [cols, rows] = ifs.shape.size;
        if z.is_empty() {
            z = vec![0; ifs.shape.padded().iter().product()];
        }
        let step = self.header.bound.map_or(0, |e| 2 * i64::from(e) + 1);
        ifs.rounded_onto(self.header.seed(), Stop::PUBLISHED, step, &mut z)?;
        crop(&mut z, ifs.shape.padded()[0], [cols, rows]);
        Ok(Heights { cols, rows, z, void })
    }

    /// What a bound adds at a post, in units: it holds over the cell of the post at every zoom. 0 beyond the tile.
    pub fn added(&self, col: usize, row: usize) -> f64 {
        let Some(e) = self.header.bound else { return 0.0 };
        if col >= self.header.size[0] || row >= self.header.size[1] {
            return 0.0;
        }
        let stride = self.planes[0].shape.padded()[0];
        let q = self.residual.get(row * stride + col).copied().unwrap_or(0);
        f64::from(q) * (2.0 * f64::from(e) + 1.0)
    }

    /// The walk of a plane.
    pub fn walk(&self, k: usize) -> Result<Walk<2>> {
        let ifs = self
            .planes
            .get(k)
            .ok_or_else(|| Error::invalid("plane", format!("{k}; the tile has {}", self.planes.len())))?;
        Walk::new(ifs)
    }

    /// The volume at zoom 1.
    pub fn volume(&self) -> Result<Grid<3>> {
        self.only(&[Kind::Volume], "volume")?;
        let ifs = self.volume.as_ref().ok_or_else(|| Error::invalid("volume", "the tile has none"))?;
        let whole = ifs.iterate([1, 1], self.header.seed(), Stop::PUBLISHED, &mut || true)?.grid;
        Ok(cropped(whole, ifs.shape.size))
    }

    /// The picture at zoom 2^k, `by` = 2^k. I and Q, which are smaller, are taken straight between their samples.
    pub fn picture(&self, by: usize) -> Result<Picture> {
        self.only(&[Kind::Grey, Kind::Colour], "picture")?;
        if !by.is_power_of_two() {
            return Err(Error::invalid("zoom", format!("{by}; a power of two is needed")));
        }
        let mut grids = Vec::new();
        for (k, ifs) in self.planes.iter().enumerate() {
            let whole = if by == 1 {
                ifs.iterate([1, 1], self.header.seed(), Stop::PUBLISHED, &mut || true)?.grid
            } else {
                self.walk(k)?.doubled(by.trailing_zeros())?
            };
            grids.push(cropped(whole, ifs.shape.size.map(|n| n * by)));
        }
        let [cols, rows, _] = self.header.size;
        self.picture_of(&grids, [cols * by, rows * by])
    }

    /// The picture of `size` pixels that planes make, all at one zoom: the brightness pixel by pixel, I and Q, which are smaller, straight
    /// between their samples.
    pub fn picture_of(&self, planes: &[Grid<2>], [cols, rows]: [usize; 2]) -> Result<Picture> {
        self.only(&[Kind::Grey, Kind::Colour], "picture")?;
        let fits = |(k, g): (usize, &Grid<2>)| {
            let whole = g.size[0].checked_mul(g.size[1]).is_some_and(|n| n > 0 && n == g.values.len());
            whole && (k > 0 || g.size == [cols, rows])
        };
        if planes.len() != self.planes.len() || !planes.iter().enumerate().all(fits) {
            return Err(Error::invalid(
                "planes",
                format!("{}; {} of {cols} x {rows} pixels are needed", planes.len(), self.planes.len()),
            ));
        }
        let smaller: Vec<usize> = self.planes.iter().map(|p| self.header.smaller(&p.shape)).collect();
        let channels = planes.len();
        let mut samples = Vec::with_capacity(cols * rows * channels);
        let byte = |v: f64| v.round().clamp(0.0, 255.0) as u8;
        for y in 0..rows {
            for x in 0..cols {
                let at = |k: usize| {
                    let g = &planes[k];
                    if g.size == [cols, rows] {
                        return g.values[y * cols + x];
                    }
                    let centre = |v: usize| (v as f64 + 0.5) / smaller[k] as f64;
                    colour::between(&g.values, g.size[0], g.size, centre(x), centre(y))
                };
                if channels == 1 {
                    samples.push(byte(at(0)));
                } else {
                    samples.extend(colour::rgb([at(0), at(1), at(2)]).map(byte));
                }
            }
        }
        Ok(Picture { cols, rows, channels, samples })
    }

    /// Maps that are there.
    pub fn maps(&self) -> usize {
        self.planes.iter().map(Ifs::maps).sum::<usize>() + self.volume.as_ref().map_or(0, Ifs::maps)
    }

    /// The shape of a plane.
    pub fn shape(&self, k: usize) -> Option<&Shape<2>> {
        self.planes.get(k).map(|p| &p.shape)
    }
}

/// Takes the rows of a plane together.
fn crop<T: Copy>(values: &mut Vec<T>, stride: usize, [cols, rows]: [usize; 2]) {
    for y in 0..rows {
        values.copy_within(y * stride..y * stride + cols, y * cols);
    }
    values.truncate(cols * rows);
}

/// The corner of a grid.
pub(super) fn cropped<const D: usize>(mut grid: Grid<D>, size: [usize; D]) -> Grid<D> {
    let mut rows = size;
    rows[0] = 1;
    for (k, p) in super::grid::points(rows).enumerate() {
        let at = grid.at(p);
        grid.values.copy_within(at..at + size[0], k * size[0]);
    }
    grid.values.truncate(size.iter().product());
    grid.size = size;
    grid
}
