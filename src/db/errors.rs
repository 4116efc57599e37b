//! The errors of a survey's patches: one pass over its posts, block by block, all levels over a block while it is at hand
//! (section 8 of the LOD-space specification). What an error is, is in `height::patch`; here is what has to be read for it.

use super::change::Progress;
use super::reader::SampleReader;
use super::tile::{along_curve, blocks_of, posts_of};
use crate::base::Result;
use crate::height::block::BLOCK;
use crate::height::frame::CellRect;
use crate::height::lod::{Place, places_touching_posts};
use crate::height::patch::bicubic::Spline;
use crate::height::patch::{Kind, Residuals, worst};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Blocks across a square of posts that one thread takes.
const SQUARE: i64 = 4;

/// The wanted places of one level that a rectangle of posts touches, and the posts that lie in their domains.
struct Touched {
    level: u8,
    places: CellRect,
    posts: CellRect,
}

/// Largest errors so far, level by level, row-major over the level's range. An error is no less than 0, so its bits are
/// in its order.
struct Totals<'a> {
    ranges: &'a [CellRect],
    most: Vec<Vec<AtomicU64>>,
}

impl Totals<'_> {
    /// Takes the errors of a rectangle of places, row-major.
    fn add(&self, level: u8, places: &CellRect, found: &[f64]) {
        let (range, most) = (&self.ranges[level as usize], &self.most[level as usize]);
        for (pj, row) in (places.j0..places.j1).zip(found.chunks_exact(places.width() as usize)) {
            let at = ((pj - range.j0) * range.width() + places.i0 - range.i0) as usize;
            for (total, d) in most[at..].iter().zip(row) {
                total.fetch_max(d.to_bits(), Ordering::Relaxed);
            }
        }
    }
}

/// Memory that was used before.
#[derive(Default)]
struct Scratch {
    posts: Vec<f64>,
    vertices: Vec<f64>,
}

/// Largest error of every wanted place of every level above 0, row-major over the level's range. Places for which
/// `exists` says no may be given 0.
pub fn errors(
    reader: &SampleReader,
    kind: Kind,
    ranges: &[CellRect],
    all: &CellRect,
    exists: &(dyn Fn(Place) -> Result<bool> + Sync),
    progress: &Progress,
) -> Result<Vec<Vec<f64>>> {
    let count = |r: &CellRect| (r.width() * r.height()) as usize;
    let most = ranges.iter().map(|r| (0..count(r)).map(|_| AtomicU64::new(0)).collect()).collect();
    let totals = Totals { ranges, most };
    let blocks = blocks_of(all);
    let squares = CellRect::new(
        blocks.i0.div_euclid(SQUARE),
        blocks.j0.div_euclid(SQUARE),
        (blocks.i1 - 1).div_euclid(SQUARE) + 1,
        (blocks.j1 - 1).div_euclid(SQUARE) + 1,
    );
    let squares = if ranges.len() < 2 { Vec::new() } else { along_curve(&squares) };
    let done = AtomicU64::new(0);
    squares.par_iter().try_for_each_init(Scratch::default, |scratch, (i, j)| -> Result<()> {
        progress.check()?;
        let square = CellRect::new(i * SQUARE, j * SQUARE, (i + 1) * SQUARE, (j + 1) * SQUARE);
        match kind {
            Kind::Bilinear => {
                for bj in square.j0..square.j1 {
                    for bi in square.i0..square.i1 {
                        bilinear(reader, (bi, bj), all, &totals, scratch)?;
                    }
                }
            }
            Kind::Bicubic => bicubic(reader, &square, all, &totals, exists, scratch)?,
        }
        let n = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress.step("errors", n as f64 / squares.len() as f64)
    })?;
    let plain = |v: Vec<AtomicU64>| v.into_iter().map(|d| f64::from_bits(d.into_inner())).collect();
    Ok(totals.most.into_iter().map(plain).collect())
}

/// What a rectangle of posts has to do with each level.
fn touched(ranges: &[CellRect], held: &CellRect) -> Vec<Touched> {
    let mut out = Vec::new();
    if held.is_empty() {
        return out;
    }
    for (level, range) in ranges.iter().enumerate().skip(1) {
        let level = level as u8;
        let near = places_touching_posts(level, held.i0, held.j0, held.i1 - 1, held.j1 - 1);
        let places = near.intersect(range);
        if places.is_empty() {
            continue;
        }
        let first = Place::new(level, places.i0, places.j0).domain();
        let last = Place::new(level, places.i1 - 1, places.j1 - 1).domain();
        let posts = CellRect::new(first.i0, first.j0, last.i1 + 1, last.j1 + 1).intersect(held);
        if !posts.is_empty() {
            out.push(Touched { level, places, posts });
        }
    }
    out
}

/// One block of posts. All patches of a level share one map of errors, since they agree where they overlap.
fn bilinear(
    reader: &SampleReader,
    (bi, bj): (i64, i64),
    all: &CellRect,
    totals: &Totals,
    scratch: &mut Scratch,
) -> Result<()> {
    let block = posts_of(bi, bj);
    let touched = touched(totals.ranges, &block.intersect(all));
    if touched.is_empty() || reader.is_void(bi, bj)? {
        return Ok(());
    }
    let heights = reader.passing_posts(bi, bj)?;
    let posts = match &heights.valid {
        None => &heights.z,
        Some(valid) => {
            scratch.posts.clear();
            let posts = heights.z.iter().zip(valid).map(|(h, v)| if *v == 0 { f64::NAN } else { *h });
            scratch.posts.extend(posts);
            &scratch.posts
        }
    };
    for t in &touched {
        let mut gather = Residuals::new(t.level, t.places, t.posts.i0, t.posts.width() as usize);
        let (v0, vn) = gather.vertices();
        let (first, last) = (t.posts.j0 >> t.level, ((t.posts.j1 - 1) >> t.level) + 1);
        let held = CellRect::new(v0, first, v0 + vn as i64, last + 1);
        reader.vertices_into(t.level, &held, &mut scratch.vertices)?;
        for j in t.posts.j0..t.posts.j1 {
            let below = ((j >> t.level) - first) as usize * vn;
            let (below, above) = scratch.vertices[below..].split_at(vn);
            let at = ((j - block.j0) * BLOCK + t.posts.i0 - block.i0) as usize;
            gather.row(j, &posts[at..at + t.posts.width() as usize], below, &above[..vn]);
        }
        totals.add(t.level, &t.places, &gather.finish());
    }
    Ok(())
}

/// A square of blocks, each patch for itself: its spline has its own ends.
fn bicubic(
    reader: &SampleReader,
    square: &CellRect,
    all: &CellRect,
    totals: &Totals,
    exists: &(dyn Fn(Place) -> Result<bool> + Sync),
    scratch: &mut Scratch,
) -> Result<()> {
    let side = |k: i64| k * BLOCK;
    let held =
        CellRect::new(side(square.i0), side(square.j0), side(square.i1), side(square.j1)).intersect(all);
    let touched = touched(totals.ranges, &held);
    if touched.is_empty() || reader.posts_are_void(square)? {
        return Ok(());
    }
    reader.posts_into(&held, &mut scratch.posts)?;
    for t in &touched {
        for (i, j) in (t.places.j0..t.places.j1).flat_map(|j| (t.places.i0..t.places.i1).map(move |i| (i, j)))
        {
            let place = Place::new(t.level, i, j);
            if exists(place)? {
                let spline = Spline::new(&*reader.vertices(Kind::Bicubic, place)?);
                let found = worst(&spline, place, &held, &scratch.posts);
                totals.add(t.level, &CellRect::new(i, j, i + 1, j + 1), &[found]);
            }
        }
    }
    Ok(())
}
