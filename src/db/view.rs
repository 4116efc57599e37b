//! A version as tables: pages read on demand, cached; and what the rules of LOD space see of it.

use super::caches::{Caches, Known};
use super::corrections::Corrections;
use super::head::Head;
use super::masks::Masks;
use super::reader::SampleReader;
use super::root::{Root, SurveyEntry};
use super::seams::SeamCache;
use super::tile::Directory;
use crate::base::lattice::{Bounds, Quad};
use crate::base::{Error, Result};
use crate::height::cells::{Block, Fill};
use crate::height::lod::{Cells, Fact, Geometry, Place, SurveyNumber, World};
use crate::store::quadtree::{Domains, Node, Nodes, Record};
use crate::store::segment::{Files, PageRef, Pages, file_name};
use crate::store::table::{PageAddress, PageList, PatchEntry, PatchPage, TopEntry, TopPage, find, slot};
use rstar::primitives::{GeomWithData, Rectangle};
use rstar::{AABB, RTree};
use std::collections::{BTreeMap, HashMap};
use std::sync::{Arc, OnceLock};

/// Cores of surveys, and the ring of one cell to which their weights reach, in an R*-tree.
pub struct Index(RTree<GeomWithData<Rectangle<[f64; 2]>, SurveyNumber>>);

impl Index {
    pub fn new<'a>(entries: impl Iterator<Item = &'a SurveyEntry>) -> Index {
        let boxes = entries.map(|e| {
            let g = &e.geometry;
            let (min, max) = corners(&g.frame.bounds(&g.core.grow(1)));
            GeomWithData::new(Rectangle::from_corners(min, max), e.number)
        });
        Index(RTree::bulk_load(boxes.collect()))
    }

    /// Surveys whose boxes may meet `b`, ascending.
    pub(super) fn meeting(&self, b: &Bounds) -> Vec<SurveyNumber> {
        let (min, max) = corners(b);
        let mut out: Vec<SurveyNumber> =
            self.0.locate_in_envelope_intersecting(AABB::from_corners(min, max)).map(|g| g.data).collect();
        out.sort_unstable();
        out
    }
}

/// A box in floats, grown by more than an `i64` loses in an `f64`.
fn corners(b: &Bounds) -> ([f64; 2], [f64; 2]) {
    const SLACK: f64 = 1024.0;
    ([b.min.x as f64 - SLACK, b.min.y as f64 - SLACK], [b.max.x as f64 + SLACK, b.max.y as f64 + SLACK])
}

/// Patch and top tables of a set of surveys, wherever their pages are.
pub trait Tables: Sync {
    fn entries(&self) -> &BTreeMap<SurveyNumber, SurveyEntry>;
    fn index(&self) -> &Index;
    fn patch_page(&self, survey: SurveyNumber, at: PageAddress) -> Result<Option<Arc<PatchPage>>>;
    fn top_page(&self, survey: SurveyNumber, at: PageAddress) -> Result<Option<Arc<TopPage>>>;

    fn patch(&self, survey: SurveyNumber, place: Place) -> Result<Option<PatchEntry>> {
        Ok(self.patch_page(survey, PageAddress::of_place(place))?.and_then(|p| p.patches[slot(place)]))
    }

    fn top(&self, survey: SurveyNumber, place: Place) -> Result<Option<TopEntry>> {
        Ok(self.top_page(survey, PageAddress::of_place(place))?.and_then(|p| p.tops[slot(place)]))
    }

    fn geometry_of(&self, survey: SurveyNumber) -> &Geometry {
        &self.entries().get(&survey).expect("the caller asks for surveys of this version only").geometry
    }
}

/// Tables as the rules of LOD space see them.
pub struct Rules<'a>(pub &'a dyn Tables);

impl World for Rules<'_> {
    fn meeting(&self, bounds: &Bounds) -> Vec<SurveyNumber> {
        self.0.index().meeting(bounds)
    }

    fn geometry(&self, survey: SurveyNumber) -> &Geometry {
        self.0.geometry_of(survey)
    }

    fn fill(&self, survey: SurveyNumber, cells: Cells, place: Place) -> Result<Fill> {
        Ok(match cells {
            Cells::Core => self.0.patch(survey, place)?.map_or(Fill::Empty, |p| p.core),
            Cells::CorePrime => self.0.top(survey, place)?.map_or(Fill::Empty, |t| t.kernel),
        })
    }

    fn block(&self, survey: SurveyNumber, cells: Cells, i: i32, j: i32) -> Result<Block> {
        let place = Place { level: 0, i, j };
        let at = PageAddress::of_place(place);
        Ok(match cells {
            Cells::Core => self.0.patch_page(survey, at)?.map_or(Block::EMPTY, |p| p.block(slot(place))),
            Cells::CorePrime => self.0.top_page(survey, at)?.map_or(Block::EMPTY, |p| p.block(slot(place))),
        })
    }

    fn fact(&self, survey: SurveyNumber, place: Place) -> Result<Option<Fact>> {
        Ok(self.0.patch(survey, place)?.map(|p| p.fact))
    }
}

impl Domains for Rules<'_> {
    fn domain(&self, r: &Record) -> Quad {
        self.0.geometry_of(r.survey).frame.quad(&r.place.domain())
    }
}

/// The tables of one version.
pub struct View {
    pub files: Files,
    pub tree: Option<crate::store::quadtree::ChildRef>,
    entries: BTreeMap<SurveyNumber, SurveyEntry>,
    index: Index,
    heads: HashMap<SurveyNumber, OnceLock<Arc<Known>>>,
    top_lists: HashMap<SurveyNumber, OnceLock<Arc<PageList>>>,
    pub caches: Arc<Caches>,
    /// Correction fields and what they are made of.
    pub seams: SeamCache,
    /// Blocks of masks.
    pub masks: Masks,
    /// Blocks of corrections.
    pub corrections: Corrections,
}

impl View {
    /// Opens a version with caches of its own.
    pub fn open(files: Files, root: Option<PageRef>) -> Result<View> {
        View::sharing(files, root, Caches::new())
    }

    /// Opens a committed version with the caches of its database.
    pub fn sharing(files: Files, root: Option<PageRef>, caches: Arc<Caches>) -> Result<View> {
        let root = match root {
            Some(at) => Root::decode(&files.page(&at)?, &file_name(at.file))?,
            None => Root::default(),
        };
        let entries: BTreeMap<_, _> = root.surveys.into_iter().map(|s| (s.number, s)).collect();
        Ok(View {
            index: Index::new(entries.values()),
            heads: entries.keys().map(|n| (*n, OnceLock::new())).collect(),
            top_lists: entries.keys().map(|n| (*n, OnceLock::new())).collect(),
            caches,
            seams: SeamCache::new(),
            masks: Masks::new(),
            corrections: Corrections::new(),
            tree: root.tree,
            files,
            entries,
        })
    }

    pub fn entry(&self, survey: SurveyNumber) -> Result<&SurveyEntry> {
        self.entries
            .get(&survey)
            .ok_or_else(|| Error::missing(format!("survey {}", survey.0), "see `terraquilt surveys`"))
    }

    pub fn head(&self, survey: SurveyNumber) -> Result<&Arc<Head>> {
        Ok(&self.known(survey)?.head)
    }

    fn known(&self, survey: SurveyNumber) -> Result<&Known> {
        let slot = self.heads.get(&survey).ok_or_else(|| unknown(survey))?;
        if let Some(h) = slot.get() {
            return Ok(h);
        }
        let known = self.caches.head(&self.files, &self.entry(survey)?.head)?;
        Ok(slot.get_or_init(|| known))
    }

    pub fn top_list(&self, survey: SurveyNumber) -> Result<&Arc<PageList>> {
        let slot = self.top_lists.get(&survey).ok_or_else(|| unknown(survey))?;
        if let Some(l) = slot.get() {
            return Ok(l);
        }
        let list = self.caches.top_list(&self.files, &self.entry(survey)?.tops)?;
        Ok(slot.get_or_init(|| list))
    }

    pub fn directory(&self, at: &PageRef) -> Result<Arc<Directory>> {
        self.caches.directory(&self.files, at)
    }

    /// Page of a sample block of a level above 0.
    fn level_block(&self, survey: SurveyNumber, level: u8, bi: i64, bj: i64) -> Result<Option<PageRef>> {
        let page = self.patch_page(survey, PageAddress::of_block(level, bi, bj))?;
        Ok(page.and_then(|p| p.blocks[crate::store::table::block_slot(bi, bj)]))
    }

    /// Calls `f` with a reader of one survey's samples.
    pub fn with_samples<R>(
        &self,
        survey: SurveyNumber,
        f: impl FnOnce(&SampleReader) -> Result<R>,
    ) -> Result<R> {
        let Known { head, stamp } = self.known(survey)?;
        let tiles =
            head.tiles.iter().map(|t| Ok((t, self.directory(&t.directory)?))).collect::<Result<Vec<_>>>()?;
        let levels = |level: u8, bi: i64, bj: i64| self.level_block(survey, level, bi, bj);
        f(&SampleReader {
            pages: &self.files,
            declaration: &head.declaration,
            tiles,
            levels: &levels,
            cache: &self.caches.blocks,
            stamp: *stamp,
        })
    }

    /// Every patch page of a survey.
    pub fn each_patch_page(
        &self,
        survey: SurveyNumber,
        mut f: impl FnMut(PageAddress, &PatchPage) -> Result<()>,
    ) -> Result<()> {
        for (at, _) in self.head(survey)?.clone().pages.iter() {
            if let Some(p) = self.patch_page(survey, *at)? {
                f(*at, &p)?;
            }
        }
        Ok(())
    }

    /// Every patch of one page of a survey: its place, fact and what the set makes of it.
    pub fn each_patch_of(
        &self,
        survey: SurveyNumber,
        at: PageAddress,
        mut f: impl FnMut(Place, &PatchEntry, &TopEntry) -> Result<()>,
    ) -> Result<()> {
        let Some(page) = self.patch_page(survey, at)? else { return Ok(()) };
        let tops = self.top_page(survey, at)?;
        for (k, p) in page.patches.iter().enumerate() {
            let Some(p) = p else { continue };
            let top = tops.as_ref().and_then(|t| t.tops[k]).ok_or_else(|| {
                Error::corrupt(
                    "top table",
                    format!("{:?}", at.place(k)),
                    "a patch has no entry; run `terraquilt verify`",
                )
            })?;
            f(at.place(k), p, &top)?;
        }
        Ok(())
    }

    /// The same for all pages of a survey.
    pub fn each_patch(
        &self,
        survey: SurveyNumber,
        mut f: impl FnMut(Place, &PatchEntry, &TopEntry) -> Result<()>,
    ) -> Result<()> {
        self.each_patch_page(survey, |at, _| self.each_patch_of(survey, at, &mut f))
    }

    /// The record of a patch in the tree, if it is live.
    pub fn record(survey: SurveyNumber, place: Place, p: &PatchEntry, t: &TopEntry) -> Option<Record> {
        (t.standing.top > p.fact.bot).then_some(Record {
            top: t.standing.top,
            bot: p.fact.bot,
            floor: t.standing.floor,
            survey,
            place,
            id: p.fact.id,
        })
    }
}

impl Tables for View {
    fn entries(&self) -> &BTreeMap<SurveyNumber, SurveyEntry> {
        &self.entries
    }

    fn index(&self) -> &Index {
        &self.index
    }

    fn patch_page(&self, survey: SurveyNumber, at: PageAddress) -> Result<Option<Arc<PatchPage>>> {
        let Some(r) = find(&self.head(survey)?.pages, at) else { return Ok(None) };
        self.caches.patch_page(&self.files, &r, at).map(Some)
    }

    fn top_page(&self, survey: SurveyNumber, at: PageAddress) -> Result<Option<Arc<TopPage>>> {
        let Some(r) = find(self.top_list(survey)?, at) else { return Ok(None) };
        self.caches.top_page(&self.files, &r, at).map(Some)
    }
}

impl Nodes for View {
    fn node(&self, at: &PageRef) -> Result<Arc<Node>> {
        self.caches.node(&self.files, at)
    }
}

fn unknown(survey: SurveyNumber) -> Error {
    Error::corrupt("tree", format!("survey {}", survey.0), "is not in the root page; rebuild from a backup")
}
