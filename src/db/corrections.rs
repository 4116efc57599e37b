//! Corrections of seams that an answer needs, as blocks that travel: the fields of level-0 places that are not flat.
//!
//! Which places have one is found from the top of each survey down: a square of places is passed over if no better survey is
//! near, or if none of the masks around changes within reach. What is left are the places along borders; their fields are
//! derived once for a version and kept packed.

use super::Snapshot;
use super::query::Selection;
use super::seams::Fields;
use super::view::{Rules, Tables};
use crate::base::limits::CORRECTIONS_MAX;
use crate::base::{Error, Result};
use crate::codec::corrections;
use crate::height::cells::Fill;
use crate::height::frame::CellRect;
use crate::height::lod::cut::Clip;
use crate::height::lod::{Cells, Geometry, KERNEL, Place, SurveyNumber, World, places_meeting};
use crate::height::surface::{How, Seams};
use bytes::Bytes;
use quick_cache::Weighter;
use quick_cache::sync::Cache;
use rayon::prelude::*;

/// Squares that are expected, and bytes of packed fields that are kept.
const SQUARES_CACHED: usize = 65536;
const BYTES_CACHED: u64 = 64 << 20;

/// The correction of a survey over a level-0 place.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct CorrectionPart {
    pub survey: SurveyNumber,
    pub i: i32,
    pub j: i32,
    /// Packed by [`corrections::pack`].
    pub nodes: Bytes,
}

impl CorrectionPart {
    /// What tells blocks of a version apart, and their order.
    pub fn key(&self) -> (SurveyNumber, i32, i32) {
        (self.survey, self.i, self.j)
    }
}

/// What a square of places is.
#[derive(Clone)]
enum Square {
    /// No place of it has a correction.
    Flat,
    /// A place, with its correction.
    Bent(Bytes),
    Cut,
}

/// A square of a survey; gaps held to the stated accuracies or not.
type Key = (SurveyNumber, Place, bool);

#[derive(Clone)]
struct ByBytes;

impl Weighter<Key, Square> for ByBytes {
    fn weight(&self, _: &Key, s: &Square) -> u64 {
        match s {
            Square::Bent(nodes) => 64 + nodes.len() as u64,
            _ => 64,
        }
    }
}

/// Squares that were met lately, for one version.
pub struct Corrections(Cache<Key, Square, ByBytes>);

impl Corrections {
    pub fn new() -> Corrections {
        Corrections(Cache::with_weighter(SQUARES_CACHED, BYTES_CACHED, ByBytes))
    }
}

impl Snapshot {
    /// The corrections by which the patches of a selection are bent: of each of its surveys, the places that meet its region or lie
    /// within a cell of it, and whose field is not flat. Ascending by key. None with seams off.
    ///
    /// Microseconds once the places of a version are known; each new one costs the derivation of its field.
    ///
    /// # Errors
    /// `Limit` if more than [`CORRECTIONS_MAX`] places lie along borders.
    pub fn corrections(&self, selection: &Selection, how: How) -> Result<Vec<CorrectionPart>> {
        if how.seams == Seams::Off || selection.region.is_empty() {
            return Ok(Vec::new());
        }
        let fields = self.fields(how);
        let mut clip = Clip::new(&selection.region);
        let mut surveys: Vec<SurveyNumber> = selection.records.iter().map(|r| r.survey).collect();
        surveys.sort_unstable();
        surveys.dedup();
        let mut found = Vec::new();
        for survey in surveys {
            let g = self.view.geometry_of(survey);
            let roots = places_meeting(g.level_max, &g.core.grow(1));
            for j in roots.j0..roots.j1 {
                for i in roots.i0..roots.i1 {
                    let place = Place::new(g.level_max, i, j);
                    self.along_borders(&fields, (survey, g), place, &mut clip, &mut found)?;
                }
            }
        }
        found.sort_unstable_by_key(|(survey, place, _)| (*survey, place.i, place.j));
        let parts: Vec<Option<CorrectionPart>> = found
            .into_par_iter()
            .map(|(survey, place, known)| {
                let Place { i, j, .. } = place;
                let nodes = known.map_or_else(|| self.bent(&fields, survey, place), |n| Ok(Some(n)))?;
                Ok(nodes.map(|nodes| CorrectionPart { survey, i, j, nodes }))
            })
            .collect::<Result<_>>()?;
        Ok(parts.into_iter().flatten().collect())
    }

    /// The level-0 places of a square that may have a correction, with their nodes where they are known.
    fn along_borders(
        &self,
        fields: &Fields,
        (survey, g): (SurveyNumber, &Geometry),
        place: Place,
        clip: &mut Clip,
        out: &mut Vec<(SurveyNumber, Place, Option<Bytes>)>,
    ) -> Result<()> {
        let rect = place.rect();
        if !rect.grow(1).overlaps(&g.core) {
            return Ok(());
        }
        let size = self.unit().size();
        let quad = g.frame.quad(&rect.grow(1)).0.map(|p| [p.x as f64 * size, p.y as f64 * size]);
        if clip.part(&quad).is_empty() {
            return Ok(());
        }
        let key = (survey, place, fields.consistent);
        let known = match self.view.corrections.0.get(&key) {
            Some(Square::Flat) => return Ok(()),
            Some(Square::Bent(nodes)) => Some(nodes),
            Some(Square::Cut) => None,
            None if fields.apart(survey, &rect)? => {
                self.view.corrections.0.insert(key, Square::Flat);
                return Ok(());
            }
            None if place.level > 0 => {
                self.view.corrections.0.insert(key, Square::Cut);
                None
            }
            None => None,
        };
        if place.level == 0 {
            out.push((survey, place, known));
            let n = out.len() as u64;
            if n > CORRECTIONS_MAX {
                let what = "places along borders of one answer, as far as they were counted (ask for a smaller region, or with seams off)";
                return Err(Error::limit(what, CORRECTIONS_MAX, n));
            }
            return Ok(());
        }
        for child in place.children() {
            self.along_borders(fields, (survey, g), child, clip, out)?;
        }
        Ok(())
    }

    /// The nodes of a place; `None` if its field is flat.
    fn bent(&self, fields: &Fields, survey: SurveyNumber, place: Place) -> Result<Option<Bytes>> {
        let field = fields.field(survey, place.i, place.j)?;
        let nodes = if field.is_flat() { None } else { Some(Bytes::from(corrections::pack(&field)?)) };
        let square = nodes.clone().map_or(Square::Flat, Square::Bent);
        self.view.corrections.0.insert((survey, place, fields.consistent), square);
        Ok(nodes)
    }
}

impl Fields<'_> {
    /// Whether no border between a survey and a better one is within reach of a square of its places: then all fields of it are
    /// flat. (The other way round it is a guess.)
    fn apart(&self, survey: SurveyNumber, rect: &CellRect) -> Result<bool> {
        let near = rect.grow(i64::from(self.rows()) * KERNEL);
        let above = self.above(survey, &near);
        if above.is_empty() {
            return Ok(true);
        }
        let quad = self.view.geometry_of(survey).frame.quad(&near.grow(1));
        let mut covered = false;
        for h in above {
            let window = self.view.geometry_of(h).frame.cells_meeting(&quad).grow(2);
            match self.filled(h, &window)? {
                Fill::Empty => {}
                Fill::Full => covered = true,
                Fill::Mixed => return Ok(false),
            }
        }
        // No better one begins or ends here: left are borders of the survey itself inside of them.
        Ok(!covered || self.filled(survey, &near.grow(2))? != Fill::Mixed)
    }

    /// How much of a window core' of a survey fills. `Mixed` may also be a guess: of a place that the window cuts.
    fn filled(&self, survey: SurveyNumber, window: &CellRect) -> Result<Fill> {
        let g = self.view.geometry_of(survey);
        let inner = window.intersect(&g.core);
        if inner.is_empty() {
            return Ok(Fill::Empty);
        }
        let span = inner.width().max(inner.height());
        let level = (0..=g.level_max).find(|l| KERNEL << l >= span).unwrap_or(g.level_max);
        let places = places_meeting(level, &inner);
        let mut all = (inner != *window).then_some(Fill::Empty);
        for j in places.j0..places.j1 {
            for i in places.i0..places.i1 {
                self.join(survey, Place::new(level, i, j), &inner, &mut all)?;
                if all == Some(Fill::Mixed) {
                    return Ok(Fill::Mixed);
                }
            }
        }
        Ok(all.unwrap_or(Fill::Empty))
    }

    fn join(
        &self,
        survey: SurveyNumber,
        place: Place,
        window: &CellRect,
        all: &mut Option<Fill>,
    ) -> Result<()> {
        if !place.rect().overlaps(window) || *all == Some(Fill::Mixed) {
            return Ok(());
        }
        let here = Rules(self.view).fill(survey, Cells::CorePrime, place)?;
        if here == Fill::Mixed && place.level > 0 {
            return place.children().into_iter().try_for_each(|c| self.join(survey, c, window, all));
        }
        *all = Some(if all.is_none_or(|a| a == here) { here } else { Fill::Mixed });
        Ok(())
    }
}
