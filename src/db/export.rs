//! What went in comes out: the samples of a tile, bit for bit.

use super::database::Snapshot;
use super::head::{Declaration, Tile};
use super::tile::Directory;
use crate::base::{Error, Result, limits};
use crate::height::block::{BLOCK, RawBlock, decode};
use crate::height::frame::CellRect;
use crate::height::lod::SurveyNumber;
use crate::store::segment::{PageRef, Pages, file_name};
use crate::store::table::PAGE_BLOCKS;

/// A delivered tile: read row band by row band.
pub struct RawTile<'a> {
    snapshot: &'a Snapshot,
    pub declaration: Declaration,
    pub tile: Tile,
}

/// Opens a tile of a survey for reading back.
pub fn read_tile(snapshot: &Snapshot, survey: SurveyNumber, index: usize) -> Result<RawTile<'_>> {
    let head = snapshot.head(survey)?;
    Ok(RawTile { snapshot, declaration: head.declaration.clone(), tile: head.tiles[index].clone() })
}

/// A survey's own posts: those of its files, or, where they were delivered in another system, what was resampled from them.
#[derive(Clone, Debug, PartialEq)]
pub struct OwnPosts {
    /// Index of the first post; the last lies `cols - 1`, `rows - 1` further.
    pub first: [i64; 2],
    pub cols: usize,
    pub rows: usize,
    /// Heights in metres, row by row; voids are NaN.
    pub z: Vec<f64>,
}

/// Reads all posts of a survey at once.
///
/// # Errors
/// [`Error::Limit`] above [`limits::WINDOW_POSTS_MAX`] posts.
pub fn own_posts(snapshot: &Snapshot, survey: SurveyNumber) -> Result<OwnPosts> {
    let head = snapshot.head(survey)?;
    let mut rect = head.posts();
    if head.declaration.resampled.is_some() {
        rect = CellRect::new(0, 0, 0, 0);
        snapshot.view.each_patch_page(survey, |at, page| {
            let side = i64::from(PAGE_BLOCKS);
            for (k, _) in page.blocks.iter().enumerate().filter(|(_, b)| at.level == 0 && b.is_some()) {
                let (i, j) =
                    (i64::from(at.i) * side + k as i64 % side, i64::from(at.j) * side + k as i64 / side);
                rect = rect.union(&CellRect::new(i * BLOCK, j * BLOCK, (i + 1) * BLOCK, (j + 1) * BLOCK));
            }
            Ok(())
        })?;
    }
    let count = rect.width() as u64 * rect.height() as u64;
    if count > limits::WINDOW_POSTS_MAX {
        return Err(Error::limit("posts of a survey read at once", limits::WINDOW_POSTS_MAX, count));
    }
    let z = snapshot.view.with_samples(survey, |r| r.posts(&rect))?;
    Ok(OwnPosts { first: [rect.i0, rect.j0], cols: rect.width() as usize, rows: rect.height() as usize, z })
}

impl RawTile<'_> {
    pub fn cols(&self) -> usize {
        self.tile.posts.width() as usize
    }
    pub fn rows(&self) -> usize {
        self.tile.posts.height() as usize
    }

    /// Calls `f(first row, rows, samples, valid)` for every band of rows, top to bottom: little-endian samples and one
    /// byte a post, as they were delivered.
    pub fn bands(&self, mut f: impl FnMut(usize, usize, &[u8], &[u8]) -> Result<()>) -> Result<()> {
        let posts = self.tile.posts;
        let sample_type = self.declaration.delivered().sample_type;
        let w = sample_type.bytes();
        let directory = self.snapshot.view.directory(&self.tile.directory)?;
        let cols = self.cols();
        for bj in directory.blocks.j0..directory.blocks.j1 {
            let j0 = (bj * BLOCK).max(posts.j0);
            let rows = (((bj + 1) * BLOCK).min(posts.j1) - j0) as usize;
            let mut samples = vec![0u8; rows * cols * w];
            let mut valid = vec![1u8; rows * cols];
            for bi in directory.blocks.i0..directory.blocks.i1 {
                let Some((at, raw)) = self.block(&directory, bi, bj)? else { continue };
                let (i0, j1) = (bi * BLOCK + raw.col as i64, bj * BLOCK + (raw.row + raw.rows) as i64);
                let held = i0 >= posts.i0 && i0 + raw.cols as i64 <= posts.i1 && j1 <= j0 + rows as i64;
                if raw.sample_type != sample_type || !held {
                    return Err(Error::corrupt(
                        file_name(at.file),
                        at.place(),
                        "is not a block of this tile",
                    ));
                }
                let c0 = (bi * BLOCK + raw.col as i64 - posts.i0) as usize;
                for r in 0..raw.rows.min(rows) {
                    let (to, from) = (r * cols + c0, r * raw.cols);
                    samples[to * w..(to + raw.cols) * w]
                        .copy_from_slice(&raw.samples[from * w..(from + raw.cols) * w]);
                    if let Some(v) = &raw.valid {
                        valid[to..to + raw.cols].copy_from_slice(&v[from..from + raw.cols]);
                    }
                }
            }
            f((j0 - posts.j0) as usize, rows, &samples, &valid)?;
        }
        Ok(())
    }

    /// Calls `f(block column and row, block)` for every block of samples of the tile, as it is stored.
    pub fn blocks(&self, mut f: impl FnMut([i64; 2], RawBlock) -> Result<()>) -> Result<()> {
        let directory = self.snapshot.view.directory(&self.tile.directory)?;
        for bj in directory.blocks.j0..directory.blocks.j1 {
            for bi in directory.blocks.i0..directory.blocks.i1 {
                if let Some((_, raw)) = self.block(&directory, bi, bj)? {
                    f([bi, bj], raw)?;
                }
            }
        }
        Ok(())
    }

    fn block(&self, directory: &Directory, bi: i64, bj: i64) -> Result<Option<(PageRef, RawBlock)>> {
        let Some((at, _)) = directory.get(bi, bj) else { return Ok(None) };
        let raw = decode(&self.snapshot.view.files.page(&at)?, &file_name(at.file))?;
        Ok(Some((at, raw)))
    }
}
