//! A metric system chosen from where the data lies: the UTM zone of its middle, or polar stereographic.
//!
//! **Bound.** An area fits a UTM zone if it lies within 6 degrees of longitude, and within 530 km, of the zone's
//! central meridian, between 80 degrees south and 84 degrees north. There a length on the map is between
//! 0.9996 and 1.0031 of the length on the ellipsoid: 1 - 0.0004 on the meridian, and
//! 0.9996 * (1 + d^2 / (2 R^2)) at a distance d from it, R = 6356 km at least. An area fits a polar
//! system (WGS 84, true at the pole up to 0.994: EPSG:32661, EPSG:32761) if it lies beyond 60 degrees; the
//! scale there is between 0.994 and 1.066.

use super::{Crs, DatumChoice, Transform};
use crate::base::{Error, Result};

/// Largest difference of longitude from the central meridian, degrees.
const REACH_DEGREES: f64 = 6.0;
/// Largest distance from the central meridian along the widest parallel, metres.
const REACH_M: f64 = 530_000.0;
/// Metres of one degree of longitude on the equator of WGS 84.
const DEGREE_M: f64 = 111_319.490_793;
const UTM_SOUTH: f64 = -80.0;
const UTM_NORTH: f64 = 84.0;
/// Polar systems are chosen for areas beyond this latitude that UTM does not hold.
const POLAR: f64 = 60.0;

/// The system for an area given as west, south, east, north in degrees; east may exceed 180 (or lie below west)
/// for an area across the antimeridian.
///
/// # Errors
/// If the area is none, or too wide or too long for one system: with its width, the limit and what to do.
pub fn automatic(bounds: [f64; 4]) -> Result<Crs> {
    let [west, south, mut east, north] = bounds;
    let sound = bounds.iter().all(|v| v.is_finite())
        && (-90.0..=90.0).contains(&south)
        && (south..=90.0).contains(&north)
        && west.abs() <= 540.0
        && east.abs() <= 540.0;
    if !sound {
        return Err(Error::invalid(
            "area for an automatic CRS",
            format!("longitude {west} to {east}, latitude {south} to {north} is no area"),
        ));
    }
    if east < west {
        east += 360.0;
    }
    if south >= UTM_SOUTH && north <= UTM_NORTH {
        let middle = normal((west + east) / 2.0);
        let zone = (((middle + 180.0) / 6.0).floor() as i64).clamp(0, 59) as u32 + 1;
        let meridian = f64::from(zone) * 6.0 - 183.0;
        let centre = meridian + (west + east) / 2.0 - middle;
        let reach = (east - centre).max(centre - west);
        let widest = if south > 0.0 { south } else { north.min(0.0) };
        let metres = reach * DEGREE_M * widest.to_radians().cos();
        if reach <= REACH_DEGREES && metres <= REACH_M {
            let northern = south + north >= 0.0;
            return Crs::from_epsg(if northern { 32600 } else { 32700 } + zone);
        }
    }
    if south >= POLAR {
        return Crs::from_epsg(32661);
    }
    if north <= -POLAR {
        return Crs::from_epsg(32761);
    }
    Err(Error::unsupported(
        "automatic CRS",
        format!(
            "the data is {:.1} degrees wide (longitude {west:.2} to {east:.2}, latitude {south:.2} to {north:.2}); \
             a UTM zone holds what lies within {REACH_DEGREES} degrees and {:.0} km of its central meridian between \
             80 S and 84 N, a polar system what lies beyond {POLAR} degrees of latitude",
            east - west,
            REACH_M / 1000.0
        ),
        "make the database in a system that fits the whole area with `terraquilt init NEWDIR --crs ...`, such as EPSG:5070 (United States), EPSG:3035 (Europe) \
         or EPSG:4326 (anywhere, in degrees)",
    ))
}

/// Longitude within [-180, 180).
fn normal(lon: f64) -> f64 {
    lon - 360.0 * ((lon + 180.0) / 360.0).floor()
}

/// Points along each edge of a rectangle.
const EDGE: usize = 64;

/// West, south, east, north in degrees of a rectangle (xmin, ymin, xmax, ymax) of `crs`, on the datum of `crs`.
///
/// Edges and inside are walked on a net of 65 by 65 points, and a pole inside counts with all longitudes. East
/// exceeds 180 where the rectangle crosses the antimeridian.
///
/// # Errors
/// If a point has no longitude and latitude.
pub fn lonlat_bounds(crs: &Crs, bounds: [f64; 4]) -> Result<[f64; 4]> {
    let way = Transform::new(crs, &Crs::from_epsg(4326)?, &DatumChoice::Ballpark)?;
    let [x0, y0, x1, y1] = bounds;
    let point = |x: f64, y: f64| {
        way.forward([x, y]).ok_or_else(|| {
            Error::invalid(
                &crs.code,
                format!("position ({x}, {y}) has no longitude and latitude; is it in this system?"),
            )
        })
    };
    let at = |a: f64, b: f64, i: usize| a + (b - a) * i as f64 / EDGE as f64;
    let (mut south, mut north) = (f64::INFINITY, f64::NEG_INFINITY);
    let (mut west, mut east) = (f64::INFINITY, f64::NEG_INFINITY);
    // Longitudes are followed from neighbour to neighbour, so that 180 is no border.
    let mut row_start = None;
    for j in 0..=EDGE {
        let mut last = row_start;
        for i in 0..=EDGE {
            let [lon, lat] = point(at(x0, x1, i), at(y0, y1, j))?;
            let lon = last.map_or(lon, |l: f64| lon + 360.0 * ((l - lon) / 360.0).round());
            last = Some(lon);
            if i == 0 {
                row_start = last;
            }
            (south, north) = (south.min(lat), north.max(lat));
            (west, east) = (west.min(lon), east.max(lon));
        }
    }
    for pole in [-90.0, 90.0] {
        let inside = way.inverse([0.0, pole]).is_some_and(|[x, y]| {
            (x0.min(x1)..=x0.max(x1)).contains(&x) && (y0.min(y1)..=y0.max(y1)).contains(&y)
        });
        if inside && crs.unit != super::AxisUnit::Degree {
            (west, east) = (-180.0, 180.0);
            (south, north) = (south.min(pole), north.max(pole));
        }
    }
    if east - west >= 360.0 {
        (west, east) = (-180.0, 180.0);
    }
    let turns = 360.0 * ((west + 180.0) / 360.0).floor();
    Ok([west - turns, south, east - turns, north])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(bounds: [f64; 4]) -> String {
        automatic(bounds).map_or_else(|e| e.to_string(), |crs| crs.code)
    }

    #[test]
    fn zones_and_poles() {
        assert_eq!(code([-119.0, 37.0, -118.0, 38.0]), "EPSG:32611");
        assert_eq!(code([10.0, -1.0, 11.0, 0.5]), "EPSG:32732");
        assert_eq!(code([179.5, -17.0, 180.5, -16.0]), "EPSG:32701");
        assert_eq!(code([179.5, -17.0, -179.9, -16.0]), "EPSG:32760");
        assert_eq!(code([-180.0, -85.0, 180.0, -70.0]), "EPSG:32761");
        assert_eq!(code([20.0, 83.0, 40.0, 85.0]), "EPSG:32661");
        // Wide in degrees, narrow in metres.
        assert_eq!(code([10.0, 78.0, 20.0, 80.0]), "EPSG:32633");
    }

    #[test]
    fn too_wide_is_refused_with_the_numbers() {
        let text = code([-125.0, 30.0, -100.0, 49.0]);
        for part in ["25.0 degrees", "530 km", "--crs"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(automatic([0.0, 10.0, 1.0, 5.0]).is_err());
        assert!(automatic([f64::NAN, 0.0, 1.0, 1.0]).is_err());
    }

    #[test]
    fn bounds_of_rectangles() {
        let utm = Crs::from_epsg(32601).unwrap();
        // Across the antimeridian: zone 1 begins at 180.
        let [w, s, e, n] = lonlat_bounds(&utm, [100_000.0, 5_000_000.0, 400_000.0, 5_100_000.0]).unwrap();
        assert!((177.0..180.0).contains(&w) && (180.0..184.0).contains(&e) && s < n, "{w} {e}");
        let polar = Crs::from_epsg(3031).unwrap();
        let [w, s, e, n] = lonlat_bounds(&polar, [-1e6, -1e6, 1e6, 1e6]).unwrap();
        assert_eq!([w, s, e], [-180.0, -90.0, 180.0]);
        assert!((-78.0..-76.0).contains(&n), "{n}");
        let plain = lonlat_bounds(&Crs::from_epsg(4326).unwrap(), [7.0, 50.0, 8.0, 51.0]).unwrap();
        assert_eq!(plain, [7.0, 50.0, 8.0, 51.0]);
    }
}
