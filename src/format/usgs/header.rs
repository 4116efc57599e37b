//! Record A of a USGS DEM.

use super::fields::real;
use crate::base::{Error, Result, limits};
use crate::format::input::Input;
use crate::height::crs::Crs;

const HEADER_BYTES: usize = 1024;
/// The standard before 1988 ended record A after the number of profiles.
const OLD_HEADER_BYTES: usize = 864;
const FOOT_M: f64 = 0.3048;

const GEOGRAPHIC: i32 = 0;
const UTM: i32 = 1;

/// What the header says, as far as it is needed.
pub struct Header {
    /// Byte after the header.
    pub profiles_at: u64,
    pub profiles: u64,
    /// Steps from column to column and row to row, in the units of the profiles' places.
    pub step: [f64; 2],
    /// Degrees in one unit of places; 1 for projected grids.
    pub degrees: f64,
    /// Height of one step, in the unit of heights.
    pub height_step: f64,
    pub height_unit_m: f64,
    pub states_accuracy: bool,
    pub notes: Vec<String>,
    system: i32,
    zone: i32,
    datum: Option<i32>,
}

/// Whether a file begins like record A: level, pattern, system, zone, and units in their columns.
pub fn begins(head: &[u8]) -> bool {
    let within = |from: usize, to: usize, range: std::ops::RangeInclusive<i32>| {
        integer(head, from, to).is_some_and(|v| range.contains(&v))
    };
    head.len() >= OLD_HEADER_BYTES
        && head[..144]
            .iter()
            .all(|b| *b == b' ' || b.is_ascii_graphic() || b.is_ascii_whitespace() || *b == 0)
        && within(144, 150, 0..=9)
        && within(150, 156, 1..=4)
        && within(156, 162, 0..=99)
        && within(528, 534, 0..=3)
        && within(534, 540, 1..=2)
        && within(858, 864, 1..=i32::MAX)
}

fn integer(head: &[u8], from: usize, to: usize) -> Option<i32> {
    std::str::from_utf8(head.get(from..to)?).ok()?.trim().parse().ok()
}

impl Header {
    /// # Errors
    /// [`Error::Corrupt`] for fields that are no numbers, [`Error::Unsupported`] for what is no regular grid.
    pub fn read(input: &Input) -> Result<Header> {
        let head = input.head(HEADER_BYTES)?;
        let file = &input.file;
        let bad =
            |what: &str| Error::corrupt(file, "header (record A)", format!("{what} is no number in range"));
        let int = |from, to, what: &str| integer(&head, from, to).ok_or_else(|| bad(what));
        let float = |from: usize, to: usize, what: &str| {
            let found = head.get(from..to).and_then(real).filter(|v| *v > 0.0);
            found.ok_or_else(|| bad(what))
        };
        if int(150, 156, "pattern")? != 1 {
            return Err(Error::unsupported(
                file,
                "a USGS DEM whose posts make no regular grid",
                "grid it first, for example with gdal_grid",
            ));
        }
        let system = int(156, 162, "reference system")?;
        let zone = int(162, 168, "zone")?;
        let mut notes = Vec::new();
        let (unit, units_per_degree) = match int(528, 534, "unit of places")? {
            0 => ("radians", std::f64::consts::PI / 180.0),
            1 => ("feet", 0.0),
            2 => ("metres", 0.0),
            3 => ("arc-seconds", 3600.0),
            _ => return Err(bad("unit of places")),
        };
        if (system == GEOGRAPHIC) != (units_per_degree > 0.0) || (system == UTM && unit != "metres") {
            let reason = format!("reference system {system} with places in {unit}");
            return Err(Error::corrupt(file, "header (record A)", reason));
        }
        let height_unit_m = match int(534, 540, "unit of heights")? {
            1 => {
                notes.push(format!("heights are in feet; they are turned into metres ({FOOT_M} m)"));
                FOOT_M
            }
            2 => 1.0,
            _ => return Err(bad("unit of heights")),
        };
        let step = [float(816, 828, "resolution in x")?, float(828, 840, "resolution in y")?];
        let profiles = u64::try_from(int(858, 864, "number of profiles")?).unwrap_or(0);
        if profiles == 0 || profiles > limits::SIDE_MAX {
            return Err(Error::limit(format!("profiles of {file} (1 at least)"), limits::SIDE_MAX, profiles));
        }
        // In the old form, the first profile's own numbers follow at once: row 1, column 1.
        let old = integer(&head, 864, 870) == Some(1) && integer(&head, 870, 876) == Some(1);
        Ok(Header {
            profiles_at: if old { OLD_HEADER_BYTES } else { HEADER_BYTES } as u64,
            profiles,
            step: if unit == "arc-seconds" { step.map(whole_part_of_a_degree) } else { step },
            degrees: if units_per_degree > 0.0 { 1.0 / units_per_degree } else { 1.0 },
            height_step: float(840, 852, "resolution in z")?,
            height_unit_m,
            states_accuracy: integer(&head, 810, 816) == Some(1),
            notes,
            system,
            zone,
            datum: if old { None } else { integer(&head, 890, 892).filter(|d| *d != 0) },
        })
    }

    /// By reference system, zone and datum; None, with a note, if there is no such EPSG code.
    pub fn crs(&self, notes: &mut Vec<String>) -> Option<Crs> {
        let datum = self.datum.unwrap_or(1);
        let geographic = match datum {
            1 => 4267,
            2 => 4322,
            3 => 4326,
            4 => 4269,
            5 => 4135,
            6 => 4139,
            _ => 0,
        };
        let zone = u32::try_from(self.zone.abs()).unwrap_or(0);
        let north = self.zone > 0;
        let code = match (self.system, datum) {
            (GEOGRAPHIC, _) => geographic,
            (UTM, 1) if north => 26700 + zone,
            (UTM, 2) => zone + if north { 32200 } else { 32300 },
            (UTM, 3) => zone + if north { 32600 } else { 32700 },
            (UTM, 4) if north => 26900 + zone,
            _ => 0,
        };
        let found = Crs::from_epsg(code)
            .ok()
            .filter(|_| code != 0 && (self.system != UTM || (1..=60).contains(&zone)));
        match &found {
            Some(crs) if self.datum.is_none() => notes.push(format!(
                "the header names no datum; NAD27 is taken, that of the standard's first edition ({})",
                crs.code
            )),
            Some(_) => {}
            None => notes.push(format!(
                "its reference system {}, zone {}, datum {datum} has no EPSG code here; name the CRS with --crs",
                self.system, self.zone
            )),
        }
        found
    }
}

/// Seconds of arc with the header's six digits, as the whole part of a degree that they mean (0.333333: 1/3).
fn whole_part_of_a_degree(step: f64) -> f64 {
    let parts = 3600.0 / step;
    if (parts - parts.round()).abs() < 0.02 { 3600.0 / parts.round() } else { step }
}
