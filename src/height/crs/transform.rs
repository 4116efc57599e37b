//! The way from one system to another: back to longitude and latitude, over the datums, and forth again.

use super::datum::{DatumChoice, Shift};
use super::definition::{Definition, Method};
use super::own::Plane;
use super::{Crs, differs_from_proj};
use crate::base::{Error, Result};

/// Version of the library that computes projections: part of what is recorded.
const LIBRARY: &str = "proj-core 0.13.1";

/// Turns positions of one system into positions of another. The same input gives the same bits.
pub struct Transform {
    from: Projection,
    to: Projection,
    shift: Shift,
    description: String,
}

/// Between the coordinates of a system and degrees on its own datum.
enum Projection {
    Geographic,
    /// Forward and inverse.
    Core(Box<(proj_core::Transform, proj_core::Transform)>),
    Own(Plane),
}

impl Transform {
    /// The way from `from` to `to`. Datums that agree within metres by the EPSG registry are taken as one (a
    /// note says so); any other shift has to be stated by one of the systems or by `choice`.
    ///
    /// # Errors
    /// If a system is not known, is known to be computed otherwise than by PROJ, or a datum shift is needed
    /// and not stated.
    pub fn new(from: &Crs, to: &Crs, choice: &DatumChoice) -> Result<Transform> {
        let (a, b) = (from.definition()?, to.definition()?);
        let what = format!("{} to {}", from.code, to.code);
        let shift = match from.code == to.code {
            true => Shift::none_on(&a.datum),
            false => Shift::between(&what, (&a.datum, a.ellipsoid), (&b.datum, b.ellipsoid), choice)?,
        };
        let description = format!("{what}: {}; {LIBRARY}", shift.text);
        Ok(Transform { from: Projection::new(from, &a)?, to: Projection::new(to, &b)?, shift, description })
    }

    /// Position in `to` of a position in `from`: x (easting, longitude) first, degrees in geographic systems.
    /// None where the projection is not defined.
    pub fn forward(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        self.to.project(self.shift.forward(self.from.unproject(p)?))
    }

    /// The way back.
    pub fn inverse(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        self.from.project(self.shift.inverse(self.to.unproject(p)?))
    }

    /// Both systems, what was done about their datums and who chose it, and the library: one line, to be
    /// recorded with what was transformed.
    pub fn description(&self) -> &str {
        &self.description
    }

    /// What a user should know: datums that were taken as one, a ballpark shift.
    pub fn notes(&self) -> &[String] {
        &self.shift.notes
    }
}

impl Projection {
    fn new(crs: &Crs, definition: &Definition) -> Result<Projection> {
        if let Some(why) = differs_from_proj(crs, definition) {
            return Err(Error::unsupported(
                &crs.code,
                why,
                "warp the grid into another system with GDAL first",
            ));
        }
        if let Some(Method::Own(own)) = definition.projection {
            return Ok(Projection::Own(Plane::new(own, definition.ellipsoid, definition.unit_m)));
        }
        let Some((geographic, projected)) = definition.core_pair(&crs.code)? else {
            return Ok(Projection::Geographic);
        };
        let way = |a, b| proj_core::Transform::from_crs_defs(a, b).map_err(|e| Error::invalid(&crs.code, e));
        Ok(Projection::Core(Box::new((way(&geographic, &projected)?, way(&projected, &geographic)?))))
    }

    fn project(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        finite(match self {
            Projection::Geographic => p,
            Projection::Core(pair) => run(&pair.0, p)?,
            Projection::Own(plane) => plane.project(p)?,
        })
    }

    fn unproject(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        finite(match self {
            Projection::Geographic => p,
            Projection::Core(pair) => run(&pair.1, p)?,
            Projection::Own(plane) => plane.unproject(p)?,
        })
    }
}

fn run(way: &proj_core::Transform, p: [f64; 2]) -> Option<[f64; 2]> {
    way.convert((p[0], p[1])).map(|(x, y)| [x, y]).ok()
}

fn finite(p: [f64; 2]) -> Option<[f64; 2]> {
    p.iter().all(|v| v.is_finite()).then_some(p)
}

/// Whether two systems put points at the same place: nine points around the middle of the projection.
pub(super) fn agree(a: &Crs, b: &Crs) -> bool {
    let (Ok(da), Ok(db)) = (a.definition(), b.definition()) else { return false };
    if !da.same_datum(&db) || da.projection.is_some() != db.projection.is_some() {
        return false;
    }
    let (Ok(pa), Ok(pb)) = (Projection::new(a, &da), Projection::new(b, &db)) else { return false };
    let [lon, lat] = da.middle();
    let offsets = [-1.5, 0.2, 2.5];
    offsets.iter().flat_map(|x| offsets.map(|y| [lon + x, (lat + y).clamp(-89.9, 89.9)])).all(|p| {
        match (pa.project(p), pb.project(p)) {
            (Some(p), Some(q)) => (p[0] - q[0]).abs() <= AGREE && (p[1] - q[1]).abs() <= AGREE,
            _ => false,
        }
    })
}

/// Largest difference of [`agree`], in units of the systems.
const AGREE: f64 = 1e-6;
