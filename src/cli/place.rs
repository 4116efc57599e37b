//! Regions in files, and what is said of coordinates.

use super::output::message;
use crate::base::polygon::Polygon;
use crate::base::{Error, Result};
use crate::export::{Coords, Place};
use crate::format::geojson::read_polygons;
use crate::height::crs::{AxisUnit, Crs};
use std::path::Path;
use std::sync::Arc;

/// Says what a person should know of coordinates.
pub fn told(coords: Option<Coords>) -> Option<Coords> {
    coords.iter().flat_map(|c| &c.notes).for_each(|n| message(&format!("note: {n}")));
    coords
}

/// The polygons of a GeoJSON file. Its own member `crs` says what its coordinates are, else `--coords`, else they are
/// taken in the database's CRS; but if that is in metres and they can only be degrees, as RFC 7946 has them.
pub fn place_of_file(
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
        Some(text) => told(Coords::new(text, database)?),
        None if coords.is_some() => None,
        None if degrees && !on_data && database.unit != AxisUnit::Degree => {
            message(&format!(
                "note: {name} names no CRS and its coordinates look like degrees: they are read as longitude and \
                 latitude (EPSG:4326); --coords {} says that they are not",
                database.code
            ));
            told(Coords::new("EPSG:4326", database)?)
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
    Ok(Place::of_polygon(polygon, coords))
}
