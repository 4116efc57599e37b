//! From samples to patches: what one survey is, rebuilt where its samples changed.
//!
//! Everything here is a function of (declaration, union of the samples). In order: level 0 (core cells, keys) with the blocks of
//! level 1, further levels (decimated, with fills), errors over every sample, content keys. A post is decoded once for the
//! first and once for the errors of all levels. Sections 8, 9, 12 and 13 of the LOD-space specification.

use super::change::Progress;
use super::errors::errors;
use super::head::{Declaration, Head, Tile};
use super::levels::{decimate, quarters, vertices_near};
use super::reader::{BlockCache, SampleReader};
use super::resample::{Resampling, warp_of};
use super::tile::{Directory, along_curve, blocks_of};
use crate::base::{Error, Result, limits};
use crate::height::block::{BLOCK, encode};
use crate::height::cells::Fill;
use crate::height::frame::CellRect;
use crate::height::lod::{Fact, LEVEL_MAX, Place, places_meeting, places_touching_posts};
use crate::height::patch::{Kind, bottom, id};
use crate::store::segment::{Layered, PageRef, SegmentWriter};
use crate::store::table::{PAGE_BLOCKS, PAGE_SIDE, PageAddress, PatchEntry, PatchPage, block_slot, slot};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

/// Places across a page.
const SIDE: i64 = PAGE_SIDE as i64;
/// Blocks of a level that are made before they are written.
const BLOCKS_AT_ONCE: usize = 256;

/// The state of a survey before the change.
pub struct Before<'a> {
    pub head: &'a Head,
    pub page: &'a (dyn Fn(PageAddress) -> Result<Option<Arc<PatchPage>>> + Sync),
}

/// A survey after the change.
pub struct Built {
    pub head: Head,
    /// Changed pages; `None`: the page went.
    pub pages: BTreeMap<PageAddress, Option<Arc<PatchPage>>>,
    /// Places whose fact or core changed, with what was and what is.
    pub changed: Vec<(Place, Option<PatchEntry>, Option<PatchEntry>)>,
    /// Pages of the previous state that are dead now.
    pub dead: Vec<PageRef>,
    /// Posts of the survey that may have changed.
    pub dirty: CellRect,
    /// What resampling did to the samples that changed, if the survey is resampled and it was asked for.
    pub resampling: Option<Resampling>,
}

/// What is built from.
pub struct Input<'a> {
    /// Of all patches of the database.
    pub kind: Kind,
    pub declaration: Declaration,
    /// Descending by key.
    pub tiles: Vec<(Tile, Arc<Directory>)>,
    pub before: Option<Before<'a>>,
    /// Delivered posts whose sample may have changed; everything if there is no state before.
    pub dirty: Vec<CellRect>,
    /// Compare the posts of a resampled survey with the samples they were made of.
    pub compare: bool,
    pub cache: &'a BlockCache,
    pub stamp: u64,
}

/// Builds the patch table of a survey. Levels are appended to `out`; patch pages are returned.
pub fn build(
    input: Input,
    base: &crate::store::segment::Files,
    out: &mut SegmentWriter,
    progress: &Progress,
) -> Result<Built> {
    let warp = warp_of(&input.declaration)?;
    let own = |posts: &CellRect| match &warp {
        None => Ok(*posts),
        Some(_) if posts.is_empty() => Ok(*posts),
        Some(w) => w.target_rect(posts, &input.declaration.name),
    };
    let mut dirty = CellRect::new(0, 0, 0, 0);
    for r in &input.dirty {
        dirty = dirty.union(&own(r)?);
    }
    // Every post that is there or comes; a larger rectangle does no harm.
    let mut posts = dirty;
    match (&warp, &input.before) {
        (None, _) => posts = input.tiles.iter().fold(posts, |r, (t, _)| r.union(&t.posts)),
        // Pages tell where resampled posts are: no tile is placed again.
        (Some(_), Some(b)) => {
            let level_0 = b.head.pages.iter().filter(|(a, _)| a.level == 0);
            posts = level_0.fold(posts, |r, (a, _)| r.union(&page_posts(*a)));
        }
        (Some(_), None) => {}
    }
    let extent = posts.union(&dirty);
    let span = extent.width() as u64 * extent.height() as u64;
    if span > limits::EXTENT_POSTS_MAX {
        return Err(Error::limit(
            format!(
                "posts in the rectangle around all tiles of '{}' (tiles far apart are surveys of their own)",
                input.declaration.name
            ),
            limits::EXTENT_POSTS_MAX,
            span,
        ));
    }
    let delivered = input.dirty.clone();
    let compare = input.compare;
    let mut b =
        Builder { input, posts, dirty, pages: BTreeMap::new(), blocks: HashMap::new(), changed: Vec::new() };
    if let Some(w) = &warp {
        b.resample(w, base, out, progress)?;
    }
    b.finest(base, out, progress)?;
    let core = b.core_rect()?;
    let level_max = level_max(&core)?;
    b.fills(level_max)?;
    for level in 1..=level_max {
        if level > 1 {
            b.level(level, base, out, progress)?;
        }
        b.note_blocks(level)?;
    }
    b.facts(level_max, base, out, progress)?;
    let resampling = match &warp {
        Some(w) if compare => Some(b.compare(w, &delivered, base, out, progress)?),
        _ => None,
    };
    let mut built = b.finish(level_max, core, out)?;
    built.resampling = resampling;
    Ok(built)
}

/// The least level at which the core needs at most 2 x 2 patches.
fn level_max(core: &CellRect) -> Result<u8> {
    (0..=LEVEL_MAX)
        .find(|l| {
            let p = places_meeting(*l, core);
            p.width() <= 2 && p.height() <= 2
        })
        .ok_or_else(|| Error::limit("levels of a survey", u64::from(LEVEL_MAX), u64::from(LEVEL_MAX) + 1))
}

pub(super) struct Builder<'a> {
    pub(super) input: Input<'a>,
    /// The rectangle of posts that tiles span, and those that may have changed.
    pub(super) posts: CellRect,
    pub(super) dirty: CellRect,
    /// Pages that change, as they will be.
    pages: BTreeMap<PageAddress, PatchPage>,
    /// New sample blocks of levels above 0.
    blocks: HashMap<(u8, i64, i64), Option<PageRef>>,
    changed: Vec<(Place, Option<PatchEntry>, Option<PatchEntry>)>,
}

impl Builder<'_> {
    fn before_page(&self, at: PageAddress) -> Result<Option<Arc<PatchPage>>> {
        match &self.input.before {
            Some(b) => (b.page)(at),
            None => Ok(None),
        }
    }

    pub(super) fn before_entry(&self, place: Place) -> Result<Option<PatchEntry>> {
        Ok(self.before_page(PageAddress::of_place(place))?.and_then(|p| p.patches[slot(place)]))
    }

    pub(super) fn edit(&mut self, at: PageAddress) -> Result<&mut PatchPage> {
        if !self.pages.contains_key(&at) {
            let page = self.before_page(at)?.map_or_else(PatchPage::default, |p| (*p).clone());
            self.pages.insert(at, page);
        }
        Ok(self.pages.get_mut(&at).expect("it was just put there"))
    }

    /// The fill of a place as it will be.
    fn core_fill(&self, place: Place) -> Result<Fill> {
        let at = PageAddress::of_place(place);
        if let Some(p) = self.pages.get(&at) {
            return Ok(p.patches[slot(place)].map_or(Fill::Empty, |e| e.core));
        }
        Ok(self.before_page(at)?.and_then(|p| p.patches[slot(place)]).map_or(Fill::Empty, |e| e.core))
    }

    fn level_before(&self) -> Option<u8> {
        self.input.before.as_ref().map(|b| b.head.level_max)
    }

    /// Whether everything of this level has to be built.
    pub(super) fn is_new(&self, level: u8) -> bool {
        self.level_before().is_none_or(|l| level > l)
    }

    /// The rectangle of delivered posts that tiles span.
    pub(super) fn delivered_posts(&self) -> CellRect {
        self.input.tiles.iter().fold(CellRect::new(0, 0, 0, 0), |r, (t, _)| r.union(&t.posts))
    }

    /// Whether a page is there or will be.
    pub(super) fn knows(&self, at: PageAddress) -> Result<bool> {
        Ok(self.pages.contains_key(&at) || self.before_page(at)?.is_some())
    }

    pub(super) fn set_block(&mut self, level: u8, bi: i64, bj: i64, at: Option<PageRef>) {
        self.blocks.insert((level, bi, bj), at);
    }

    pub(super) fn with_reader<R>(
        &self,
        base: &crate::store::segment::Files,
        out: &SegmentWriter,
        f: impl FnOnce(&SampleReader) -> Result<R>,
    ) -> Result<R> {
        let pages = Layered { base, writing: vec![out] };
        let levels = |level: u8, bi: i64, bj: i64| -> Result<Option<PageRef>> {
            if let Some(at) = self.blocks.get(&(level, bi, bj)) {
                return Ok(*at);
            }
            let at = PageAddress::of_block(level, bi, bj);
            Ok(self.before_page(at)?.and_then(|p| p.blocks[block_slot(bi, bj)]))
        };
        let reader = SampleReader {
            pages: &pages,
            declaration: &self.input.declaration,
            tiles: self.input.tiles.iter().map(|(t, d)| (t, d.clone())).collect(),
            levels: &levels,
            cache: self.input.cache,
            stamp: self.input.stamp,
        };
        f(&reader)
    }

    pub(super) fn set_fact(&mut self, place: Place, fact: Fact) -> Result<()> {
        if let Some(e) = &mut self.edit(PageAddress::of_place(place))?.patches[slot(place)] {
            e.fact = fact;
        }
        Ok(())
    }

    /// The smallest rectangle of cells that holds the core.
    fn core_rect(&self) -> Result<CellRect> {
        let mut rect = CellRect::new(0, 0, 0, 0);
        let mut add = |at: PageAddress, page: &PatchPage| {
            for (s, e) in page.patches.iter().enumerate() {
                let Some(e) = e else { continue };
                let r = at.place(s).rect();
                if rect.contains(&r) && !rect.is_empty() {
                    continue;
                }
                if e.core == Fill::Full {
                    rect = rect.union(&r);
                    continue;
                }
                let mut parts = Vec::new();
                page.block(s).rects(at.place(s).i, at.place(s).j, &r, &mut parts);
                for p in parts {
                    rect = rect.union(&p);
                }
            }
        };
        for (at, page) in self.pages.iter().filter(|(a, _)| a.level == 0) {
            add(*at, page);
        }
        if let Some(b) = &self.input.before {
            for (at, _) in b.head.pages.iter().filter(|(a, _)| a.level == 0 && !self.pages.contains_key(a)) {
                if let Some(p) = (b.page)(*at)? {
                    add(*at, &p);
                }
            }
        }
        if rect.is_empty() {
            return Err(Error::invalid(
                &self.input.declaration.name,
                "no cell has valid samples all around it (4 x 4 posts are the least); nothing could be certified. check --nodata",
            ));
        }
        Ok(rect)
    }

    /// How much of each rectangle above level 0 is core: page by page, each under a quarter of the page above.
    fn fills(&mut self, level_max: u8) -> Result<()> {
        const HALF: i32 = PAGE_SIDE / 2;
        let mut below: BTreeSet<(i32, i32)> =
            self.pages.keys().filter(|a| a.level == 0).map(|a| (a.i, a.j)).collect();
        for level in 1..=level_max {
            if self.is_new(level) {
                // The level did not exist: its places lie over every place below.
                if let Some(b) = &self.input.before {
                    let known = b.head.pages.iter().map(|(a, _)| a).filter(|a| a.level == level - 1);
                    below.extend(known.map(|a| (a.i, a.j)));
                }
            }
            for (i, j) in &below {
                let from = PageAddress { level: level - 1, i: *i, j: *j };
                let kept = if self.pages.contains_key(&from) { None } else { self.before_page(from)? };
                let Some(page) = self.pages.get(&from).or(kept.as_deref()) else { continue };
                let core = |a: i32, b: i32| {
                    page.patches[(b * PAGE_SIDE + a) as usize].map_or(Fill::Empty, |e| e.core)
                };
                let joined: Vec<(Place, Fill)> = (0..HALF * HALF)
                    .map(|k| (k % HALF, k / HALF))
                    .map(|(a, b)| {
                        let (c, d) = (2 * a, 2 * b);
                        let quarters = [core(c, d), core(c + 1, d), core(c, d + 1), core(c + 1, d + 1)];
                        (Place { level, i: i * HALF + a, j: j * HALF + b }, Fill::join(quarters))
                    })
                    .collect();
                for (place, fill) in joined {
                    if fill != Fill::Empty || self.before_entry(place)?.is_some() {
                        set_core(self.edit(PageAddress::of_place(place))?, slot(place), fill);
                    }
                }
            }
            below = below.iter().map(|(i, j)| (i >> 1, j >> 1)).collect();
        }
        Ok(())
    }

    /// Decimates the level below (not level 0, see [`Builder::finest`]) and fills the vertices without a sample.
    fn level(
        &mut self,
        level: u8,
        base: &crate::store::segment::Files,
        out: &mut SegmentWriter,
        progress: &Progress,
    ) -> Result<()> {
        let all = self.posts;
        let posts = if self.is_new(level) { all } else { self.dirty };
        for some in along_curve(&blocks_of(&vertices_near(&posts, level))).chunks(BLOCKS_AT_ONCE) {
            progress.check()?;
            let found: Vec<Option<Vec<u8>>> = self.with_reader(base, out, |reader| {
                some.par_iter()
                    .map(|(bi, bj)| {
                        let quarters = quarters(reader, level, *bi, *bj)?;
                        Ok(decimate(reader, level, (*bi, *bj), &quarters, &all)?.map(|b| encode(&b)))
                    })
                    .collect()
            })?;
            for ((bi, bj), bytes) in some.iter().zip(found) {
                let at = bytes.map(|b| out.append(&b)).transpose()?;
                self.blocks.insert((level, *bi, *bj), at);
            }
        }
        Ok(())
    }

    /// Names the new blocks of a level in its pages.
    fn note_blocks(&mut self, level: u8) -> Result<()> {
        let new: Vec<((u8, i64, i64), Option<PageRef>)> =
            self.blocks.iter().filter(|(k, _)| k.0 == level).map(|(k, v)| (*k, *v)).collect();
        for ((_, bi, bj), at) in new {
            let address = PageAddress::of_block(level, bi, bj);
            if at.is_some() || self.knows(address)? {
                self.edit(address)?.blocks[block_slot(bi, bj)] = at;
            }
        }
        Ok(())
    }

    /// Places of a level whose payload or error may have changed.
    pub(super) fn dirty_places(&self, level: u8, all: &CellRect) -> CellRect {
        let d = if self.is_new(level) { *all } else { self.dirty };
        let r = if level == 0 { 0 } else { 1i64 << level };
        places_touching_posts(level, d.i0 - r, d.j0 - r, d.i1 - 1 + r, d.j1 - 1 + r)
    }

    /// Errors and content keys above level 0.
    fn facts(
        &mut self,
        level_max: u8,
        base: &crate::store::segment::Files,
        out: &SegmentWriter,
        progress: &Progress,
    ) -> Result<()> {
        let all = self.posts;
        let ranges: Vec<CellRect> = (0..=level_max).map(|l| self.dirty_places(l, &all)).collect();
        let kind = self.input.kind;
        let deltas = self.with_reader(base, out, |reader| {
            let exists = |place| Ok(self.core_fill(place)? != Fill::Empty);
            errors(reader, kind, &ranges, &all, &exists, progress)
        })?;
        let declaration_id = self.input.declaration.id();
        let accuracy = self.input.declaration.accuracy_m;
        for level in 1..=level_max {
            let range = ranges[level as usize];
            let (i1, j1) = ((range.i1 - 1).div_euclid(SIDE) + 1, (range.j1 - 1).div_euclid(SIDE) + 1);
            let pages = CellRect::new(range.i0.div_euclid(SIDE), range.j0.div_euclid(SIDE), i1, j1);
            let found: Vec<Vec<(Place, Fact)>> = self.with_reader(base, out, |reader| {
                along_curve(&pages)
                    .into_par_iter()
                    .map(|(pi, pj)| {
                        let mut found = Vec::new();
                        let page = CellRect::new(pi * SIDE, pj * SIDE, (pi + 1) * SIDE, (pj + 1) * SIDE);
                        let here = page.intersect(&range);
                        for (i, j) in (here.j0..here.j1).flat_map(|j| (here.i0..here.i1).map(move |i| (i, j)))
                        {
                            let place = Place::new(level, i, j);
                            if self.core_fill(place)? == Fill::Empty {
                                continue;
                            }
                            let k = ((j - range.j0) * range.width() + i - range.i0) as usize;
                            let bot = bottom(accuracy, deltas[level as usize][k]);
                            let z = reader.vertices(kind, place)?;
                            found.push((place, Fact { id: id(kind, &declaration_id, place, &z, bot), bot }));
                        }
                        Ok(found)
                    })
                    .collect()
            })?;
            progress.step("keys", f64::from(level) / f64::from(level_max))?;
            for (place, fact) in found.into_iter().flatten() {
                self.set_fact(place, fact)?;
            }
        }
        Ok(())
    }

    fn finish(mut self, level_max: u8, core: CellRect, out: &mut SegmentWriter) -> Result<Built> {
        // Levels above the new top go.
        let gone: Vec<PageAddress> = self.input.before.as_ref().map_or(Vec::new(), |b| {
            b.head.pages.iter().map(|(a, _)| *a).filter(|a| a.level > level_max).collect()
        });
        for at in gone {
            self.pages.insert(at, PatchPage::default());
        }
        self.pages.retain(|a, p| a.level <= level_max || p.is_empty());
        // Blocks of level 1 that were made before it was known that there is no such level.
        let mut dead: Vec<PageRef> =
            self.blocks.iter().filter(|(k, _)| k.0 > level_max).filter_map(|(_, at)| *at).collect();
        let mut list: BTreeMap<PageAddress, PageRef> =
            self.input.before.as_ref().map_or(BTreeMap::new(), |b| b.head.pages.iter().copied().collect());
        let mut pages = BTreeMap::new();
        let mut patches = self.input.before.as_ref().map_or(0, |b| b.head.patches);
        for (at, page) in std::mem::take(&mut self.pages) {
            let old = self.before_page(at)?;
            if old.as_ref().is_some_and(|o| **o == page) {
                continue;
            }
            for k in 0..page.patches.len() {
                let (was, is) = (old.as_ref().and_then(|o| o.patches[k]), page.patches[k]);
                let block_changed =
                    at.level == 0 && old.as_ref().is_some_and(|o| o.block(k) != page.block(k));
                patches = patches + u64::from(is.is_some()) - u64::from(was.is_some());
                if was != is || block_changed {
                    self.changed.push((at.place(k), was, is));
                }
            }
            if let Some(o) = &old {
                dead.extend(
                    o.blocks.iter().zip(&page.blocks).filter(|(a, b)| a != b).filter_map(|(a, _)| *a),
                );
            }
            dead.extend(list.remove(&at));
            if page.is_empty() {
                pages.insert(at, None);
            } else {
                list.insert(at, out.append(&page.encode(at))?);
                pages.insert(at, Some(Arc::new(page)));
            }
        }
        let head = Head {
            declaration: self.input.declaration,
            tiles: self.input.tiles.into_iter().map(|(t, _)| t).collect(),
            level_max,
            core,
            patches,
            pages: list.into_iter().collect(),
        };
        Ok(Built { head, pages, changed: self.changed, dead, dirty: self.dirty, resampling: None })
    }
}

/// The posts of the sample blocks of a level-0 page.
fn page_posts(at: PageAddress) -> CellRect {
    let side = i64::from(PAGE_BLOCKS) * BLOCK;
    let (i, j) = (i64::from(at.i) * side, i64::from(at.j) * side);
    CellRect::new(i, j, i + side, j + side)
}

/// Says how much of a place is core; where there is none there is no patch.
pub(super) fn set_core(page: &mut PatchPage, slot: usize, core: Fill) {
    page.patches[slot] = match (core, page.patches[slot]) {
        (Fill::Empty, _) => None,
        (core, Some(e)) => Some(PatchEntry { core, ..e }),
        (core, None) => Some(PatchEntry { fact: Fact { id: Default::default(), bot: f32::INFINITY }, core }),
    };
}
