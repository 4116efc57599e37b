//! A file that is asked for.

use super::{area, how, tolerance};
use crate::base::{Error, Result, limits};
use crate::db::Snapshot;
use crate::db::query::{Area, Query, Tolerance};
use crate::export::fractal::{Choice, search_of};
use crate::export::{Coords, FileRequest, Form, Packing, Place};
use crate::height::crs::AxisUnit;
use crate::wire::v1;
use crate::wire::v1::file_request::{Format, Search as Asked};
use std::sync::Arc;

/// Pixels of a picture: it is held in memory while it is drawn.
const PICTURE_PIXELS_MAX: u64 = 64_000_000;
/// Posts of a fractal tile: some 200 bytes of memory a post while it is made.
const TILE_POSTS_MAX: u64 = 2049 * 2049;
/// Those whose ranges meet domains far away.
const TILE_FAR_POSTS_MAX: u64 = 513 * 513;

/// What is to be written.
pub enum File {
    Surface(Box<FileRequest>),
    /// A survey's own samples, of one tile.
    Samples {
        survey: String,
        tile: Option<String>,
    },
}

/// `pixels_max`: what the server allows of any raster.
pub fn file(r: &v1::FileRequest, s: &Snapshot, pixels_max: u64) -> Result<File> {
    let known = Format::try_from(r.format)
        .map_err(|_| Error::invalid("format", format!("{} is none that this server knows", r.format)))?;
    let form = match known {
        Format::Unspecified => {
            return Err(Error::invalid(
                "format",
                "is missing; say FORMAT_GLB, FORMAT_GEOTIFF, FORMAT_PNG or FORMAT_IFS",
            ));
        }
        Format::Glb => Form::Glb,
        Format::Geotiff => Form::GeoTiff,
        Format::Png => Form::Png,
        Format::Ifs => Form::Ifs,
    };
    let tile = tile(r)?;
    tile.only_for_ifs(form.ending())?;
    let packing = Packing { quantize: r.quantize, meshopt: r.meshopt };
    packing.only_for_glb(form.ending())?;
    let text = |t: &str| (!t.is_empty()).then(|| t.to_string());
    if let Some(survey) = text(&r.survey) {
        if form != Form::GeoTiff {
            return Err(Error::invalid(
                "survey",
                "a survey's samples are written as GeoTIFF; ask for that format",
            ));
        }
        return Ok(File::Samples { survey, tile: text(&r.tile) });
    }
    if !r.tile.is_empty() {
        return Err(Error::invalid("tile", format!("'{}' is of no survey; name it in `survey`", r.tile)));
    }
    let query = Query {
        area: Area::Everything,
        tolerance: tolerance(r.tolerance.as_ref())?,
        how: how(r.blend, r.seams, form.seams())?,
    };
    if let (Tolerance::Camera(_), AxisUnit::Degree) = (&query.tolerance, s.crs().unit) {
        return Err(Error::unsupported(
            &s.crs().code,
            "a camera needs metres, and this database is in degrees",
            "ask with error_m",
        ));
    }
    let place = place(r.region.as_ref(), &r.coords, r.region_in_database_crs, s)?;
    let query = Query { area: place.area.clone(), ..query };
    let pixels_max = match form {
        Form::Png => pixels_max.min(PICTURE_PIXELS_MAX),
        Form::Ifs => pixels_max.min(TILE_POSTS_MAX),
        _ => pixels_max.min(limits::RASTER_POSTS_MAX),
    };
    Ok(File::Surface(Box::new(FileRequest {
        form,
        place,
        query,
        step: step([r.step_x, r.step_y])?,
        packing,
        tile,
        pixels_max,
        far_posts_max: TILE_FAR_POSTS_MAX,
    })))
}

/// What is chosen of a fractal tile.
fn tile(r: &v1::FileRequest) -> Result<Choice> {
    let unknown = |_| Error::invalid("search", format!("{} is none that this server knows", r.search));
    let name = match Asked::try_from(r.search).map_err(unknown)? {
        Asked::Unspecified => None,
        Asked::Near => Some("near"),
        Asked::Classes => Some("classes"),
        Asked::Exact => Some("exact"),
    };
    let unit = (r.unit_m != 0.0).then_some(r.unit_m);
    Ok(Choice { bound: r.bound_m, maps: r.maps, unit, search: name.and_then(search_of) })
}

/// Steps along both axes; 0: absent.
pub fn step(given: [f64; 2]) -> Result<Option<[f64; 2]>> {
    if given.iter().any(|v| !(v.is_finite() && *v >= 0.0)) {
        return Err(Error::invalid("step_x, step_y", format!("{given:?}; they must be positive")));
    }
    Ok(match given {
        [0.0, 0.0] => None,
        [x, 0.0] => Some([x, x]),
        [0.0, y] => Some([y, y]),
        both => Some(both),
    })
}

/// A region in the coordinates of the caller.
pub fn place(
    region: Option<&v1::Region>,
    coords: &str,
    region_in_database_crs: bool,
    s: &Snapshot,
) -> Result<Place> {
    let named = coords;
    let coords = Coords::of((!named.is_empty()).then_some(named), s.crs())?;
    match area(region)? {
        Area::Everything => Ok(Place::everywhere(coords, s.bounds())),
        Area::Box(b) if region_in_database_crs && coords.is_some() => Err(Error::invalid(
            "region_in_database_crs",
            format!("goes with polygons; the box {b:?} is read in {named}"),
        )),
        Area::Box(b) => Place::of_box(b, coords),
        Area::Polygon(p) => {
            let polygon = match &coords {
                Some(c) if !region_in_database_crs => Arc::new(c.polygon("region.polygon", &p)?),
                _ => p,
            };
            Ok(Place::of_polygon(polygon, coords))
        }
    }
}
