//! A survey that comes where no other is: nothing covers it, and it covers nothing. Its kernels are its cores, so what the set
//! makes of it is derived page by page, without the questions that `update` asks about what was there.

use super::change::Progress;
use super::update::{Changes, Draft, Rebuilt};
use super::view::{Rules, Tables, View};
use crate::base::Result;
use crate::height::cells::Fill;
use crate::height::lod::cutter::standing;
use crate::height::lod::{Standing, SurveyNumber};
use crate::store::quadtree::Record;
use crate::store::table::{PageAddress, PatchPage, TopEntry, TopPage};
use rayon::prelude::*;
use std::sync::Arc;

/// Pages whose tops are computed before they are taken in.
const PAGES_AT_ONCE: usize = 256;

impl Draft<'_> {
    /// Whether a rebuilt survey is new, meets no other (by the boxes of their cores, grown by a cell), and is all that changes.
    pub(super) fn is_alone(&self, rebuilt: &Rebuilt) -> bool {
        let (survey, base) = (rebuilt.survey, self.base.entries());
        let rank = |e: &super::root::SurveyEntry| e.geometry.precedence;
        let stays = |n, old| self.entries().get(n).is_some_and(|new| rank(new) == rank(old));
        let Some(e) = self.entries().get(&survey).filter(|_| !base.contains_key(&survey)) else {
            return false;
        };
        let near = self.index().meeting(&e.geometry.frame.bounds(&e.geometry.core.grow(1)));
        near == [survey] && base.iter().all(|(n, old)| stays(n, old))
    }

    /// [`Draft::derive`] for a survey that is alone.
    pub(super) fn derive_alone(&mut self, rebuilt: Rebuilt, progress: &Progress) -> Result<Changes> {
        let survey = rebuilt.survey;
        let pages: Vec<(PageAddress, Arc<PatchPage>)> =
            rebuilt.pages.into_iter().filter_map(|(at, page)| Some((at, page?))).collect();
        for (at, page) in &pages {
            self.lay(survey, *at, page.clone(), Arc::new(uncovered(page)));
        }
        let mut out = Changes::default();
        let (mut live, mut all) = (0, 0);
        for (n, some) in pages.chunks(PAGES_AT_ONCE).enumerate() {
            progress.step("tops", (n * PAGES_AT_ONCE) as f64 / pages.len() as f64)?;
            let draft = &*self;
            let found: Vec<(TopPage, Vec<Record>)> = some
                .par_iter()
                .map(|(at, page)| draft.standings(survey, *at, page))
                .collect::<Result<_>>()?;
            for ((at, page), (tops, records)) in some.iter().zip(found) {
                all += page.patches.iter().flatten().count();
                live += records.len();
                out.come.extend(records);
                let tops = Arc::new(tops);
                if !tops.is_empty() {
                    out.tops.insert((survey, *at), Some(tops.clone()));
                }
                self.lay(survey, *at, page.clone(), tops);
            }
        }
        out.computed = all as u64;
        out.counts.insert(survey, (live as i64, (all - live) as i64));
        Ok(out)
    }

    /// Tops and floors of the patches of a page, and the records of those that are live.
    fn standings(
        &self,
        survey: SurveyNumber,
        at: PageAddress,
        page: &PatchPage,
    ) -> Result<(TopPage, Vec<Record>)> {
        let (mut tops, mut records) = (uncovered(page), Vec::new());
        for (slot, (patch, top)) in page.patches.iter().zip(&mut tops.tops).enumerate() {
            let (Some(patch), Some(top)) = (patch, top) else { continue };
            let place = at.place(slot);
            top.standing = standing(&Rules(self), survey, place, &patch.fact)?;
            records.extend(View::record(survey, place, patch, top));
        }
        Ok((tops, records))
    }
}

/// The page of the top table where nothing is covered: kernels are cores. No top is known yet (NaN).
fn uncovered(page: &PatchPage) -> TopPage {
    let standing = Standing { top: f32::NAN, floor: false };
    let entry = |core: Fill| TopEntry { standing, kernel: core };
    TopPage {
        tops: page.patches.iter().map(|p| p.map(|p| entry(p.core))).collect(),
        cells: page.cells.clone(),
    }
}
