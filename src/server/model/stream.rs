//! A stream of the surface that is asked for.

use super::export::{place, step};
use super::{how, tolerance};
use crate::base::{Error, Result};
use crate::db::Snapshot;
use crate::db::query::{Query, Tolerance};
use crate::export::{Choice, StreamRequest};
use crate::height::crs::AxisUnit;
use crate::height::surface::Seams;
use crate::wire::v1;
use crate::wire::v1::surface_request::Profile as Asked;
use terraquilt_codecs::gtb::Profile;

/// Streams that refine one another.
const DEPTH_MAX: u64 = 8;

/// What is to be made. `side_max`: posts along a side that the server allows.
pub fn stream(r: &v1::SurfaceRequest, s: &Snapshot, side_max: u64) -> Result<StreamRequest> {
    let unknown = |_| Error::invalid("profile", format!("{} is none that this server knows", r.profile));
    let profile = match Asked::try_from(r.profile).map_err(unknown)? {
        Asked::Unspecified | Asked::Cubic => Profile::Cubic,
        Asked::Adaptive => Profile::Adaptive,
    };
    let tolerance = tolerance(r.tolerance.as_ref())?;
    if let (Tolerance::Camera(_), AxisUnit::Degree) = (&tolerance, s.crs().unit) {
        return Err(Error::unsupported(
            &s.crs().code,
            "a camera needs metres, and this database is in degrees",
            "ask with error_m",
        ));
    }
    let place = place(r.region.as_ref(), &r.coords, r.region_in_database_crs, s)?;
    let how = how(r.blend, r.seams, Seams::Off)?;
    let unit = (r.unit_m != 0.0).then_some(r.unit_m);
    Ok(StreamRequest {
        query: Query { area: place.area.clone(), tolerance, how },
        place,
        step: step([r.step_x, r.step_y])?,
        profile,
        choice: Choice { bound: r.bound_m, layers: r.layers_m.clone(), unit },
        side_max,
    })
}

/// Refuses what is held and cannot be made again as it was.
pub fn held(r: &v1::SurfaceRequest) -> Result<()> {
    let (mut of, mut depth) = (r, 0);
    while let Some(h) = &of.held {
        depth += 1;
        if depth > DEPTH_MAX {
            return Err(Error::limit("streams that refine one another (ask for all)", DEPTH_MAX, depth));
        }
        of = match &h.request {
            Some(inner) if inner.at > 0 => inner,
            Some(_) => {
                return Err(Error::invalid("held.request.at", "is missing; say the version of what is held"));
            }
            None => return Err(Error::invalid("held.request", "is missing; say with what it was asked")),
        };
    }
    Ok(())
}
