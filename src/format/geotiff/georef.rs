//! Where the posts lie and in which CRS, from the GeoTIFF tags.
//!
//! Positions come from ModelPixelScale with one ModelTiepoint, else from ModelTransformation, as GDAL reads
//! them (a negative vertical scale is taken as its magnitude). A post is the centre of its pixel: with
//! PixelIsPoint the tags speak of centres already, with PixelIsArea (the default) of corners.

use super::metadata::shorten;
use super::projection;
use crate::base::{Error, Result};
use crate::height::crs::unit::metres_of_code;
use crate::height::crs::vertical::{Vertical, VerticalDatum, unit_metres};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::source::Affine;
use std::collections::BTreeMap;
use tiff_reader::Ifd;

pub const TAG_PIXEL_SCALE: u16 = 33550;
pub const TAG_TIEPOINTS: u16 = 33922;
pub const TAG_TRANSFORMATION: u16 = 34264;
pub const TAG_GEO_KEYS: u16 = 34735;
const TAG_GEO_DOUBLES: u16 = 34736;
pub const TAG_GEO_ASCII: u16 = 34737;

pub const KEY_MODEL_TYPE: u16 = 1024;
pub const KEY_RASTER_TYPE: u16 = 1025;
const KEY_CITATION: u16 = 1026;
pub const KEY_GEODETIC_CRS: u16 = 2048;
pub const KEY_GEODETIC_CITATION: u16 = 2049;
pub const KEY_ANGULAR_UNIT: u16 = 2054;
pub const KEY_PROJECTED_CRS: u16 = 3072;
pub const KEY_PROJECTED_CITATION: u16 = 3073;
pub const KEY_LINEAR_UNIT: u16 = 3076;
pub const KEY_LINEAR_UNIT_METRES: u16 = 3077;
pub const KEY_VERTICAL_CRS: u16 = 4096;
pub const KEY_VERTICAL_CITATION: u16 = 4097;
pub const KEY_VERTICAL_DATUM: u16 = 4098;
pub const KEY_VERTICAL_UNIT: u16 = 4099;

pub const MODEL_PROJECTED: u16 = 1;
pub const MODEL_GEOGRAPHIC: u16 = 2;
pub const RASTER_AREA: u16 = 1;
const RASTER_POINT: u16 = 2;
pub const UNIT_METRE: u16 = 9001;
pub const UNIT_DEGREE: u16 = 9102;
pub const UNIT_DEGREE_UNSPECIFIED: u16 = 9122;
pub const USER_DEFINED: u16 = 32767;

/// The GeoKeys of an image; keys that point outside their tags are left out.
#[derive(Default)]
pub struct GeoKeys {
    pub(super) shorts: BTreeMap<u16, u16>,
    pub(super) doubles: BTreeMap<u16, Vec<f64>>,
    texts: BTreeMap<u16, String>,
}

impl GeoKeys {
    pub fn read(ifd: &Ifd) -> GeoKeys {
        let mut keys = GeoKeys::default();
        let Some(directory) = ifd.tag(TAG_GEO_KEYS).and_then(|t| t.value.as_u16_slice()) else {
            return keys;
        };
        let doubles = ifd.tag(TAG_GEO_DOUBLES).and_then(|t| t.value.as_f64_vec()).unwrap_or_default();
        let ascii = ifd.tag(TAG_GEO_ASCII).and_then(|t| t.value.as_str()).unwrap_or("");
        let count = directory.get(3).copied().unwrap_or(0);
        for entry in directory.chunks_exact(4).skip(1).take(usize::from(count)) {
            let (key, tag, n, value) = (entry[0], entry[1], usize::from(entry[2]), entry[3]);
            let at = usize::from(value);
            match tag {
                0 => drop(keys.shorts.insert(key, value)),
                TAG_GEO_DOUBLES => {
                    if let Some(v) = at.checked_add(n).and_then(|end| doubles.get(at..end)) {
                        keys.doubles.insert(key, v.to_vec());
                    }
                }
                TAG_GEO_ASCII => {
                    if let Some(text) = at.checked_add(n).and_then(|end| ascii.get(at..end.min(ascii.len())))
                    {
                        keys.texts.insert(key, text.trim_end_matches(['|', '\0']).to_string());
                    }
                }
                _ => {}
            }
        }
        keys
    }

    /// A code that is stated and not "user-defined".
    pub fn code(&self, key: u16) -> Option<u16> {
        self.short(key).filter(|code| *code != 0 && *code != USER_DEFINED)
    }

    pub fn short(&self, key: u16) -> Option<u16> {
        self.shorts.get(&key).copied()
    }

    pub fn double(&self, key: u16) -> Option<f64> {
        self.numbers(key).first().copied()
    }

    /// All numbers of a key; none if it is not there.
    pub fn numbers(&self, key: u16) -> &[f64] {
        self.doubles.get(&key).map_or(&[], |v| v.as_slice())
    }

    /// The WKT that ESRI's programs put into a citation.
    fn esri_text(&self) -> Option<&str> {
        let mark = "ESRI PE String = ";
        self.texts.values().find_map(|text| text.split_once(mark)).map(|(_, wkt)| wkt.trim())
    }

    /// The system as this program names it where EPSG has no code: `ESRI:n` or a PROJ string in a citation.
    fn named(&self) -> Option<Crs> {
        [KEY_PROJECTED_CITATION, KEY_GEODETIC_CITATION]
            .into_iter()
            .filter_map(|key| self.texts.get(&key))
            .filter(|text| text.starts_with("ESRI:") || text.starts_with("+proj="))
            .find_map(|text| Crs::parse(text).ok())
    }

    /// The name of a vertical system that is user-defined: how this program writes a datum without a code.
    fn named_heights(&self) -> Option<Vertical> {
        let own = self.short(KEY_VERTICAL_CRS) == Some(USER_DEFINED);
        let name = self.texts.get(&KEY_VERTICAL_CITATION).filter(|text| own && *text != "unknown")?;
        let datum = VerticalDatum::parse(name).ok()?;
        Some(Vertical { datum: Some(datum.as_str().to_string()), unit_m: None })
    }

    /// What the file says of its CRS in words.
    fn citation(&self) -> Option<String> {
        [KEY_CITATION, KEY_PROJECTED_CITATION, KEY_GEODETIC_CITATION]
            .into_iter()
            .filter_map(|key| self.texts.get(&key))
            .map(|text| shorten(text))
            .find(|text| !text.is_empty() && text != "unknown")
    }
}

/// Post positions; None without georeference, or if it is not one affine map (told in `notes`).
pub fn affine(ifd: &Ifd, keys: &GeoKeys, notes: &mut Vec<String>) -> Option<Affine> {
    let numbers = |tag| ifd.tag(tag).and_then(|t| t.value.as_f64_vec()).unwrap_or_default();
    let (scale, ties, matrix) =
        (numbers(TAG_PIXEL_SCALE), numbers(TAG_TIEPOINTS), numbers(TAG_TRANSFORMATION));
    // Position of the file's raster point (i, j) is base + i * col_step + j * row_step.
    let (base, col_step, row_step) = if let ([sx, sy, ..], [i, j, _, x, y, ..]) = (&scale[..], &ties[..])
        && *sx != 0.0
        && *sy != 0.0
    {
        if *sy < 0.0 {
            notes
                .push(format!("the file's vertical step is negative ({sy}); read as north-up, as GDAL does"));
        }
        let down = -sy.abs();
        ([x - i * sx, y - j * down], [*sx, 0.0], [0.0, down])
    } else if let [a, b, _, d, e, f, _, h, ..] = &matrix[..] {
        ([*d, *h], [*a, *e], [*b, *f])
    } else {
        if ties.len() >= 12 {
            notes.push("placed by ground control points only; warp it with gdalwarp first".to_string());
        }
        return None;
    };
    if (base, col_step, row_step) == ([0.0; 2], [1.0, 0.0], [0.0, 1.0]) {
        // Column and row numbers, which is how GDAL writes "nowhere".
        return None;
    }
    let half = if keys.short(KEY_RASTER_TYPE) == Some(RASTER_POINT) { 0.0 } else { 0.5 };
    let origin = [0, 1].map(|k| base[k] + half * col_step[k] + half * row_step[k]);
    let determinant = col_step[0] * row_step[1] - col_step[1] * row_step[0];
    if !origin.iter().all(|v| v.is_finite()) || !determinant.is_finite() || determinant == 0.0 {
        notes.push("the file's georeference is not usable (zero or infinite step); ignored".to_string());
        return None;
    }
    Some(Affine { origin, col_step, row_step })
}

/// The CRS: by EPSG code, from ESRI's WKT, or from a projection that the keys spell out. None, with a note of
/// what the file says, if it names none that can be computed.
pub fn crs(keys: &GeoKeys, notes: &mut Vec<String>) -> Option<Crs> {
    let says = keys.citation().map(|text| format!(" (it says: {text})")).unwrap_or_default();
    let model = keys.short(KEY_MODEL_TYPE);
    let code = match model {
        Some(MODEL_PROJECTED) => keys.code(KEY_PROJECTED_CRS),
        Some(MODEL_GEOGRAPHIC) => keys.code(KEY_GEODETIC_CRS),
        _ => match keys.short(KEY_PROJECTED_CRS) {
            Some(_) => keys.code(KEY_PROJECTED_CRS),
            None => keys.code(KEY_GEODETIC_CRS),
        },
    };
    let read = match code {
        Some(code) => Crs::from_epsg(u32::from(code))
            .map_err(|_| format!("the file's CRS EPSG:{code} is not in the registry of this build")),
        None => match (keys.named(), keys.esri_text()) {
            (Some(crs), _) => Ok(crs),
            (None, Some(wkt)) => {
                Crs::parse(wkt).map_err(|e| format!("the file's CRS is not understood: {e}"))
            }
            (None, None) => projection::proj_string(keys).and_then(|text| {
                Crs::parse(&text).map_err(|e| format!("the file's CRS is not understood: {e}"))
            }),
        },
    };
    let checked = read.and_then(|crs| unit_fault(keys, &crs).map(|()| crs));
    checked.map_err(|reason| notes.push(format!("{reason}{says}"))).ok()
}

/// Checks that the file's own unit is that of its CRS; in words what is wrong if not.
fn unit_fault(keys: &GeoKeys, crs: &Crs) -> std::result::Result<(), String> {
    match crs.unit {
        AxisUnit::Degree => match keys.short(KEY_ANGULAR_UNIT).unwrap_or(UNIT_DEGREE) {
            UNIT_DEGREE | UNIT_DEGREE_UNSPECIFIED => Ok(()),
            unit => Err(format!("the file says {} but counts angles in unit {unit}, not degrees", crs.code)),
        },
        AxisUnit::Metre(expected) => match linear_unit(keys)? {
            // One part in a million divides the two feet.
            Some(found) if (found / expected - 1.0).abs() > 1e-6 => Err(format!(
                "the file says {} (unit {expected} m) but its own unit is {found} m; name the CRS",
                crs.code
            )),
            _ => Ok(()),
        },
    }
}

/// Metres of the unit of the horizontal axes; None if the file does not say.
///
/// # Errors
/// In words for a note: a unit that is stated, and whose size is not known.
pub fn linear_unit(keys: &GeoKeys) -> std::result::Result<Option<f64>, String> {
    match keys.short(KEY_LINEAR_UNIT) {
        None | Some(0) => Ok(None),
        Some(USER_DEFINED) => match keys.double(KEY_LINEAR_UNIT_METRES) {
            Some(metres) if metres.is_finite() && metres > 0.0 => Ok(Some(metres)),
            Some(metres) => Err(format!("the file counts lengths in a unit of its own of {metres} m")),
            None => {
                Err("the file counts lengths in a unit of its own and does not say how long it is".into())
            }
        },
        Some(code) => metres_of_code(code).map(Some).ok_or_else(|| {
            format!("the file counts lengths in unit EPSG:{code}, whose size in metres is not known")
        }),
    }
}

/// What the file says of its heights: vertical keys (the code, else the name), else the compound or three-dimensional code, else ESRI's
/// WKT; the unit of the band (GDAL's) comes first.
///
/// # Errors
/// [`Error::Unsupported`] if the vertical keys state a unit whose size is not known and nothing else gives it.
pub fn vertical(keys: &GeoKeys, band_unit: Option<&str>, file: &str) -> Result<Vertical> {
    // Codes of GeoTIFF 1.0, before they were EPSG's: 5001 to 5033 are heights over an ellipsoid.
    let by_code = |code: u16| match code {
        5001..=5033 => Some(Vertical { datum: Some("ellipsoid".to_string()), unit_m: None }),
        5103 => Some(Vertical { datum: Some("EPSG:5703".to_string()), unit_m: None }),
        code => Vertical::from_epsg(u32::from(code)),
    };
    let first_of = |stated: [u16; 2]| stated.into_iter().filter_map(|key| keys.code(key)).find_map(by_code);
    let mut vertical = first_of([KEY_VERTICAL_CRS, KEY_VERTICAL_DATUM])
        .or_else(|| keys.named_heights())
        .or_else(|| first_of([KEY_PROJECTED_CRS, KEY_GEODETIC_CRS]))
        .or_else(|| keys.esri_text().map(Vertical::of_text))
        .unwrap_or_default();
    let stated = keys.short(KEY_VERTICAL_UNIT).filter(|code| *code != 0);
    let by_key = stated.and_then(metres_of_code);
    vertical.unit_m = band_unit.and_then(unit_metres).or(by_key).or(vertical.unit_m);
    match (stated, vertical.unit_m) {
        (Some(code), None) => Err(Error::unsupported(
            file,
            format!("its heights are in unit {code} of EPSG, whose size in metres is not known"),
            "write the true unit into a copy of the file (gdal_edit.py -units m), or the heights in metres",
        )),
        _ => Ok(vertical),
    }
}

/// A note if the file says that heights are not in metres.
pub fn height_unit_note(keys: &GeoKeys, unit: Option<&str>) -> Option<String> {
    if let Some(unit) = unit {
        return match unit_metres(unit) {
            Some(1.0) => None,
            Some(_) => Some(format!(
                "the file gives heights in '{unit}'; --vertical-unit says otherwise if that is wrong"
            )),
            None => Some(format!(
                "the file gives heights in '{unit}', which is no known unit; --vertical-unit says which it is"
            )),
        };
    }
    let metres = keys.short(KEY_VERTICAL_UNIT).and_then(metres_of_code).filter(|m| *m != 1.0)?;
    Some(format!(
        "the file gives heights in units of {metres} m; --vertical-unit says otherwise if that is wrong"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keys(shorts: &[(u16, u16)]) -> GeoKeys {
        let mut keys = GeoKeys::default();
        keys.shorts.extend(shorts.iter().copied());
        keys
    }

    #[test]
    fn units_that_are_stated_are_known_or_refused() {
        let utm = |unit: u16| keys(&[(1024, 1), (3072, 32610), (3076, unit)]);
        let laea = |unit: u16| keys(&[(1024, 1), (2048, 4326), (3072, 32767), (3075, 10), (3076, unit)]);
        let read = |keys: &GeoKeys| {
            let mut notes = Vec::new();
            (crs(keys, &mut notes), notes.concat())
        };
        assert_eq!(read(&utm(9001)).0.unwrap().code, "EPSG:32610");
        let (found, note) = read(&utm(9036));
        assert!(found.is_none() && note.contains("its own unit is 1000 m"), "{note}");
        for (code, metres) in [(9036, 1000.0), (9005, 0.3047972654), (9093, 1609.344)] {
            assert_eq!(read(&laea(code)).0.unwrap().unit, AxisUnit::Metre(metres), "{code}");
        }
        for code in [32767, 9101, 9999] {
            for keys in [utm(code), laea(code)] {
                let (found, note) = read(&keys);
                assert!(found.is_none() && note.contains("counts lengths in"), "{code}: {note}");
            }
        }
        let mut own = laea(32767);
        own.doubles.insert(KEY_LINEAR_UNIT_METRES, vec![f64::NAN]);
        assert!(read(&own).0.is_none());
        own.doubles.insert(KEY_LINEAR_UNIT_METRES, vec![0.25]);
        assert_eq!(read(&own).0.unwrap().unit, AxisUnit::Metre(0.25));
    }

    #[test]
    fn units_of_height_that_are_stated_are_known_or_refused() {
        let of = |unit: u16, band: Option<&str>| vertical(&keys(&[(4099, unit)]), band, "file");
        assert_eq!(of(9036, None).unwrap().unit_m, Some(1000.0));
        assert_eq!(of(9014, None).unwrap().unit_m, Some(1.8288));
        assert_eq!(of(0, None).unwrap().unit_m, None);
        assert_eq!(of(32767, Some("ft")).unwrap().unit_m, Some(0.3048));
        for unit in [32767, 9101] {
            let text = of(unit, None).unwrap_err().to_string();
            assert!(text.contains("file") && text.contains(&unit.to_string()), "{text}");
        }
    }
}
