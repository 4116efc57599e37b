//! Reading the posts and vertices of one survey: decoded blocks, cached.

use super::head::{Declaration, Tile};
use super::kept::Kept;
use super::tile::Directory;
use crate::base::{Error, Result};
use crate::height::block::{BLOCK, Heights, RawBlock, decode};
use crate::height::frame::CellRect;
use crate::height::lod::{Place, SIDE};
use crate::height::patch::{Kind, Vertices, bicubic};
use crate::height::source::SampleType;
use crate::store::segment::{PageRef, Pages, file_name};
use quick_cache::Weighter;
use std::sync::Arc;

const N: usize = BLOCK as usize;

/// A block in the cache: survey, level, block indices, and a stamp that tells builds apart.
pub type BlockKey = (u64, u8, i64, i64);

#[derive(Clone)]
pub struct ByBytes;

impl Weighter<BlockKey, Arc<Heights>> for ByBytes {
    fn weight(&self, _: &BlockKey, v: &Arc<Heights>) -> u64 {
        v.weight()
    }
}

pub type BlockCache = Kept<BlockKey, Arc<Heights>, ByBytes>;

/// A cache of decoded blocks of at most `bytes`.
pub fn block_cache(bytes: u64) -> BlockCache {
    Kept::weighing((bytes / 100_000).max(16) as usize, bytes, ByBytes)
}

/// Finds the page of a sample block of a level above 0.
pub type LevelBlocks<'a> = &'a (dyn Fn(u8, i64, i64) -> Result<Option<PageRef>> + Sync);

/// Which posts or vertices of a survey are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Layer {
    /// Delivered samples, on the lattice of the files.
    Delivered,
    /// Vertices of a level, on the survey's own lattice; level 0 are its posts.
    Level(u8),
}

/// Level by which blocks of delivered samples are told apart in the cache from those that were resampled from them.
const DELIVERED: u8 = u8::MAX;

/// What is read where there is no sample.
#[derive(Clone, Copy, PartialEq)]
enum Voids {
    /// The fill; 0 where there is none.
    AsStored,
    /// NaN where there is no fill (which is stored as 0, so a fill of 0 counts as none); else the fill.
    OpenAsNan,
    AllAsNan,
}

/// Gives heights to the vertices of a patch that have neither a sample nor a fill (NaN).
pub fn close(kind: Kind, z: &mut Vertices) {
    let mut open = [false; SIDE * SIDE];
    for (z, open) in z.iter_mut().zip(&mut open).filter(|(z, _)| z.is_nan()) {
        (*z, *open) = (0.0, true);
    }
    if kind == Kind::Bicubic {
        bicubic::extend(z, &mut open);
    }
}

/// The samples of one survey. Where it was delivered in another system, its posts are resampled ones: they are found like
/// the levels above them, and the tiles hold what they were made of.
pub struct SampleReader<'a> {
    pub pages: &'a dyn Pages,
    pub declaration: &'a Declaration,
    /// Descending by key, each with its directory.
    pub tiles: Vec<(&'a Tile, Arc<Directory>)>,
    pub levels: LevelBlocks<'a>,
    pub cache: &'a BlockCache,
    /// Distinguishes this survey (and this state of it) in the cache.
    pub stamp: u64,
}

/// A block as stored.
///
/// # Errors
/// If its samples are not of the declared type, though page and checksum are right.
pub(super) fn stored(pages: &dyn Pages, at: &PageRef, declared: SampleType) -> Result<RawBlock> {
    let raw = decode(&pages.page(at)?, &file_name(at.file))?;
    if raw.sample_type != declared {
        return Err(Error::corrupt(
            file_name(at.file),
            at.place(),
            format!("holds {} samples, the survey has {}", raw.sample_type.name(), declared.name()),
        ));
    }
    Ok(raw)
}

impl SampleReader<'_> {
    /// A block of posts or vertices as stored, of the survey's sample type.
    pub fn raw(&self, at: &PageRef) -> Result<RawBlock> {
        stored(self.pages, at, self.declaration.sample_type)
    }

    /// Raw blocks of the tiles, least key first: laid in this order the greatest key wins.
    fn tile_blocks(&self, bi: i64, bj: i64) -> Result<Vec<RawBlock>> {
        let declared = self.declaration.delivered().sample_type;
        let mut out = Vec::new();
        for (_, directory) in self.tiles.iter().rev() {
            if let Some((at, _)) = directory.get(bi, bj) {
                out.push(stored(self.pages, &at, declared)?);
            }
        }
        Ok(out)
    }

    /// Whether no tile holds a valid sample in a block of delivered samples.
    fn tiles_are_void(&self, bi: i64, bj: i64) -> bool {
        self.tiles.iter().filter_map(|(_, d)| d.get(bi, bj)).all(|(_, valid)| valid == 0)
    }

    /// Raw blocks of posts (level 0), in the order in which they are laid.
    pub fn post_blocks(&self, bi: i64, bj: i64) -> Result<Vec<RawBlock>> {
        if self.declaration.resampled.is_none() {
            return if self.tiles_are_void(bi, bj) { Ok(Vec::new()) } else { self.tile_blocks(bi, bj) };
        }
        (self.levels)(0, bi, bj)?.map(|at| self.raw(&at)).into_iter().collect()
    }

    /// Whether a block of posts (level 0) holds no valid sample.
    pub fn is_void(&self, bi: i64, bj: i64) -> Result<bool> {
        if self.declaration.resampled.is_none() {
            return Ok(self.tiles_are_void(bi, bj));
        }
        Ok((self.levels)(0, bi, bj)?.is_none())
    }

    /// Whether no block of posts in a rectangle of blocks holds a valid sample.
    pub fn posts_are_void(&self, blocks: &CellRect) -> Result<bool> {
        for bj in blocks.j0..blocks.j1 {
            for bi in blocks.i0..blocks.i1 {
                if !self.is_void(bi, bj)? {
                    return Ok(false);
                }
            }
        }
        Ok(true)
    }

    /// Whether no tile holds a valid sample near a rectangle of delivered posts: false may be wrong, true is not.
    pub fn delivered_is_void(&self, r: &CellRect) -> bool {
        let b = super::tile::blocks_of(r);
        (b.j0..b.j1).all(|bj| (b.i0..b.i1).all(|bi| self.tiles_are_void(bi, bj)))
    }

    /// Raw blocks of a level, in the order in which they are laid.
    pub fn raw_blocks(&self, level: u8, bi: i64, bj: i64) -> Result<Vec<RawBlock>> {
        if level == 0 {
            return self.post_blocks(bi, bj);
        }
        (self.levels)(level, bi, bj)?.map(|at| self.raw(&at)).into_iter().collect()
    }

    /// Keeps a block of posts for who reads it next, made of its raw blocks.
    pub fn keep_posts(&self, bi: i64, bj: i64, raws: &[RawBlock]) {
        let key = (self.stamp, 0, bi, bj);
        if self.cache.get(&key).is_none() {
            let mut h = Heights::void();
            for raw in raws {
                h.lay(raw, self.declaration.scale, self.declaration.offset);
            }
            self.cache.insert(key, Arc::new(h));
        }
    }

    /// A decoded block of a level. A block that does not exist is all void.
    pub fn block(&self, level: u8, bi: i64, bj: i64) -> Result<Arc<Heights>> {
        self.decoded(Layer::Level(level), bi, bj)
    }

    /// A block of posts that is looked at once: if it is not kept, it does not push out what is.
    pub fn passing_posts(&self, bi: i64, bj: i64) -> Result<Arc<Heights>> {
        match self.cache.get(&(self.stamp, 0, bi, bj)) {
            Some(b) => Ok(b),
            None => self.laid(Layer::Level(0), bi, bj).map(Arc::new),
        }
    }

    fn decoded(&self, layer: Layer, bi: i64, bj: i64) -> Result<Arc<Heights>> {
        let level = match layer {
            Layer::Delivered => DELIVERED,
            Layer::Level(l) => l,
        };
        let key = (self.stamp, level, bi, bj);
        self.cache.or_read(key, || self.laid(layer, bi, bj).map(Arc::new))
    }

    fn laid(&self, layer: Layer, bi: i64, bj: i64) -> Result<Heights> {
        let d = self.declaration;
        let mut h = Heights::void();
        match layer {
            Layer::Delivered => {
                let delivered = d.delivered();
                for raw in self.tile_blocks(bi, bj)? {
                    h.lay(&raw, delivered.scale, delivered.offset);
                }
            }
            Layer::Level(l) => {
                for raw in self.raw_blocks(l, bi, bj)? {
                    h.lay(&raw, d.scale, d.offset);
                }
            }
        }
        Ok(h)
    }

    /// The 33 x 33 vertices of a patch. A bicubic one has no open vertices: those that are void and have no fill are
    /// given what the others of the patch suggest.
    pub fn vertices(&self, kind: Kind, place: Place) -> Result<Box<Vertices>> {
        let mut z: Box<Vertices> =
            vec![0.0; SIDE * SIDE].into_boxed_slice().try_into().expect("SIDE x SIDE values");
        let d = place.domain();
        let (i0, j0) = (d.i0 >> place.level, d.j0 >> place.level);
        let layer = Layer::Level(place.level);
        match kind {
            Kind::Bilinear => self.copy(layer, i0, j0, SIDE, SIDE, &mut z[..], Voids::AsStored)?,
            Kind::Bicubic => {
                self.copy(layer, i0, j0, SIDE, SIDE, &mut z[..], Voids::OpenAsNan)?;
                close(kind, &mut z);
            }
        }
        Ok(z)
    }

    /// A rectangle of posts (level 0), voids as NaN.
    pub fn posts(&self, r: &CellRect) -> Result<Vec<f64>> {
        let mut z = Vec::new();
        self.rectangle(Layer::Level(0), r, Voids::AllAsNan, &mut z)?;
        Ok(z)
    }

    /// The same, into memory that was used before.
    pub fn posts_into(&self, r: &CellRect, z: &mut Vec<f64>) -> Result<()> {
        self.rectangle(Layer::Level(0), r, Voids::AllAsNan, z)
    }

    /// A rectangle of delivered heights, voids as NaN.
    pub fn delivered_posts(&self, r: &CellRect) -> Result<Vec<f64>> {
        let mut z = Vec::new();
        self.rectangle(Layer::Delivered, r, Voids::AllAsNan, &mut z)?;
        Ok(z)
    }

    /// A rectangle of vertices of a level, fills for voids, 0 where there is none; into memory that was used before.
    pub fn vertices_into(&self, level: u8, r: &CellRect, z: &mut Vec<f64>) -> Result<()> {
        self.rectangle(Layer::Level(level), r, Voids::AsStored, z)
    }

    fn rectangle(&self, layer: Layer, r: &CellRect, voids: Voids, z: &mut Vec<f64>) -> Result<()> {
        let (cols, rows) = (r.width() as usize, r.height() as usize);
        z.resize(cols * rows, 0.0);
        self.copy(layer, r.i0, r.j0, cols, rows, z, voids)
    }

    #[allow(clippy::too_many_arguments)]
    fn copy(
        &self,
        layer: Layer,
        i0: i64,
        j0: i64,
        cols: usize,
        rows: usize,
        out: &mut [f64],
        voids: Voids,
    ) -> Result<()> {
        let (i1, j1) = (i0 + cols as i64, j0 + rows as i64);
        for bj in j0.div_euclid(BLOCK)..=(j1 - 1).div_euclid(BLOCK) {
            for bi in i0.div_euclid(BLOCK)..=(i1 - 1).div_euclid(BLOCK) {
                let block = self.decoded(layer, bi, bj)?;
                let (ci, cj) = (bi * BLOCK, bj * BLOCK);
                let (a0, a1) = ((i0.max(ci) - ci) as usize, (i1.min(ci + BLOCK) - ci) as usize);
                for j in j0.max(cj)..j1.min(cj + BLOCK) {
                    let b = (j - cj) as usize;
                    let from = &block.z[b * N + a0..b * N + a1];
                    let at = (j - j0) as usize * cols + (ci + a0 as i64 - i0) as usize;
                    out[at..at + from.len()].copy_from_slice(from);
                    if voids != Voids::AsStored
                        && let Some(v) = &block.valid
                    {
                        for (o, v) in out[at..at + from.len()].iter_mut().zip(&v[b * N + a0..b * N + a1]) {
                            if *v == 0 && (voids == Voids::AllAsNan || *o == 0.0) {
                                *o = f64::NAN;
                            }
                        }
                    }
                }
            }
        }
        Ok(())
    }
}
