//! LOD space: patch boxes over (x, y, error), their order, their tops, and cuts through them.
//!
//! After "Patchwork Terrains" (Rocca, Panozzo, Puppo), section 3.3. Departures, each argued in
//! `docs/decisions/`: the order is strict and total by content key; boxes are half open; kernels are clipped
//! to whole level-0 cells with measured neighbours; covered patches lie dormant instead of being removed.

pub mod cover;
pub mod cut;
pub mod cutter;
mod order;

pub use order::Rank;

use super::cells::{Block, Fill};
use super::frame::{CellRect, Frame};
use crate::base::Result;
use crate::base::lattice::{Bounds, Quad};

/// Cells across a level-0 kernel.
pub const KERNEL: i64 = 28;
/// Cells of the extension zone on each side.
pub const MARGIN: i64 = 2;
/// Vertices across a patch.
pub const SIDE: usize = (KERNEL + 2 * MARGIN + 1) as usize;
/// Largest level; 28 * 2^24 posts is more than any survey holds.
pub const LEVEL_MAX: u8 = 24;

/// Content key of a patch: the first 16 bytes of a BLAKE3 hash over its declaration, place, payload and error.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct PatchId(pub [u8; 16]);

impl std::fmt::Display for PatchId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.iter().try_for_each(|b| write!(f, "{b:02x}"))
    }
}

impl std::fmt::Debug for PatchId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{self}")
    }
}

/// Number of a survey inside one database. Never part of an identity or an order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SurveyNumber(pub u32);

/// Place of a patch in its survey's pyramid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Place {
    pub level: u8,
    pub i: i32,
    pub j: i32,
}

impl Place {
    pub fn new(level: u8, i: i64, j: i64) -> Place {
        Place { level, i: i as i32, j: j as i32 }
    }

    /// The kernel rectangle, in level-0 cells.
    pub fn rect(&self) -> CellRect {
        let s = KERNEL << self.level;
        let (i, j) = (i64::from(self.i) * s, i64::from(self.j) * s);
        CellRect::new(i, j, i + s, j + s)
    }

    /// The domain: the kernel rectangle grown by the extension zone.
    pub fn domain(&self) -> CellRect {
        self.rect().grow(MARGIN << self.level)
    }

    pub fn parent(&self) -> Place {
        Place { level: self.level + 1, i: self.i >> 1, j: self.j >> 1 }
    }

    /// The four places whose kernel rectangles tile this one's (level > 0).
    pub fn children(&self) -> [Place; 4] {
        let c = |a, b| Place { level: self.level - 1, i: 2 * self.i + a, j: 2 * self.j + b };
        [c(0, 0), c(1, 0), c(0, 1), c(1, 1)]
    }

    /// The place at `level` whose kernel rectangle holds the cell.
    pub fn of_cell(level: u8, i: i64, j: i64) -> Place {
        let s = KERNEL << level;
        Place::new(level, i.div_euclid(s), j.div_euclid(s))
    }
}

/// The places of one level whose kernel rectangles meet a rectangle of cells: `[i0, i1) x [j0, j1)` in places.
pub fn places_meeting(level: u8, cells: &CellRect) -> CellRect {
    if cells.is_empty() {
        return CellRect::new(0, 0, 0, 0);
    }
    let s = KERNEL << level;
    CellRect::new(
        cells.i0.div_euclid(s),
        cells.j0.div_euclid(s),
        (cells.i1 - 1).div_euclid(s) + 1,
        (cells.j1 - 1).div_euclid(s) + 1,
    )
}

/// The places of one level whose *closed domains* meet a closed rectangle of posts.
pub fn places_touching_posts(level: u8, i0: i64, j0: i64, i1: i64, j1: i64) -> CellRect {
    let (s, m) = (KERNEL << level, MARGIN << level);
    CellRect::new(
        -((m + s - i0).div_euclid(s)),
        -((m + s - j0).div_euclid(s)),
        (i1 + m).div_euclid(s) + 1,
        (j1 + m).div_euclid(s) + 1,
    )
}

/// What never changes while a patch exists.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fact {
    pub id: PatchId,
    /// Accuracy plus measured error, rounded up: the bottom of the box, metres.
    pub bot: f32,
}

/// What the set of surveys makes of a patch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Standing {
    /// Top of the box, metres; infinite if never covered.
    pub top: f32,
    /// The patch is somewhere the best data there is.
    pub floor: bool,
}

/// What the rules of LOD space need to know of a survey.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    pub frame: Frame,
    /// Nominal steps, CRS units.
    pub steps: [f64; 2],
    /// Accuracy e(G): stated accuracy rounded up to the stored type, metres.
    pub accuracy: f32,
    pub precedence: i64,
    pub level_max: u8,
    /// Smallest rectangle of cells that holds core(G).
    pub core: CellRect,
}

impl Geometry {
    /// Nominal area of a patch of this level, CRS units squared: the same expression for every survey.
    pub fn area(&self, level: u8) -> f64 {
        let side = (KERNEL + 2 * MARGIN) as f64 * f64::from(1u32 << level);
        self.steps[0] * self.steps[1] * (side * side)
    }

    pub fn bounds(&self) -> Bounds {
        self.frame.bounds(&self.core)
    }

    pub fn quad(&self) -> Quad {
        self.frame.quad(&self.core)
    }
}

/// Which set of level-0 cells is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cells {
    /// Cells whose 3 x 3 block has samples at every corner: a function of the survey.
    Core,
    /// What precedence leaves of it: a function of the set.
    CorePrime,
}

/// The set of surveys as the rules of LOD space see it.
pub trait World: Sync {
    /// Surveys whose core may meet the box, ascending by number.
    fn meeting(&self, bounds: &Bounds) -> Vec<SurveyNumber>;
    fn geometry(&self, survey: SurveyNumber) -> &Geometry;
    /// How much of a kernel rectangle is in the set of cells.
    fn fill(&self, survey: SurveyNumber, cells: Cells, place: Place) -> Result<Fill>;
    /// The cells of one level-0 kernel rectangle (any fill).
    fn block(&self, survey: SurveyNumber, cells: Cells, i: i32, j: i32) -> Result<Block>;
    /// The stored patch, dormant or live; `None` if there is none.
    fn fact(&self, survey: SurveyNumber, place: Place) -> Result<Option<Fact>>;
}
