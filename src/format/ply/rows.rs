//! The rows after the header, number by number.

use super::header::{Element, Encoding, Kind, Lines, Property};
use crate::base::{Error, Result};

/// Reads numbers in order, and knows where they stand.
pub struct Rows<'a> {
    file: &'a str,
    encoding: Encoding,
    lines: Lines<'a>,
    /// Of a text: what is left of the row.
    line: &'a [u8],
    element: String,
    row: u64,
}

impl<'a> Rows<'a> {
    pub fn new(file: &'a str, bytes: &'a [u8], encoding: Encoding) -> Rows<'a> {
        let lines = Lines { bytes, at: 0 };
        Rows { file, encoding, lines, line: &[], element: String::new(), row: 0 }
    }

    /// Goes on to the rows of an element, if so many can be there.
    pub fn enter(&mut self, element: &Element) -> Result<()> {
        (self.element, self.row) = (element.name.clone(), 0);
        let left = (self.lines.bytes.len() - self.lines.at) as u64;
        // A row of a text is a digit and the end of its line, at least.
        let least = match self.encoding {
            Encoding::Text => element.count.saturating_mul(2).saturating_sub(1),
            _ => element.count.saturating_mul(element.least_bytes()),
        };
        if element.properties.is_empty() && element.count > 0 {
            return Err(self.bad("its rows have no properties"));
        }
        if least > left {
            let reason = format!("{} rows need {least} bytes, {left} are left", element.count);
            return Err(Error::corrupt(self.file, format!("element {}", element.name), reason));
        }
        Ok(())
    }

    /// Begins a row.
    pub fn begin(&mut self) -> Result<()> {
        self.row += 1;
        if self.encoding == Encoding::Text {
            // Empty lines are no rows.
            let full = |line: &&[u8]| !line.trim_ascii().is_empty();
            self.line = self.lines.find(full).ok_or_else(|| self.bad("the file ends before it"))?;
        }
        Ok(())
    }

    /// Ends a row.
    pub fn end(&self) -> Result<()> {
        let left = self.line.trim_ascii();
        if left.is_empty() {
            return Ok(());
        }
        Err(self.bad(format!("'{}' is left over; the header names fewer numbers", word_of(left))))
    }

    /// The next number.
    pub fn number(&mut self, kind: Kind) -> Result<f64> {
        if self.encoding != Encoding::Text {
            return self.binary(kind);
        }
        let rest = self.line.trim_ascii_start();
        let length = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let (word, rest) = rest.split_at(length);
        if word.is_empty() {
            return Err(self.bad("the row ends too soon; the header names more numbers"));
        }
        self.line = rest;
        let number = std::str::from_utf8(word).ok().and_then(|w| w.parse().ok());
        number.ok_or_else(|| self.bad(format!("'{}' is no number", word_of(word))))
    }

    fn binary(&mut self, kind: Kind) -> Result<f64> {
        let (mut bytes, n) = ([0u8; 8], kind.bytes());
        let Some(found) = self.lines.bytes.get(self.lines.at..self.lines.at + n) else {
            return Err(self.bad("the file ends within it"));
        };
        self.lines.at += n;
        bytes[..n].copy_from_slice(found);
        if self.encoding == Encoding::BigEndian {
            bytes[..n].reverse();
        }
        let [a, b, c, d, ..] = bytes;
        Ok(match kind {
            Kind::I8 => f64::from(a as i8),
            Kind::U8 => f64::from(a),
            Kind::I16 => f64::from(i16::from_le_bytes([a, b])),
            Kind::U16 => f64::from(u16::from_le_bytes([a, b])),
            Kind::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Kind::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Kind::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Kind::F64 => f64::from_le_bytes(bytes),
        })
    }

    /// How many numbers the list that follows has.
    pub fn length(&mut self, property: &Property) -> Result<u64> {
        let length = self.number(property.count.unwrap_or(Kind::U8))?;
        if !(length >= 0.0 && length <= f64::from(u32::MAX) && length.fract() == 0.0) {
            return Err(self.bad(format!("list {} has length {length}", property.name)));
        }
        Ok(length as u64)
    }

    /// Passes over a property.
    pub fn skip(&mut self, property: &Property) -> Result<()> {
        let count = if property.count.is_some() { self.length(property)? } else { 1 };
        if self.encoding == Encoding::Text {
            return (0..count).try_for_each(|_| self.number(property.kind).map(drop));
        }
        let end = self.lines.at as u64 + count * property.kind.bytes() as u64;
        if end > self.lines.bytes.len() as u64 {
            return Err(self.bad(format!("the file ends within {}", property.name)));
        }
        self.lines.at = end as usize;
        Ok(())
    }

    /// Passes over all rows of an element.
    pub fn pass_over(&mut self, element: &Element) -> Result<()> {
        for _ in 0..element.count {
            self.begin()?;
            element.properties.iter().try_for_each(|p| self.skip(p))?;
            self.end()?;
        }
        Ok(())
    }

    /// The row is not as it should be.
    pub fn bad(&self, reason: impl ToString) -> Error {
        let place = match self.row {
            0 => format!("element {}", self.element),
            row => format!("element {}, row {row}", self.element),
        };
        Error::corrupt(self.file, place, reason)
    }
}

/// The first word of what is left, as far as a user wants to see it.
fn word_of(bytes: &[u8]) -> String {
    let word = bytes.split(u8::is_ascii_whitespace).next().unwrap_or(bytes);
    String::from_utf8_lossy(&word[..word.len().min(40)]).into_owned()
}
