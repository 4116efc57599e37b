//! Levels above 0: every other vertex of the level below, with fills where there is no sample (sections 8 and 9 of the
//! LOD-space specification).

use super::reader::SampleReader;
use super::tile::{blocks_of, posts_of};
use crate::base::Result;
use crate::height::block::{BLOCK, RawBlock};
use crate::height::frame::CellRect;
use rayon::prelude::*;

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

const N: usize = BLOCK as usize;

/// The raw blocks of the level below that lie under block (bi, bj) of a level: south-west, south-east, north-west, north-east;
/// each in the order in which they are laid.
pub type Quarters = [Vec<RawBlock>; 4];

/// Reads what lies under a block of a level.
pub fn quarters(reader: &SampleReader, level: u8, bi: i64, bj: i64) -> Result<Quarters> {
    let mut out = Quarters::default();
    for (q, raws) in out.iter_mut().enumerate() {
        let q = q as i64;
        *raws = reader.raw_blocks(level - 1, 2 * bi + (q & 1), 2 * bj + (q >> 1))?;
    }
    Ok(out)
}

/// Lays every other sample of a raw block that lies under quarter `q` of a block with samples of `W` bytes.
fn lay<const W: usize>(raw: &RawBlock, q: usize, samples: &mut [u8], valid: &mut [u8]) {
    let (samples, from) = (samples.as_chunks_mut::<W>().0, raw.samples.as_chunks::<W>().0);
    let (oi, oj) = ((q & 1) * N / 2, (q >> 1) * N / 2);
    let (first_row, first_col) = (raw.row % 2, raw.col % 2);
    if first_col >= raw.cols {
        return;
    }
    for r in (first_row..raw.rows).step_by(2) {
        let at = (oj + (raw.row + r) / 2) * N + oi + (raw.col + first_col) / 2;
        let here = r * raw.cols + first_col..(r + 1) * raw.cols;
        let to = samples[at..].iter_mut().zip(&mut valid[at..]);
        match &raw.valid {
            None => {
                for ((s, v), h) in to.zip(from[here].iter().step_by(2)) {
                    (*s, *v) = (*h, 1);
                }
            }
            Some(mask) => {
                let held = from[here.clone()].iter().step_by(2).zip(mask[here].iter().step_by(2));
                for ((s, v), (h, _)) in to.zip(held).filter(|(_, (_, ok))| **ok != 0) {
                    (*s, *v) = (*h, 1);
                }
            }
        }
    }
}

/// One block of a level: every other vertex of the level below, with fills. `None` if nothing is in it.
pub fn decimate(
    reader: &SampleReader,
    level: u8,
    (bi, bj): (i64, i64),
    quarters: &Quarters,
    all: &CellRect,
) -> Result<Option<RawBlock>> {
    let t = reader.declaration.sample_type;
    let w = t.bytes();
    let mut samples = vec![0u8; N * N * w];
    let mut valid = vec![0u8; N * N];
    for (q, raws) in quarters.iter().enumerate() {
        for raw in raws {
            match w {
                1 => lay::<1>(raw, q, &mut samples, &mut valid),
                2 => lay::<2>(raw, q, &mut samples, &mut valid),
                4 => lay::<4>(raw, q, &mut samples, &mut valid),
                _ => lay::<8>(raw, q, &mut samples, &mut valid),
            }
        }
    }
    if !valid.contains(&0) {
        let fills = Vec::new();
        return Ok(Some(RawBlock {
            col: 0,
            row: 0,
            cols: N,
            rows: N,
            sample_type: t,
            samples,
            valid: None,
            fills,
        }));
    }
    // The smallest rectangle that holds every vertex with a sample or a fill: a function of the samples near.
    let own = posts_of(bi, bj).intersect(&vertices_near(all, level));
    if own.is_empty() {
        return Ok(None);
    }
    let own =
        CellRect::new(own.i0 - bi * BLOCK, own.j0 - bj * BLOCK, own.i1 - bi * BLOCK, own.j1 - bj * BLOCK);
    let vertices = || (own.j0..own.j1).flat_map(|b| (own.i0..own.i1).map(move |a| (a, b)));
    let open: Vec<(i64, i64)> = vertices().filter(|(a, b)| valid[(b * BLOCK + a) as usize] == 0).collect();
    let found: Vec<Option<f32>> = open
        .par_iter()
        .with_min_len(16)
        .map(|(a, b)| fill(reader, level, bi * BLOCK + a, bj * BLOCK + b, all))
        .collect::<Result<_>>()?;
    let mut filled = vec![None; N * N];
    for ((a, b), f) in open.iter().zip(found) {
        filled[(b * BLOCK + a) as usize] = f;
    }
    let mut held = CellRect::new(0, 0, 0, 0);
    for (a, b) in vertices() {
        let k = (b * BLOCK + a) as usize;
        if valid[k] != 0 || filled[k].is_some() {
            held = held.union(&CellRect::new(a, b, a + 1, b + 1));
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
    if reader.posts_are_void(&blocks_of(&window))? {
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
