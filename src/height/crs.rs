//! What a coordinate means: the name of a coordinate reference system and the unit of its axes.
//!
//! Nothing is reprojected here: a survey has to be in the database's CRS.

use crate::base::{Error, Result};

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

/// A coordinate reference system, by authority and code (`EPSG:32610`).
#[derive(Clone, Debug, PartialEq)]
pub struct Crs {
    /// `EPSG:n`, upper case.
    pub code: String,
    pub unit: AxisUnit,
}

impl Crs {
    /// The CRS with this EPSG code.
    ///
    /// # Errors
    /// If the registry does not hold the code.
    pub fn from_epsg(code: u32) -> Result<Crs> {
        let unit = unit_of(code).ok_or_else(|| {
            Error::unsupported(
                format!("EPSG:{code}"),
                "not in the EPSG registry this build knows",
                "name another CRS with --crs EPSG:n",
            )
        })?;
        Ok(Crs { code: format!("EPSG:{code}"), unit })
    }

    /// Reads `EPSG:n`.
    pub fn parse(text: &str) -> Result<Crs> {
        let (authority, code) = text.split_once(':').unwrap_or(("", text));
        if !authority.eq_ignore_ascii_case("epsg") {
            return Err(Error::unsupported(
                text,
                "only EPSG codes are understood so far, written EPSG:n",
                "give --crs EPSG:n (with the letters), or warp the grid into an EPSG system first",
            ));
        }
        let n = code
            .trim()
            .parse::<u32>()
            .map_err(|_| Error::invalid("crs", format!("'{text}' is not EPSG:n")))?;
        Crs::from_epsg(n)
    }
}

/// Geographic systems whose registry unit is the grad, counted from Paris. proj-core gives every geographic
/// system in degrees, so a file in one of these would be read 10 % too large: they are refused.
const GRAD_CODES: [u32; 8] = [4807, 4810, 4811, 4816, 4819, 4821, 4901, 4902];

/// Unit of the horizontal axes of an EPSG system; of a compound system, those of its horizontal part.
///
/// None for codes that the registry does not hold, for geocentric and purely vertical systems, and for
/// geographic systems in grads.
fn unit_of(code: u32) -> Option<AxisUnit> {
    if GRAD_CODES.contains(&code) {
        return None;
    }
    let crs = proj_core::lookup_epsg(code)?;
    if let Some(projected) = crs.as_projected() {
        let metres = projected.linear_unit_to_meter();
        (metres.is_finite() && metres > 0.0).then_some(AxisUnit::Metre(metres))
    } else if crs.is_geographic() {
        Some(AxisUnit::Degree)
    } else {
        None
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
        assert!(Crs::parse("ESRI:102003").is_err());
        assert!(Crs::parse("EPSG:").is_err());
    }
}
