//! Esri's raw grids: samples in one file, their layout as words in a `.hdr` beside it.
//!
//! Two dialects of the header are read. That of float grids (`.flt`) has the keywords of an ASCII grid
//! (`ncols`, `xllcorner`, `cellsize`, `byteorder`); that of images (`.bil`, `.bip`, `.bsq`, and `.dem` of GTOPO30
//! and SRTM30) has `NCOLS`, `ULXMAP`, `XDIM`, `NBITS`, `LAYOUT`. Case does not matter, and they may mix. Keywords: ArcGIS help, "Float to
//! Raster" and "BIL, BIP, and BSQ raster files".

use super::input::Input;
use super::raw::{Layout, RawGrid};
use super::sidecar::{self, Sidecar};
use super::window;
use crate::base::{Error, Result};
use crate::height::source::{Affine, SampleType, SourceInfo};
use std::collections::BTreeMap;
use std::path::Path;

/// Opens the data file by its header; no sample is read.
///
/// # Errors
/// [`Error::Corrupt`] for a header that lacks something or does not fit the file, [`Error::Unsupported`] for
/// sample types that are not read.
pub fn open(input: Input, header: &Sidecar) -> Result<RawGrid> {
    let h = Header::read(header);
    let mut notes = Vec::new();
    let (cols, rows) = (h.count("NCOLS")?, h.count("NROWS")?);
    window::check_size(&input.file, cols, rows)?;
    let bands = if h.has("NBANDS") { h.count("NBANDS")? } else { 1 };
    let nodata = h.number_of(&["NODATA_VALUE", "NODATA"])?;
    let sample_type = h.sample_type(&input.file, nodata, &mut notes)?;
    if bands > 1 {
        notes.push(format!("the file has {bands} bands; the first is read"));
    }
    let mut info = SourceInfo {
        file: input.file.clone(),
        format: "Esri raw grid",
        cols,
        rows,
        sample_type,
        affine: h.affine(rows)?,
        crs: None,
        nodata,
        scale: 1.0,
        offset: 0.0,
        accuracy_m: None,
        product: None,
        vertical_datum: None,
        vertical_unit_m: None,
        notes,
    };
    sidecar::complete(&mut info, &input, &[])?;
    let layout = h.layout(cols, rows, bands, sample_type.bytes() as u64)?;
    RawGrid::new(info, input, layout)
}

/// Whether a text is such a header: its lines begin with keywords.
pub fn is_header(text: &str) -> bool {
    let known = ["NCOLS", "NROWS", "BYTEORDER", "LAYOUT", "NBANDS", "NBITS", "XLLCORNER", "ULXMAP"];
    let words = text.lines().filter_map(|l| l.split_whitespace().next());
    words.filter(|w| known.contains(&w.to_ascii_uppercase().as_str())).count() >= 2
}

/// The words of a header by their keyword, in upper case.
struct Header<'a> {
    file: &'a str,
    words: BTreeMap<String, &'a str>,
}

impl<'a> Header<'a> {
    fn read(sidecar: &'a Sidecar) -> Header<'a> {
        let mut words = BTreeMap::new();
        for line in sidecar.text.lines() {
            let mut parts = line.split_whitespace();
            if let (Some(key), Some(value)) = (parts.next(), parts.next()) {
                words.entry(key.to_ascii_uppercase()).or_insert(value);
            }
        }
        Header { file: &sidecar.file, words }
    }

    fn has(&self, key: &str) -> bool {
        self.words.contains_key(key)
    }

    fn bad(&self, key: &str, reason: impl ToString) -> Error {
        Error::corrupt(self.file, format!("keyword {key}"), reason)
    }

    fn parsed<T: std::str::FromStr>(&self, key: &str, what: &str) -> Result<Option<T>> {
        let Some(word) = self.words.get(key) else { return Ok(None) };
        let parsed = word.parse().map_err(|_| self.bad(key, format!("'{word}' is not {what}")))?;
        Ok(Some(parsed))
    }

    fn count(&self, key: &str) -> Result<u64> {
        let n = self.parsed(key, "a number of posts or bands")?;
        n.ok_or_else(|| self.bad(key, "it is absent"))
    }

    fn bytes(&self, key: &str) -> Result<Option<u64>> {
        self.parsed(key, "a number of bytes")
    }

    fn number(&self, key: &str) -> Result<Option<f64>> {
        match self.parsed::<f64>(key, "a number")? {
            Some(v) if v.is_infinite() => Err(self.bad(key, "it is infinite")),
            v => Ok(v),
        }
    }

    fn number_of(&self, keys: &[&str]) -> Result<Option<f64>> {
        keys.iter().find(|k| self.has(k)).map_or(Ok(None), |k| self.number(k))
    }

    /// Posts are centres of cells.
    fn affine(&self, rows: u64) -> Result<Option<Affine>> {
        let dx = self.number_of(&["CELLSIZE", "DX", "XDIM"])?;
        let dy = self.number_of(&["CELLSIZE", "DY", "YDIM"])?;
        let (Some(dx), Some(dy)) = (dx, dy) else { return Ok(None) };
        let down = (rows - 1) as f64 * dy;
        let x = match (self.number("XLLCORNER")?, self.number_of(&["XLLCENTER", "ULXMAP"])?) {
            (Some(x), _) => x + dx / 2.0,
            (None, Some(x)) => x,
            (None, None) => return Ok(None),
        };
        let y = match (self.number("YLLCORNER")?, self.number("YLLCENTER")?, self.number("ULYMAP")?) {
            (Some(y), _, _) => y + dy / 2.0 + down,
            (None, Some(y), _) => y + down,
            (None, None, Some(y)) => y,
            _ => return Ok(None),
        };
        let affine = Affine { origin: [x, y], col_step: [dx, 0.0], row_step: [0.0, -dy] };
        if !sidecar::usable(&affine) || dx < 0.0 || dy < 0.0 {
            return Err(self.bad("cell size", format!("{dx} x {dy} from ({x}, {y}) is no grid")));
        }
        Ok(Some(affine))
    }

    fn sample_type(&self, file: &str, nodata: Option<f64>, notes: &mut Vec<String>) -> Result<SampleType> {
        let extension =
            Path::new(file).extension().and_then(|e| e.to_str()).unwrap_or("").to_ascii_lowercase();
        let kind = self.words.get("PIXELTYPE").map(|w| w.to_ascii_uppercase());
        let float = extension == "flt" || kind.as_deref().is_some_and(|k| k.starts_with('F'));
        let bits: u64 = self.parsed("NBITS", "a number of bits")?.unwrap_or(if float { 32 } else { 8 });
        let signed = match &kind {
            Some(kind) => kind.starts_with('S'),
            // GTOPO30 and SRTM30 say it by their nodata value, or by nothing but their name.
            None => nodata.is_some_and(|v| v < 0.0) || extension == "dem",
        };
        if kind.is_none() && !float && bits > 8 {
            let read = if signed { "signed" } else { "unsigned" };
            notes.push(format!("the header names no PIXELTYPE; samples are read as {read} integers"));
        }
        Ok(match (float, signed, bits) {
            (true, _, 32) => SampleType::F32,
            (true, _, 64) => SampleType::F64,
            (false, false, 8) => SampleType::U8,
            (false, true, 8) => SampleType::I8,
            (false, false, 16) => SampleType::U16,
            (false, true, 16) => SampleType::I16,
            (false, false, 32) => SampleType::U32,
            (false, true, 32) => SampleType::I32,
            _ => {
                return Err(Error::unsupported(
                    file,
                    format!("samples of {bits} bits are not read"),
                    "convert it with: gdal_translate -ot Float32 INPUT OUTPUT.tif",
                ));
            }
        })
    }

    /// Band 1 of `bands`.
    fn layout(&self, cols: u64, rows: u64, bands: u64, width: u64) -> Result<Layout> {
        let order = self.words.get("BYTEORDER").map_or("I".to_string(), |w| w.to_ascii_uppercase());
        let big_endian = match order.as_str() {
            "I" | "LSBFIRST" | "INTEL" => false,
            "M" | "MSBFIRST" | "MOTOROLA" => true,
            _ => {
                return Err(
                    self.bad("BYTEORDER", format!("'{order}' is neither I, M, LSBFIRST nor MSBFIRST"))
                );
            }
        };
        let at = self.bytes("SKIPBYTES")?.unwrap_or(0);
        let order = self.words.get("LAYOUT").map_or("BIL".to_string(), |w| w.to_ascii_uppercase());
        let band_row = cols.saturating_mul(width);
        let (sample_stride, row_bytes) = match order.as_str() {
            "BIL" => (width, self.bytes("TOTALROWBYTES")?.unwrap_or(band_row.saturating_mul(bands))),
            "BIP" => (
                width.saturating_mul(bands),
                self.bytes("TOTALROWBYTES")?.unwrap_or(band_row.saturating_mul(bands)),
            ),
            "BSQ" => (width, self.bytes("BANDROWBYTES")?.unwrap_or(band_row)),
            _ => return Err(self.bad("LAYOUT", format!("'{order}' is neither BIL, BIP nor BSQ"))),
        };
        let row_span = sample_stride.saturating_mul(cols - 1).saturating_add(width);
        if row_bytes < row_span && rows > 1 {
            let reason = format!("rows of {row_bytes} bytes, but {cols} samples need {row_span}");
            return Err(self.bad("TOTALROWBYTES", reason));
        }
        Ok(Layout { at, sample_stride, row_stride: row_bytes, big_endian })
    }
}
