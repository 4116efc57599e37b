//! Tiles: delivered samples in blocks on the survey's lattice, and their directory.

use super::change::Progress;
use super::head::{Declaration, Tile, put_rect, read_rect};
use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result, limits};
use crate::height::block::{BLOCK, RawBlock, encode};
use crate::height::frame::CellRect;
use crate::height::source::{HeightSource, SampleType, SourceInfo, Window};
use crate::store::segment::{PageRef, SegmentWriter};
use rayon::prelude::*;
use std::collections::VecDeque;

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

/// The posts of a block.
pub fn posts_of(bi: i64, bj: i64) -> CellRect {
    CellRect::new(bi * BLOCK, bj * BLOCK, (bi + 1) * BLOCK, (bj + 1) * BLOCK)
}

/// The indices of a rectangle along a Z-curve. Who goes that way meets what lies side by side soon after one another,
/// so a cache serves that is small against a row of the rectangle.
pub fn along_curve(r: &CellRect) -> Vec<(i64, i64)> {
    let spread = |v: i64| (0..32).fold(0u64, |s, k| s | (v as u64 >> k & 1) << (2 * k));
    let mut all: Vec<(i64, i64)> = (r.j0..r.j1).flat_map(|j| (r.i0..r.i1).map(move |i| (i, j))).collect();
    all.sort_by_cached_key(|(i, j)| spread(i - r.i0) | spread(j - r.j0) << 1);
    all
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

/// Some rows of a source.
struct Rows {
    /// Rows of the file: `[first, end)`.
    first: u64,
    end: u64,
    data: Vec<u8>,
    /// One byte a post, 0 = void; `None` = all valid.
    valid: Option<Vec<u8>>,
}

/// A source that is read from the top, batch by batch, and what the key of its tile hashes.
struct Reading<'a> {
    source: &'a mut dyn HeightSource,
    info: &'a SourceInfo,
    /// Rows of a batch.
    batch: usize,
    /// Rows read so far.
    next: u64,
    hash: blake3::Hasher,
    message: Vec<u8>,
}

impl Reading<'_> {
    /// The next batch of rows; `None` at the end of the file.
    fn rows(&mut self) -> Result<Option<Rows>> {
        let rows = self.batch.min((self.info.rows - self.next) as usize);
        if rows == 0 {
            return Ok(None);
        }
        let (cols, width) = (self.info.cols as usize, self.info.sample_type.bytes());
        let s = self.source.read(Window { col: 0, row: self.next, cols, rows })?;
        if s.data.len() != cols * rows * width || s.valid.len() != cols * rows {
            return Err(Error::corrupt(
                &self.info.file,
                format!("rows {}..", self.next),
                "the source returned another extent",
            ));
        }
        // The message of a batch lies in one piece: blake3 takes several of its chunks side by side.
        self.message.clear();
        for (data, valid) in s.data.chunks_exact(cols * width).zip(s.valid.chunks_exact(cols)) {
            self.message.extend_from_slice(data);
            put_bits(&mut self.message, valid);
        }
        self.hash.put(&self.message);
        let first = self.next;
        self.next += rows as u64;
        let valid = s.valid.contains(&0).then_some(s.valid);
        Ok(Some(Rows { first, end: self.next, data: s.data, valid }))
    }
}

/// One bit a post, eight to a byte, lowest first.
fn put_bits(out: &mut Vec<u8>, valid: &[u8]) {
    if valid.contains(&0) {
        let bits = |c: &[u8]| c.iter().enumerate().fold(0, |b, (k, v)| b | u8::from(*v != 0) << k);
        out.extend(valid.chunks(8).map(bits));
    } else {
        out.resize(out.len() + valid.len() / 8, 0xff);
        if !valid.len().is_multiple_of(8) {
            out.put_u8((1 << (valid.len() % 8)) - 1);
        }
    }
}

/// A block of a tile, ready to be written.
struct Packed {
    bytes: Vec<u8>,
    valid: u32,
    /// Least and greatest sample, as stored.
    span: [f64; 2],
}

/// Packs the posts `r` of one block out of rows that hold them. `posts` are those of the whole file.
fn pack(held: &VecDeque<Rows>, posts: &CellRect, r: &CellRect, sample_type: SampleType) -> Packed {
    const ALL_VALID: [u8; (BLOCK * BLOCK) as usize] = [1; (BLOCK * BLOCK) as usize];
    let width = sample_type.bytes();
    let stride = posts.width() as usize;
    let (cols, rows) = (r.width() as usize, r.height() as usize);
    let (col, row0, row1) = ((r.i0 - posts.i0) as usize, (r.j0 - posts.j0) as u64, (r.j1 - posts.j0) as u64);
    let mut samples = Vec::with_capacity(cols * rows * width);
    let mut valid = Vec::new();
    let near = || held.iter().filter(|b| b.first < row1 && row0 < b.end);
    let voids = near().any(|b| b.valid.is_some());
    for b in near() {
        for row in row0.max(b.first)..row1.min(b.end) {
            let at = (row - b.first) as usize * stride + col;
            samples.extend_from_slice(&b.data[at * width..(at + cols) * width]);
            if voids {
                valid.extend_from_slice(b.valid.as_ref().map_or(&ALL_VALID[..cols], |v| &v[at..at + cols]));
            }
        }
    }
    let (count, span) = sample_type.span(&samples, if voids { &valid } else { &ALL_VALID[..cols * rows] });
    let raw = RawBlock {
        col: r.i0.rem_euclid(BLOCK) as usize,
        row: r.j0.rem_euclid(BLOCK) as usize,
        cols,
        rows,
        sample_type,
        samples,
        valid: valid.contains(&0).then_some(valid),
        fills: Vec::new(),
    };
    Packed { bytes: encode(&raw), valid: count as u32, span }
}

/// Reads a source once, top to bottom, and writes its blocks: while a batch of rows is read, the blocks that the rows
/// before it complete are packed. Holds two batches and a row of blocks.
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
    let mut hash = blake3::Hasher::new();
    hash.put(b"terraquilt tile 1");
    put_rect(&mut hash, &posts);
    let most = (limits::WINDOW_POSTS_MAX / info.cols.max(1)).max(1) as usize;
    let batch = source.row_batch().clamp(1, most);
    let mut reading = Reading { source, info: &info, batch, next: 0, hash, message: Vec::new() };
    let mut pages = Vec::with_capacity((blocks.width() * blocks.height()) as usize);
    let (mut valid_count, mut z) = (0u64, [f64::INFINITY, f64::NEG_INFINITY]);
    let mut held: VecDeque<Rows> = VecDeque::new();
    let mut came = reading.rows()?;
    let mut bj = blocks.j0;
    while bj < blocks.j1 {
        held.extend(came);
        progress.step("reading", reading.next as f64 / info.rows as f64)?;
        // Rows of blocks that are complete now.
        let end = posts.j0 + reading.next as i64;
        let stop = if end == posts.j1 { blocks.j1 } else { end.div_euclid(BLOCK).max(bj) };
        let whole: Vec<CellRect> = (bj..stop)
            .flat_map(|bj| (blocks.i0..blocks.i1).map(move |bi| (bi, bj)))
            .map(|(bi, bj)| posts_of(bi, bj).intersect(&posts))
            .collect();
        let (packed, next) = rayon::join(
            || whole.par_iter().map(|r| pack(&held, &posts, r, delivered.sample_type)).collect::<Vec<_>>(),
            || reading.rows(),
        );
        for p in packed {
            pages.push((out.append(&p.bytes)?, p.valid));
            valid_count += u64::from(p.valid);
            z = [z[0].min(p.span[0]), z[1].max(p.span[1])];
        }
        bj = stop;
        let done = bj * BLOCK - posts.j0;
        while held.front().is_some_and(|b| b.end as i64 <= done) {
            held.pop_front();
        }
        came = next?;
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
        key: reading.hash.finalize().as_bytes()[..16].try_into().expect("a hash has 32 bytes"),
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn bits_are_those_of_each_post() {
        for n in 0..40usize {
            for step in [1usize, 2, 3, 50] {
                let valid: Vec<u8> = (0..n).map(|k| u8::from(step == 50 || k % step != 0)).collect();
                let mut found = vec![7];
                put_bits(&mut found, &valid);
                assert_eq!(found.len(), 1 + n.div_ceil(8));
                let bit = |k: usize| found[1 + k / 8] >> (k % 8) & 1;
                assert!(
                    (0..found.len() * 8 - 8).all(|k| bit(k) == valid.get(k).copied().unwrap_or(0)),
                    "{valid:?}"
                );
            }
        }
    }

    #[test]
    fn the_curve_meets_each_index_once_and_goes_by_small_squares() {
        let r = CellRect::new(-3, -5, 13, 3);
        let way = along_curve(&r);
        assert_eq!(way.iter().collect::<BTreeSet<_>>().len(), 16 * 8);
        for four in way.chunks_exact(4) {
            let (i, j) = four[0];
            assert_eq!(four, [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)]);
        }
        assert!(along_curve(&CellRect::new(0, 0, 0, 9)).is_empty());
    }

    /// Blocks out of batches of any height, voids in some of them.
    #[test]
    fn blocks_are_packed_as_the_posts_lie() {
        let posts = CellRect::new(-30, 50, 170, 300);
        let sample = |i: i64, j: i64| (i * 31 + j * 7) as i16;
        let is_valid = |i: i64, j: i64| !(90..130).contains(&j) || (i + j) % 5 != 0;
        let mut held = VecDeque::new();
        let mut row = 0;
        for height in [1i64, 60, 64, 125] {
            let all = || (row..row + height).flat_map(|j| (0..200).map(move |i| (i - 30, j + 50)));
            let data = all().flat_map(|(i, j)| sample(i, j).to_le_bytes()).collect();
            let valid: Vec<u8> = all().map(|(i, j)| u8::from(is_valid(i, j))).collect();
            let valid = valid.contains(&0).then_some(valid);
            held.push_back(Rows { first: row as u64, end: (row + height) as u64, data, valid });
            row += height;
        }
        let blocks = blocks_of(&posts);
        for (bi, bj) in along_curve(&blocks) {
            let r = posts_of(bi, bj).intersect(&posts);
            let packed = pack(&held, &posts, &r, SampleType::I16);
            let raw = crate::height::block::decode(&packed.bytes, "t").unwrap();
            let all = || (r.j0..r.j1).flat_map(|j| (r.i0..r.i1).map(move |i| (i, j)));
            let kept: Vec<i16> = all().filter(|(i, j)| is_valid(*i, *j)).map(|(i, j)| sample(i, j)).collect();
            let span = [f64::from(*kept.iter().min().unwrap()), f64::from(*kept.iter().max().unwrap())];
            assert_eq!((packed.valid as usize, packed.span), (kept.len(), span));
            let (col, row) = (r.i0.rem_euclid(BLOCK) as usize, r.j0.rem_euclid(BLOCK) as usize);
            assert_eq!(
                (raw.col, raw.row, raw.cols as i64, raw.rows as i64),
                (col, row, r.width(), r.height())
            );
            assert!(
                raw.samples.chunks_exact(2).zip(all()).all(|(s, (i, j))| s == sample(i, j).to_le_bytes())
            );
            let valid: Vec<u8> = all().map(|(i, j)| u8::from(is_valid(i, j))).collect();
            assert_eq!(raw.valid, valid.contains(&0).then_some(valid));
        }
    }
}
