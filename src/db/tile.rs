//! Tiles: delivered samples in blocks on the survey's lattice, and their directory.

use super::change::Progress;
use super::head::{Declaration, Tile, put_rect, read_rect};
use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result, limits};
use crate::height::block::{BLOCK, RawBlock, encode};
use crate::height::frame::CellRect;
use crate::height::source::{HeightSource, Window};
use crate::store::segment::{PageRef, SegmentWriter};
use rayon::prelude::*;

/// Where the level-0 blocks of a tile are.
#[derive(Clone, Debug, PartialEq)]
pub struct Directory {
    /// Blocks: `[i0, i1) x [j0, j1)` in block indices.
    pub blocks: CellRect,
    /// Row-major: page and number of valid samples.
    pub pages: Vec<(PageRef, u32)>,
}

/// The blocks that a rectangle of posts touches.
pub fn blocks_of(posts: &CellRect) -> CellRect {
    CellRect::new(
        posts.i0.div_euclid(BLOCK),
        posts.j0.div_euclid(BLOCK),
        (posts.i1 - 1).div_euclid(BLOCK) + 1,
        (posts.j1 - 1).div_euclid(BLOCK) + 1,
    )
}

impl Directory {
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        out.put_u8(b'D');
        put_rect(&mut out, &self.blocks);
        for (p, valid) in &self.pages {
            p.put(&mut out);
            out.put_u32(*valid);
        }
        out
    }

    pub fn decode(bytes: &[u8], file: &str) -> Result<Directory> {
        let mut r = Reader::new(bytes, file, "tile directory");
        let kind = r.u8()?;
        if kind != b'D' {
            return Err(r.bad(format!("page kind {kind:#04x} is not a tile directory")));
        }
        let blocks = read_rect(&mut r)?;
        let n = blocks.width().checked_mul(blocks.height()).unwrap_or(i64::MAX) as u64;
        if n != (r.remaining() / (PageRef::BYTES + 4)) as u64 {
            return Err(r.bad(format!("{n} blocks in {} bytes", r.remaining())));
        }
        let pages = (0..n).map(|_| Ok((PageRef::read(&mut r)?, r.u32()?))).collect::<Result<Vec<_>>>()?;
        r.end()?;
        Ok(Directory { blocks, pages })
    }

    pub fn get(&self, bi: i64, bj: i64) -> Option<(PageRef, u32)> {
        let b = &self.blocks;
        ((b.i0..b.i1).contains(&bi) && (b.j0..b.j1).contains(&bj))
            .then(|| self.pages[((bj - b.j0) * b.width() + bi - b.i0) as usize])
    }
}

/// Reads a source once, top to bottom, and writes its blocks. Holds one row of blocks at a time.
pub fn write_tile(
    source: &mut dyn HeightSource,
    declaration: &Declaration,
    first: [i64; 2],
    out: &mut SegmentWriter,
    progress: &Progress,
) -> Result<Tile> {
    let info = source.info().clone();
    let posts = CellRect::new(first[0], first[1], first[0] + info.cols as i64, first[1] + info.rows as i64);
    let blocks = blocks_of(&posts);
    let delivered = declaration.delivered();
    let width = delivered.sample_type.bytes();
    let cols = info.cols as usize;
    let mut hash = blake3::Hasher::new();
    hash.put(b"terraquilt tile 1");
    put_rect(&mut hash, &posts);
    let mut pages = Vec::with_capacity((blocks.width() * blocks.height()) as usize);
    let (mut valid_count, mut z) = (0u64, [f64::INFINITY, f64::NEG_INFINITY]);
    // Rows read but not yet written: from row `held_from` of the file.
    let (mut held, mut mask, mut held_from) = (Vec::<u8>::new(), Vec::<u8>::new(), 0u64);
    let batch = source.row_batch().clamp(1, (limits::WINDOW_POSTS_MAX as usize / cols.max(1)).max(1));
    let mut next = 0u64;
    for bj in blocks.j0..blocks.j1 {
        let row0 = (bj * BLOCK).max(posts.j0) - posts.j0;
        let row1 = ((bj + 1) * BLOCK).min(posts.j1) - posts.j0;
        while (next as i64) < row1 {
            let rows = batch.min((info.rows - next) as usize);
            let s = source.read(Window { col: 0, row: next, cols, rows })?;
            if s.data.len() != cols * rows * width || s.valid.len() != cols * rows {
                return Err(Error::corrupt(
                    &info.file,
                    format!("rows {next}.."),
                    "the source returned another extent",
                ));
            }
            for r in 0..rows {
                hash.put(&s.data[r * cols * width..(r + 1) * cols * width]);
                let bits: Vec<u8> = s.valid[r * cols..(r + 1) * cols]
                    .chunks(8)
                    .map(|c| c.iter().enumerate().fold(0, |b, (k, v)| b | u8::from(*v != 0) << k))
                    .collect();
                hash.put(&bits);
            }
            for (k, v) in s.valid.iter().enumerate() {
                if *v != 0 {
                    valid_count += 1;
                    let h = delivered.sample_type.value(&s.data[k * width..]);
                    z = [z[0].min(h), z[1].max(h)];
                }
            }
            held.extend_from_slice(&s.data);
            mask.extend_from_slice(&s.valid);
            next += rows as u64;
            progress.step("reading", next as f64 / info.rows as f64)?;
        }
        let rows = (row1 - row0) as usize;
        let skip = (row0 as u64 - held_from) as usize * cols;
        let packed: Vec<(Vec<u8>, u32)> = (blocks.i0..blocks.i1)
            .into_par_iter()
            .map(|bi| {
                let c0 = ((bi * BLOCK).max(posts.i0) - posts.i0) as usize;
                let c1 = (((bi + 1) * BLOCK).min(posts.i1) - posts.i0) as usize;
                let n = c1 - c0;
                let mut samples = Vec::with_capacity(n * rows * width);
                let mut valid = Vec::with_capacity(n * rows);
                for r in 0..rows {
                    let at = skip + r * cols + c0;
                    samples.extend_from_slice(&held[at * width..(at + n) * width]);
                    valid.extend_from_slice(&mask[at..at + n]);
                }
                let raw = RawBlock {
                    col: (posts.i0 + c0 as i64).rem_euclid(BLOCK) as usize,
                    row: (posts.j0 + row0).rem_euclid(BLOCK) as usize,
                    cols: n,
                    rows,
                    sample_type: delivered.sample_type,
                    samples,
                    valid: valid.contains(&0).then_some(valid),
                    fills: Vec::new(),
                };
                (encode(&raw), raw.valid_count())
            })
            .collect();
        for (bytes, valid) in packed {
            pages.push((out.append(&bytes)?, valid));
        }
        let done = (row1 as u64 - held_from) as usize * cols;
        held.drain(..done * width);
        mask.drain(..done);
        held_from = row1 as u64;
    }
    let to_height = |v: f64| v * delivered.scale + delivered.offset;
    let (a, b) = (to_height(z[0]), to_height(z[1]));
    let far = a.abs().max(b.abs());
    if valid_count > 0 && (far.is_nan() || far > limits::HEIGHT_M_MAX) {
        return Err(Error::invalid(
            &info.file,
            format!(
                "holds heights from {} to {} m; beyond {} m is no ground: check --nodata and --vertical-unit",
                a.min(b),
                a.max(b),
                limits::HEIGHT_M_MAX
            ),
        ));
    }
    let directory = out.append(&Directory { blocks, pages }.encode())?;
    Ok(Tile {
        key: hash.finalize().as_bytes()[..16].try_into().expect("a hash has 32 bytes"),
        posts,
        directory,
        valid: valid_count,
        z: [a.min(b), a.max(b)],
        file: std::path::Path::new(&info.file)
            .file_name()
            .map_or_else(|| info.file.clone(), |n| n.to_string_lossy().into_owned()),
        affine: info.affine.ok_or_else(|| Error::invalid(&info.file, "has no georeference"))?,
        nodata: info.nodata,
    })
}
