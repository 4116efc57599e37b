//! What a coordinate means: coordinate reference systems, the ways between them, heights and their datums.
//!
//! A [`Crs`] is a text that is stored and compared, with the unit of its axes. [`Transform`] is the way from one
//! to another. This folder is the only door to proj-core and proj-wkt.

mod automatic;
mod datum;
mod definition;
mod esri;
pub mod geoid;
mod notation;
mod own;
mod transform;
pub mod unit;
pub mod vertical;
mod wkt;

pub use automatic::{automatic, lonlat_bounds};
pub use datum::{DatumChoice, Helmert};
pub use notation::{datum_words, ellipsoid_words};
pub use transform::Transform;

use crate::base::{Error, Result};
use definition::{Definition, Method};

/// Unit of the horizontal axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AxisUnit {
    /// Length; metres per unit.
    Metre(f64),
    /// Angle in degrees (longitude, latitude).
    Degree,
}

impl AxisUnit {
    /// Reads what [`AxisUnit`] prints.
    pub fn parse(text: &str) -> Option<AxisUnit> {
        match text {
            "degree" => Some(AxisUnit::Degree),
            _ => text.parse().ok().filter(|m: &f64| m.is_finite() && *m > 0.0).map(AxisUnit::Metre),
        }
    }
}

/// `degree`, or the metres of one unit.
impl std::fmt::Display for AxisUnit {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            AxisUnit::Metre(m) => write!(f, "{m}"),
            AxisUnit::Degree => write!(f, "degree"),
        }
    }
}

/// A horizontal coordinate reference system.
#[derive(Clone, Debug, PartialEq)]
pub struct Crs {
    /// `EPSG:n` where there is a code, else `ESRI:n`, else a PROJ string in canonical form.
    pub code: String,
    pub unit: AxisUnit,
}

impl Crs {
    /// The CRS with this EPSG code.
    ///
    /// # Errors
    /// If the registry does not hold the code.
    pub fn from_epsg(code: u32) -> Result<Crs> {
        let text = format!("EPSG:{code}");
        let unit = epsg_definition(code)?.unit();
        Ok(Crs { code: text, unit })
    }

    /// Reads `EPSG:n`, `ESRI:n`, a PROJ string (`+proj=...`), or WKT (1, 2, or as ESRI writes it).
    ///
    /// A text that names its own EPSG code becomes that code. Of a compound system the horizontal part is taken.
    ///
    /// # Errors
    /// If the text cannot be read or names what this build cannot compute.
    pub fn parse(text: &str) -> Result<Crs> {
        let (code, definition) = notation::read(text)?;
        Ok(Crs { code, unit: definition.unit() })
    }

    /// Equal code, or definitions that put a handful of points (spread over the area of use of the projection)
    /// at the same place to 1e-6 units, on one datum. Two old ellipsoids without a word about the datum are one
    /// datum only in one and the same text.
    pub fn same_as(&self, other: &Crs) -> bool {
        self.code == other.code || transform::agree(self, other)
    }

    /// Longitude and latitude next to the middle of what the system is made for, degrees: its projection's origin.
    pub fn middle(&self) -> Result<[f64; 2]> {
        Ok(self.definition()?.middle())
    }

    fn epsg(&self) -> Option<u32> {
        self.code.strip_prefix("EPSG:").and_then(|n| n.parse().ok())
    }

    fn definition(&self) -> Result<Definition> {
        notation::read(&self.code).map(|(_, definition)| definition)
    }
}

/// Geographic systems whose registry unit is the grad, counted from Paris. proj-core gives every geographic
/// system in degrees, so a file in one of these would be read 10 % too large: they are refused.
const GRAD_CODES: [u32; 8] = [4807, 4810, 4811, 4816, 4819, 4821, 4901, 4902];

/// EPSG systems that proj-core does not hold, as PROJ 9.5.1 writes them: EASE-Grid 2.0.
const ADDED: [(u32, &str); 1] =
    [(6933, "+proj=cea +lat_ts=30 +lon_0=0 +x_0=0 +y_0=0 +datum=WGS84 +units=m +no_defs")];

/// What an EPSG code defines; of a compound system, its horizontal part.
///
/// # Errors
/// For codes that the registry does not hold, for geocentric and purely vertical systems, and for geographic
/// systems in grads.
fn epsg_definition(code: u32) -> Result<Definition> {
    let text = format!("EPSG:{code}");
    if let Some((_, definition)) = ADDED.iter().find(|(c, _)| *c == code) {
        return notation::core_of(definition);
    }
    let known = (!GRAD_CODES.contains(&code)).then(|| proj_core::lookup_epsg(code)).flatten();
    let crs = known.ok_or_else(|| {
        Error::unsupported(
            &text,
            "not in the EPSG registry this build knows",
            "name another CRS with --crs, or give its definition as a PROJ string",
        )
    })?;
    Definition::from_core(&text, &crs)
}

/// EPSG systems that count longitude from Paris, Ferro, Oslo and so on. proj-core reads them as if from
/// Greenwich. Source: prime meridians in the registry of PROJ 9.5.1.
const OTHER_MERIDIAN: [std::ops::RangeInclusive<u32>; 24] = [
    2062..=2062,
    2934..=2934,
    2963..=2963,
    4801..=4821,
    4901..=4904,
    5221..=5229,
    5329..=5331,
    8042..=8045,
    20790..=20791,
    21100..=21100,
    21500..=21500,
    21780..=21780,
    22300..=22300,
    25700..=25700,
    26591..=26592,
    27391..=27398,
    27500..=27500,
    27561..=27564,
    27571..=27574,
    27581..=27584,
    27591..=27594,
    29700..=29702,
    31251..=31253,
    31281..=31293,
];

/// Whether an EPSG system counts longitude from another meridian than Greenwich.
pub fn counts_from_another_meridian(epsg: u32) -> bool {
    OTHER_MERIDIAN.iter().any(|codes| codes.contains(&epsg))
}

/// Why a system must not be transformed: proj-core and PROJ compute it differently.
fn differs_from_proj(crs: &Crs, definition: &Definition) -> Option<&'static str> {
    if crs.epsg().is_some_and(counts_from_another_meridian) {
        return Some("a system that counts longitude from another meridian than Greenwich");
    }
    match definition.projection {
        Some(Method::Core(proj_core::ProjectionMethod::EquidistantCylindrical { .. }))
            if definition.ellipsoid.f != 0.0 =>
        {
            Some(
                "an equidistant cylindrical system on an ellipsoid, for which versions of PROJ use different \
                 formulas, up to 25 km apart",
            )
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_of_known_systems() {
        for code in [4326, 4269, 4258, 4979] {
            assert_eq!(Crs::from_epsg(code).unwrap().unit, AxisUnit::Degree, "EPSG:{code}");
        }
        for code in [32611, 3857, 25832, 3031, 3794] {
            assert_eq!(Crs::from_epsg(code).unwrap().unit, AxisUnit::Metre(1.0), "EPSG:{code}");
        }
        let AxisUnit::Metre(foot) = Crs::parse("epsg:2229").unwrap().unit else {
            panic!("2229 is projected")
        };
        assert!((foot - 1200.0 / 3937.0).abs() < 1e-12, "{foot}");
    }

    #[test]
    fn geocentric_vertical_grads_and_unknown_are_refused() {
        for code in [4978, 5773, 5703, 4807, 0, 99999] {
            assert!(Crs::from_epsg(code).is_err(), "EPSG:{code}");
        }
        assert!(Crs::parse("EPSG:").is_err());
    }

    #[test]
    fn texts_become_one_code() {
        let code = |text: &str| Crs::parse(text).unwrap().code;
        assert_eq!(code("esri:102003"), "ESRI:102003");
        assert_eq!(code("ESRI:102100"), "EPSG:3857");
        assert_eq!(
            code("+proj=utm +zone=11 +datum=NAD83 +units=us-ft +type=crs"),
            "+proj=tmerc +lat_0=0 +lon_0=-117 +k=0.9996 +x_0=500000 +y_0=0 +datum=NAD83 \
             +to_meter=0.3048006096012192 +no_defs"
        );
        let usual = [
            "+proj=lcc +lat_1=49 +ellps=bessel +towgs84=1,2,3",
            "+proj=stere +lat_0=-90 +lat_ts=-71 +datum=WGS84",
            "+proj=laea +lat_0=52 +lon_0=10 +x_0=4321000 +y_0=3210000 +ellps=GRS80",
            "+proj=longlat +R=6371007 +no_defs",
            "+proj=tmerc +lon_0=9 +datum=potsdam",
            "+proj=omerc +lat_0=4 +lonc=115 +alpha=53.3 +gamma=53.1 +k=0.99984 +a=6377298.556 +rf=300.8017",
        ];
        for text in usual {
            let first = code(text);
            assert_eq!(code(&first), first, "{text}");
        }
    }

    #[test]
    fn equal_definitions_are_recognised() {
        let epsg = Crs::from_epsg(3031).unwrap();
        let text = "+proj=stere +lat_0=-90 +lat_ts=-71 +lon_0=0 +k=1 +x_0=0 +y_0=0 +datum=WGS84 +units=m";
        assert!(Crs::parse(text).unwrap().same_as(&epsg));
        assert!(!Crs::parse(&text.replace("71", "70")).unwrap().same_as(&epsg));
        assert!(!Crs::parse(&text.replace("WGS84", "NAD83")).unwrap().same_as(&epsg));
        assert!(!Crs::parse(&text.replace("=m", "=ft")).unwrap().same_as(&epsg));
        assert!(Crs::parse("ESRI:102039").unwrap().same_as(&Crs::from_epsg(5070).unwrap()));
        assert!(!Crs::parse("ESRI:102003").unwrap().same_as(&Crs::from_epsg(5070).unwrap()));
    }
}
