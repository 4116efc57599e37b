//! What each survey contributes, and what would come back if it left.

use super::database::Snapshot;
use super::head::hex;
use super::pages;
use super::view::Rules;
use crate::base::Result;
use crate::height::lod::{Cells, SurveyNumber, World};
use crate::store::segment::PageRef;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// What a survey contributes to a version.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Contribution {
    pub id: String,
    pub name: String,
    pub date: Option<String>,
    pub accuracy_m: f64,
    pub patches: u64,
    pub live: u64,
    /// Live patches as a share of its patches.
    pub live_share: f64,
    /// Cells that it surveyed, and those of them that no survey of higher precedence takes.
    pub cells: u64,
    pub cells_kept: u64,
    pub cells_share: f64,
    /// No patch is live: it is seen at no tolerance, and heights stay the same without it.
    pub redundant: bool,
    /// Bytes of pages that no other survey needs: what removing it frees, after `prune` (and `compact`, where a file holds
    /// more than that).
    pub bytes: u64,
}

/// What every survey of a version contributes, in order of arrival.
pub fn contributions(s: &Snapshot) -> Result<Vec<Contribution>> {
    s.entries()
        .map(|e| {
            let (cells, kept) = cells(s, e.number)?;
            let mut own: HashSet<PageRef> = HashSet::new();
            pages::gather_survey(&s.view, e, &mut own)?;
            let share = |part: u64, all: u64| if all > 0 { part as f64 / all as f64 } else { 0.0 };
            let patches = e.live + e.dormant;
            Ok(Contribution {
                id: hex(&e.id),
                name: e.name.clone(),
                date: e.date.map(|d| d.to_string()),
                accuracy_m: s.view.head(e.number)?.declaration.accuracy_m,
                patches,
                live: e.live,
                live_share: share(e.live, patches),
                cells,
                cells_kept: kept,
                cells_share: share(kept, cells),
                redundant: e.live == 0,
                bytes: own.iter().map(|p| u64::from(p.len)).sum(),
            })
        })
        .collect()
}

/// Cells of core(G) and of core'(G).
fn cells(s: &Snapshot, n: SurveyNumber) -> Result<(u64, u64)> {
    let rules = Rules(&s.view);
    let (mut core, mut kept) = (0, 0);
    s.view.each_patch(n, |place, _, _| {
        if place.level == 0 {
            core += u64::from(rules.block(n, Cells::Core, place.i, place.j)?.count());
            kept += u64::from(rules.block(n, Cells::CorePrime, place.i, place.j)?.count());
        }
        Ok(())
    })?;
    Ok((core, kept))
}
