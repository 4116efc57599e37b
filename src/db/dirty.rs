//! Which patches a commit may give another top or floor: step 3 of the local update ([`super::update`]; section 12 of the
//! LOD-space specification).

use super::sheets::Sheets;
use super::update::{Draft, Moved};
use super::view::Tables;
use crate::base::Result;
use crate::height::frame::CellRect;
use crate::height::lod::{Fact, Place, SurveyNumber, places_meeting};
use crate::store::table::PatchEntry;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashMap, HashSet};

impl Draft<'_> {
    /// Step 3, which: patches whose top or floor may differ.
    pub(super) fn dirty(
        &self,
        changed: &[(SurveyNumber, Place, Option<PatchEntry>, Option<PatchEntry>)],
        flipped: &HashMap<SurveyNumber, HashSet<Place>>,
        moved: &Moved,
    ) -> Result<Vec<(SurveyNumber, Place, Fact)>> {
        // Where anything changed, per survey: a rectangle of its cells. A kernel above a flip changed only there.
        let mut regions: BTreeMap<SurveyNumber, CellRect> = BTreeMap::new();
        let came_or_went = changed.iter().filter(|(_, _, was, is)| was.map(|e| e.fact) != is.map(|e| e.fact));
        let blocks = flipped.iter().flat_map(|(s, f)| f.iter().filter(|p| p.level == 0).map(|p| (*s, *p)));
        for (s, p) in came_or_went.map(|(s, p, ..)| (*s, *p)).chain(blocks) {
            let core = self.geometry_either(s).core;
            let old = self.base.entries().get(&s).map(|e| e.geometry.core);
            let most = core.union(&old.unwrap_or(core));
            let r = regions.entry(s).or_insert(CellRect::new(0, 0, 0, 0));
            *r = r.union(&p.rect().intersect(&most));
        }
        let own: HashSet<(SurveyNumber, Place)> =
            changed.iter().filter(|(_, _, _, is)| is.is_some()).map(|(s, p, ..)| (*s, *p)).collect();
        let mut seen: HashSet<(SurveyNumber, Place)> = HashSet::new();
        let mut list = Vec::new();
        for (x, e) in &self.entries {
            let g = &e.geometry;
            for (s, region) in &regions {
                let gs = self.geometry_either(*s);
                let quad = gs.frame.quad(region);
                if !quad.bounds().overlaps(&g.bounds()) {
                    continue;
                }
                let cells = if s == x { *region } else { g.frame.cells_meeting(&quad) }.intersect(&g.core);
                for level in 0..=g.level_max {
                    let range = places_meeting(level, &cells);
                    for j in range.j0..range.j1 {
                        for i in range.i0..range.i1 {
                            let place = Place::new(level, i, j);
                            if seen.insert((*x, place)) {
                                list.push((*x, place));
                            }
                        }
                    }
                }
            }
        }
        let sheets = Sheets::new(self);
        let found: Vec<Option<(SurveyNumber, Place, Fact)>> = list
            .par_iter()
            .map(|(x, place)| {
                let Some(entry) = sheets.patch(*x, *place)? else { return Ok(None) };
                let whole = own.contains(&(*x, *place)) || flipped.get(x).is_some_and(|f| f.contains(place));
                if whole || self.may_differ(&sheets, *x, *place, &entry.fact, moved, flipped)? {
                    return Ok(Some((*x, *place, entry.fact)));
                }
                Ok(None)
            })
            .collect::<Result<_>>()?;
        let mut dirty: Vec<_> = found.into_iter().flatten().collect();
        dirty.sort_unstable_by_key(|(s, p, _)| (*s, *p));
        Ok(dirty)
    }

    /// The finer form of section 12, step 4, for a patch whose own fact and kernel are unchanged.
    fn may_differ(
        &self,
        sheets: &Sheets,
        x: SurveyNumber,
        place: Place,
        fact: &Fact,
        moved: &Moved,
        flipped: &HashMap<SurveyNumber, HashSet<Place>>,
    ) -> Result<bool> {
        let Some(top) = sheets.top(x, place)? else { return Ok(true) };
        let live = top.standing.top > fact.bot;
        let g = self.geometry_of(x);
        let quad = g.frame.quad(&place.rect().intersect(&g.core));
        for (s, places) in moved {
            let gs = self.geometry_either(*s);
            let window = if *s == x { place.rect() } else { gs.frame.cells_meeting(&quad) };
            // A survey that was better here, or is, may have been or become the best data. One that only came can take a floor
            // away, one that went can give one back, and neither to a patch that is dormant.
            let came = !self.base.entries().contains_key(s);
            let went = !self.entries.contains_key(s);
            let may_turn = live && if top.standing.floor { !went } else { !came };
            let better = may_turn && gs.accuracy < fact.bot && fact.bot <= g.accuracy && *s != x;
            let levels = gs.level_max.max(self.base.entries().get(s).map_or(0, |e| e.geometry.level_max));
            for level in 0..=levels {
                let may_cover = gs.area(level).total_cmp(&g.area(place.level)).is_ge();
                if !(may_cover || better && level == 0) {
                    continue;
                }
                let range = places_meeting(level, &window);
                for j in range.j0..range.j1 {
                    for i in range.i0..range.i1 {
                        let q = Place::new(level, i, j);
                        let Some(bot) = places.get(&q) else { continue };
                        if may_cover && *bot <= top.standing.top {
                            return Ok(true);
                        }
                        let kernel_changed = went || flipped.get(s).is_some_and(|f| f.contains(&q));
                        if better && level == 0 && kernel_changed {
                            return Ok(true);
                        }
                    }
                }
            }
        }
        Ok(false)
    }
}
