//! What a text defines: projection, unit, ellipsoid and datum, whatever notation they were written in.
//!
//! A definition splits a system into a *projection* between its coordinates and longitude/latitude on its own
//! ellipsoid, which proj-core computes, and a *datum*, which `datum` ties to WGS 84. proj-core is never
//! asked to choose a datum operation.

use super::AxisUnit;
use super::datum::{Datum, Helmert};
use super::own::Own;
use crate::base::{Error, Result};
use proj_core::{CrsDef, DatumToWgs84, GeographicCrsDef, LinearUnit, ProjectedCrsDef, ProjectionMethod};

/// Semi-major axis in metres and flattening.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ellipsoid {
    pub a: f64,
    pub f: f64,
}

impl Ellipsoid {
    pub const WGS84: Ellipsoid = Ellipsoid { a: 6378137.0, f: 1.0 / 298.257223563 };
    const GRS80: Ellipsoid = Ellipsoid { a: 6378137.0, f: 1.0 / 298.257222101 };

    pub fn of(datum: &proj_core::Datum) -> Ellipsoid {
        Ellipsoid { a: datum.ellipsoid().semi_major_axis(), f: datum.ellipsoid().flattening() }
    }

    /// Equal but for rounding: within a millimetre in size, and in flattening closer than WGS 84 and GRS 1980 are
    /// (1.6e-11).
    pub fn same(self, other: Ellipsoid) -> bool {
        (self.a - other.a).abs() < 1e-3 && (self.f - other.f).abs() < 1e-12
    }

    /// WGS 84 or GRS 1980, which are a tenth of a millimetre apart.
    pub fn is_modern(self) -> bool {
        self.same(Ellipsoid::WGS84) || self.same(Ellipsoid::GRS80)
    }
}

/// Between longitude/latitude and the plane.
#[derive(Clone, Copy, Debug)]
pub(super) enum Method {
    Core(ProjectionMethod),
    Own(Own),
}

/// One horizontal system.
#[derive(Clone, Debug)]
pub(super) struct Definition {
    /// None: longitude and latitude in degrees.
    pub projection: Option<Method>,
    /// Metres of one unit of a projected system.
    pub unit_m: f64,
    pub ellipsoid: Ellipsoid,
    pub datum: Datum,
}

impl Definition {
    /// The horizontal part of a definition of proj-core; `text` is for messages.
    ///
    /// # Errors
    /// If it has none (geocentric or vertical systems).
    pub fn from_core(text: &str, crs: &CrsDef) -> Result<Definition> {
        let no_map = || {
            Error::unsupported(
                text,
                "a geocentric or purely vertical system, in which no grid can lie",
                "name a geographic or projected system with --crs",
            )
        };
        let crs = crs.horizontal_crs().ok_or_else(no_map)?;
        let (projection, unit_m) = match (crs.as_projected(), crs.as_geographic()) {
            (Some(p), _) => (Some(Method::Core(p.method())), p.linear_unit_to_meter()),
            (None, Some(_)) => (None, 1.0),
            (None, None) => return Err(no_map()),
        };
        let core = crs.datum();
        let ellipsoid = Ellipsoid::of(core);
        let declared = match core.to_wgs84() {
            DatumToWgs84::Helmert(h) if core.epsg() == 0 => Some(Helmert {
                shift_m: [h.dx(), h.dy(), h.dz()],
                turn_arcsec: [h.rx(), h.ry(), h.rz()],
                scale_ppm: h.ds(),
            }),
            DatumToWgs84::GridShift(_) if core.epsg() == 0 => {
                return Err(Error::unsupported(
                    text,
                    "a datum that is defined by grid files",
                    "leave +nadgrids out and give the grid with --datum-shift",
                ));
            }
            _ => None,
        };
        let null = core.is_wgs84_compatible();
        let name = crs
            .base_geographic_crs_epsg()
            .or(Some(crs.epsg()))
            .and_then(proj_core::lookup_epsg)
            .filter(|base| base.is_geographic())
            .map(|base| base.name().to_string());
        let datum = Datum::new(core.epsg(), name, declared, null && core.epsg() == 0, ellipsoid);
        Ok(Definition { projection, unit_m, ellipsoid, datum })
    }

    /// Unit of the axes.
    pub fn unit(&self) -> AxisUnit {
        match self.projection {
            Some(_) => AxisUnit::Metre(self.unit_m),
            None => AxisUnit::Degree,
        }
    }

    /// The geographic and the projected system of proj-core on one nameless datum, so that a transform between
    /// them is the projection and nothing else. None for geographic systems and projections of our own.
    pub fn core_pair(&self, text: &str) -> Result<Option<(CrsDef, CrsDef)>> {
        let Some(Method::Core(method)) = self.projection else { return Ok(None) };
        let bad = |e: proj_core::Error| Error::invalid(text, e);
        let ellipsoid = match self.ellipsoid.f {
            0.0 => proj_core::Ellipsoid::sphere(self.ellipsoid.a),
            f => proj_core::Ellipsoid::from_a_f(self.ellipsoid.a, f),
        }
        .map_err(bad)?;
        let datum = proj_core::Datum::new(ellipsoid, DatumToWgs84::Identity).map_err(bad)?;
        let unit = LinearUnit::from_meters_per_unit(self.unit_m).map_err(bad)?;
        let geographic = CrsDef::Geographic(GeographicCrsDef::new(0, datum.clone(), ""));
        let projected = CrsDef::Projected(ProjectedCrsDef::new(0, datum, method, unit, ""));
        Ok(Some((geographic, projected)))
    }
}

impl Definition {
    /// On one datum, for certain: named or declared alike, or both nameless on a modern ellipsoid.
    pub fn same_datum(&self, other: &Definition) -> bool {
        self.ellipsoid.same(other.ellipsoid) && self.datum.same(&other.datum)
    }

    /// Longitude and latitude of a place where the projection is well-behaved.
    pub fn middle(&self) -> [f64; 2] {
        use ProjectionMethod as P;
        let method = match self.projection {
            None => return [0.0, 0.0],
            Some(Method::Own(own)) => return [own.lon0, 10.0],
            Some(Method::Core(method)) => method,
        };
        match method {
            P::TransverseMercator { lon0, lat0, .. } => [lon0, lat0],
            P::PolarStereographic { lon0, lat_ts, .. } => [lon0, lat_ts.clamp(-80.0, 80.0)],
            P::PolarStereographicVariantC { lon0, lat_ts, .. } => [lon0, lat_ts.clamp(-80.0, 80.0)],
            P::LambertConformalConic { lon0, lat1, lat2, .. }
            | P::LambertConformalConicMichigan { lon0, lat1, lat2, .. }
            | P::AlbersEqualArea { lon0, lat1, lat2, .. } => [lon0, (lat1 + lat2) / 2.0],
            P::LambertAzimuthalEqualArea { lon0, lat0, .. }
            | P::LambertAzimuthalEqualAreaSpherical { lon0, lat0, .. }
            | P::ObliqueStereographic { lon0, lat0, .. }
            | P::LambertConformalConic1SPVariantB { lon0, lat0, .. }
            | P::CassiniSoldner { lon0, lat0, .. }
            | P::ColombiaUrban { lon0, lat0, .. }
            | P::KrovakNorthOrientated { lon0, lat0, .. }
            | P::KrovakModifiedNorthOrientated { lon0, lat0, .. }
            | P::AmericanPolyconic { lon0, lat0, .. }
            | P::AzimuthalEquidistant { lon0, lat0, .. }
            | P::GuamProjection { lon0, lat0, .. }
            | P::LabordeObliqueMercator { lon0, lat0, .. } => [lon0, lat0.clamp(-80.0, 80.0)],
            P::HotineObliqueMercator { lonc, latc, .. } => [lonc, latc],
            P::Mercator { lon0, .. }
            | P::EquidistantCylindrical { lon0, .. }
            | P::EqualEarth { lon0, .. } => [lon0, 10.0],
            _ => [0.0, 10.0],
        }
    }
}
