//! Where surveys hold measured ground, as blocks that travel: core' as a quadtree of squares of places.
//!
//! How a survey is cut into blocks depends on nothing but its core': from the places of its highest level down, a full square
//! is a block, an empty one is none, a mixed one is cut in four, down to [`cells::LEVEL_MAX`], where it is packed. So blocks
//! keep their keys however a region moves, and their contents until a commit changes core'.

use super::Snapshot;
use super::query::Selection;
use super::view::{Rules, Tables};
use crate::base::Result;
use crate::codec::cells;
use crate::height::cells::{Block, Fill};
use crate::height::lod::cut::{Clip, Region};
use crate::height::lod::{Cells, Geometry, Place, SurveyNumber, World, places_meeting};
use bytes::Bytes;
use quick_cache::sync::Cache;

/// Squares that are remembered: full and cut ones take 50 bytes, packed ones some hundred.
const SQUARES_CACHED: usize = 65536;

/// A block of core' of a survey.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct MaskPart {
    pub survey: SurveyNumber,
    /// The square of a place, on this level.
    pub level: u8,
    pub i: i32,
    pub j: i32,
    /// Packed by [`cells::pack`]; empty: every cell.
    pub cells: Bytes,
}

impl MaskPart {
    /// What tells blocks of a version apart, and their order.
    pub fn key(&self) -> (SurveyNumber, u8, i32, i32) {
        (self.survey, self.level, self.i, self.j)
    }
}

/// What a square of places is.
#[derive(Clone)]
enum Square {
    Empty,
    /// A block, with its cells.
    Block(Bytes),
    Cut,
}

/// Squares that were met lately, for one version.
pub struct Masks(Cache<(SurveyNumber, Place), Square>);

impl Masks {
    pub fn new() -> Masks {
        Masks(Cache::new(SQUARES_CACHED))
    }
}

impl Snapshot {
    /// The surveys whose frames a selection needs: those of its patches, and those near its region, whose cells decide which
    /// floors are shown. Ascending.
    pub fn surveys_of(&self, selection: &Selection) -> Vec<SurveyNumber> {
        let mut all = self.near(selection.region.bounds());
        all.extend(selection.records.iter().map(|r| r.survey));
        let mut all: Vec<SurveyNumber> = all.into_iter().collect();
        all.sort_unstable();
        all
    }

    /// The blocks of core' of every survey near a region, whether a patch of it is needed or not: those that hold a cell and
    /// meet the region or lie within a cell of it. Ascending by key. Looks up some squares for each survey: microseconds
    /// once they are known.
    pub fn masks(&self, region: &Region) -> Result<Vec<MaskPart>> {
        let mut out = Vec::new();
        if region.is_empty() {
            return Ok(out);
        }
        let mut clip = Clip::new(region);
        let mut near: Vec<SurveyNumber> = self.near(region.bounds()).into_iter().collect();
        near.sort_unstable();
        for survey in near {
            let g = self.view.geometry_of(survey);
            let roots = places_meeting(g.level_max, &g.core);
            let from = out.len();
            for j in roots.j0..roots.j1 {
                for i in roots.i0..roots.i1 {
                    self.blocks_of(survey, g, Place::new(g.level_max, i, j), &mut clip, &mut out)?;
                }
            }
            out[from..].sort_unstable_by_key(MaskPart::key);
        }
        Ok(out)
    }

    fn blocks_of(
        &self,
        survey: SurveyNumber,
        g: &Geometry,
        place: Place,
        clip: &mut Clip,
        out: &mut Vec<MaskPart>,
    ) -> Result<()> {
        let rect = place.rect();
        if !rect.overlaps(&g.core) {
            return Ok(());
        }
        let size = self.unit().size();
        let quad = g.frame.quad(&rect.grow(1)).0.map(|p| [p.x as f64 * size, p.y as f64 * size]);
        if clip.part(&quad).is_empty() {
            return Ok(());
        }
        match self.square(survey, place)? {
            Square::Empty => {}
            Square::Block(cells) => {
                let Place { level, i, j } = place;
                out.push(MaskPart { survey, level, i, j, cells });
            }
            Square::Cut => {
                for child in place.children() {
                    self.blocks_of(survey, g, child, clip, out)?;
                }
            }
        }
        Ok(())
    }

    fn square(&self, survey: SurveyNumber, place: Place) -> Result<Square> {
        let key = (survey, place);
        if let Some(s) = self.view.masks.0.get(&key) {
            return Ok(s);
        }
        let found = match Rules(&self.view).fill(survey, Cells::CorePrime, place)? {
            Fill::Empty => Square::Empty,
            Fill::Full => Square::Block(Bytes::new()),
            Fill::Mixed if place.level > cells::LEVEL_MAX => Square::Cut,
            Fill::Mixed => Square::Block(cells::pack(place.level, &self.places(survey, place)?).into()),
        };
        self.view.masks.0.insert(key, found.clone());
        Ok(found)
    }

    /// core' of the level-0 places of a square, row by row.
    fn places(&self, survey: SurveyNumber, place: Place) -> Result<Vec<Block>> {
        let rules = Rules(&self.view);
        let side = 1i32 << place.level;
        let (i0, j0) = (place.i << place.level, place.j << place.level);
        let mut out = Vec::with_capacity((side * side) as usize);
        for j in j0..j0 + side {
            for i in i0..i0 + side {
                out.push(match rules.fill(survey, Cells::CorePrime, Place { level: 0, i, j })? {
                    Fill::Empty => Block::EMPTY,
                    Fill::Full => Block::FULL,
                    Fill::Mixed => rules.block(survey, Cells::CorePrime, i, j)?,
                });
            }
        }
        Ok(out)
    }
}
