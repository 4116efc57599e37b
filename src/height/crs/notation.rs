//! The notations of a system: EPSG and ESRI codes, PROJ strings, WKT; and the one text that is stored.

use super::datum::Datum;
use super::definition::{Definition, Ellipsoid, Method};
use super::wkt::{self, Node};
use super::{Crs, epsg_definition, esri, own};
use crate::base::limits::TEXT_BYTES_MAX;
use crate::base::{Error, Result};
use proj_core::ProjectionMethod as P;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::OnceLock;

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
    if text.starts_with('+') {
        return Ok((format!("ESRI:{n}"), core_of(&text)?));
    }
    read(&text)
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
    let definition = core_of(&words.join(" "))?;
    canonical(text, definition)
}

/// Names an old datum by its EPSG code, as PROJ strings cannot. PROJ passes over words it does not know, so
/// the rest of the text means the same to it.
const DATUM_CODE: &str = "+datum_epsg=";

/// The definition of a PROJ string without PROJ's own peculiarities.
pub(super) fn core_of(text: &str) -> Result<Definition> {
    if let Some(code) = text.split_whitespace().find_map(|w| w.strip_prefix(DATUM_CODE)) {
        let rest: Vec<&str> = text.split_whitespace().filter(|w| !w.starts_with(DATUM_CODE)).collect();
        return with_old_datum(text, code, core_of(&rest.join(" "))?);
    }
    if let Some(own) = own::read(text)? {
        return Ok(own);
    }
    let core = proj_wkt::parse_crs(text).map_err(|e| {
        Error::unsupported(text, e, "give an EPSG code, or warp the grid with GDAL into such a system first")
    })?;
    match core.epsg() {
        0 => Definition::from_core(text, &core),
        n => epsg_definition(n),
    }
}

/// The definition, which has an ellipsoid and no datum, on the datum with this code.
fn with_old_datum(text: &str, code: &str, definition: Definition) -> Result<Definition> {
    let wrong = |reason: String| Error::invalid(text, format!("{DATUM_CODE}{code}: {reason}"));
    let known = code.parse().ok().and_then(|n| Some((n, proj_core::lookup_datum_epsg(n)?)));
    let (code, core) = known.ok_or_else(|| wrong("no datum of the EPSG registry this build knows".into()))?;
    let ellipsoid = Ellipsoid::of(&core);
    if !matches!(definition.datum, Datum::Unnamed { .. }) || !ellipsoid.same(definition.ellipsoid) {
        return Err(wrong("the text states another datum or ellipsoid".into()));
    }
    let datum = Datum::new(code, None, None, false, ellipsoid);
    if !matches!(datum, Datum::Old { .. }) {
        return Err(wrong("only for old datums; leave it out or name the datum with +datum".into()));
    }
    Ok(Definition { datum, ..definition })
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

/// The text to store for a definition: its code if a common system is written the same, else its PROJ string.
fn canonical(text: &str, definition: Definition) -> Result<(String, Definition)> {
    let written = write(&definition).ok_or_else(|| {
        Error::unsupported(text, "a projection that has no PROJ string", "name the CRS by its EPSG code")
    })?;
    if let Some(code) = common_names().get(&written) {
        return Ok((code.clone(), definition));
    }
    // The text that is stored is the one that counts: it has to mean the same when it is read again.
    let again = core_of(&written)?;
    if write(&again).as_ref() != Some(&written) {
        return Err(Error::invalid(text, format!("it is not the same when written as '{written}'")));
    }
    Ok((written, again))
}

/// EPSG systems that files often spell out instead of naming: on WGS 84, NAD83 or NAD27, the datums that a
/// PROJ string can name.
const COMMON: [RangeInclusive<u32>; 24] = [
    4326..=4326,
    4269..=4269,
    4267..=4267,
    3857..=3857,
    3395..=3395,
    3031..=3032,
    3413..=3413,
    3976..=3976,
    3995..=3996,
    32661..=32661,
    32761..=32761,
    6931..=6933,
    3571..=3576,
    5070..=5071,
    3338..=3338,
    3005..=3005,
    3347..=3348,
    3978..=3979,
    32601..=32660,
    32701..=32760,
    26901..=26923,
    26701..=26722,
    26929..=26998,
    2222..=2289,
];

/// Codes by the PROJ strings of their systems; EPSG before ESRI.
fn common_names() -> &'static BTreeMap<String, String> {
    static NAMES: OnceLock<BTreeMap<String, String>> = OnceLock::new();
    NAMES.get_or_init(|| {
        let mut names = BTreeMap::new();
        for n in esri::own_codes() {
            let text = esri::lookup(n).and_then(|text| core_of(&text).ok()).and_then(|d| write(&d));
            names.extend(text.map(|text| (text, format!("ESRI:{n}"))));
        }
        // Backwards, so that of two codes with one definition the lower one stays.
        for n in COMMON.into_iter().flatten().rev() {
            let definition = epsg_definition(n).ok().filter(|d| names_its_datum(&d.datum));
            names.extend(definition.and_then(|d| write(&d)).map(|text| (text, format!("EPSG:{n}"))));
        }
        names
    })
}

fn names_its_datum(datum: &Datum) -> bool {
    matches!(datum, Datum::Modern { code: 6326 | 6269, .. } | Datum::Old { code: 6267, .. })
}

/// The words of a PROJ string for the ellipsoid of a system alone.
///
/// # Errors
/// If the system is not known.
pub fn ellipsoid_words(crs: &Crs) -> Result<String> {
    crs.definition().map(|definition| ellipsoid(definition.ellipsoid))
}

/// The words of a PROJ string for datum and ellipsoid of a system; an old datum that PROJ has no word for stands
/// there with its EPSG code (`+datum_epsg=n`).
///
/// # Errors
/// If the system is not known, or counts longitude from another meridian than Greenwich, which the words would
/// lose.
pub fn datum_words(crs: &Crs) -> Result<String> {
    let definition = crs.definition()?;
    if crs.epsg().is_some_and(super::counts_from_another_meridian) {
        return Err(Error::unsupported(
            &crs.code,
            "longitude is counted from another meridian than Greenwich",
            "warp the grid into another system with GDAL first",
        ));
    }
    Ok(datum_text(&definition))
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
        Some(Method::Core(p)) => projection(p)?,
        Some(Method::Own(p)) => p.to_string(),
    };
    out.push(' ');
    out.push_str(&datum_text(d));
    if d.projection.is_some() {
        match d.unit_m {
            1.0 => out.push_str(" +units=m"),
            m => out.push_str(&format!(" +to_meter={m}")),
        }
    }
    out.push_str(" +no_defs");
    Some(out)
}

fn datum_text(d: &Definition) -> String {
    match &d.datum {
        Datum::Modern { code: 6326, .. } => "+datum=WGS84".to_string(),
        Datum::Modern { code: 6269, .. } => "+datum=NAD83".to_string(),
        Datum::Old { code: 6267, .. } => "+datum=NAD27".to_string(),
        Datum::Modern { .. } => format!("{} +towgs84=0,0,0,0,0,0,0", ellipsoid(d.ellipsoid)),
        Datum::Declared(h) => {
            let ([x, y, z], [rx, ry, rz], s) = (h.shift_m, h.turn_arcsec, h.scale_ppm);
            format!("{} +towgs84={x},{y},{z},{rx},{ry},{rz},{s}", ellipsoid(d.ellipsoid))
        }
        Datum::Old { code, .. } => format!("{} {DATUM_CODE}{code}", ellipsoid(d.ellipsoid)),
        Datum::Unnamed { .. } => ellipsoid(d.ellipsoid),
    }
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
