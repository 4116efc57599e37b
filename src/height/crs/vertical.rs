//! What a height counts from, and in which unit.
//!
//! Nothing here is converted: heights over a geoid become heights over the ellipsoid in `height::lifted`, with a
//! grid that the user gives.

use super::wkt::{self, Node};
use crate::base::{Error, Result};

/// Metres of the international foot.
pub const FOOT_M: f64 = 0.3048;
/// Metres of the US survey foot.
pub const US_FOOT_M: f64 = 1200.0 / 3937.0;

/// Zero surface of heights, as it is recorded: `EPSG:n` of a vertical system, `ellipsoid`, or a free name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct VerticalDatum(String);

impl VerticalDatum {
    pub fn ellipsoid() -> VerticalDatum {
        VerticalDatum("ellipsoid".to_string())
    }

    /// Reads `EPSG:n` (a vertical system), `ellipsoid`, `navd88`, `egm96`, `egm2008`, or a free name of at most 64
    /// printable letters.
    ///
    /// # Errors
    /// For codes that are not of a vertical system, and for empty, long or unprintable names.
    pub fn parse(text: &str) -> Result<VerticalDatum> {
        let text = text.trim();
        if let Some((authority, code)) = text.split_once(':')
            && authority.eq_ignore_ascii_case("epsg")
        {
            let known = code.parse().ok().and_then(Vertical::from_epsg).and_then(|v| v.datum);
            return known.map(VerticalDatum).ok_or_else(|| {
                Error::unsupported(
                    text,
                    "no vertical system of the EPSG registry this build knows",
                    "give a vertical code such as EPSG:5703, 'ellipsoid', or a free name",
                )
            });
        }
        let name = match text.to_ascii_lowercase().as_str() {
            "ellipsoid" | "ellipsoidal" => "ellipsoid",
            "navd88" | "navd88 height" => "EPSG:5703",
            "egm96" | "egm96 height" => "EPSG:5773",
            "egm2008" | "egm2008 height" => "EPSG:3855",
            "" => return Err(Error::invalid("vertical datum", "the name is empty")),
            _ if text.chars().count() > 64 || text.chars().any(char::is_control) => {
                return Err(Error::invalid("vertical datum", "a name has at most 64 printable letters"));
            }
            _ => text,
        };
        Ok(VerticalDatum(name.to_string()))
    }

    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Metres of a unit that a file or a user names: `m`, `ft`, `us-ft`, `cm` and their longer names.
pub fn unit_metres(name: &str) -> Option<f64> {
    match name.trim().to_ascii_lowercase().replace(['_', ' '], "-").as_str() {
        "m" | "metre" | "meter" | "metres" | "meters" => Some(1.0),
        "ft" | "foot" | "feet" | "international-foot" | "foot-intl" => Some(FOOT_M),
        "us-ft" | "ftus" | "ft-us" | "us-survey-foot" | "us-survey-feet" | "foot-us" | "us-foot"
        | "us-survey-ft" => Some(US_FOOT_M),
        "cm" | "centimetre" | "centimeter" | "centimetres" | "centimeters" => Some(0.01),
        "dm" | "decimetre" | "decimeter" | "decimetres" | "decimeters" => Some(0.1),
        "km" | "kilometre" | "kilometer" | "kilometres" | "kilometers" => Some(1000.0),
        _ => None,
    }
}

/// What a file says of its heights; None where it says nothing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Vertical {
    /// As [`VerticalDatum`] records it.
    pub datum: Option<String>,
    /// Metres of one unit.
    pub unit_m: Option<f64>,
}

/// Systems that hang on the datum of another one, in another unit: code, code of the one in metres, unit.
const IN_FEET: [(u32, u32, f64); 3] =
    [(6360, 5703, US_FOOT_M), (8228, 5703, FOOT_M), (5702, 7968, US_FOOT_M)];

/// Compound systems that proj-core does not hold: code and vertical code.
const COMPOUND: [(u32, u32); 8] = [
    (5498, 5703),
    (5500, 5703),
    (6349, 5703),
    (9518, 3855),
    (9707, 5773),
    (7415, 5709),
    (7405, 5701),
    (5554, 5783),
];

impl Vertical {
    /// What a vertical, compound or three-dimensional EPSG code says of heights; None for any other code.
    pub fn from_epsg(code: u32) -> Option<Vertical> {
        if let Some((_, metric, unit_m)) = IN_FEET.iter().find(|(c, ..)| *c == code) {
            return Some(Vertical { datum: Some(format!("EPSG:{metric}")), unit_m: Some(*unit_m) });
        }
        if let Some((_, vertical)) = COMPOUND.iter().find(|(c, _)| *c == code) {
            return Vertical::from_epsg(*vertical)
                .or_else(|| Some(Vertical { datum: Some(format!("EPSG:{vertical}")), unit_m: Some(1.0) }));
        }
        let of = |v: &proj_core::VerticalCrsDef| {
            let datum = match v.kind().is_ellipsoidal_height() {
                true => "ellipsoid".to_string(),
                false if v.epsg() != 0 => format!("EPSG:{}", v.epsg()),
                false => v.name().chars().take(64).collect(),
            };
            Vertical { datum: Some(datum), unit_m: Some(v.linear_unit_to_meter()) }
        };
        match proj_core::lookup_epsg(code) {
            Some(crs) => match crs.vertical_crs() {
                Some(v) if IN_FEET.iter().any(|(c, ..)| *c == v.epsg()) => Vertical::from_epsg(v.epsg()),
                Some(v) => Some(of(v)),
                None => None,
            },
            None => proj_core::lookup_vertical_epsg(code).map(|v| of(&v)),
        }
    }

    /// What a text that defines a CRS says of heights: a compound code (`EPSG:n`, `EPSG:n+m`), WKT with a vertical
    /// part, `+vunits=` and `+geoidgrids=` of PROJ strings. Nothing where it says nothing.
    pub fn of_text(text: &str) -> Vertical {
        let text = text.trim();
        if text.starts_with('+') {
            let value = |key: &str| text.split_whitespace().find_map(|w| w.strip_prefix(key));
            let unit = value("+vunits=").and_then(unit_metres);
            let metres = value("+vto_meter=").and_then(|v| v.parse().ok());
            let unit_m = unit.or(metres).filter(|m| m.is_finite() && *m > 0.0);
            return Vertical { datum: None, unit_m };
        }
        if text.contains(['[', '(']) {
            return Node::parse(text).map(|tree| Vertical::of_tree(&tree)).unwrap_or_default();
        }
        let code = text.split_once(':').map_or(text, |(_, code)| code);
        let code = code.split_once('+').map_or(code, |(_, vertical)| vertical);
        code.trim().parse().ok().and_then(Vertical::from_epsg).unwrap_or_default()
    }

    fn of_tree(tree: &Node) -> Vertical {
        let Some(node) = wkt::vertical(tree) else {
            // A compound code may stand on the outside only.
            let outer = tree.code().filter(|(authority, _)| authority == "EPSG");
            return outer.and_then(|(_, n)| Vertical::from_epsg(n)).unwrap_or_default();
        };
        if let Some((authority, n)) = node.code()
            && authority == "EPSG"
            && let Some(known) = Vertical::from_epsg(n)
        {
            return known;
        }
        let datum = node.child(&["VERT_DATUM", "VDATUM", "VRF", "VERTICALDATUM", "DATUM"]);
        let name = datum.and_then(|d| d.text(0)).or(node.text(0)).unwrap_or("");
        let plain = name.to_ascii_lowercase().replace(['_', ' '], "");
        let known = [
            ("northamericanverticaldatum1988", "EPSG:5703"),
            ("navd88", "EPSG:5703"),
            ("egm96", "EPSG:5773"),
            ("egm2008", "EPSG:3855"),
            ("ellipsoid", "ellipsoid"),
        ];
        let recorded = known.iter().find(|(part, _)| plain.contains(part)).map(|(_, code)| code.to_string());
        // An ESRI text that hangs heights on a DATUM means the ellipsoid of that datum.
        let recorded = match datum {
            Some(d) if d.keyword == "DATUM" => Some("ellipsoid".to_string()),
            _ => recorded.or_else(|| VerticalDatum::parse(name).ok().map(|d| d.0)),
        };
        let axis_unit = node.children().find_map(|c| c.child(&["LENGTHUNIT", "UNIT"]));
        let unit = node.child(&["UNIT", "LENGTHUNIT"]).or(axis_unit);
        let unit_m = unit.and_then(|u| u.text(1)?.parse().ok()).filter(|m: &f64| m.is_finite() && *m > 0.0);
        Vertical { datum: recorded, unit_m }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(datum: &str, unit_m: f64) -> Vertical {
        Vertical { datum: Some(datum.to_string()), unit_m: Some(unit_m) }
    }

    #[test]
    fn codes() {
        for code in ["EPSG:5703", "EPSG:5498", "EPSG:4269+5703"] {
            assert_eq!(Vertical::of_text(code), text("EPSG:5703", 1.0), "{code}");
        }
        assert_eq!(Vertical::of_text("EPSG:9518"), text("EPSG:3855", 1.0));
        assert_eq!(Vertical::of_text("EPSG:6360"), text("EPSG:5703", US_FOOT_M));
        assert_eq!(Vertical::of_text("EPSG:4979"), text("ellipsoid", 1.0));
        assert_eq!(Vertical::of_text("EPSG:32611"), Vertical::default());
        assert_eq!(Vertical::of_text("+proj=longlat +vunits=us-ft").unit_m, Some(US_FOOT_M));
        assert_eq!(VerticalDatum::parse("NAVD88").unwrap().as_str(), "EPSG:5703");
        assert_eq!(VerticalDatum::parse("Amsterdam ordnance").unwrap().as_str(), "Amsterdam ordnance");
        assert!(VerticalDatum::parse("EPSG:32611").is_err() && VerticalDatum::parse(" ").is_err());
    }

    #[test]
    fn compound_wkt() {
        let wkt = r#"COMPD_CS["a",GEOGCS["WGS 84",DATUM["WGS_1984",SPHEROID["WGS 84",6378137,298.257223563]],
            PRIMEM["Greenwich",0],UNIT["degree",0.0174532925199433]],
            VERT_CS["local heights",VERT_DATUM["City zero",2005],UNIT["foot",0.3048],AXIS["Up",UP]]]"#;
        assert_eq!(Vertical::of_text(wkt), text("City zero", 0.3048));
        let esri = r#"PROJCS["x",GEOGCS["g"],VERTCS["NAVD_1988",VDATUM["North_American_Vertical_Datum_1988"],
            PARAMETER["Direction",1.0],UNIT["Centimeter",0.01]]]"#;
        assert_eq!(Vertical::of_text(esri), text("EPSG:5703", 0.01));
    }
}
