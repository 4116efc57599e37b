//! The local update: what a commit changes in kernels, tops, floors and tree (section 12 of the LOD-space
//! specification). Equal to a fresh build, and only as dear as what is touched.
//!
//! 1. core' of the changed surveys and of lower ones that meet a core cell which came or went: flips;
//! 2. how much of each rectangle above a flip is left;
//! 3. top and floor of every patch whose kernel meets a flip or a kernel of a patch that came or went, unless the
//!    change is provably beside it (smaller, or not below its top);
//! 4. the records that differ go into the tree.

use super::change::Progress;
use super::root::SurveyEntry;
use super::sheets::Sheets;
use super::view::{Index, Tables, View};
use crate::base::Result;
use crate::base::lattice::Quad;
use crate::height::cells::{Block, Fill};
use crate::height::frame::CellRect;
use crate::height::lod::cutter::standing;
use crate::height::lod::{Fact, Geometry, Place, Standing, SurveyNumber, cover, places_meeting};
use crate::store::quadtree::{Domains, Record};
use crate::store::table::{PageAddress, PatchEntry, PatchPage, TopEntry, TopPage, slot};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::sync::Arc;

/// A version in the making: the tables of the base with pages laid over them.
pub struct Draft<'a> {
    pub base: &'a View,
    pub entries: BTreeMap<SurveyNumber, SurveyEntry>,
    index: Index,
    patches: BTreeMap<(SurveyNumber, PageAddress), Option<Arc<PatchPage>>>,
    tops: HashMap<(SurveyNumber, PageAddress), Option<Arc<TopPage>>>,
}

impl Tables for Draft<'_> {
    fn entries(&self) -> &BTreeMap<SurveyNumber, SurveyEntry> {
        &self.entries
    }

    fn index(&self) -> &Index {
        &self.index
    }

    fn patch_page(&self, survey: SurveyNumber, at: PageAddress) -> Result<Option<Arc<PatchPage>>> {
        match self.patches.get(&(survey, at)) {
            Some(p) => Ok(p.clone()),
            None if self.base.entries().contains_key(&survey) => self.base.patch_page(survey, at),
            None => Ok(None),
        }
    }

    fn top_page(&self, survey: SurveyNumber, at: PageAddress) -> Result<Option<Arc<TopPage>>> {
        match self.tops.get(&(survey, at)) {
            Some(p) => Ok(p.clone()),
            None if self.base.entries().contains_key(&survey) => self.base.top_page(survey, at),
            None => Ok(None),
        }
    }
}

/// Domains of records of the base and of the draft.
impl Domains for Draft<'_> {
    fn domain(&self, r: &Record) -> Quad {
        let g = match self.entries.get(&r.survey) {
            Some(e) => &e.geometry,
            None => self.base.geometry_of(r.survey),
        };
        g.frame.quad(&r.place.domain())
    }
}

/// A survey whose samples changed (or that is new).
pub struct Rebuilt {
    pub survey: SurveyNumber,
    pub pages: BTreeMap<PageAddress, Option<Arc<PatchPage>>>,
    pub changed: Vec<(Place, Option<PatchEntry>, Option<PatchEntry>)>,
}

/// What a commit changed below the root.
#[derive(Default)]
pub struct Changes {
    /// Changed pages of the top table.
    pub tops: BTreeMap<(SurveyNumber, PageAddress), Option<Arc<TopPage>>>,
    pub gone: Vec<Record>,
    pub come: Vec<Record>,
    /// Level-0 places where core' changed.
    pub flips: BTreeMap<SurveyNumber, BTreeSet<(i32, i32)>>,
    /// Tops that were computed, and live and dormant patches per touched survey.
    pub computed: u64,
    pub counts: BTreeMap<SurveyNumber, (i64, i64)>,
}

/// A patch that came, went, changed its error or its kernel: the least of its errors, old and new.
pub(super) type Moved = HashMap<SurveyNumber, HashMap<Place, f32>>;

impl<'a> Draft<'a> {
    pub fn new(base: &'a View, entries: BTreeMap<SurveyNumber, SurveyEntry>) -> Draft<'a> {
        let index = Index::new(entries.values());
        Draft { base, entries, index, patches: BTreeMap::new(), tops: HashMap::new() }
    }

    /// Lays pages over those of the base.
    pub(super) fn lay(&mut self, s: SurveyNumber, at: PageAddress, page: Arc<PatchPage>, tops: Arc<TopPage>) {
        self.patches.insert((s, at), Some(page));
        self.tops.insert((s, at), Some(tops));
    }

    /// Where a survey of the draft may have pages, ascending.
    pub(super) fn addresses(&self, s: SurveyNumber) -> Result<Vec<PageAddress>> {
        let mut out: Vec<PageAddress> = match self.base.entries().contains_key(&s) {
            true => self.base.head(s)?.pages.iter().map(|(at, _)| *at).collect(),
            false => Vec::new(),
        };
        let first = PageAddress { level: 0, i: i32::MIN, j: i32::MIN };
        let laid = self.patches.range((s, first)..).map(|(key, _)| *key);
        out.extend(laid.take_while(|(n, _)| *n == s).map(|(_, at)| at));
        out.sort_unstable();
        out.dedup();
        Ok(out)
    }

    pub(super) fn geometry_either(&self, s: SurveyNumber) -> &Geometry {
        match self.entries.get(&s) {
            Some(e) => &e.geometry,
            None => self.base.geometry_of(s),
        }
    }

    fn edit_top(&mut self, survey: SurveyNumber, at: PageAddress) -> Result<&mut TopPage> {
        if !self.tops.contains_key(&(survey, at)) {
            let page = self.top_page(survey, at)?;
            self.tops.insert((survey, at), page);
        }
        let page = self.tops.get_mut(&(survey, at)).expect("it was just put there");
        Ok(Arc::make_mut(page.get_or_insert_with(Default::default)))
    }

    /// Computes everything that the change of surveys does to kernels, tops and tree.
    ///
    /// `rebuilt`: the survey whose samples changed, if any. Surveys in the base but not in the draft went; surveys
    /// whose precedence differs were re-ranked.
    pub fn derive(&mut self, rebuilt: Option<Rebuilt>, progress: &Progress) -> Result<Changes> {
        let rebuilt = match rebuilt {
            Some(r) if self.is_alone(&r) => return self.derive_alone(r, progress),
            other => other,
        };
        let mut out = Changes::default();
        let mut moved: Moved = HashMap::new();
        let mut changed: Vec<(SurveyNumber, Place, Option<PatchEntry>, Option<PatchEntry>)> = Vec::new();
        // Level-0 places whose core changed, and surveys whose rank did: they may flip cells of lower surveys.
        let mut stirred: BTreeMap<SurveyNumber, Vec<(i32, i32)>> = BTreeMap::new();
        if let Some(r) = rebuilt {
            for (at, page) in r.pages {
                self.patches.insert((r.survey, at), page);
            }
            for (place, was, is) in r.changed {
                if place.level == 0 {
                    stirred.entry(r.survey).or_default().push((place.i, place.j));
                }
                changed.push((r.survey, place, was, is));
            }
        }
        let base_entries = self.base.entries();
        let mut ranks: HashMap<SurveyNumber, i64> = HashMap::new();
        for (n, old) in base_entries {
            let new = self.entries.get(n);
            match new {
                None => {
                    let mut places = Vec::new();
                    self.base.each_patch_page(*n, |at, page| {
                        for (k, e) in page.patches.iter().enumerate() {
                            if let Some(e) = e {
                                changed.push((*n, at.place(k), Some(*e), None));
                                if at.level == 0 {
                                    places.push((at.place(k).i, at.place(k).j));
                                }
                            }
                        }
                        Ok(())
                    })?;
                    stirred.insert(*n, places);
                }
                Some(e) if e.geometry.precedence != old.geometry.precedence => {
                    let places = stirred.entry(*n).or_default();
                    let head = self.base.head(*n)?.clone();
                    for (at, _) in head.pages.iter().filter(|(a, _)| a.level == 0) {
                        if let Some(page) = self.base.patch_page(*n, *at)? {
                            places.extend(
                                page.patches
                                    .iter()
                                    .enumerate()
                                    .filter(|(_, e)| e.is_some())
                                    .map(|(k, _)| (at.place(k).i, at.place(k).j)),
                            );
                        }
                    }
                }
                Some(_) => {}
            }
            let new_rank = new.map_or(old.geometry.precedence, |e| e.geometry.precedence);
            ranks.insert(*n, old.geometry.precedence.max(new_rank));
        }
        for (n, e) in &self.entries {
            ranks.entry(*n).or_insert(e.geometry.precedence);
        }

        // Entries of the top table for patches that came; none for those that went.
        for (s, place, was, is) in &changed {
            let least = [was, is].into_iter().flatten().map(|e| e.fact.bot).fold(f32::INFINITY, f32::min);
            moved.entry(*s).or_default().insert(*place, least);
            if !self.entries.contains_key(s) {
                continue;
            }
            let k = slot(*place);
            let page = self.edit_top(*s, PageAddress::of_place(*place))?;
            match (is, page.tops[k]) {
                (None, _) => {
                    page.tops[k] = None;
                    page.set_block(k, None);
                }
                (Some(_), None) => {
                    let standing = Standing { top: f32::NAN, floor: false };
                    page.tops[k] = Some(TopEntry { standing, kernel: Fill::Empty });
                }
                (Some(_), Some(_)) => {}
            }
        }
        let flipped = self.flip(&stirred, &ranks, &mut out, progress)?;
        for (s, places) in &flipped {
            for place in places {
                if let Some(e) = self.patch(*s, *place)? {
                    let least = moved.entry(*s).or_default().entry(*place).or_insert(e.fact.bot);
                    *least = least.min(e.fact.bot);
                }
            }
        }
        let dirty = self.dirty(&changed, &flipped, &moved)?;
        self.stand(&dirty, &mut out, progress)?;
        self.records(&changed, &dirty, &mut out)?;
        for ((s, at), page) in std::mem::take(&mut self.tops) {
            if !self.entries.contains_key(&s) {
                continue;
            }
            let page = page.filter(|p| !p.is_empty());
            let before = if base_entries.contains_key(&s) { self.base.top_page(s, at)? } else { None };
            if page.as_deref() != before.as_deref() {
                out.tops.insert((s, at), page.clone());
            }
            self.tops.insert((s, at), page);
        }
        Ok(out)
    }

    /// Step 1 and 2: recomputes core' where it may have changed. Returns every place whose kernel changed.
    fn flip(
        &mut self,
        stirred: &BTreeMap<SurveyNumber, Vec<(i32, i32)>>,
        ranks: &HashMap<SurveyNumber, i64>,
        out: &mut Changes,
        progress: &Progress,
    ) -> Result<HashMap<SurveyNumber, HashSet<Place>>> {
        let mut work: BTreeMap<SurveyNumber, BTreeSet<(i32, i32)>> = BTreeMap::new();
        for (s, places) in stirred {
            if self.entries.contains_key(s) {
                work.entry(*s).or_default().extend(places.iter().copied());
            }
            let g = self.geometry_either(*s);
            // Where its core is or was: a tile may have left.
            let reach =
                self.base.entries().get(s).map_or(g.bounds(), |e| e.geometry.bounds().union(&g.bounds()));
            let (rank, areas) = (ranks[s], joined(places));
            for (h, e) in &self.entries {
                if h == s || e.geometry.precedence >= rank || !e.geometry.bounds().overlaps(&reach) {
                    continue;
                }
                let set = work.entry(*h).or_default();
                for area in &areas {
                    let cells =
                        e.geometry.frame.cells_meeting(&g.frame.quad(area)).intersect(&e.geometry.core);
                    let range = places_meeting(0, &cells);
                    for j in range.j0..range.j1 {
                        set.extend((range.i0..range.i1).map(|i| (i as i32, j as i32)));
                    }
                }
            }
        }
        let list: Vec<(SurveyNumber, i32, i32)> =
            work.iter().flat_map(|(s, p)| p.iter().map(|(i, j)| (*s, *i, *j))).collect();
        let done = std::sync::atomic::AtomicU64::new(0);
        let found: Vec<Block> = {
            let sheets = Sheets::new(self);
            list.par_iter()
                .map(|(s, i, j)| {
                    let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if n.is_multiple_of(1024) {
                        progress.step("precedence", n as f64 / list.len() as f64)?;
                    }
                    cover::core_prime(&sheets, *s, *i, *j)
                })
                .collect::<Result<_>>()?
        };
        let mut flipped: HashMap<SurveyNumber, HashSet<Place>> = HashMap::new();
        for ((s, i, j), block) in list.iter().zip(found) {
            let place = Place { level: 0, i: *i, j: *j };
            let at = PageAddress::of_place(place);
            let k = slot(place);
            let (was, entry) =
                self.top_page(*s, at)?.map_or((Block::EMPTY, None), |p| (p.block(k), p.tops[k]));
            let Some(entry) = entry else {
                // The place went: its cells left every rectangle above it.
                if self.base.entries().contains_key(s)
                    && self.base.top(*s, place)?.is_some_and(|t| t.kernel != Fill::Empty)
                {
                    flipped.entry(*s).or_default().insert(place);
                    out.flips.entry(*s).or_default().insert((*i, *j));
                }
                continue;
            };
            if was == block && entry.kernel == block.fill() {
                continue;
            }
            let page = self.edit_top(*s, at)?;
            page.tops[k] = Some(TopEntry { kernel: block.fill(), ..entry });
            page.set_block(k, Some(block));
            flipped.entry(*s).or_default().insert(place);
            out.flips.entry(*s).or_default().insert((*i, *j));
        }
        // Places above a flip, and places that came: what is left of their rectangles.
        for (s, e) in self.entries.clone() {
            let mut places: BTreeSet<Place> =
                flipped.get(&s).map_or(BTreeSet::new(), |f| f.iter().copied().collect());
            for level in 1..=e.geometry.level_max {
                let mut above: BTreeSet<Place> = places.iter().map(Place::parent).collect();
                // A place that came without a flip below it (its children had come before): a new top level.
                above.extend(self.unset(s, level));
                for place in &above {
                    let Some(entry) = self.top(s, *place)? else { continue };
                    let mut fills = [Fill::Empty; 4];
                    for (f, c) in fills.iter_mut().zip(place.children()) {
                        *f = self.top(s, c)?.map_or(Fill::Empty, |t| t.kernel);
                    }
                    let kernel = Fill::join(fills);
                    if kernel != entry.kernel {
                        let k = slot(*place);
                        self.edit_top(s, PageAddress::of_place(*place))?.tops[k] =
                            Some(TopEntry { kernel, ..entry });
                    }
                    // Its cells changed even if it was and is mixed.
                    flipped.entry(s).or_default().insert(*place);
                }
                places = above;
            }
        }
        Ok(flipped)
    }

    /// Places of a level in pages being edited that have no top yet.
    fn unset(&self, s: SurveyNumber, level: u8) -> Vec<Place> {
        let mut out = Vec::new();
        for ((n, at), page) in &self.tops {
            if *n == s
                && at.level == level
                && let Some(p) = page
            {
                let new =
                    p.tops.iter().enumerate().filter(|(_, t)| t.is_some_and(|t| t.standing.top.is_nan()));
                out.extend(new.map(|(k, _)| at.place(k)));
            }
        }
        out
    }

    /// Step 3, what: tops and floors, in parallel.
    fn stand(
        &mut self,
        dirty: &[(SurveyNumber, Place, Fact)],
        out: &mut Changes,
        progress: &Progress,
    ) -> Result<()> {
        let done = std::sync::atomic::AtomicU64::new(0);
        let found: Vec<Standing> = {
            let sheets = Sheets::new(self);
            dirty
                .par_iter()
                .with_max_len(256)
                .map(|(s, place, fact)| {
                    let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if n.is_multiple_of(256) {
                        progress.step("tops", n as f64 / dirty.len() as f64)?;
                    }
                    standing(&sheets, *s, *place, fact)
                })
                .collect::<Result<_>>()?
        };
        out.computed = dirty.len() as u64;
        for ((s, place, _), standing) in dirty.iter().zip(found) {
            let k = slot(*place);
            if let Some(t) = self.top(*s, *place)?
                && t.standing != standing
            {
                self.edit_top(*s, PageAddress::of_place(*place))?.tops[k] = Some(TopEntry { standing, ..t });
            }
        }
        Ok(())
    }

    /// Step 4: records that differ.
    fn records(
        &self,
        changed: &[(SurveyNumber, Place, Option<PatchEntry>, Option<PatchEntry>)],
        dirty: &[(SurveyNumber, Place, Fact)],
        out: &mut Changes,
    ) -> Result<()> {
        let mut all: Vec<(SurveyNumber, Place)> = changed.iter().map(|(s, p, ..)| (*s, *p)).collect();
        all.extend(dirty.iter().map(|(s, p, _)| (*s, *p)));
        all.sort_unstable();
        all.dedup();
        for (s, place) in all {
            let was = match self.base.entries().contains_key(&s) {
                true => state(self.base, s, place)?,
                false => None,
            };
            let is = match self.entries.contains_key(&s) {
                true => state(self, s, place)?,
                false => None,
            };
            let count = out.counts.entry(s).or_default();
            for (x, sign) in [(&was, -1), (&is, 1)] {
                match x {
                    Some(Some(_)) => count.0 += sign,
                    Some(None) => count.1 += sign,
                    None => {}
                }
            }
            let (was, is) = (was.flatten(), is.flatten());
            if was != is {
                out.gone.extend(was);
                out.come.extend(is);
            }
        }
        Ok(())
    }
}

/// `None`: no such patch; `Some(None)`: dormant; `Some(Some(record))`: live.
fn state(t: &dyn Tables, s: SurveyNumber, place: Place) -> Result<Option<Option<Record>>> {
    let Some(p) = t.patch(s, place)? else { return Ok(None) };
    let Some(top) = t.top(s, place)? else { return Ok(None) };
    Ok(Some(View::record(s, place, &p, &top)))
}

/// Level-0 places as a few rectangles of cells: rows of places, joined where equal.
fn joined(places: &[(i32, i32)]) -> Vec<CellRect> {
    let mut rects: Vec<CellRect> =
        places.iter().map(|(i, j)| Place { level: 0, i: *i, j: *j }.rect()).collect();
    crate::height::cells::merge(&mut rects);
    rects
}
