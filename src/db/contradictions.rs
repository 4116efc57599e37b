//! Where two surveys say different things of the same ground (section 15 of the LOD-space specification).
//!
//! f_G0 and f_H0 are the level-0 surfaces of two surveys: their samples, bilinear between four valid posts. Where both
//! have a value and |f_H0 - f_G0| > e_H + e_G, one of the two stated accuracies is false or the ground has changed.
//! They are compared at the centres of the cells of the coarser survey G, so a report costs what the overlap costs;
//! of more than [`CELLS_MAX`] cells every n-th of every n-th row is taken.

use super::database::Snapshot;
use super::head::{Declaration, Head};
use super::reader::{BlockCache, SampleReader};
use super::tile::Directory;
use super::triangles::metres_per_unit;
use super::view::{Rules, Tables, View};
use super::writing::Writing;
use crate::base::Result;
use crate::base::lattice::Point;
use crate::height::block::{BLOCK, Heights};
use crate::height::crs::AxisUnit;
use crate::height::frame::{CellRect, Frame, LatticeUnit};
use crate::height::lod::{SurveyNumber, World};
use crate::store::segment::{Layered, SegmentWriter};
use crate::store::table::{PageAddress, PatchPage, block_slot};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Cells of one pair of surveys that are compared at most.
pub const CELLS_MAX: i64 = 1 << 22;
/// Cells compared by one thread at a time: rows, and columns of a run (so that blocks of samples stay at hand).
const ROWS: usize = 32;
const RUN: usize = 64;

/// Two surveys that overlap, compared. Differences are the finer survey minus the coarser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    pub coarser: String,
    pub finer: String,
    /// Sum of the two stated accuracies, metres: a larger difference contradicts one of them.
    pub allowed_m: f64,
    /// Ground that both surveys cover, square metres, and the part of it where they contradict each other.
    pub overlap_m2: f64,
    pub contradicted_m2: f64,
    pub share: f64,
    /// Of the differences in the whole overlap, metres.
    pub mean_m: f64,
    pub std_m: f64,
    /// The difference farthest from 0, and where it is.
    pub largest_m: f64,
    pub largest_at: [f64; 2],
    /// Cells of the coarser survey that were compared, and those that contradict.
    pub cells: u64,
    pub contradicted_cells: u64,
    /// Every n-th cell of every n-th row was compared.
    pub every: i64,
    /// What the figures suggest.
    pub hint: Option<String>,
}

/// The differences of a pair, cell by cell.
#[derive(Clone, Debug)]
pub struct Overlap {
    pub found: Contradiction,
    /// The coarser survey's frame, in lattice units, and the cells that were looked at.
    pub frame: Frame,
    pub unit: LatticeUnit,
    pub cells: CellRect,
    /// Looked at in each axis: one cell stands for `every` x `every`.
    pub cols: usize,
    pub rows: usize,
    /// Finer minus coarser, metres; NaN where not both have data. Row by row from the cell (i0, j0).
    pub difference: Vec<f32>,
}

impl Overlap {
    pub fn contradicts(&self, col: usize, row: usize) -> bool {
        f64::from(self.difference[row * self.cols + col]).abs() > self.found.allowed_m
    }

    /// Where the corner of a looked-at cell lies, CRS units.
    pub fn corner(&self, col: usize, row: usize) -> [f64; 2] {
        let n = self.found.every;
        let i = (self.cells.i0 + col as i64 * n).min(self.cells.i1);
        let j = (self.cells.j0 + row as i64 * n).min(self.cells.j1);
        let p = self.frame.post(i, j);
        [p.x as f64 * self.unit.size(), p.y as f64 * self.unit.size()]
    }

    /// The difference at a point (CRS units), NaN outside.
    pub fn at(&self, p: [f64; 2]) -> f32 {
        let (Some(x), Some(y)) = (self.unit.round(p[0]), self.unit.round(p[1])) else { return f32::NAN };
        let (i, j) = self.frame.index(Point::new(x, y));
        let n = self.found.every as f64;
        let (c, r) = ((i - self.cells.i0 as f64).div_euclid(n), (j - self.cells.j0 as f64).div_euclid(n));
        if c < 0.0 || r < 0.0 || c >= self.cols as f64 || r >= self.rows as f64 {
            return f32::NAN;
        }
        self.difference[r as usize * self.cols + c as usize]
    }
}

/// One survey of a pair.
struct Side<'a> {
    name: &'a str,
    frame: Frame,
    /// Nominal area of a cell, CRS units squared.
    cell: f64,
    accuracy: f64,
    posts: CellRect,
    id: [u8; 16],
    samples: &'a SampleReader<'a>,
}

impl<'a> Side<'a> {
    fn new(d: &'a Declaration, posts: CellRect, samples: &'a SampleReader<'a>) -> Side<'a> {
        let steps = d.lattice.nominal_steps();
        Side {
            name: &d.name,
            frame: d.frame,
            cell: steps[0] * steps[1],
            accuracy: f64::from(d.accuracy()),
            posts,
            id: d.id(),
            samples,
        }
    }

    fn cells(&self) -> CellRect {
        CellRect::new(self.posts.i0, self.posts.j0, self.posts.i1 - 1, self.posts.j1 - 1)
    }
}

/// Reads the level-0 surface point by point; keeps the block met last.
struct Cursor<'a> {
    samples: &'a SampleReader<'a>,
    /// Block indices, and the block if anything in it is valid.
    last: Option<([i64; 2], Option<Arc<Heights>>)>,
}

impl<'a> Cursor<'a> {
    fn new(samples: &'a SampleReader<'a>) -> Cursor<'a> {
        Cursor { samples, last: None }
    }

    fn block(&mut self, at: [i64; 2]) -> Result<Option<&Heights>> {
        if self.last.as_ref().is_none_or(|(k, _)| *k != at) {
            let block = match self.samples.is_void(at[0], at[1])? {
                true => None,
                false => Some(self.samples.block(0, at[0], at[1])?),
            };
            self.last = Some((at, block));
        }
        Ok(self.last.as_ref().and_then(|(_, b)| b.as_deref()))
    }

    /// The posts (i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1); NaN for those that are void. Those of weight 0 need not be
    /// read, and may be NaN, too.
    fn posts(&mut self, i: i64, j: i64, weights: &[f64; 4]) -> Result<[f64; 4]> {
        const N: usize = BLOCK as usize;
        let at = [i.div_euclid(BLOCK), j.div_euclid(BLOCK)];
        let (a, b) = ((i - at[0] * BLOCK) as usize, (j - at[1] * BLOCK) as usize);
        if a + 1 < N && b + 1 < N {
            let Some(block) = self.block(at)? else { return Ok([f64::NAN; 4]) };
            let k = b * N + a;
            let around = [k, k + 1, k + N, k + N + 1];
            return Ok(match &block.valid {
                None => around.map(|k| block.z[k]),
                Some(valid) => around.map(|k| if valid[k] != 0 { block.z[k] } else { f64::NAN }),
            });
        }
        let mut z = [f64::NAN; 4];
        for (k, z) in z.iter_mut().enumerate().filter(|(k, _)| weights[*k] > 0.0) {
            let (i, j) = (i + k as i64 % 2, j + k as i64 / 2);
            let at = [i.div_euclid(BLOCK), j.div_euclid(BLOCK)];
            if let Some(block) = self.block(at)? {
                let (a, b) = ((i - at[0] * BLOCK) as usize, (j - at[1] * BLOCK) as usize);
                if block.is_valid(a, b) {
                    *z = block.z[b * N + a];
                }
            }
        }
        Ok(z)
    }

    /// The bilinear height at index coordinates, if every post that has weight is valid.
    fn height(&mut self, i: f64, j: f64) -> Result<Option<f64>> {
        // Closer to a post line than this is on it: index coordinates are good to 1e-6 of a cell.
        const ON: f64 = 1e-6;
        let split = |v: f64| {
            // The whole part, by integers: indices are far below 2^53, and rounding to a float is a call on most machines.
            let n = v as i64 - i64::from(v as i64 as f64 > v);
            let part = v - n as f64;
            match () {
                () if part < ON => (n, 0.0),
                () if (n + 1) as f64 - v < ON => (n + 1, 0.0),
                () => (n, part),
            }
        };
        let ((a, x), (b, y)) = (split(i), split(j));
        let weights = [(1.0 - x) * (1.0 - y), x * (1.0 - y), (1.0 - x) * y, x * y];
        let posts = self.posts(a, b, &weights)?;
        let mut z = 0.0;
        for (w, h) in weights.into_iter().zip(posts) {
            if w > 0.0 {
                z += w * h;
            }
        }
        Ok((!z.is_nan()).then_some(z))
    }
}

/// Sums over some rows.
#[derive(Clone, Copy, Default)]
struct Sums {
    cells: u64,
    contradicted: u64,
    area: f64,
    area_contradicted: f64,
    sum: f64,
    squares: f64,
    largest: f64,
    at: [f64; 2],
}

impl Sums {
    fn and(mut self, o: &Sums) -> Sums {
        self.cells += o.cells;
        self.contradicted += o.contradicted;
        self.area += o.area;
        self.area_contradicted += o.area_contradicted;
        self.sum += o.sum;
        self.squares += o.squares;
        if o.largest.abs() > self.largest.abs() {
            (self.largest, self.at) = (o.largest, o.at);
        }
        self
    }
}

/// Compares two surveys inside a window of the first one's (`a`'s) cells; `None`: they share no ground there.
fn compare(
    a: &Side,
    b: &Side,
    window: Option<&CellRect>,
    unit: LatticeUnit,
    axis: AxisUnit,
) -> Result<Option<Overlap>> {
    // The coarser is G; of equal steps the less accurate, then the greater id: whoever came first.
    let rank = |s: &Side| (s.cell, s.accuracy);
    let a_is_coarser = rank(a).partial_cmp(&rank(b)).is_none_or(|o| o.then_with(|| a.id.cmp(&b.id)).is_gt());
    let (g, h) = if a_is_coarser { (a, b) } else { (b, a) };
    let mut cells = g.cells().intersect(&g.frame.cells_meeting(&h.frame.quad(&h.cells())));
    if let Some(w) = window {
        cells = cells.intersect(&match a_is_coarser {
            true => *w,
            false => g.frame.cells_meeting(&a.frame.quad(w)),
        });
    }
    if cells.is_empty() {
        return Ok(None);
    }
    let every =
        ((cells.width() as f64 * cells.height() as f64 / CELLS_MAX as f64).sqrt().ceil() as i64).max(1);
    let count = |n: i64| ((n + every - 1) / every) as usize;
    let (cols, rows) = (count(cells.width()), count(cells.height()));
    let allowed = g.accuracy + h.accuracy;
    let size = unit.size();
    let cell_units = g.frame.determinant().unsigned_abs() as f64 * size * size * (every * every) as f64;
    let mut difference = vec![f32::NAN; cols * rows];
    let chunk = |first: usize, lines: &mut [f32]| -> Result<Sums> {
        let mut sums = Sums::default();
        let mut on_g = Cursor::new(g.samples);
        let mut on_h = Cursor::new(h.samples);
        for from in (0..cols).step_by(RUN) {
            for row in 0..lines.len() / cols {
                for col in from..(from + RUN).min(cols) {
                    let middle =
                        |k: usize, from: i64, to: i64| (from + k as i64 * every + every / 2).min(to - 1);
                    let (i, j) = (middle(col, cells.i0, cells.i1), middle(first + row, cells.j0, cells.j1));
                    let Some(zg) = on_g.height(i as f64 + 0.5, j as f64 + 0.5)? else { continue };
                    let (p, q) = (g.frame.post(i, j), g.frame.post(i + 1, j + 1));
                    let centre = Point::new(p.x + (q.x - p.x) / 2, p.y + (q.y - p.y) / 2);
                    let (u, v) = h.frame.index(centre);
                    let Some(zh) = on_h.height(u, v)? else { continue };
                    let d = zh - zg;
                    lines[row * cols + col] = d as f32;
                    let at = [centre.x as f64 * size, centre.y as f64 * size];
                    let k = metres_per_unit(axis, at);
                    let contradicts = d.abs() > allowed;
                    let area = cell_units * k[0] * k[1];
                    sums.cells += 1;
                    sums.area += area;
                    sums.sum += d;
                    sums.squares += d * d;
                    if contradicts {
                        sums.contradicted += 1;
                        sums.area_contradicted += area;
                    }
                    if d.abs() > sums.largest.abs() {
                        (sums.largest, sums.at) = (d, at);
                    }
                }
            }
        }
        Ok(sums)
    };
    let parts: Vec<Sums> = difference
        .par_chunks_mut(cols * ROWS)
        .enumerate()
        .map(|(k, lines)| chunk(k * ROWS, lines))
        .collect::<Result<_>>()?;
    let s = parts.iter().fold(Sums::default(), |s, p| s.and(p));
    if s.cells == 0 {
        return Ok(None);
    }
    let n = s.cells as f64;
    let mean = s.sum / n;
    let std = (s.squares / n - mean * mean).max(0.0).sqrt();
    let found = Contradiction {
        coarser: g.name.to_string(),
        finer: h.name.to_string(),
        allowed_m: allowed,
        overlap_m2: s.area,
        contradicted_m2: s.area_contradicted,
        share: s.area_contradicted / s.area,
        mean_m: mean,
        std_m: std,
        largest_m: s.largest,
        largest_at: s.at,
        cells: s.cells,
        contradicted_cells: s.contradicted,
        every,
        hint: (s.contradicted > 0 && mean.abs() > 2.0 * std && mean.abs() > allowed)
            .then(|| "nearly the same everywhere: datum slip? (another vertical datum or unit)".into()),
    };
    Ok(Some(Overlap { found, frame: g.frame, unit, cells, cols, rows, difference }))
}

/// Calls `f` with a survey of a version as one side of a pair.
fn with_side<R>(view: &View, n: SurveyNumber, f: impl FnOnce(&Side) -> Result<R>) -> Result<R> {
    let head = view.head(n)?.clone();
    view.with_samples(n, |samples| f(&Side::new(&head.declaration, head.own_posts(), samples)))
}

impl Snapshot {
    /// Compares every two surveys that overlap, or the two named; calls `f` with each pair, in order of arrival.
    pub fn contradictions(
        &self,
        named: Option<[&str; 2]>,
        mut f: impl FnMut(Overlap) -> Result<()>,
    ) -> Result<()> {
        let pairs: Vec<[SurveyNumber; 2]> = match named {
            Some([a, b]) => vec![[self.survey(a)?.number, self.survey(b)?.number]],
            None => {
                let rules = Rules(&self.view);
                let all = self.view.entries();
                all.values()
                    .flat_map(|e| {
                        let near = rules.meeting(&e.geometry.bounds());
                        near.into_iter().filter(|o| *o > e.number).map(|o| [e.number, o])
                    })
                    .collect()
            }
        };
        for [a, b] in pairs {
            let found = with_side(&self.view, a, |a| {
                with_side(&self.view, b, |b| compare(a, b, None, self.unit, self.crs.unit))
            })?;
            if let Some(o) = found {
                f(o)?;
            }
        }
        Ok(())
    }
}

/// A survey as it will be once the files that arrive are in.
pub(super) struct Arriving<'a> {
    pub survey: SurveyNumber,
    pub head: &'a Head,
    /// Directories of its tiles, in their order.
    pub directories: Vec<Arc<Directory>>,
    /// Patch pages that changed.
    pub pages: &'a BTreeMap<PageAddress, Option<Arc<PatchPage>>>,
    /// Posts that may have changed.
    pub dirty: CellRect,
    /// Where new pages are.
    pub segment: &'a SegmentWriter,
    /// Its decoded blocks, from when it was built.
    pub blocks: &'a BlockCache,
    pub stamp: u64,
}

impl Writing {
    /// Compares what arrives with every other survey under it; pairs without a contradiction are left out.
    pub(super) fn contradictions(
        &self,
        new: &Arriving,
        unit: LatticeUnit,
        axis: AxisUnit,
    ) -> Result<Vec<Contradiction>> {
        let pages = Layered { base: &self.view.files, writing: vec![new.segment] };
        let view = &self.view;
        let levels = |level: u8, bi: i64, bj: i64| {
            let at = PageAddress::of_block(level, bi, bj);
            let page = match new.pages.get(&at) {
                Some(p) => p.clone(),
                None if view.entries().contains_key(&new.survey) => view.patch_page(new.survey, at)?,
                None => None,
            };
            Ok(page.and_then(|p| p.blocks[block_slot(bi, bj)]))
        };
        let declaration = &new.head.declaration;
        let samples = SampleReader {
            pages: &pages,
            declaration,
            tiles: new.head.tiles.iter().zip(new.directories.iter().cloned()).collect(),
            levels: &levels,
            cache: new.blocks,
            stamp: new.stamp,
        };
        let side = Side::new(declaration, new.head.own_posts(), &samples);
        let window = new.dirty.grow(1);
        let bounds = declaration.frame.bounds(&window);
        let mut out = Vec::new();
        for other in Rules(&self.view).meeting(&bounds) {
            if other == new.survey {
                continue;
            }
            let found = with_side(&self.view, other, |o| compare(&side, o, Some(&window), unit, axis))?;
            out.extend(found.map(|o| o.found).filter(|c| c.contradicted_cells > 0));
        }
        Ok(out)
    }
}
