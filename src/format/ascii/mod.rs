//! Esri ASCII grids (`.asc`): a header of keywords, then the heights as words, north to south.
//!
//! Opening goes once through the text: every word must be a number and there must be as many as the header says;
//! what is kept is where each row begins. Rows may be wrapped over lines in any way; but where there are as many
//! lines as rows, every line has to hold one row. Samples become the narrowest of int32, float32 and float64 that
//! holds every number as it is written (as f64 reads it).
//!
//! Keywords: ArcGIS help, "Esri ASCII raster format"; `dx` and `dy` in place of `cellsize` as GDAL writes them.

mod tokens;

use super::input::{Input, InputReader};
use super::sidecar;
use super::voids::Voids;
use super::window;
use crate::base::{Error, Result};
use crate::height::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use std::collections::BTreeMap;
use std::sync::Arc;
use tokens::{Decimal, Word, Words};

const KEYWORDS: [&str; 11] = [
    "NCOLS",
    "NROWS",
    "XLLCORNER",
    "XLLCENTER",
    "YLLCORNER",
    "YLLCENTER",
    "CELLSIZE",
    "DX",
    "DY",
    "NODATA_VALUE",
    "NODATA",
];
/// What marks voids in a grid whose header does not say, by Esri's definition of the format.
const NODATA_UNSAID: f64 = -9999.0;

/// Whether a text begins like an ASCII grid: with one of its keywords.
pub fn begins(head: &[u8]) -> bool {
    let text = head.strip_prefix(b"\xef\xbb\xbf").unwrap_or(head);
    let word = text.split(u8::is_ascii_whitespace).find(|w| !w.is_empty()).unwrap_or(&[]);
    std::str::from_utf8(word).is_ok_and(|w| KEYWORDS.contains(&w.to_ascii_uppercase().as_str()))
}

/// One ASCII grid.
pub struct AsciiGrid {
    info: SourceInfo,
    input: Arc<Input>,
    /// Byte where each row begins.
    rows_at: Vec<u64>,
    decimal: Decimal,
    voids: Voids,
}

impl AsciiGrid {
    /// Opens a grid and goes once through its words.
    ///
    /// # Errors
    /// [`Error::Corrupt`], with the line, for a header that lacks something, words that are no numbers, and too few
    /// or too many of them; [`Error::Limit`] for too many posts.
    pub fn open(input: Input) -> Result<AsciiGrid> {
        let input = Arc::new(input);
        let begin = if input.head(3)? == b"\xef\xbb\xbf" { 3 } else { 0 };
        let mut words = Words::new(input.reader(begin), begin);
        let mut header = Header { file: &input.file, values: BTreeMap::new(), decimal: Decimal::default() };
        let data_at = header.read(&mut words)?;
        let (cols, rows) = (header.count("NCOLS")?, header.count("NROWS")?);
        window::check_size(&input.file, cols, rows)?;
        // A number and a blank for each post but the last; the header is longer than a blank.
        if cols * rows > input.span_bytes() / 2 {
            let reason = format!("{cols} x {rows} posts in a file of {} bytes", input.span_bytes());
            return Err(Error::corrupt(&input.file, "header", reason));
        }
        let affine = header.affine(rows)?;
        let nodata = header.number(&["NODATA_VALUE", "NODATA"])?;
        let scan = Scan::of(&input, data_at, [cols, rows], header.decimal)?;
        let mut notes = Vec::new();
        if scan.decimal == Decimal::Comma {
            notes.push("numbers are written with decimal commas".to_string());
        }
        if nodata.is_none() && scan.unsaid_voids > 0 {
            notes.push(format!(
                "the header names no NODATA_value; {} posts of {NODATA_UNSAID} are void (Esri's default)",
                scan.unsaid_voids
            ));
        }
        let mut info = SourceInfo {
            file: input.file.clone(),
            format: "Esri ASCII grid",
            cols,
            rows,
            sample_type: scan.sample_type(),
            affine: Some(affine),
            crs: None,
            nodata: nodata.or((scan.unsaid_voids > 0).then_some(NODATA_UNSAID)),
            scale: 1.0,
            offset: 0.0,
            accuracy_m: None,
            product: None,
            vertical_datum: None,
            vertical_unit_m: None,
            notes,
        };
        sidecar::complete(&mut info, &input, &[])?;
        let voids = Voids::of(&mut info);
        Ok(AsciiGrid { info, input, rows_at: scan.rows_at, decimal: scan.decimal, voids })
    }
}

impl HeightSource for AsciiGrid {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.info.nodata = Some(value);
        self.voids = Voids::of(&mut self.info);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        window::check(&self.info, w)?;
        let sample_type = self.info.sample_type;
        let mut data = Vec::with_capacity(w.cols * w.rows * sample_type.bytes());
        let mut words = None;
        for row in w.row..w.row + w.rows as u64 {
            let at = self.rows_at[row as usize];
            // Whole rows follow one another.
            let words: &mut Words<InputReader> = match &mut words {
                Some(words) if w.cols as u64 == self.info.cols => words,
                other => other.insert(Words::new(self.input.reader(at), at)),
            };
            for col in 0..w.col + w.cols as u64 {
                let word = words.next().map_err(|e| Error::io(&self.info.file, e))?;
                let value = word.and_then(|word| self.decimal.number(word.bytes));
                let Some(value) = value else {
                    let place = format!("column {col}, row {row}");
                    return Err(Error::corrupt(&self.info.file, place, "the file changed while it was read"));
                };
                if col >= w.col {
                    match sample_type {
                        SampleType::I32 => data.extend((value as i32).to_le_bytes()),
                        SampleType::F32 => data.extend((value as f32).to_le_bytes()),
                        _ => data.extend(value.to_le_bytes()),
                    }
                }
            }
        }
        let valid = self.voids.valid(&data);
        Ok(Samples { cols: w.cols, rows: w.rows, data, valid })
    }
}

/// The header's numbers by their keyword, and the line where each stands.
struct Header<'a> {
    file: &'a str,
    values: BTreeMap<&'static str, (f64, u64)>,
    decimal: Decimal,
}

impl Header<'_> {
    /// Reads keywords up to the first number that belongs to none; gives byte and line where that stands.
    fn read(&mut self, words: &mut Words<InputReader>) -> Result<(u64, u64)> {
        loop {
            let Some(word) = words.next().map_err(|e| Error::io(self.file, e))? else {
                return Err(Error::corrupt(self.file, "header", "no heights follow it"));
            };
            let shown = word.shown();
            let Some(keyword) = KEYWORDS.into_iter().find(|k| k.eq_ignore_ascii_case(&shown)) else {
                if Decimal::default().number(word.bytes).is_some() {
                    return Ok((word.at, word.line));
                }
                let reason = format!("'{shown}' is neither a keyword of an Esri grid nor a number");
                return Err(Error::corrupt(self.file, format!("header, line {}", word.line), reason));
            };
            let place = format!("header, line {}", word.line);
            let word = words.next().map_err(|e| Error::io(self.file, e))?;
            let value = word.and_then(|w| self.decimal.number(w.bytes));
            let Some(value) = value else {
                let found = word.map_or("nothing".to_string(), |w| format!("'{}'", w.shown()));
                let reason = format!("a number must follow {keyword}, not {found}");
                return Err(Error::corrupt(self.file, place, reason));
            };
            let line = word.map_or(0, |w| w.line);
            if self.values.insert(keyword, (value, line)).is_some() {
                return Err(Error::corrupt(
                    self.file,
                    place,
                    format!("{keyword} stands there for the second time"),
                ));
            }
        }
    }

    fn number(&self, keywords: &[&str]) -> Result<Option<f64>> {
        let mut found = keywords.iter().filter_map(|k| Some((*k, self.values.get(k)?.0)));
        let first = found.next();
        if let (Some((a, _)), Some((b, _))) = (first, found.next()) {
            return Err(Error::corrupt(self.file, "header", format!("both {a} and {b} are given")));
        }
        Ok(first.map(|f| f.1))
    }

    fn needed(&self, keywords: &[&str]) -> Result<f64> {
        let absent = || Error::corrupt(self.file, "header", format!("{} is absent", keywords.join(" or ")));
        self.number(keywords)?.ok_or_else(absent)
    }

    fn count(&self, keyword: &str) -> Result<u64> {
        let v = self.needed(&[keyword])?;
        if v.fract() != 0.0 || !(0.0..1e18).contains(&v) {
            return Err(Error::corrupt(
                self.file,
                "header",
                format!("{keyword} is {v}, not a number of posts"),
            ));
        }
        Ok(v as u64)
    }

    /// Posts are the centres of the cells.
    fn affine(&self, rows: u64) -> Result<Affine> {
        let step = |keyword| self.needed(&["CELLSIZE", keyword]);
        let (dx, dy) = (step("DX")?, step("DY")?);
        let at = |corner, centre, step: f64| {
            let half = if self.values.contains_key(corner) { step / 2.0 } else { 0.0 };
            Ok::<f64, Error>(self.needed(&[corner, centre])? + half)
        };
        let (x, y) = (at("XLLCORNER", "XLLCENTER", dx)?, at("YLLCORNER", "YLLCENTER", dy)?);
        let origin = [x, y + (rows - 1) as f64 * dy];
        let affine = Affine { origin, col_step: [dx, 0.0], row_step: [0.0, -dy] };
        if !(sidecar::usable(&affine) && dx > 0.0 && dy > 0.0) {
            let reason = format!("cells of {dx} x {dy} from ({x}, {y}) make no grid");
            return Err(Error::corrupt(self.file, "header", reason));
        }
        Ok(affine)
    }
}

/// What one pass through the heights finds.
struct Scan {
    rows_at: Vec<u64>,
    decimal: Decimal,
    all_int32: bool,
    all_float32: bool,
    /// Numbers that are void if the header does not say what is.
    unsaid_voids: u64,
}

impl Scan {
    fn of(
        input: &Arc<Input>,
        (at, line): (u64, u64),
        [cols, rows]: [u64; 2],
        decimal: Decimal,
    ) -> Result<Scan> {
        let mut scan =
            Scan { rows_at: Vec::new(), decimal, all_int32: true, all_float32: true, unsaid_voids: 0 };
        let mut words = Words::new(input.reader(at), at);
        let bad =
            |line: u64, reason: String| Err(Error::corrupt(&input.file, format!("line {line}"), reason));
        let mut count = 0u64;
        // Lines that hold numbers; words of the one that is being read; the first that is not one row.
        let (mut lines, mut in_line, mut here, mut uneven) = (0u64, 0u64, line, None);
        let mut close = |lines: u64, in_line: u64, here: u64| {
            if lines > 0 && in_line != cols && uneven.is_none() {
                uneven = Some((here, in_line));
            }
            uneven
        };
        while let Some(word) = words.next().map_err(|e| Error::io(&input.file, e))? {
            let line_now = line - 1 + word.line;
            if word.opens_line {
                close(lines, in_line, here);
                (lines, in_line, here) = (lines + 1, 0, line_now);
            }
            if count == cols * rows {
                return bad(line_now, format!("more than {cols} x {rows} values"));
            }
            if count.is_multiple_of(cols) {
                scan.rows_at.push(word.at);
            }
            if let Err(reason) = scan.take(word) {
                return bad(line_now, reason);
            }
            (count, in_line) = (count + 1, in_line + 1);
        }
        let uneven = close(lines, in_line, here);
        if count < cols * rows {
            let short = uneven.filter(|u| u.1 < cols && lines <= rows);
            let first =
                short.map_or(String::new(), |(at, n)| format!("; line {at} is the first with less ({n})"));
            return bad(here, format!("the values end there: {count} of {cols} x {rows}{first}"));
        }
        // As many lines as rows: then a line is a row, and a value too few here is one too many there.
        if let (Some((at, n)), true) = (uneven, lines == rows) {
            return bad(at, format!("{n} values, but a row has {cols}"));
        }
        Ok(scan)
    }

    fn take(&mut self, word: Word) -> std::result::Result<(), String> {
        let before = self.decimal;
        let Some(v) = self.decimal.number(word.bytes) else {
            let shown = word.shown();
            return Err(match before {
                Decimal::Comma if shown.contains('.') => {
                    format!("'{shown}' has a decimal point, numbers before it have commas")
                }
                Decimal::Point if shown.contains(',') => {
                    format!("'{shown}' has a comma, numbers before it have decimal points")
                }
                _ => format!("'{shown}' is not a number"),
            });
        };
        self.all_int32 &= v.fract() == 0.0 && v >= f64::from(i32::MIN) && v <= f64::from(i32::MAX);
        self.all_float32 &= v.is_nan() || f64::from(v as f32) == v;
        self.unsaid_voids += u64::from(v == NODATA_UNSAID);
        Ok(())
    }

    fn sample_type(&self) -> SampleType {
        match (self.all_int32, self.all_float32) {
            (true, _) => SampleType::I32,
            (false, true) => SampleType::F32,
            (false, false) => SampleType::F64,
        }
    }
}
