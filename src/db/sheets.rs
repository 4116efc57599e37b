//! The tables of a commit as the rules of LOD space ask them: some hundred times a patch, so that every look counts.
//!
//! The pages of a survey lie in a vector sorted by address. A page is fetched when it is first asked for and then borrowed: a look
//! is a search among the few pages of one survey, without a lock, a count or a hash of a page reference.

use super::update::Draft;
use super::view::Tables;
use crate::base::Result;
use crate::base::lattice::Bounds;
use crate::height::cells::{Block, Fill};
use crate::height::lod::{Cells, Fact, Geometry, Place, SurveyNumber, World};
use crate::store::table::{PageAddress, PatchEntry, PatchPage, TopEntry, TopPage, slot};
use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::{Arc, OnceLock};

/// Spreads numbers of surveys, which count up, over the buckets of a map: the multiplier is 2^64 over the golden ratio.
#[derive(Default)]
struct Spread(u64);

impl Hasher for Spread {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u32(u32::from(*b)));
    }

    fn write_u32(&mut self, n: u32) {
        self.0 = (self.0 ^ u64::from(n)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// One address of a survey and what is there.
struct Leaf {
    at: PageAddress,
    patches: OnceLock<Option<Arc<PatchPage>>>,
    tops: OnceLock<Option<Arc<TopPage>>>,
}

/// One survey: its pages, ascending by address.
struct Sheet<'a> {
    geometry: &'a Geometry,
    leaves: OnceLock<Vec<Leaf>>,
}

/// A draft that does not change any more.
pub(super) struct Sheets<'a> {
    draft: &'a Draft<'a>,
    sheets: HashMap<SurveyNumber, Sheet<'a>, BuildHasherDefault<Spread>>,
}

impl<'a> Sheets<'a> {
    pub fn new(draft: &'a Draft<'a>) -> Sheets<'a> {
        let sheet = |g| Sheet { geometry: g, leaves: OnceLock::new() };
        let sheets = draft.entries().iter().map(|(s, e)| (*s, sheet(&e.geometry))).collect();
        Sheets { draft, sheets }
    }

    fn leaf(&self, survey: SurveyNumber, place: Place) -> Result<Option<&Leaf>> {
        let Some(sheet) = self.sheets.get(&survey) else { return Ok(None) };
        let leaves = match sheet.leaves.get() {
            Some(l) => l,
            None => {
                let leaf = |at| Leaf { at, patches: OnceLock::new(), tops: OnceLock::new() };
                let leaves = self.draft.addresses(survey)?.into_iter().map(leaf).collect();
                sheet.leaves.get_or_init(|| leaves)
            }
        };
        let at = PageAddress::of_place(place);
        Ok(leaves.binary_search_by_key(&at, |l| l.at).ok().map(|k| &leaves[k]))
    }

    fn patches(&self, survey: SurveyNumber, place: Place) -> Result<Option<&PatchPage>> {
        let Some(leaf) = self.leaf(survey, place)? else { return Ok(None) };
        if let Some(page) = leaf.patches.get() {
            return Ok(page.as_deref());
        }
        let page = self.draft.patch_page(survey, leaf.at)?;
        Ok(leaf.patches.get_or_init(|| page).as_deref())
    }

    fn tops(&self, survey: SurveyNumber, place: Place) -> Result<Option<&TopPage>> {
        let Some(leaf) = self.leaf(survey, place)? else { return Ok(None) };
        if let Some(page) = leaf.tops.get() {
            return Ok(page.as_deref());
        }
        let page = self.draft.top_page(survey, leaf.at)?;
        Ok(leaf.tops.get_or_init(|| page).as_deref())
    }

    pub fn patch(&self, survey: SurveyNumber, place: Place) -> Result<Option<&PatchEntry>> {
        Ok(self.patches(survey, place)?.and_then(|p| p.patches[slot(place)].as_ref()))
    }

    pub fn top(&self, survey: SurveyNumber, place: Place) -> Result<Option<&TopEntry>> {
        Ok(self.tops(survey, place)?.and_then(|p| p.tops[slot(place)].as_ref()))
    }
}

impl World for Sheets<'_> {
    fn meeting(&self, bounds: &Bounds) -> Vec<SurveyNumber> {
        self.draft.index().meeting(bounds)
    }

    fn geometry(&self, survey: SurveyNumber) -> &Geometry {
        self.sheets.get(&survey).expect("the caller asks for surveys of this version only").geometry
    }

    fn fill(&self, survey: SurveyNumber, cells: Cells, place: Place) -> Result<Fill> {
        Ok(match cells {
            Cells::Core => self.patch(survey, place)?.map_or(Fill::Empty, |p| p.core),
            Cells::CorePrime => self.top(survey, place)?.map_or(Fill::Empty, |t| t.kernel),
        })
    }

    fn block(&self, survey: SurveyNumber, cells: Cells, i: i32, j: i32) -> Result<Block> {
        let place = Place { level: 0, i, j };
        Ok(match cells {
            Cells::Core => self.patches(survey, place)?.map_or(Block::EMPTY, |p| p.block(slot(place))),
            Cells::CorePrime => self.tops(survey, place)?.map_or(Block::EMPTY, |p| p.block(slot(place))),
        })
    }

    fn fact(&self, survey: SurveyNumber, place: Place) -> Result<Option<Fact>> {
        Ok(self.patch(survey, place)?.map(|p| p.fact))
    }
}
