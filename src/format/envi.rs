//! ENVI grids: samples in one file of any name, their layout as `key = value` in a `.hdr` beside it.
//!
//! Keys: NV5 ENVI documentation, "ENVI Header Files".

use super::geotiff::shorten;
use super::input::Input;
use super::raw::{Layout, RawGrid};
use super::sidecar::{self, Sidecar};
use super::window;
use crate::base::{Error, Result};
use crate::height::crs::Crs;
use crate::height::source::{Affine, SampleType, SourceInfo};
use std::collections::BTreeMap;

/// Whether a text is such a header.
pub fn is_header(text: &str) -> bool {
    text.trim_start().starts_with("ENVI")
}

/// Opens the data file by its header; no sample is read.
///
/// # Errors
/// As [`super::esri::open`].
pub fn open(input: Input, header: &Sidecar) -> Result<RawGrid> {
    let h = Header::read(header);
    let (cols, rows) = (h.count("samples", None)?, h.count("lines", None)?);
    window::check_size(&input.file, cols, rows)?;
    let bands = h.count("bands", Some(1))?;
    let sample_type = h.sample_type()?;
    let mut notes = Vec::new();
    if bands > 1 {
        notes.push(format!("the file has {bands} bands; the first is read"));
    }
    let mut info = SourceInfo {
        file: input.file.clone(),
        format: "ENVI",
        cols,
        rows,
        sample_type,
        affine: h.affine(&mut notes),
        crs: None,
        nodata: h.number("data ignore value")?,
        scale: h.number("data gain values")?.unwrap_or(1.0),
        offset: h.number("data offset values")?.unwrap_or(0.0),
        accuracy_m: None,
        product: None,
        vertical_datum: None,
        vertical_unit_m: None,
        notes,
    };
    if !info.scale.is_finite() || info.scale == 0.0 || !info.offset.is_finite() {
        let reason = format!("scale {} and offset {} make no heights", info.scale, info.offset);
        return Err(Error::corrupt(h.file, "data gain values", reason));
    }
    info.crs = h.crs(&mut info.notes);
    sidecar::complete(&mut info, &input, &[])?;
    let layout = h.layout(cols, bands, sample_type.bytes() as u64)?;
    RawGrid::new(info, input, layout)
}

/// Values by their key, in lower case; lists without their braces.
struct Header<'a> {
    file: &'a str,
    values: BTreeMap<String, &'a str>,
}

impl<'a> Header<'a> {
    fn read(sidecar: &'a Sidecar) -> Header<'a> {
        let mut values = BTreeMap::new();
        let mut rest = sidecar.text.as_str();
        while let Some((key, after)) = rest.split_once('=') {
            // A key stands on one line; what stands before it belongs to nothing.
            let key = key.rsplit('\n').next().unwrap_or(key).trim().to_ascii_lowercase();
            let after = after.trim_start_matches([' ', '\t']);
            let (value, tail) = match after.strip_prefix('{') {
                Some(list) => list.split_once('}').unwrap_or((list, "")),
                None => after.split_once('\n').unwrap_or((after, "")),
            };
            values.entry(key).or_insert(value.trim());
            rest = tail;
        }
        Header { file: &sidecar.file, values }
    }

    fn bad(&self, key: &str, reason: impl ToString) -> Error {
        Error::corrupt(self.file, format!("key '{key}'"), reason)
    }

    fn count(&self, key: &str, absent: Option<u64>) -> Result<u64> {
        match self.values.get(key) {
            Some(word) => {
                word.parse().map_err(|_| self.bad(key, format!("'{}' is no number", shorten(word))))
            }
            None => absent.ok_or_else(|| self.bad(key, "it is absent")),
        }
    }

    /// A number, or the first of a list.
    fn number(&self, key: &str) -> Result<Option<f64>> {
        let Some(text) = self.values.get(key) else { return Ok(None) };
        let word = text.split(',').next().unwrap_or("").trim();
        let number = word.parse().map_err(|_| self.bad(key, format!("'{}' is no number", shorten(word))))?;
        Ok(Some(number))
    }

    fn sample_type(&self) -> Result<SampleType> {
        let unsupported = |what: String| {
            Err(Error::unsupported(
                self.file,
                what,
                "convert it with: gdal_translate -ot Float32 INPUT OUTPUT.tif",
            ))
        };
        if self.count("file compression", Some(0))? != 0 {
            return unsupported("compressed ENVI files are not read".to_string());
        }
        Ok(match self.count("data type", None)? {
            1 => SampleType::U8,
            2 => SampleType::I16,
            3 => SampleType::I32,
            4 => SampleType::F32,
            5 => SampleType::F64,
            12 => SampleType::U16,
            13 => SampleType::U32,
            code => return unsupported(format!("data type {code} (complex or 64-bit integers) is not read")),
        })
    }

    /// Band 1 of `bands`.
    fn layout(&self, cols: u64, bands: u64, width: u64) -> Result<Layout> {
        let big_endian = match self.count("byte order", Some(0))? {
            0 => false,
            1 => true,
            other => return Err(self.bad("byte order", format!("{other} is neither 0 nor 1"))),
        };
        let row = cols.saturating_mul(width);
        let order = self.values.get("interleave").map_or("bsq".to_string(), |w| w.to_ascii_lowercase());
        let (sample_stride, row_stride) = match order.as_str() {
            "bsq" => (width, row),
            "bil" => (width, row.saturating_mul(bands)),
            "bip" => (width.saturating_mul(bands), row.saturating_mul(bands)),
            _ => {
                return Err(
                    self.bad("interleave", format!("'{}' is neither bsq, bil nor bip", shorten(&order)))
                );
            }
        };
        if bands == 0 {
            return Err(self.bad("bands", "there are none"));
        }
        Ok(Layout { at: self.count("header offset", Some(0))?, sample_stride, row_stride, big_endian })
    }

    /// The words of `map info`: projection, column and row (from 1, corners of cells) of a point, its place, the
    /// steps, then zone, hemisphere, datum and `name=value` as the projection has them.
    fn map_info(&self) -> Vec<&'a str> {
        self.values.get("map info").map_or(Vec::new(), |text| text.split(',').map(str::trim).collect())
    }

    fn affine(&self, notes: &mut Vec<String>) -> Option<Affine> {
        let words = self.map_info();
        if words.len() < 7 || words[0].eq_ignore_ascii_case("arbitrary") {
            return None;
        }
        let numbers: Vec<f64> = words[1..7].iter().map_while(|w| w.parse().ok()).collect();
        let turned =
            words.iter().find_map(|w| w.strip_prefix("rotation=")).map_or(Some(0.0), |w| w.parse().ok());
        let found = if let ([col, row, x, y, dx, dy], Some(turned)) = (&numbers[..], turned) {
            let (sin, cos) = if turned == 0.0 { (0.0, 1.0) } else { f64::to_radians(turned).sin_cos() };
            // Counter-clockwise, as GDAL reads it.
            let (col_step, row_step) = ([cos * dx, sin * dy], [sin * dx, -cos * dy]);
            // The centre of the first cell.
            let (i, j) = (1.5 - col, 1.5 - row);
            let at = |k: usize, p: f64| p + i * col_step[k] + j * row_step[k];
            Some(Affine { origin: [at(0, *x), at(1, *y)], col_step, row_step })
        } else {
            None
        };
        let found = found.filter(sidecar::usable);
        if found.is_none() {
            notes.push(format!("the map info '{}' places no grid; ignored", shorten(&words.join(", "))));
        }
        found
    }

    /// By the coordinate system string, else by the words of `map info`.
    fn crs(&self, notes: &mut Vec<String>) -> Option<Crs> {
        let mut said = Vec::new();
        let text = self.values.get("coordinate system string");
        let by_text = text.and_then(|text| sidecar::understood(text, self.file, &mut said));
        let found = by_text.or_else(|| self.crs_of_map_info());
        if found.is_none() {
            notes.extend(said);
        }
        found
    }

    fn crs_of_map_info(&self) -> Option<Crs> {
        let words = self.map_info();
        let has = |name: &str| words.iter().any(|w| w.eq_ignore_ascii_case(name));
        let datums = [
            ("WGS-84", 4326, 32600),
            ("North America 1983", 4269, 26900),
            ("North America 1927", 4267, 26700),
        ];
        let (_, geographic, utm) = datums.into_iter().find(|d| has(d.0))?;
        match words.first()?.to_ascii_lowercase().as_str() {
            "geographic lat/lon" => Crs::from_epsg(geographic).ok(),
            "utm" => {
                let zone: u32 = words.get(7)?.parse().ok().filter(|z| (1..=60).contains(z))?;
                let south = if has("South") { 100 } else { 0 };
                Crs::from_epsg(utm + south + zone).ok().filter(|_| south == 0 || utm == 32600)
            }
            _ => None,
        }
    }
}
