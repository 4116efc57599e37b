//! Questions as messages.

use crate::base::{Error, Result};
use crate::db::query::{Area, Tolerance};
use crate::height::lod::cut::{Camera, ErrorRaster, Focus};
use crate::height::surface::{Blend, How, Seams};
use crate::wire::{MESSAGE_BYTES_MAX, v1};

fn packed(points: &[[f64; 2]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

/// Where; `None`: everything.
pub fn region(area: &Area) -> Option<v1::Region> {
    use v1::region::Kind;
    let kind = match area {
        Area::Everything => return None,
        Area::Box([xmin, ymin, xmax, ymax]) => {
            Kind::Box(v1::Box { xmin: *xmin, ymin: *ymin, xmax: *xmax, ymax: *ymax })
        }
        Area::Polygon(p) => {
            let ring = |r: &Vec<[f64; 2]>| v1::Ring { points: packed(r).into() };
            let part = |p: &Vec<Vec<[f64; 2]>>| v1::PolygonPart { rings: p.iter().map(ring).collect() };
            Kind::Polygon(v1::Polygon { parts: p.parts().iter().map(part).collect() })
        }
    };
    Some(v1::Region { kind: Some(kind) })
}

/// How exact.
///
/// # Errors
/// If a raster of tolerances is too large for a message.
pub fn tolerance(t: &Tolerance) -> Result<v1::Tolerance> {
    use v1::tolerance::Kind;
    let kind = match t {
        Tolerance::Constant(e) => Kind::ErrorM(*e),
        Tolerance::Camera(c) => Kind::Camera(camera(c)),
        Tolerance::Foci(f) => {
            let one = |f: &Focus| v1::Focus {
                x: f.center[0],
                y: f.center[1],
                radius_m: f.radius,
                error_m: f.error,
                growth: f.growth,
            };
            Kind::Foci(v1::Foci { foci: f.foci().iter().map(one).collect() })
        }
        Tolerance::Raster(r) => Kind::Raster(raster(r)?),
    };
    Ok(v1::Tolerance { kind: Some(kind) })
}

fn camera(c: &Camera) -> v1::Camera {
    v1::Camera {
        eye_x: c.eye[0],
        eye_y: c.eye[1],
        eye_z: c.eye[2],
        look_at_x: c.look_at[0],
        look_at_y: c.look_at[1],
        look_at_z: c.look_at[2],
        fov_deg: c.fov_deg,
        viewport_width: c.viewport[0],
        viewport_height: c.viewport[1],
        pixels: c.pixels,
        far_m: c.far,
    }
}

fn raster(r: &ErrorRaster) -> Result<v1::ErrorRaster> {
    let (cols, rows, values, at) = r.posts();
    // A message has other fields, too.
    let most = MESSAGE_BYTES_MAX / 4 - 1024;
    if values.len() > most {
        let what = "posts of --error-raster in one message to a server (give a coarser raster)";
        return Err(Error::limit(what, most as u64, values.len() as u64));
    }
    Ok(v1::ErrorRaster {
        cols: cols as u32,
        rows: rows as u32,
        x: at.origin[0],
        y: at.origin[1],
        col_dx: at.col_step[0],
        col_dy: at.col_step[1],
        row_dx: at.row_step[0],
        row_dy: at.row_step[1],
        errors_m: values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>().into(),
    })
}

/// In which manner.
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
