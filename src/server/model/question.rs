//! Where and how exact: regions, tolerances, manners.

use crate::base::polygon::Polygon;
use crate::base::{Error, Result, limits};
use crate::db::query::{Area, Query, Tolerance};
use crate::height::lod::cut::{Camera, ErrorRaster, Foci, Focus};
use crate::height::source::Affine;
use crate::height::surface::{Blend, How, Seams};
use crate::wire::v1;
use std::sync::Arc;

/// Finite numbers only.
fn finite<const N: usize>(what: &str, values: [f64; N]) -> Result<[f64; N]> {
    if values.iter().all(|v| v.is_finite()) {
        return Ok(values);
    }
    Err(Error::invalid(what, format!("{values:?} holds a number that is not finite")))
}

/// Pairs of little-endian float64.
pub fn pairs(what: &str, bytes: &[u8]) -> Result<Vec<[f64; 2]>> {
    if !bytes.len().is_multiple_of(16) {
        return Err(Error::invalid(
            what,
            format!("{} bytes are no pairs of float64; send 16 bytes a point, x then y", bytes.len()),
        ));
    }
    let number = |b: &[u8]| f64::from_le_bytes(b.try_into().expect("8 bytes were cut"));
    Ok(bytes.chunks_exact(16).map(|b| [number(&b[..8]), number(&b[8..])]).collect())
}

/// Where.
pub fn area(region: Option<&v1::Region>) -> Result<Area> {
    use v1::region::Kind;
    match region.and_then(|r| r.kind.as_ref()) {
        None => Ok(Area::Everything),
        Some(Kind::Box(b)) => {
            let b = finite("region.box", [b.xmin, b.ymin, b.xmax, b.ymax])?;
            if b[0] >= b[2] || b[1] >= b[3] {
                return Err(Error::invalid(
                    "region.box",
                    format!("{b:?} is empty; give xmin below xmax and ymin below ymax"),
                ));
            }
            Ok(Area::Box(b))
        }
        Some(Kind::Polygon(p)) => {
            let bytes: usize = p.parts.iter().flat_map(|p| &p.rings).map(|r| r.points.len()).sum();
            if bytes as u64 / 16 > limits::POLYGON_POINTS_MAX {
                return Err(Error::limit(
                    "points of region.polygon",
                    limits::POLYGON_POINTS_MAX,
                    bytes as u64 / 16,
                ));
            }
            let part =
                |p: &v1::PolygonPart| p.rings.iter().map(|r| pairs("region.polygon", &r.points)).collect();
            let parts = p.parts.iter().map(part).collect::<Result<_>>()?;
            Ok(Area::Polygon(Arc::new(Polygon::new("region.polygon", parts)?)))
        }
    }
}

/// How exact.
pub fn tolerance(t: Option<&v1::Tolerance>) -> Result<Tolerance> {
    use v1::tolerance::Kind;
    match t.and_then(|t| t.kind.as_ref()) {
        None => Err(Error::invalid("tolerance", "is missing; give error_m (metres), camera, foci or raster")),
        Some(Kind::ErrorM(e)) => {
            if e.is_nan() || *e < 0.0 {
                return Err(Error::invalid(
                    "tolerance.error_m",
                    format!("{e} is no error; give metres, 0 or more"),
                ));
            }
            Ok(Tolerance::Constant(*e))
        }
        Some(Kind::Camera(c)) => Ok(Tolerance::Camera(camera(c)?)),
        Some(Kind::Foci(f)) => Ok(Tolerance::Foci(foci_of(f)?)),
        Some(Kind::Raster(r)) => Ok(Tolerance::Raster(Arc::new(raster(r)?))),
    }
}

fn camera(c: &v1::Camera) -> Result<Camera> {
    let eye = finite("camera.eye", [c.eye_x, c.eye_y, c.eye_z])?;
    let look = finite("camera.look_at", [c.look_at_x, c.look_at_y, c.look_at_z])?;
    let [fov, pixels, far] = finite("camera", [c.fov_deg, c.pixels, c.far_m])?;
    Camera::new(eye, look, fov, [c.viewport_width, c.viewport_height], pixels, (far != 0.0).then_some(far))
}

fn foci_of(f: &v1::Foci) -> Result<Foci> {
    let one = |f: &v1::Focus| {
        let [x, y, radius, error, growth] =
            finite("tolerance.foci", [f.x, f.y, f.radius_m, f.error_m, f.growth])?;
        Ok(Focus { center: [x, y], radius, error, growth })
    };
    Foci::new(f.foci.iter().map(one).collect::<Result<_>>()?)
}

fn raster(r: &v1::ErrorRaster) -> Result<ErrorRaster> {
    let (cols, rows) = (r.cols as usize, r.rows as usize);
    let wanted = u64::from(r.cols) * u64::from(r.rows);
    if wanted > limits::TOLERANCE_POSTS_MAX {
        return Err(Error::limit("posts of tolerance.raster", limits::TOLERANCE_POSTS_MAX, wanted));
    }
    if wanted == 0 || r.errors_m.len() as u64 != wanted * 4 {
        let reason =
            format!("{} bytes for {cols} x {rows} posts; {} are needed", r.errors_m.len(), wanted * 4);
        return Err(Error::invalid("tolerance.raster.errors_m", reason));
    }
    let values: Vec<f32> = r
        .errors_m
        .chunks_exact(4)
        .map(|b| f32::from_le_bytes(b.try_into().expect("4 bytes were cut")))
        .collect();
    if let Some(k) = values.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
        let reason = format!("{} in column {}, row {}; give 0 or more", values[k], k % cols, k / cols);
        return Err(Error::invalid("tolerance.raster.errors_m", reason));
    }
    let [x, y] = finite("tolerance.raster", [r.x, r.y])?;
    let [cx, cy, rx, ry] = finite("tolerance.raster", [r.col_dx, r.col_dy, r.row_dx, r.row_dy])?;
    ErrorRaster::new(cols, rows, values, &Affine { origin: [x, y], col_step: [cx, cy], row_step: [rx, ry] })
}

/// In which manner; `seams`: what unspecified means.
pub fn how(blend: i32, seams: i32, unspecified: Seams) -> Result<How> {
    let unknown = |what: &str, n: i32| {
        Error::invalid(what, format!("{n} is none that this server knows; see terrain.proto"))
    };
    let blend = match v1::Blend::try_from(blend).map_err(|_| unknown("blend", blend))? {
        v1::Blend::Unspecified | v1::Blend::Exact => Blend::Exact,
        v1::Blend::Plain => Blend::Plain,
    };
    let seams = match v1::Seams::try_from(seams).map_err(|_| unknown("seams", seams))? {
        v1::Seams::Unspecified => unspecified,
        v1::Seams::Off => Seams::Off,
        v1::Seams::All => Seams::All,
        v1::Seams::Consistent => Seams::Consistent,
    };
    Ok(How { blend, seams })
}

/// A manner, as it is said in answers.
pub fn manner(how: How) -> (v1::Blend, v1::Seams) {
    let blend = match how.blend {
        Blend::Exact => v1::Blend::Exact,
        Blend::Plain => v1::Blend::Plain,
    };
    let seams = match how.seams {
        Seams::Off => v1::Seams::Off,
        Seams::All => v1::Seams::All,
        Seams::Consistent => v1::Seams::Consistent,
    };
    (blend, seams)
}

/// A whole question.
pub fn query(region: Option<&v1::Region>, t: Option<&v1::Tolerance>, how: How) -> Result<Query> {
    Ok(Query { area: area(region)?, tolerance: tolerance(t)?, how })
}
