//! Levels above 0: every other vertex of the level below, with fills where there is no sample (sections 8 and 9 of the
//! LOD-space specification).

use super::reader::SampleReader;
use super::tile::blocks_of;
use crate::base::Result;
use crate::height::block::{BLOCK, RawBlock};
use crate::height::frame::CellRect;

/// Vertices of a level that posts can change: `[i0, i1) x [j0, j1)`.
pub fn vertices_near(posts: &CellRect, level: u8) -> CellRect {
    let r = 1i64 << level;
    CellRect::new(
        posts.i0.div_euclid(r),
        posts.j0.div_euclid(r),
        (posts.i1 - 1).div_euclid(r) + 2,
        (posts.j1 - 1).div_euclid(r) + 2,
    )
}

/// One block of a level: every other vertex of the level below, with fills. `None` if nothing is in it.
pub fn decimate(
    reader: &SampleReader,
    level: u8,
    bi: i64,
    bj: i64,
    all: &CellRect,
) -> Result<Option<RawBlock>> {
    const N: usize = BLOCK as usize;
    let t = reader.declaration.sample_type;
    let w = t.bytes();
    let mut samples = vec![0u8; N * N * w];
    let mut valid = vec![0u8; N * N];
    for q in 0..4usize {
        let (ci, cj) = (2 * bi + (q as i64 & 1), 2 * bj + (q as i64 >> 1));
        let raws = if level == 1 {
            reader.post_blocks(ci, cj)?
        } else {
            match (reader.levels)(level - 1, ci, cj)? {
                Some(at) => vec![reader.raw(&at)?],
                None => Vec::new(),
            }
        };
        let (oi, oj) = ((q & 1) * N / 2, (q >> 1) * N / 2);
        for raw in raws {
            for r in (raw.row % 2..raw.rows).step_by(2) {
                for c in (raw.col % 2..raw.cols).step_by(2) {
                    let k = r * raw.cols + c;
                    if raw.valid.as_ref().is_none_or(|v| v[k] != 0) {
                        let at = (oj + (raw.row + r) / 2) * N + oi + (raw.col + c) / 2;
                        samples[at * w..(at + 1) * w].copy_from_slice(&raw.samples[k * w..(k + 1) * w]);
                        valid[at] = 1;
                    }
                }
            }
        }
    }
    // The smallest rectangle that holds every vertex with a sample or a fill: a function of the samples near.
    let near = vertices_near(all, level);
    let own = CellRect::new(bi * BLOCK, bj * BLOCK, (bi + 1) * BLOCK, (bj + 1) * BLOCK).intersect(&near);
    let mut filled = vec![None; N * N];
    let mut held = CellRect::new(0, 0, 0, 0);
    for j in own.j0..own.j1 {
        for i in own.i0..own.i1 {
            let (a, b) = (i - bi * BLOCK, j - bj * BLOCK);
            let k = (b * BLOCK + a) as usize;
            if valid[k] == 0 {
                filled[k] = fill(reader, level, i, j, all)?;
            }
            if valid[k] != 0 || filled[k].is_some() {
                held = held.union(&CellRect::new(a, b, a + 1, b + 1));
            }
        }
    }
    if held.is_empty() {
        return Ok(None);
    }
    let (col, row) = (held.i0 as usize, held.j0 as usize);
    let (cols, rows) = (held.width() as usize, held.height() as usize);
    let mut cut_samples = Vec::with_capacity(cols * rows * w);
    let mut cut_valid = Vec::with_capacity(cols * rows);
    let mut fills = Vec::new();
    for b in row..row + rows {
        cut_samples.extend_from_slice(&samples[(b * N + col) * w..(b * N + col + cols) * w]);
        cut_valid.extend_from_slice(&valid[b * N + col..b * N + col + cols]);
        for k in b * N + col..b * N + col + cols {
            if valid[k] == 0 {
                fills.push(filled[k].unwrap_or(0.0));
            }
        }
    }
    let voids = !fills.is_empty();
    Ok(Some(RawBlock {
        col,
        row,
        cols,
        rows,
        sample_type: t,
        samples: cut_samples,
        valid: voids.then_some(cut_valid),
        fills,
    }))
}

/// The fill of a vertex without a sample: the mean of the valid samples less than one level step away in both axes,
/// summed in index order (section 9), rounded to `f32`.
fn fill(reader: &SampleReader, level: u8, i: i64, j: i64, all: &CellRect) -> Result<Option<f32>> {
    let r = 1i64 << level;
    let window = CellRect::new(i * r - r + 1, j * r - r + 1, i * r + r, j * r + r).intersect(all);
    if window.is_empty() {
        return Ok(None);
    }
    let blocks = blocks_of(&window);
    let mut all_void = true;
    for bj in blocks.j0..blocks.j1 {
        for bi in blocks.i0..blocks.i1 {
            all_void = all_void && reader.is_void(bi, bj)?;
        }
    }
    if all_void {
        return Ok(None);
    }
    let (mut sum, mut n) = (0.0f64, 0u64);
    // Row bands of one block height keep memory small; order stays row by row.
    let mut j0 = window.j0;
    while j0 < window.j1 {
        let j1 = ((j0.div_euclid(BLOCK) + 1) * BLOCK).min(window.j1);
        for h in reader.posts(&CellRect::new(window.i0, j0, window.i1, j1))? {
            if !h.is_nan() {
                sum += h;
                n += 1;
            }
        }
        j0 = j1;
    }
    Ok((n > 0).then(|| (sum / n as f64) as f32))
}
