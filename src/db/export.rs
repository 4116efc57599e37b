//! What went in comes out: the samples of a tile, bit for bit.

use super::database::Snapshot;
use super::head::{Declaration, Tile};
use crate::base::{Error, Result};
use crate::height::block::{BLOCK, decode};
use crate::height::lod::SurveyNumber;
use crate::store::segment::{Pages, file_name};

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
        let view = &self.snapshot.view;
        let directory = view.directory(&self.tile.directory)?;
        let cols = self.cols();
        for bj in directory.blocks.j0..directory.blocks.j1 {
            let j0 = (bj * BLOCK).max(posts.j0);
            let rows = (((bj + 1) * BLOCK).min(posts.j1) - j0) as usize;
            let mut samples = vec![0u8; rows * cols * w];
            let mut valid = vec![1u8; rows * cols];
            for bi in directory.blocks.i0..directory.blocks.i1 {
                let Some((at, _)) = directory.get(bi, bj) else { continue };
                let raw = decode(&view.files.page(&at)?, &file_name(at.file))?;
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
}
