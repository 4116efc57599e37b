//! The errors of a survey's patches: one pass over its posts, bands of rows in parallel (section 8 of the LOD-space
//! specification). What an error is, is in `height::patch`; here is what has to be read for it.

use super::change::Progress;
use super::reader::SampleReader;
use super::tile::blocks_of;
use crate::base::Result;
use crate::height::block::BLOCK;
use crate::height::frame::CellRect;
use crate::height::lod::{Place, places_touching_posts};
use crate::height::patch::bicubic::Spline;
use crate::height::patch::{Kind, Residuals, worst};
use rayon::prelude::*;
use std::sync::Mutex;

/// The wanted places of one level that a band of posts touches.
struct Touched {
    level: u8,
    places: CellRect,
    /// First column of posts in their closed domains, and the first one after.
    lo: i64,
    hi: i64,
}

/// A band of posts: whole rows of the columns that some wanted place needs, voids as NaN.
struct Band {
    held: CellRect,
    posts: Vec<f64>,
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
    let totals: Vec<Mutex<Vec<f64>>> =
        ranges.iter().map(|r| Mutex::new(vec![0.0; (r.width() * r.height()) as usize])).collect();
    let rows = blocks_of(all);
    let done = std::sync::atomic::AtomicU64::new(0);
    let bands: Vec<i64> = if ranges.len() < 2 { Vec::new() } else { (rows.j0..rows.j1).collect() };
    bands.into_par_iter().with_max_len(1).try_for_each(|bj| -> Result<()> {
        let (j0, j1) = ((bj * BLOCK).max(all.j0), ((bj + 1) * BLOCK).min(all.j1));
        let touched = touched(ranges, all, j0, j1);
        if touched.is_empty() {
            return Ok(());
        }
        progress.check()?;
        let cols = touched
            .iter()
            .fold(CellRect::new(0, 0, 0, 0), |c, t| c.union(&CellRect::new(t.lo, j0, t.hi, j1)));
        let held = CellRect::new(cols.i0, j0, cols.i1, j1);
        let band = Band { posts: reader.posts(&held)?, held };
        for t in &touched {
            let found = match kind {
                Kind::Bilinear => bilinear(reader, t, &band)?,
                Kind::Bicubic => bicubic(reader, t, &band, exists)?,
            };
            let range = &ranges[t.level as usize];
            let mut total =
                totals[t.level as usize].lock().expect("no thread panicked while holding the errors");
            for (k, d) in found.into_iter().enumerate() {
                let (pi, pj) =
                    (t.places.i0 + k as i64 % t.places.width(), t.places.j0 + k as i64 / t.places.width());
                let most = &mut total[((pj - range.j0) * range.width() + pi - range.i0) as usize];
                *most = most.max(d);
            }
        }
        let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
        progress.step("errors", n as f64 / rows.height() as f64)
    })?;
    Ok(totals
        .into_iter()
        .map(|m| m.into_inner().expect("no thread panicked while holding the errors"))
        .collect())
}

/// What a band of rows `[j0, j1)` has to do with each level.
fn touched(ranges: &[CellRect], all: &CellRect, j0: i64, j1: i64) -> Vec<Touched> {
    let mut out = Vec::new();
    for (level, range) in ranges.iter().enumerate().skip(1) {
        let level = level as u8;
        let near = places_touching_posts(level, i64::MIN / 4, j0, i64::MAX / 4, j1 - 1);
        let places = CellRect::new(range.i0, range.j0.max(near.j0), range.i1, range.j1.min(near.j1));
        if places.is_empty() {
            continue;
        }
        let lo = Place::new(level, places.i0, 0).domain().i0.max(all.i0);
        let hi = (Place::new(level, places.i1 - 1, 0).domain().i1 + 1).min(all.i1);
        if lo < hi {
            out.push(Touched { level, places, lo, hi });
        }
    }
    out
}

/// All patches of the level share one map of errors, since they agree where they overlap.
fn bilinear(reader: &SampleReader, t: &Touched, band: &Band) -> Result<Vec<f64>> {
    let mut gather = Residuals::new(t.level, t.places, t.lo, (t.hi - t.lo) as usize);
    let (v0, vn) = gather.vertices();
    let (mut below, mut above) = (vec![0.0; vn], vec![0.0; vn]);
    let mut at = i64::MIN;
    let width = band.held.width() as usize;
    for j in band.held.j0..band.held.j1 {
        if !gather.wants(j) {
            continue;
        }
        let v = j >> t.level;
        if v != at {
            if v == at.wrapping_add(1) {
                std::mem::swap(&mut below, &mut above);
            } else {
                reader.line(t.level, v0, v, &mut below)?;
            }
            reader.line(t.level, v0, v + 1, &mut above)?;
            at = v;
        }
        let row = &band.posts[(j - band.held.j0) as usize * width..][..width];
        let from = (t.lo - band.held.i0) as usize;
        gather.row(j, &row[from..from + (t.hi - t.lo) as usize], &below, &above);
    }
    Ok(gather.finish())
}

/// Each patch for itself: its spline has its own ends.
fn bicubic(
    reader: &SampleReader,
    t: &Touched,
    band: &Band,
    exists: &(dyn Fn(Place) -> Result<bool> + Sync),
) -> Result<Vec<f64>> {
    let places = (t.places.j0..t.places.j1).flat_map(|j| (t.places.i0..t.places.i1).map(move |i| (i, j)));
    places
        .map(|(i, j)| {
            let place = Place::new(t.level, i, j);
            if !exists(place)? {
                return Ok(0.0);
            }
            let spline = Spline::new(&*reader.vertices(Kind::Bicubic, place)?);
            Ok(worst(&spline, place, &band.held, &band.posts))
        })
        .collect()
}
