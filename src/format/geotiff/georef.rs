//! Where the posts lie and in which CRS, from the GeoTIFF tags.
//!
//! Positions come from ModelPixelScale with one ModelTiepoint, else from ModelTransformation, as GDAL reads
//! them (a negative vertical scale is taken as its magnitude). A post is the centre of its pixel: with
//! PixelIsPoint the tags speak of centres already, with PixelIsArea (the default) of corners.

use super::metadata::shorten;
use super::projection;
use crate::height::crs::vertical::{FOOT_M, US_FOOT_M, Vertical, unit_metres};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::source::Affine;
use std::collections::BTreeMap;
use tiff_reader::Ifd;

pub const TAG_PIXEL_SCALE: u16 = 33550;
pub const TAG_TIEPOINTS: u16 = 33922;
pub const TAG_TRANSFORMATION: u16 = 34264;
pub const TAG_GEO_KEYS: u16 = 34735;
const TAG_GEO_DOUBLES: u16 = 34736;
const TAG_GEO_ASCII: u16 = 34737;

pub const KEY_MODEL_TYPE: u16 = 1024;
pub const KEY_RASTER_TYPE: u16 = 1025;
const KEY_CITATION: u16 = 1026;
pub const KEY_GEODETIC_CRS: u16 = 2048;
const KEY_GEODETIC_CITATION: u16 = 2049;
pub const KEY_ANGULAR_UNIT: u16 = 2054;
pub const KEY_PROJECTED_CRS: u16 = 3072;
const KEY_PROJECTED_CITATION: u16 = 3073;
pub const KEY_LINEAR_UNIT: u16 = 3076;
pub const KEY_LINEAR_UNIT_METRES: u16 = 3077;
const KEY_VERTICAL_CRS: u16 = 4096;
const KEY_VERTICAL_DATUM: u16 = 4098;
const KEY_VERTICAL_UNIT: u16 = 4099;

pub const MODEL_PROJECTED: u16 = 1;
pub const MODEL_GEOGRAPHIC: u16 = 2;
pub const RASTER_AREA: u16 = 1;
const RASTER_POINT: u16 = 2;
const UNIT_METRE: u16 = 9001;
const UNIT_FOOT: u16 = 9002;
const UNIT_US_FOOT: u16 = 9003;
pub const UNIT_DEGREE: u16 = 9102;
pub const UNIT_DEGREE_UNSPECIFIED: u16 = 9122;
pub const USER_DEFINED: u16 = 32767;

/// The GeoKeys of an image; keys that point outside their tags are left out.
#[derive(Default)]
pub struct GeoKeys {
    shorts: BTreeMap<u16, u16>,
    doubles: BTreeMap<u16, Vec<f64>>,
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
        None => match keys.esri_text() {
            Some(wkt) => Crs::parse(wkt).map_err(|e| format!("the file's CRS is not understood: {e}")),
            None => projection::proj_string(keys).and_then(|text| {
                Crs::parse(&text).map_err(|e| format!("the file's CRS is not understood: {e}"))
            }),
        },
    };
    let checked = read.and_then(|crs| unit_fault(keys, &crs).map_or(Ok(crs), Err));
    checked.map_err(|reason| notes.push(format!("{reason}{says}"))).ok()
}

/// What is wrong if the file's own unit is not that of its CRS.
fn unit_fault(keys: &GeoKeys, crs: &Crs) -> Option<String> {
    match crs.unit {
        AxisUnit::Degree => {
            let unit = keys.short(KEY_ANGULAR_UNIT).unwrap_or(UNIT_DEGREE);
            (unit != UNIT_DEGREE && unit != UNIT_DEGREE_UNSPECIFIED)
                .then(|| format!("the file says {} but counts angles in unit {unit}, not degrees", crs.code))
        }
        AxisUnit::Metre(expected) => {
            // One part in a million divides the two feet.
            let found = linear_unit(keys).filter(|f| (f / expected - 1.0).abs() > 1e-6 || f.is_nan())?;
            Some(format!(
                "the file says {} (unit {expected} m) but its own unit is {found} m; name the CRS",
                crs.code
            ))
        }
    }
}

/// Metres of the unit of the horizontal axes; None if the file does not say.
pub fn linear_unit(keys: &GeoKeys) -> Option<f64> {
    match keys.short(KEY_LINEAR_UNIT) {
        Some(USER_DEFINED) => keys.double(KEY_LINEAR_UNIT_METRES),
        unit => unit_of_code(unit?),
    }
}

fn unit_of_code(code: u16) -> Option<f64> {
    match code {
        UNIT_METRE => Some(1.0),
        UNIT_FOOT => Some(FOOT_M),
        UNIT_US_FOOT => Some(US_FOOT_M),
        _ => None,
    }
}

/// What the file says of its heights: vertical keys, else the compound or three-dimensional code, else ESRI's
/// WKT; the unit of the band (GDAL's) comes first.
pub fn vertical(keys: &GeoKeys, band_unit: Option<&str>) -> Vertical {
    // Codes of GeoTIFF 1.0, before they were EPSG's: 5001 to 5033 are heights over an ellipsoid.
    let by_code = |code: u16| match code {
        5001..=5033 => Some(Vertical { datum: Some("ellipsoid".to_string()), unit_m: None }),
        5103 => Some(Vertical { datum: Some("EPSG:5703".to_string()), unit_m: None }),
        code => Vertical::from_epsg(u32::from(code)),
    };
    let stated = [KEY_VERTICAL_CRS, KEY_VERTICAL_DATUM, KEY_PROJECTED_CRS, KEY_GEODETIC_CRS];
    let mut vertical = stated
        .into_iter()
        .filter_map(|key| keys.code(key))
        .find_map(by_code)
        .or_else(|| keys.esri_text().map(Vertical::of_text))
        .unwrap_or_default();
    let by_key = keys.short(KEY_VERTICAL_UNIT).and_then(unit_of_code);
    vertical.unit_m = band_unit.and_then(unit_metres).or(by_key).or(vertical.unit_m);
    vertical
}

/// A note if the file says that heights are not in metres.
pub fn height_unit_note(keys: &GeoKeys, unit: Option<&str>) -> Option<String> {
    let by_key = match keys.shorts.get(&KEY_VERTICAL_UNIT) {
        Some(&UNIT_FOOT) => Some("feet"),
        Some(&UNIT_US_FOOT) => Some("US survey feet"),
        _ => None,
    };
    let metres = ["m", "metre", "meter", "metres", "meters"];
    let by_tag = unit.filter(|u| !metres.contains(&u.to_ascii_lowercase().as_str()));
    by_tag.or(by_key).map(|unit| format!("the file gives heights in '{unit}'; they are taken as metres"))
}
