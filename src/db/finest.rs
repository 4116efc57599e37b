//! The finest level of a survey, square by square: a square of posts becomes core cells, content keys and blocks of level 1,
//! while it is in memory.
//!
//! A square is what a page of the patch table covers: 16 x 16 places, 4 x 4 blocks of posts, 2 x 2 blocks of level 1. Patches
//! of level 0 have no error, so their facts are complete here.

use super::build::{Builder, set_core};
use super::change::Progress;
use super::levels::{Quarters, decimate, vertices_near};
use super::reader::{SampleReader, close};
use super::tile::{along_curve, blocks_of};
use crate::base::Result;
use crate::height::block::encode;
use crate::height::cells::{Block, Fill};
use crate::height::frame::CellRect;
use crate::height::lod::{Fact, KERNEL, MARGIN, Place, SIDE, places_meeting};
use crate::height::patch::{Kind, Vertices, bottom, id};
use crate::store::segment::{Files, SegmentWriter};
use crate::store::table::{PAGE_BLOCKS, PAGE_SIDE, PageAddress, slot};
use rayon::prelude::*;

/// Squares of level 0 (half a megabyte of samples or more) whose results are held before they are written.
const SQUARES_AT_ONCE: usize = 64;

/// What is wanted, and of what.
struct Finest<'a> {
    reader: &'a SampleReader<'a>,
    kind: Kind,
    declaration: [u8; 16],
    accuracy_m: f64,
    /// The rectangle of posts that tiles span.
    all: CellRect,
    /// Places whose core cells are wanted.
    core: CellRect,
    /// Places whose facts are wanted.
    facts: CellRect,
    /// Blocks of level 1 that are wanted.
    above: CellRect,
    /// How much of a place is core that is not among the wanted ones.
    core_before: &'a (dyn Fn(Place) -> Result<Fill> + Sync),
}

/// A block of level 1 by its indices, packed; `None`: nothing is in it.
type PackedBlock = ((i64, i64), Option<Vec<u8>>);

/// What one square gives.
struct Square {
    core: Vec<(Place, Block)>,
    facts: Vec<(Place, Fact)>,
    above: Vec<PackedBlock>,
}

impl Finest<'_> {
    /// The squares in which something is wanted: `[i0, i1) x [j0, j1)`.
    fn squares(&self) -> CellRect {
        let over = |r: &CellRect, n: i64| {
            let (i1, j1) = ((r.i1 - 1).div_euclid(n) + 1, (r.j1 - 1).div_euclid(n) + 1);
            CellRect::new(r.i0.div_euclid(n), r.j0.div_euclid(n), i1, j1)
        };
        let places = self.core.union(&self.facts);
        let mut out = CellRect::new(0, 0, 0, 0);
        for (r, n) in [(&places, i64::from(PAGE_SIDE)), (&self.above, i64::from(PAGE_BLOCKS) / 2)] {
            if !r.is_empty() {
                out = out.union(&over(r, n));
            }
        }
        out
    }

    /// Makes one square. `window` is memory that was used before.
    fn square(&self, (i, j): (i64, i64), window: &mut Vec<f64>) -> Result<Square> {
        let of = |n: i64, r: &CellRect| CellRect::new(i * n, j * n, (i + 1) * n, (j + 1) * n).intersect(r);
        let side = i64::from(PAGE_SIDE);
        let (core, facts) = (of(side, &self.core), of(side, &self.facts));
        let above = self.above(&of(i64::from(PAGE_BLOCKS) / 2, &self.above))?;
        let mut out = Square { core: Vec::new(), facts: Vec::new(), above };
        let places =
            [core, facts].iter().filter(|r| !r.is_empty()).fold(CellRect::new(0, 0, 0, 0), |a, b| a.union(b));
        if places.is_empty() {
            return Ok(out);
        }
        // The posts of all domains; those around core cells are among them.
        let held = CellRect::new(
            places.i0 * KERNEL - MARGIN,
            places.j0 * KERNEL - MARGIN,
            places.i1 * KERNEL + MARGIN + 1,
            places.j1 * KERNEL + MARGIN + 1,
        );
        let void = self.reader.posts_are_void(&blocks_of(&held))?;
        if !void {
            self.reader.posts_into(&held, window)?;
        }
        let whole = !void && window.iter().all(|h| !h.is_nan());
        let width = held.width() as usize;
        let first = |p: Place, before: i64| {
            let r = p.rect();
            (r.j0 - before - held.j0) as usize * width + (r.i0 - before - held.i0) as usize
        };
        for place in places_in(&places) {
            let inside = |r: &CellRect| {
                (r.i0..r.i1).contains(&i64::from(place.i)) && (r.j0..r.j1).contains(&i64::from(place.j))
            };
            let fill = if inside(&core) {
                let block = match (void, whole) {
                    (true, _) => Block::EMPTY,
                    (_, true) => Block::FULL,
                    _ => core_at(&window[first(place, 1)..], width),
                };
                out.core.push((place, block));
                block.fill()
            } else {
                (self.core_before)(place)?
            };
            if fill == Fill::Empty || !inside(&facts) {
                continue;
            }
            let mut z: Vertices = [f64::NAN; SIDE * SIDE];
            if !void {
                let at = first(place, MARGIN);
                for (b, row) in z.chunks_exact_mut(SIDE).enumerate() {
                    row.copy_from_slice(&window[at + b * width..][..SIDE]);
                }
            }
            if !whole {
                close(self.kind, &mut z);
            }
            let bot = bottom(self.accuracy_m, 0.0);
            out.facts.push((place, Fact { id: id(self.kind, &self.declaration, place, &z, bot), bot }));
        }
        Ok(out)
    }

    /// Blocks of level 1. What was read for them is kept for the window of posts.
    fn above(&self, wanted: &CellRect) -> Result<Vec<PackedBlock>> {
        let mut out = Vec::new();
        for bj in wanted.j0..wanted.j1 {
            for bi in wanted.i0..wanted.i1 {
                let mut quarters = Quarters::default();
                for (q, raws) in quarters.iter_mut().enumerate() {
                    let (ci, cj) = (2 * bi + (q as i64 & 1), 2 * bj + (q as i64 >> 1));
                    *raws = self.reader.post_blocks(ci, cj)?;
                    self.reader.keep_posts(ci, cj, raws);
                }
                let block = decimate(self.reader, 1, (bi, bj), &quarters, &self.all)?;
                out.push(((bi, bj), block.map(|b| encode(&b))));
            }
        }
        Ok(out)
    }
}

impl Builder<'_> {
    /// Level 0: core cells and facts of the places where they may have changed, and the blocks of level 1 over them.
    pub(super) fn finest(
        &mut self,
        base: &Files,
        out: &mut SegmentWriter,
        progress: &Progress,
    ) -> Result<()> {
        let (d, all) = (self.dirty, self.posts);
        // A cell is core by the 4 x 4 posts around it.
        let cells = CellRect::new(d.i0 - 2, d.j0 - 2, d.i1 + 1, d.j1 + 1);
        let core = places_meeting(0, &cells);
        let facts = self.dirty_places(0, &all);
        let above = blocks_of(&vertices_near(if self.is_new(1) { &all } else { &d }, 1));
        let (declaration, accuracy_m) = (self.input.declaration.id(), self.input.declaration.accuracy_m);
        let mut squares: Option<Vec<(i64, i64)>> = None;
        let mut done = 0;
        loop {
            let found: Vec<Square> = self.with_reader(base, out, |reader| {
                let core_before = |place| Ok(self.before_entry(place)?.map_or(Fill::Empty, |e| e.core));
                let finest = Finest {
                    reader,
                    kind: self.input.kind,
                    declaration,
                    accuracy_m,
                    all,
                    core,
                    facts,
                    above,
                    core_before: &core_before,
                };
                let squares = squares.get_or_insert_with(|| along_curve(&finest.squares()));
                progress.step("levels", done as f64 / squares.len().max(1) as f64)?;
                let some = &squares[done..(done + SQUARES_AT_ONCE).min(squares.len())];
                some.par_iter().map_init(Vec::new, |window, at| finest.square(*at, window)).collect()
            })?;
            if found.is_empty() {
                return Ok(());
            }
            done += found.len();
            for square in found {
                self.take_square(square, out)?;
            }
        }
    }

    fn take_square(&mut self, square: Square, out: &mut SegmentWriter) -> Result<()> {
        for (place, block) in square.core {
            let fill = block.fill();
            if fill == Fill::Empty && self.before_entry(place)?.is_none() {
                continue;
            }
            let page = self.edit(PageAddress::of_place(place))?;
            set_core(page, slot(place), fill);
            page.set_block(slot(place), Some(block));
        }
        for (place, fact) in square.facts {
            self.set_fact(place, fact)?;
        }
        for ((bi, bj), bytes) in square.above {
            let at = bytes.map(|b| out.append(&b)).transpose()?;
            self.set_block(1, bi, bj, at);
        }
        Ok(())
    }
}

fn places_in(r: &CellRect) -> impl Iterator<Item = Place> + use<> {
    let r = *r;
    (r.j0..r.j1).flat_map(move |j| (r.i0..r.i1).map(move |i| Place::new(0, i, j)))
}

/// The core cells of a place: `posts` (NaN = void) begins one post before its kernel rectangle.
fn core_at(posts: &[f64], width: usize) -> Block {
    let mut rows = [0u32; KERNEL as usize + 3];
    for (b, bits) in rows.iter_mut().enumerate() {
        let row = &posts[b * width..][..KERNEL as usize + 3];
        *bits = row.iter().enumerate().fold(0, |m, (a, h)| m | u32::from(!h.is_nan()) << a);
    }
    Block::core_of(&rows)
}
