//! Where: regions as boxes and polygons, and coordinates of the user's choice.

use super::output::message;
use crate::base::polygon::{Polygon, Ring};
use crate::base::{Error, Result, limits};
use crate::db::metres_per_unit;
use crate::db::query::Area;
use crate::format::geojson::read_polygons;
use crate::height::crs::{AxisUnit, Crs, DatumChoice, Transform};
use std::path::Path;
use std::sync::Arc;

/// Straight lines of another CRS are followed to within so many metres.
const CURVE_M: f64 = 0.001;

/// Coordinates in a CRS that is not the database's.
pub struct Coords {
    pub crs: Crs,
    way: Transform,
    database: Crs,
}

impl Coords {
    /// The CRS that `--coords` names; `None` if it names none, or that of the database.
    pub fn of(text: Option<&str>, database: &Crs) -> Result<Option<Coords>> {
        text.map(|t| Coords::new(t, database)).transpose().map(Option::flatten)
    }

    fn new(text: &str, database: &Crs) -> Result<Option<Coords>> {
        let crs = Crs::parse(text)?;
        if crs.same_as(database) {
            return Ok(None);
        }
        let way = Transform::new(&crs, database, &DatumChoice::None)?;
        way.notes().iter().for_each(|n| message(&format!("note: {n}")));
        Ok(Some(Coords { crs, way, database: database.clone() }))
    }

    /// Where a point lies in the database's CRS; `None` where that is not defined.
    pub fn inward(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        self.way.forward(p)
    }

    /// As [`Coords::inward`], with an error that names the point.
    pub fn inside(&self, what: &str, p: [f64; 2]) -> Result<[f64; 2]> {
        self.inward(p).ok_or_else(|| {
            let reason = format!(
                "{}, {} in {} has no place in the database's {} (x or longitude comes first)",
                p[0], p[1], self.crs.code, self.database.code
            );
            Error::invalid(what, reason)
        })
    }

    /// The way back.
    pub fn outward(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        self.way.inverse(p)
    }

    /// A ring whose sides are straight in these coordinates, in the database's CRS, where they are curves.
    fn ring(&self, what: &str, ring: &Ring) -> Result<Ring> {
        let mut out = Ring::new();
        for k in 0..ring.len() {
            let (a, b) = (ring[k], ring[(k + 1) % ring.len()]);
            let ends = (self.inside(what, a)?, self.inside(what, b)?);
            out.push(ends.0);
            self.curve(what, (a, b), ends, 0, &mut out)?;
        }
        Ok(out)
    }

    /// Points between two ends, until a straight line is near enough to the curve.
    fn curve(
        &self,
        what: &str,
        (a, b): ([f64; 2], [f64; 2]),
        (p, q): ([f64; 2], [f64; 2]),
        depth: u32,
        out: &mut Ring,
    ) -> Result<()> {
        let between = |a: [f64; 2], b: [f64; 2], t: f64| [0, 1].map(|k| a[k] + t * (b[k] - a[k]));
        let scale = metres_per_unit(self.database.unit, p);
        let mut middle = p;
        let mut off = 0.0f64;
        for t in [0.25, 0.75, 0.5] {
            middle = self.inside(what, between(a, b, t))?;
            let straight = between(p, q, t);
            off = off.max(((middle[0] - straight[0]) * scale[0]).hypot((middle[1] - straight[1]) * scale[1]));
        }
        if off <= CURVE_M || depth >= 24 {
            return Ok(());
        }
        if out.len() as u64 > limits::POLYGON_POINTS_MAX {
            let what = format!("points of the curves of {what} (give a smaller region)");
            return Err(Error::limit(what, limits::POLYGON_POINTS_MAX, out.len() as u64));
        }
        let half = between(a, b, 0.5);
        self.curve(what, (a, half), (p, middle), depth + 1, out)?;
        out.push(middle);
        self.curve(what, (half, b), (middle, q), depth + 1, out)
    }

    fn polygon(&self, what: &str, given: &Polygon) -> Result<Polygon> {
        let ring = |r: &Ring| self.ring(what, r);
        let parts = given.parts().iter().map(|p| p.iter().map(ring).collect()).collect::<Result<_>>()?;
        Polygon::new(what, parts)
    }
}

/// A region, and how it looks in the coordinates of the answer.
#[derive(Default)]
pub struct Place {
    pub area: Area,
    /// Those of `--coords`, if they are not the database's.
    pub coords: Option<Coords>,
    /// xmin, ymin, xmax, ymax in these coordinates; `None`: everything.
    pub bounds: Option<[f64; 4]>,
    /// What pictures and grids are cut along.
    pub mask: Option<Arc<Polygon>>,
}

impl Place {
    /// `surveys`: the box around all surveys, in the database's CRS.
    pub fn everywhere(coords: Option<Coords>, surveys: Option<[f64; 4]>) -> Place {
        let bounds = coords.as_ref().and_then(|c| seen(c, surveys?));
        Place { coords, bounds, ..Place::default() }
    }

    /// A box in the coordinates of the answer.
    pub fn of_box(b: [f64; 4], coords: Option<Coords>) -> Result<Place> {
        let Some(c) = coords else {
            return Ok(Place { area: Area::Box(b), bounds: Some(b), ..Place::default() });
        };
        let corners = vec![[b[0], b[1]], [b[2], b[1]], [b[2], b[3]], [b[0], b[3]]];
        let polygon = Polygon::new("--bbox", vec![vec![c.ring("--bbox", &corners)?]])?;
        Ok(Place { area: Area::Polygon(Arc::new(polygon)), bounds: Some(b), coords: Some(c), mask: None })
    }

    /// The polygons of a GeoJSON file. Its own member `crs` says what its coordinates are, else `--coords`, else they are
    /// taken in the database's CRS; but if that is in metres and they can only be degrees, as RFC 7946 has them.
    pub fn of_file(
        path: &Path,
        coords: Option<Coords>,
        database: &Crs,
        surveys: Option<[f64; 4]>,
    ) -> Result<Place> {
        let name = path.display().to_string();
        let found = read_polygons(path)?;
        if found.others > 0 {
            message(&format!("note: {name}: {} points or lines are not used", found.others));
        }
        let given = Polygon::new(&name, found.parts)?;
        let b = given.bounds();
        let degrees = b[0] >= -360.0 && b[2] <= 360.0 && b[1] >= -90.0 && b[3] <= 90.0;
        let on_data = surveys.is_some_and(|d| d[0] <= b[2] && b[0] <= d[2] && d[1] <= b[3] && b[1] <= d[3]);
        let own = match &found.crs {
            Some(text) => Coords::new(text, database)?,
            None if coords.is_some() => None,
            None if degrees && !on_data && database.unit != AxisUnit::Degree => {
                message(&format!(
                    "note: {name} names no CRS and its coordinates look like degrees: they are read as longitude and \
                     latitude (EPSG:4326); --coords {} says that they are not",
                    database.code
                ));
                Coords::new("EPSG:4326", database)?
            }
            None if !degrees && database.unit == AxisUnit::Degree => {
                let reason = format!(
                    "its coordinates ({}, {} .. {}, {}) are no degrees, as those of the database ({}) are; say what they \
                     are with --coords EPSG:n",
                    b[0], b[1], b[2], b[3], database.code
                );
                return Err(Error::invalid(name, reason));
            }
            None => None,
        };
        let by = match found.crs {
            Some(_) => own.as_ref(),
            None => own.as_ref().or(coords.as_ref()),
        };
        let polygon = Arc::new(match by {
            Some(c) => c.polygon(&name, &given)?,
            None => given,
        });
        let bounds = match &coords {
            None => Some(polygon.bounds()),
            Some(c) => box_around(polygon.points().filter_map(|p| c.outward(p))),
        };
        Ok(Place { area: Area::Polygon(polygon.clone()), coords, bounds, mask: Some(polygon) })
    }
}

fn box_around(points: impl Iterator<Item = [f64; 2]>) -> Option<[f64; 4]> {
    points.fold(None, |b: Option<[f64; 4]>, p| {
        let b = b.unwrap_or([p[0], p[1], p[0], p[1]]);
        Some([b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])])
    })
}

/// A box of the database's CRS as it is seen in other coordinates.
fn seen(coords: &Coords, b: [f64; 4]) -> Option<[f64; 4]> {
    const SIDE: usize = 64;
    let sides = (0..=SIDE).flat_map(|k| {
        let t = k as f64 / SIDE as f64;
        let (x, y) = (b[0] + t * (b[2] - b[0]), b[1] + t * (b[3] - b[1]));
        [[x, b[1]], [x, b[3]], [b[0], y], [b[2], y]]
    });
    box_around(sides.filter_map(|p| coords.outward(p)))
}

/// Where the surveys are, for those who asked beside them.
pub fn whereabouts(database: &Crs, surveys: Option<[f64; 4]>, coords: Option<&Coords>) -> String {
    let Some(b) = surveys else {
        return "the database is empty; `terraquilt ingest` brings a survey".into();
    };
    let (b, crs) = match coords {
        Some(c) => (seen(c, b).unwrap_or([f64::NAN; 4]), &c.crs),
        None => (b, database),
    };
    let digits = if crs.unit == AxisUnit::Degree { 6 } else { 1 };
    format!(
        "the surveys lie in {:.digits$},{:.digits$},{:.digits$},{:.digits$} ({})",
        b[0], b[1], b[2], b[3], crs.code
    )
}
