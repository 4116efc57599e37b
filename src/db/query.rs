//! Questions: which patches a region needs within a tolerance, what changed since, how high it is.

pub use super::area::Area;
use super::database::Snapshot;
pub use super::found::Found;
use super::seams::Fields;
pub use super::selection::{Difference, Selection, difference, set_hash};
use super::triangles::metres_per_unit;
use super::view::{Rules, Tables, View};
use crate::base::lattice::{Bounds, Point};
use crate::base::polygon::Polygon;
use crate::base::{Error, Result};
use crate::height::cells::{Block, Fill};
use crate::height::lod::cut::{Camera, Constant, Cut, ErrorRaster, Foci, Region};
use crate::height::lod::{Cells, Place, SurveyNumber, World};
use crate::height::patch::{Kind, Shape};
use crate::height::surface::{Hood, How, Patch, Seams, Sheet, Source, Surface, SurveyField, seam};
use crate::store::quadtree::Record;
use quick_cache::sync::Cache;
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// How much error is allowed where.
#[derive(Clone, Debug, PartialEq)]
pub enum Tolerance {
    /// Metres, everywhere.
    Constant(f64),
    /// Pixels on a screen.
    Camera(Camera),
    /// Little around some places, more farther away.
    Foci(Foci),
    /// What a raster says, in the CRS of the database.
    Raster(Arc<ErrorRaster>),
}

/// What is asked.
#[derive(Clone, Debug)]
pub struct Query {
    pub area: Area,
    pub tolerance: Tolerance,
    pub how: How,
}

impl Snapshot {
    /// Lowest and highest valid height of all samples, metres; the surface may go beyond.
    pub fn z_range(&self) -> Option<[f64; 2]> {
        let mut entries = self.entries().peekable();
        entries.peek()?;
        Some(
            self.entries()
                .fold([f64::INFINITY, f64::NEG_INFINITY], |z, e| [z[0].min(e.z[0]), z[1].max(e.z[1])]),
        )
    }

    /// xmin, ymin, xmax, ymax of the cores of all surveys, CRS units.
    pub fn bounds(&self) -> Option<[f64; 4]> {
        let size = self.unit.size();
        let b = self.entries().map(|e| e.geometry.bounds()).reduce(|a, b| a.union(&b))?;
        Some([b.min.x as f64 * size, b.min.y as f64 * size, b.max.x as f64 * size, b.max.y as f64 * size])
    }

    /// The part of an area that the camera of a question sees.
    pub(super) fn in_view(&self, query: &Query) -> Result<Area> {
        if let Area::Polygon(_) = query.area {
            return Err(Error::unsupported(
                "GLB",
                "what a camera sees is not cut along a polygon",
                "give a --bbox in the database's CRS with the camera",
            ));
        }
        let seen = Region::hull(self.region(query)?.polygon).polygon;
        if seen.len() < 3 {
            return Err(Error::invalid("--eye", "the camera sees nothing of the region"));
        }
        Ok(Area::Polygon(Arc::new(Polygon::new("view of the camera", vec![vec![seen]])?)))
    }

    /// What a tolerance is in this version. A camera's is bounded by the heights of the samples, however seams are drawn: so
    /// `--seams` moves the surface and changes no weight.
    pub(super) fn cut(&self, tolerance: &Tolerance) -> Box<dyn Cut> {
        let z = self.z_range().unwrap_or([0.0; 2]);
        match tolerance {
            // Without bound means: the coarsest surface there is.
            Tolerance::Constant(c) => Box::new(Constant(c.min(f64::MAX))),
            Tolerance::Camera(c) => Box::new(c.over(z[0], z[1])),
            Tolerance::Foci(f) => Box::new(f.clone().scaled(|p| metres_per_unit(self.crs.unit, p))),
            Tolerance::Raster(r) => Box::new(r.clone()),
        }
    }

    /// The surface of a query, ready for heights. Patches are decoded when a point first needs them.
    pub fn surface(&self, query: &Query) -> Result<Ground<'_>> {
        let selection = self.select(query)?;
        Ok(self.ground(selection, self.cut(&query.tolerance), query.how))
    }

    /// Surveys whose weights may reach into a box.
    pub(super) fn near(&self, b: [f64; 4]) -> HashSet<SurveyNumber> {
        if !b.iter().all(|v| v.is_finite()) {
            return HashSet::new();
        }
        let size = self.unit.size();
        let to = |v: f64| ((v / size).round()).clamp(-(2f64.powi(60)), 2f64.powi(60)) as i64;
        let bounds = Bounds { min: Point::new(to(b[0]), to(b[1])), max: Point::new(to(b[2]), to(b[3])) };
        Rules(&self.view).meeting(&bounds).into_iter().collect()
    }

    pub(super) fn ground(&self, selection: Selection, cut: Box<dyn Cut>, how: How) -> Ground<'_> {
        let b = selection.region.bounds();
        let origin = if b[0].is_finite() { [(b[0] + b[2]) / 2.0, (b[1] + b[3]) / 2.0] } else { [0.0; 2] };
        // Masks need every survey near the region, whether a patch of it was selected or not.
        let used: HashSet<SurveyNumber> = selection.records.iter().map(|r| r.survey).collect();
        let near = self.near(b);
        let keep: Vec<SurveyNumber> =
            self.entries().map(|e| e.number).filter(|s| used.contains(s) || near.contains(s)).collect();
        let slot: HashMap<SurveyNumber, usize> = keep.iter().enumerate().map(|(k, s)| (*s, k)).collect();
        let fields = keep.iter().map(|s| SurveyField::new(self.view.geometry_of(*s), self.unit)).collect();
        let patches = selection
            .records
            .iter()
            .map(|r| Patch {
                id: r.id,
                survey: slot[&r.survey],
                place: r.place,
                bot: r.bot,
                top: r.top,
                floor: r.floor,
            })
            .collect();
        let mut surface = Surface::new(self.kind(), origin, self.unit, fields, patches, how.blend);
        surface.corrected = how.seams != Seams::Off;
        let data = Data {
            view: &self.view,
            kind: self.kind(),
            seams: self.fields(how),
            surveys: keep,
            patches: surface.patches.iter().map(|p| (p.survey, p.place)).collect(),
            shapes: Cache::new(shapes_cached(self.kind())),
            hoods: Cache::new(65536),
        };
        Ground { snapshot: self, surface, cut, data, selection }
    }
}

/// Patches that make a height and their shares, which sum to 1; largest first.
pub type Makers = Vec<(Record, f64)>;

/// Patches that a surface keeps decoded: some 36 MB of either kind.
fn shapes_cached(kind: Kind) -> usize {
    match kind {
        Kind::Bilinear => 4096,
        Kind::Bicubic => 1024,
    }
}

/// Where a surface gets its numbers: the tables of a version, cached.
struct Data<'a> {
    view: &'a View,
    kind: Kind,
    seams: Fields<'a>,
    surveys: Vec<SurveyNumber>,
    patches: Vec<(usize, Place)>,
    shapes: Cache<usize, Shape>,
    hoods: Cache<(usize, i32, i32), Arc<Hood>>,
}

impl Source for Data<'_> {
    fn shape(&self, patch: usize) -> Result<Shape> {
        if let Some(s) = self.shapes.get(&patch) {
            return Ok(s);
        }
        let (survey, place) = self.patches[patch];
        let z = self.view.with_samples(self.surveys[survey], |r| r.vertices(self.kind, place))?;
        let shape = Shape::new(self.kind, z);
        self.shapes.insert(patch, shape.clone());
        Ok(shape)
    }

    fn seam(&self, survey: usize, i: i32, j: i32) -> Result<Arc<seam::Field>> {
        self.seams.field(self.surveys[survey], i, j)
    }

    fn hood(&self, survey: usize, i: i32, j: i32) -> Result<Arc<Hood>> {
        if let Some(h) = self.hoods.get(&(survey, i, j)) {
            return Ok(h);
        }
        let rules = Rules(self.view);
        let n = self.surveys[survey];
        let g = rules.geometry(n);
        let mut blocks = [Block::EMPTY; 9];
        // A point beside the survey asks for blocks that cannot exist; indices there may not even be places.
        let near = Place { level: 0, i, j }.rect().grow(1).overlaps(&g.core);
        if near {
            for (k, b) in blocks.iter_mut().enumerate() {
                let (a, c) = (i + k as i32 % 3 - 1, j + k as i32 / 3 - 1);
                let place = Place { level: 0, i: a, j: c };
                *b = match rules.fill(n, Cells::CorePrime, place)? {
                    Fill::Empty => Block::EMPTY,
                    Fill::Full => Block::FULL,
                    Fill::Mixed => rules.block(n, Cells::CorePrime, a, c)?,
                };
            }
        }
        let h = Arc::new(Hood::of(&blocks));
        self.hoods.insert((survey, i, j), h.clone());
        Ok(h)
    }
}

/// A surface of one version over a region: the one function that is measured and drawn.
pub struct Ground<'a> {
    pub snapshot: &'a Snapshot,
    pub surface: Surface,
    pub(super) cut: Box<dyn Cut>,
    data: Data<'a>,
    pub selection: Selection,
}

impl Ground<'_> {
    pub fn sheet(&self) -> Sheet<'_> {
        Sheet { surface: &self.surface, cut: &*self.cut, source: &self.data }
    }

    /// Which survey a patch of the surface belongs to.
    pub fn survey_of(&self, patch: usize) -> SurveyNumber {
        self.data.surveys[self.surface.patches[patch].survey]
    }

    /// The allowed error at a point, metres.
    pub fn tolerance(&self, p: [f64; 2]) -> f64 {
        self.cut.at(p)
    }

    /// The greatest tolerance anywhere in the region (the camera's grows with depth).
    pub fn tolerance_max(&self) -> f64 {
        self.cut.bounds(&self.selection.region.polygon).1
    }
}

impl Snapshot {
    /// Who makes the height at a point: patches and normalised weights, largest first; empty where there is no data.
    pub fn explain(
        &self,
        p: [f64; 2],
        tolerance: &Tolerance,
        how: impl Into<How>,
    ) -> Result<Vec<(Record, f64)>> {
        Ok(self.explained(&[p], tolerance, how)?.pop().flatten().unwrap_or_default())
    }

    /// The patch that weighs most at each point; `None` where there is no data.
    pub fn dominant(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: impl Into<How>,
    ) -> Result<Vec<Option<Record>>> {
        let how = how.into();
        let b = crate::height::lod::cut::bounds(points);
        if !b[0].is_finite() {
            return Ok(vec![None; points.len()]);
        }
        let pad = (b[2] - b[0]).max(b[3] - b[1]).max(1.0) * 1e-6;
        let region = Region::from_box([b[0] - pad, b[1] - pad, b[2] + pad, b[3] + pad]);
        let cut = self.cut(tolerance);
        let ground = self.ground(self.select_in(region, &*cut, how.blend)?, cut, how);
        points
            .par_iter()
            .map(|p| {
                let found = ground.sheet().explain(*p)?;
                Ok(found.and_then(|(_, who)| who.first().map(|(k, _)| ground.selection.records[*k])))
            })
            .collect()
    }
}
