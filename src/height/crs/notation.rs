//! The notations of a system: EPSG and ESRI codes, PROJ strings, WKT; and the one text that is stored.

use super::datum::Datum;
use super::definition::{Definition, Ellipsoid};
use super::wkt::{self, Node};
use super::{epsg_definition, esri};
use crate::base::limits::TEXT_BYTES_MAX;
use crate::base::{Error, Result};
use proj_core::ProjectionMethod as P;

/// The text to store and what it defines.
pub(super) fn read(text: &str) -> Result<(String, Definition)> {
    let text = text.trim();
    if text.starts_with('+') {
        return proj_string(text);
    }
    if text.contains(['[', '(']) {
        return wkt_text(text);
    }
    let form = || {
        Error::unsupported(
            text.chars().take(60).collect::<String>(),
            "no way to write a CRS that is known here",
            "give EPSG:n or ESRI:n (with the letters), a PROJ string (+proj=...) or WKT",
        )
    };
    let (authority, code) = text.split_once(':').ok_or_else(form)?;
    let number = || {
        let digits = code.trim();
        digits.parse::<u32>().map_err(|_| Error::invalid("crs", format!("'{text}' is not {authority}:n")))
    };
    if authority.eq_ignore_ascii_case("epsg") {
        let n = number()?;
        Ok((format!("EPSG:{n}"), epsg_definition(n)?))
    } else if authority.eq_ignore_ascii_case("esri") {
        esri_code(number()?)
    } else {
        Err(form())
    }
}

fn esri_code(n: u32) -> Result<(String, Definition)> {
    let text = esri::lookup(n).ok_or_else(|| {
        Error::unsupported(
            format!("ESRI:{n}"),
            "not among the ESRI codes this build knows",
            "give its definition: --crs with a PROJ string (+proj=...) or its WKT",
        )
    })?;
    let (code, definition) = read(&text)?;
    let code = if code.starts_with("EPSG:") { code } else { format!("ESRI:{n}") };
    Ok((code, definition))
}

/// Datums that PROJ's `+datum=` defines by an ellipsoid and a shift.
const PROJ_DATUMS: [(&str, &str); 6] = [
    ("potsdam", "+ellps=bessel +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7"),
    ("carthage", "+ellps=clrk80ign +towgs84=-263,6,431"),
    ("hermannskogel", "+ellps=bessel +towgs84=577.326,90.129,463.919,5.137,1.474,5.297,2.4232"),
    ("ire65", "+ellps=mod_airy +towgs84=482.53,-130.596,564.557,-1.042,-0.214,-0.631,8.15"),
    ("nzgd49", "+ellps=intl +towgs84=59.47,-5.04,187.44,0.47,-0.1,1.024,-4.5993"),
    ("ggrs87", "+ellps=GRS80 +towgs84=-199.87,74.79,246.62"),
];

fn proj_string(text: &str) -> Result<(String, Definition)> {
    if text.len() > TEXT_BYTES_MAX {
        return Err(Error::limit("bytes of a PROJ string", TEXT_BYTES_MAX as u64, text.len() as u64));
    }
    let mut words = Vec::new();
    for word in text.split_whitespace() {
        let (key, value) = word.split_once('=').unwrap_or((word, ""));
        let key = key.trim_start_matches('+');
        match (key, value) {
            // Heights are not part of a horizontal system.
            ("vunits" | "vto_meter" | "geoidgrids" | "geoid_crs" | "type" | "no_defs" | "wktext", _) => {}
            ("proj", "etmerc") => words.push("+proj=tmerc".to_string()),
            ("datum", name) => {
                let own = PROJ_DATUMS.iter().find(|(n, _)| n.eq_ignore_ascii_case(name));
                words.push(own.map_or(word.to_string(), |(_, parts)| parts.to_string()));
            }
            _ => words.push(format!("+{}", word.trim_start_matches('+'))),
        }
    }
    let value_of = |key: &str| {
        let start = format!("+{key}=");
        words.iter().find_map(|w| w.strip_prefix(start.as_str())).map(str::to_string)
    };
    // As PROJ: a cone with one parallel touches there, and has its origin there unless told otherwise.
    if value_of("proj").as_deref() == Some("lcc")
        && value_of("lat_2").is_none()
        && let Some(lat_1) = value_of("lat_1")
    {
        let lat_0 = value_of("lat_0").is_none().then(|| format!("+lat_0={lat_1}"));
        words.push(format!("+lat_2={lat_1}"));
        words.extend(lat_0);
    }
    let joined = words.join(" ");
    let core = proj_wkt::parse_crs(&joined).map_err(|e| {
        Error::unsupported(text, e, "give an EPSG code, or warp the grid with GDAL into such a system first")
    })?;
    if core.epsg() != 0 {
        return Ok((format!("EPSG:{}", core.epsg()), epsg_definition(core.epsg())?));
    }
    canonical(text, Definition::from_core(text, &core)?)
}

fn wkt_text(text: &str) -> Result<(String, Definition)> {
    let tree = Node::parse(text)?;
    let short = || text.chars().take(60).collect::<String>();
    let node = wkt::horizontal(&tree).ok_or_else(|| {
        Error::unsupported(short(), "no horizontal system in this WKT", "name one with --crs")
    })?;
    match node.code() {
        Some((authority, n)) if authority == "EPSG" => {
            if let Ok(definition) = epsg_definition(n) {
                return Ok((format!("EPSG:{n}"), definition));
            }
        }
        Some((authority, n)) if authority == "ESRI" => {
            if let Ok(known) = esri_code(n) {
                return Ok(known);
            }
        }
        _ => {}
    }
    let mut own = Node::parse(&node.to_string())?;
    wkt::in_known_words(&mut own)?;
    let core = proj_wkt::parse_crs(&own.to_string())
        .map_err(|e| Error::unsupported(short(), e, "name the CRS by EPSG code or as a PROJ string"))?;
    canonical(&short(), Definition::from_core(&short(), &core)?)
}

/// The PROJ string of a definition, read again: the text that is stored is the one that counts.
fn canonical(text: &str, definition: Definition) -> Result<(String, Definition)> {
    let written = write(&definition).ok_or_else(|| {
        Error::unsupported(text, "a projection that has no PROJ string", "name the CRS by its EPSG code")
    })?;
    Ok((written, definition))
}

const ELLIPSOIDS: [(&str, f64, f64); 7] = [
    ("WGS84", 6378137.0, 298.257223563),
    ("GRS80", 6378137.0, 298.257222101),
    ("clrk66", 6378206.4, 294.978698214),
    ("intl", 6378388.0, 297.0),
    ("bessel", 6377397.155, 299.1528128),
    ("krass", 6378245.0, 298.3),
    ("airy", 6377563.396, 299.3249646),
];

fn write(d: &Definition) -> Option<String> {
    let mut out = match d.projection {
        None => "+proj=longlat".to_string(),
        Some(p) => projection(p)?,
    };
    let datum = match &d.datum {
        Datum::Modern { code: 6326, .. } => "+datum=WGS84".to_string(),
        Datum::Modern { code: 6269, .. } => "+datum=NAD83".to_string(),
        Datum::Old { code: 6267, .. } => "+datum=NAD27".to_string(),
        Datum::Modern { .. } => format!("{} +towgs84=0,0,0,0,0,0,0", ellipsoid(d.ellipsoid)),
        Datum::Declared(h) => {
            let ([x, y, z], [rx, ry, rz], s) = (h.shift_m, h.turn_arcsec, h.scale_ppm);
            format!("{} +towgs84={x},{y},{z},{rx},{ry},{rz},{s}", ellipsoid(d.ellipsoid))
        }
        Datum::Old { .. } | Datum::Unnamed { .. } => ellipsoid(d.ellipsoid),
    };
    out.push(' ');
    out.push_str(&datum);
    if d.projection.is_some() {
        match d.unit_m {
            1.0 => out.push_str(" +units=m"),
            m => out.push_str(&format!(" +to_meter={m}")),
        }
    }
    out.push_str(" +no_defs");
    Some(out)
}

fn ellipsoid(e: Ellipsoid) -> String {
    let known = ELLIPSOIDS.iter().find(|(_, a, rf)| e.same(Ellipsoid { a: *a, f: 1.0 / rf }));
    match known {
        Some((name, ..)) => format!("+ellps={name}"),
        None if e.f == 0.0 => format!("+R={}", e.a),
        None => format!("+a={} +rf={}", e.a, 1.0 / e.f),
    }
}

/// None for methods that PROJ strings cannot carry, or that their reader does not know.
#[rustfmt::skip]
fn projection(p: P) -> Option<String> {
    Some(match p {
        P::WebMercator => "+proj=webmerc".to_string(),
        P::TransverseMercator { lon0, lat0, k0, false_easting: x, false_northing: y } =>
            format!("+proj=tmerc +lat_0={lat0} +lon_0={lon0} +k={k0} +x_0={x} +y_0={y}"),
        P::PolarStereographic { lon0, lat_ts, k0, false_easting: x, false_northing: y } => {
            let pole = 90f64.copysign(lat_ts);
            format!("+proj=stere +lat_0={pole} +lat_ts={lat_ts} +lon_0={lon0} +k={k0} +x_0={x} +y_0={y}")
        }
        P::LambertConformalConic { lon0, lat0, lat1, lat2, k0, false_easting: x, false_northing: y } =>
            format!("+proj=lcc +lat_0={lat0} +lon_0={lon0} +lat_1={lat1} +lat_2={lat2} +k_0={k0} +x_0={x} +y_0={y}"),
        P::AlbersEqualArea { lon0, lat0, lat1, lat2, false_easting: x, false_northing: y } =>
            format!("+proj=aea +lat_0={lat0} +lon_0={lon0} +lat_1={lat1} +lat_2={lat2} +x_0={x} +y_0={y}"),
        P::LambertAzimuthalEqualArea { lon0, lat0, false_easting: x, false_northing: y } =>
            format!("+proj=laea +lat_0={lat0} +lon_0={lon0} +x_0={x} +y_0={y}"),
        P::ObliqueStereographic { lon0, lat0, k0, false_easting: x, false_northing: y } =>
            format!("+proj=sterea +lat_0={lat0} +lon_0={lon0} +k={k0} +x_0={x} +y_0={y}"),
        P::HotineObliqueMercator { latc, lonc, azimuth, rectified_grid_angle, k0, false_easting: x, false_northing: y, variant_b } => {
            let no_uoff = if variant_b { "" } else { "+no_uoff " };
            format!("+proj=omerc {no_uoff}+lat_0={latc} +lonc={lonc} +alpha={azimuth} +gamma={rectified_grid_angle} +k={k0} +x_0={x} +y_0={y}")
        }
        P::CassiniSoldner { lon0, lat0, false_easting: x, false_northing: y } =>
            format!("+proj=cass +lat_0={lat0} +lon_0={lon0} +x_0={x} +y_0={y}"),
        P::Mercator { lon0, lat_ts, k0, false_easting: x, false_northing: y } =>
            format!("+proj=merc +lon_0={lon0} +lat_ts={lat_ts} +k={k0} +x_0={x} +y_0={y}"),
        P::EquidistantCylindrical { lon0, lat_ts, false_easting: x, false_northing: y } =>
            format!("+proj=eqc +lat_ts={lat_ts} +lon_0={lon0} +x_0={x} +y_0={y}"),
        P::EqualEarth { lon0, false_easting: x, false_northing: y } =>
            format!("+proj=eqearth +lon_0={lon0} +x_0={x} +y_0={y}"),
        P::AmericanPolyconic { lon0, lat0, false_easting: x, false_northing: y } =>
            format!("+proj=poly +lat_0={lat0} +lon_0={lon0} +x_0={x} +y_0={y}"),
        P::AzimuthalEquidistant { lon0, lat0, false_easting: x, false_northing: y } =>
            format!("+proj=aeqd +lat_0={lat0} +lon_0={lon0} +x_0={x} +y_0={y}"),
        _ => return None,
    })
}
