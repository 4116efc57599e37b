//! A projection that the GeoKeys spell out, as a PROJ string.
//!
//! Keys and methods are those of GeoTIFF 1.0 section 6.3.3 and its annexes; where programs disagree, as GDAL
//! reads them.

use super::georef::{
    GeoKeys, KEY_ANGULAR_UNIT, KEY_GEODETIC_CRS, KEY_MODEL_TYPE, MODEL_GEOGRAPHIC, UNIT_DEGREE,
    UNIT_DEGREE_UNSPECIFIED, linear_unit,
};
use crate::height::crs::{Crs, Helmert, counts_from_another_meridian, datum_words, ellipsoid_words};

const KEY_DATUM: u16 = 2050;
const KEY_PRIME_MERIDIAN: u16 = 2051;
const KEY_ELLIPSOID: u16 = 2056;
const KEY_SEMI_MAJOR: u16 = 2057;
const KEY_SEMI_MINOR: u16 = 2058;
const KEY_INVERSE_FLATTENING: u16 = 2059;
const KEY_PRIME_MERIDIAN_LONGITUDE: u16 = 2061;
const KEY_TO_WGS84: u16 = 2062;
const KEY_PROJECTION: u16 = 3074;
const KEY_METHOD: u16 = 3075;
const PARALLEL_1: u16 = 3078;
const PARALLEL_2: u16 = 3079;
const ORIGIN_LONGITUDE: u16 = 3080;
const ORIGIN_LATITUDE: u16 = 3081;
const FALSE_EASTING: u16 = 3082;
const FALSE_NORTHING: u16 = 3083;
const FALSE_ORIGIN_LONGITUDE: u16 = 3084;
const FALSE_ORIGIN_LATITUDE: u16 = 3085;
const FALSE_ORIGIN_EASTING: u16 = 3086;
const FALSE_ORIGIN_NORTHING: u16 = 3087;
const CENTRE_LONGITUDE: u16 = 3088;
const CENTRE_LATITUDE: u16 = 3089;
const CENTRE_EASTING: u16 = 3090;
const CENTRE_NORTHING: u16 = 3091;
const SCALE: u16 = 3092;
const CENTRE_SCALE: u16 = 3093;
const AZIMUTH: u16 = 3094;
const POLE_LONGITUDE: u16 = 3095;
const SKEW_ANGLE: u16 = 3096;

const GREENWICH: u16 = 8901;

/// The definition as a PROJ string.
///
/// # Errors
/// In words for a note: what is missing or not read.
pub fn proj_string(keys: &GeoKeys) -> Result<String, String> {
    let datum = datum(keys)?;
    if keys.short(KEY_MODEL_TYPE) == Some(MODEL_GEOGRAPHIC) {
        return Ok(format!("+proj=longlat {datum}"));
    }
    let projection = match keys.code(KEY_PROJECTION) {
        Some(zone @ 16001..=16060) => format!("+proj=utm +zone={}", zone - 16000),
        Some(zone @ 16101..=16160) => format!("+proj=utm +zone={} +south", zone - 16100),
        Some(code) => {
            return Err(format!("the file's CRS rests on projection EPSG:{code}, which is not read"));
        }
        None => method(keys)?,
    };
    let unit = linear_unit(keys)?.unwrap_or(1.0);
    Ok(format!("{projection} {datum} +to_meter={unit}"))
}

fn method(keys: &GeoKeys) -> Result<String, String> {
    let code = keys.short(KEY_METHOD).ok_or("the file gives no EPSG code for its CRS")?;
    let angle = keys.short(KEY_ANGULAR_UNIT).unwrap_or(UNIT_DEGREE);
    if angle != UNIT_DEGREE && angle != UNIT_DEGREE_UNSPECIFIED {
        return Err(format!("the file's CRS counts angles in unit {angle}, not degrees"));
    }
    let unit = linear_unit(keys)?.unwrap_or(1.0);
    // The first key that is there, in the order in which GDAL asks.
    let first = |order: &[u16]| order.iter().find_map(|key| keys.double(*key));
    let or_zero = |order: &[u16]| first(order).unwrap_or(0.0);
    let lon = or_zero(&[ORIGIN_LONGITUDE, FALSE_ORIGIN_LONGITUDE, CENTRE_LONGITUDE, POLE_LONGITUDE]);
    let lat = or_zero(&[ORIGIN_LATITUDE, FALSE_ORIGIN_LATITUDE, CENTRE_LATITUDE]);
    let scale = first(&[SCALE, CENTRE_SCALE]).unwrap_or(1.0);
    let x = unit * or_zero(&[FALSE_EASTING, FALSE_ORIGIN_EASTING, CENTRE_EASTING]);
    let y = unit * or_zero(&[FALSE_NORTHING, FALSE_ORIGIN_NORTHING, CENTRE_NORTHING]);
    let (lat_1, lat_2) = (or_zero(&[PARALLEL_1]), or_zero(&[PARALLEL_2]));
    let place = format!("+x_0={x} +y_0={y}");
    let origin = format!("+lat_0={lat} +lon_0={lon}");
    Ok(match code {
        1 => format!("+proj=tmerc {origin} +k={scale} {place}"),
        3 | 9815 => {
            let azimuth = or_zero(&[AZIMUTH]);
            let skew = first(&[SKEW_ANGLE]).unwrap_or(azimuth);
            let variant = if code == 3 { "+no_uoff " } else { "" };
            let (lonc, lat) =
                (first(&[CENTRE_LONGITUDE]).unwrap_or(lon), first(&[CENTRE_LATITUDE]).unwrap_or(lat));
            format!(
                "+proj=omerc {variant}+lat_0={lat} +lonc={lonc} +alpha={azimuth} +gamma={skew} +k={scale} {place}"
            )
        }
        7 => match first(&[PARALLEL_1]) {
            Some(parallel) => format!("+proj=merc +lat_ts={parallel} +lon_0={lon} {place}"),
            None => format!("+proj=merc +lon_0={lon} +k={scale} {place}"),
        },
        8 => {
            let lon = first(&[FALSE_ORIGIN_LONGITUDE]).unwrap_or(lon);
            let lat = first(&[FALSE_ORIGIN_LATITUDE]).unwrap_or(lat);
            format!("+proj=lcc +lat_0={lat} +lon_0={lon} +lat_1={lat_1} +lat_2={lat_2} {place}")
        }
        9 => format!("+proj=lcc {origin} +lat_1={lat} +lat_2={lat} +k_0={scale} {place}"),
        10 => {
            let (lon, lat) =
                (first(&[CENTRE_LONGITUDE]).unwrap_or(lon), first(&[CENTRE_LATITUDE]).unwrap_or(lat));
            format!("+proj=laea +lat_0={lat} +lon_0={lon} {place}")
        }
        11 => format!("+proj=aea {origin} +lat_1={lat_1} +lat_2={lat_2} {place}"),
        12 => format!("+proj=aeqd {origin} {place}"),
        15 => {
            let lon = first(&[POLE_LONGITUDE, ORIGIN_LONGITUDE]).unwrap_or(lon);
            let pole = 90f64.copysign(lat);
            format!("+proj=stere +lat_0={pole} +lat_ts={lat} +lon_0={lon} +k={scale} {place}")
        }
        16 => format!("+proj=sterea {origin} +k={scale} {place}"),
        17 => {
            let parallel = first(&[PARALLEL_1]).unwrap_or(0.0);
            format!("+proj=eqc +lat_ts={parallel} {origin} {place}")
        }
        18 => format!("+proj=cass {origin} {place}"),
        22 => format!("+proj=poly {origin} {place}"),
        24 => format!("+proj=sinu +lon_0={lon} {place}"),
        28 => format!("+proj=cea +lat_ts={lat_1} +lon_0={lon} {place}"),
        code => {
            return Err(format!(
                "the file's CRS uses projection method {code} of GeoTIFF, which is not read"
            ));
        }
    })
}

/// Datum and ellipsoid as PROJ words.
fn datum(keys: &GeoKeys) -> Result<String, String> {
    // Datum codes 6001 to 6999 were those of the geographic systems, moved by 2000.
    let code = keys.code(KEY_GEODETIC_CRS).map(u32::from).or_else(|| {
        keys.code(KEY_DATUM).map(u32::from).filter(|code| (6001..7000).contains(code)).map(|code| code - 2000)
    });
    let meridian = keys.code(KEY_PRIME_MERIDIAN).is_some_and(|code| code != GREENWICH)
        || keys.double(KEY_PRIME_MERIDIAN_LONGITUDE).is_some_and(|lon| lon != 0.0);
    if meridian || code.is_some_and(counts_from_another_meridian) {
        return Err("the file's CRS counts longitude from another meridian than Greenwich".to_string());
    }
    let shift = match keys.numbers(KEY_TO_WGS84) {
        [] => None,
        numbers => {
            let text: Vec<String> = numbers.iter().map(|v| v.to_string()).collect();
            let helmert = Helmert::parse(&text.join(","));
            Some(helmert.ok_or("the file's shift to WGS 84 has neither 3 nor 7 numbers")?)
        }
    };
    if let (Some(code), None) = (code, &shift) {
        let crs = Crs::from_epsg(code).map_err(|e| format!("the file's geographic system: {e}"))?;
        return datum_words(&crs).map_err(|e| format!("the file's geographic system: {e}"));
    }
    let ellipsoid = ellipsoid(keys, code)?;
    Ok(match shift {
        Some(h) => format!("{ellipsoid} +towgs84={h}"),
        None => ellipsoid,
    })
}

fn ellipsoid(keys: &GeoKeys, geographic: Option<u32>) -> Result<String, String> {
    if let Some(a) = keys.double(KEY_SEMI_MAJOR) {
        let minor = keys.double(KEY_SEMI_MINOR);
        return Ok(match keys.double(KEY_INVERSE_FLATTENING).filter(|rf| *rf != 0.0) {
            Some(rf) => format!("+a={a} +rf={rf}"),
            None => format!("+a={a} +b={}", minor.unwrap_or(a)),
        });
    }
    let named = match keys.code(KEY_ELLIPSOID) {
        Some(7001) => "+ellps=airy",
        Some(7003) => "+ellps=aust_SA",
        Some(7004) => "+ellps=bessel",
        Some(7008) => "+ellps=clrk66",
        Some(7011) => "+ellps=clrk80ign",
        Some(7012) => "+ellps=clrk80",
        Some(7019) => "+ellps=GRS80",
        Some(7022) => "+ellps=intl",
        Some(7024) => "+ellps=krass",
        Some(7030) => "+ellps=WGS84",
        Some(7043) => "+ellps=WGS72",
        Some(7048) => "+R=6371007",
        Some(code) => return Err(format!("the file's ellipsoid EPSG:{code} is not known and has no axes")),
        None => {
            // A geographic system under a shift of the file's own.
            let own = geographic.and_then(|code| ellipsoid_words(&Crs::from_epsg(code).ok()?).ok());
            return own.ok_or_else(|| "the file gives no EPSG code for its CRS".to_string());
        }
    };
    Ok(named.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(shorts: &[(u16, u16)], doubles: &[(u16, &[f64])]) -> GeoKeys {
        let mut keys = GeoKeys::default();
        keys.shorts.extend(shorts.iter().copied());
        keys.doubles.extend(doubles.iter().map(|(key, v)| (*key, v.to_vec())));
        keys
    }

    fn code(shorts: &[(u16, u16)], doubles: &[(u16, &[f64])]) -> String {
        proj_string(&keys(shorts, doubles)).map_or_else(|e| e, |text| Crs::parse(&text).unwrap().code)
    }

    #[test]
    fn a_datum_by_ellipsoid_and_shift() {
        // The keys of the file GeogToWGS84GeoKey5.tif.
        let shift = [598.1, 73.7, 418.2, 0.202, 0.045, -2.455, 6.7];
        let shorts = [(1024, 2), (2048, 32767), (2050, 32767), (2054, 9102), (2056, 7004)];
        let expected =
            "+proj=longlat +ellps=bessel +towgs84=598.1,73.7,418.2,0.202,0.045,-2.455,6.7 +no_defs";
        assert_eq!(code(&shorts, &[(2062, &shift)]), expected);
        assert!(code(&shorts, &[(2062, &shift[..4])]).contains("neither 3 nor 7"));
        assert!(code(&[(1024, 2), (2051, 8903)], &[]).contains("Greenwich"));
        // Rome, by the code of the system; Jakarta, by that of the datum, with a shift and without.
        let rome = [(1024, 1), (2048, 4806), (3072, 32767), (3074, 32767), (3075, 1), (3076, 9001)];
        assert!(code(&rome, &[]).contains("Greenwich"));
        let jakarta = [(1024, 2), (2048, 32767), (2050, 6813), (2054, 9102), (2056, 7004)];
        assert!(code(&jakarta, &[]).contains("Greenwich"));
        assert!(code(&jakarta, &[(2062, &shift)]).contains("Greenwich"));
    }

    #[test]
    fn projections_in_feet_and_metres() {
        let state_plane = [(1024, 1), (2048, 4269), (3072, 32767), (3075, 8), (3076, 9003)];
        let numbers: [(u16, &[f64]); 6] = [
            (3078, &[35.46666666666667]),
            (3079, &[34.03333333333333]),
            (3084, &[-118.0]),
            (3085, &[33.5]),
            (3086, &[6561666.667]),
            (3087, &[1640416.667]),
        ];
        let text = proj_string(&keys(&state_plane, &numbers)).unwrap();
        assert!(Crs::parse(&text).unwrap().same_as(&Crs::from_epsg(2229).unwrap()), "{text}");
        let utm = [(1024, 1), (2048, 4326), (3072, 32767), (3074, 16111), (3076, 9001)];
        assert_eq!(code(&utm, &[]), "EPSG:32711");
        let unknown = [(1024, 1), (2048, 4326), (3072, 32767), (3074, 32767), (3075, 13)];
        assert!(code(&unknown, &[]).contains("method 13"));
    }
}
