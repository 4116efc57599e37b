//! The words of a text of numbers, one after the other, and what they mean.

use std::io::{self, Read};

/// Longer words are no numbers.
const WORD_BYTES_MAX: usize = 64;
const BUFFER_BYTES: usize = 64 << 10;

/// A word: what stands between blanks.
#[derive(Clone, Copy)]
pub struct Word<'a> {
    /// Its bytes; cut after [`WORD_BYTES_MAX`].
    pub bytes: &'a [u8],
    /// Byte of the text where it begins.
    pub at: u64,
    /// Line where it stands, from 1.
    pub line: u64,
    /// Whether it is the first of its line.
    pub opens_line: bool,
}

impl Word<'_> {
    /// For messages.
    pub fn shown(&self) -> String {
        let text: String = String::from_utf8_lossy(self.bytes).chars().filter(|c| !c.is_control()).collect();
        if self.bytes.len() < WORD_BYTES_MAX { text } else { format!("{text}...") }
    }
}

/// Reads words in order, a buffer at a time.
pub struct Words<R> {
    reader: R,
    buffer: Vec<u8>,
    next: usize,
    filled: usize,
    /// Byte of the text where the buffer begins.
    base: u64,
    line: u64,
    opens_line: bool,
    word: [u8; WORD_BYTES_MAX],
}

impl<R: Read> Words<R> {
    /// Begins at byte `at` of the text, where `reader` stands.
    pub fn new(reader: R, at: u64) -> Words<R> {
        Words {
            reader,
            buffer: vec![0; BUFFER_BYTES],
            next: 0,
            filled: 0,
            base: at,
            line: 1,
            opens_line: true,
            word: [0; WORD_BYTES_MAX],
        }
    }

    fn peek(&mut self) -> io::Result<Option<u8>> {
        if self.next == self.filled {
            self.base += self.filled as u64;
            (self.next, self.filled) = (0, 0);
            self.filled = loop {
                match self.reader.read(&mut self.buffer) {
                    Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                    other => break other?,
                }
            };
        }
        Ok(self.buffer[..self.filled].get(self.next).copied())
    }

    /// The next word; None at the end.
    pub fn next(&mut self) -> io::Result<Option<Word<'_>>> {
        loop {
            match self.peek()? {
                None => return Ok(None),
                Some(b'\n') => (self.line, self.opens_line) = (self.line + 1, true),
                Some(b) if is_blank(b) => {}
                Some(_) => break,
            }
            self.next += 1;
        }
        let (at, line, opens_line) = (self.base + self.next as u64, self.line, self.opens_line);
        self.opens_line = false;
        let mut n = 0;
        while let Some(b) = self.peek()?.filter(|b| !is_blank(*b)) {
            if n < WORD_BYTES_MAX {
                self.word[n] = b;
                n += 1;
            }
            self.next += 1;
        }
        Ok(Some(Word { bytes: &self.word[..n], at, line, opens_line }))
    }
}

/// Blanks, line ends, and the control-Z that old programs end a text with.
fn is_blank(b: u8) -> bool {
    matches!(b, b' ' | b'\t' | b'\r' | b'\n' | 0x0b | 0x0c | 0x1a)
}

/// How a text writes fractions; one way only.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Decimal {
    /// No fraction was seen yet.
    #[default]
    Unknown,
    Point,
    Comma,
}

impl Decimal {
    /// The number that a word is; None if it is none, or mixes points and commas with the words before.
    ///
    /// `nan`, and what older Windows programs print for it, is a number here; so is a written infinity. A finite
    /// number beyond f64 is none.
    pub fn number(&mut self, word: &[u8]) -> Option<f64> {
        let (digits, negative) = match word {
            [b'-', rest @ ..] => (rest, true),
            [b'+', rest @ ..] => (rest, false),
            _ => (word, false),
        };
        if (1..=9).contains(&digits.len()) && digits.iter().all(u8::is_ascii_digit) {
            let whole = digits.iter().fold(0u32, |n, d| n * 10 + u32::from(d - b'0'));
            return Some(if negative { -f64::from(whole) } else { f64::from(whole) });
        }
        let text = std::str::from_utf8(word).ok()?;
        if text.len() >= WORD_BYTES_MAX {
            return None;
        }
        let letters = std::str::from_utf8(digits).ok()?.to_ascii_lowercase();
        if letters.starts_with("nan") || letters.starts_with("1.#qnan") || letters.starts_with("1.#ind") {
            return Some(f64::NAN);
        }
        let found = match (text.contains('.'), text.contains(',')) {
            (true, true) => return None,
            (true, false) => Decimal::Point,
            (false, true) => Decimal::Comma,
            (false, false) => *self,
        };
        if *self != Decimal::Unknown && found != *self {
            return None;
        }
        *self = found;
        let value: f64 = match found {
            // A second comma stays and is no part of a number.
            Decimal::Comma => text.replacen(',', ".", 1).parse().ok()?,
            _ => text.parse().ok()?,
        };
        (value.is_finite() || letters.starts_with("inf")).then_some(value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_know_their_place_across_buffers() {
        let long = format!("\n{}\r\n12 -7\x1a", " ".repeat(BUFFER_BYTES - 2));
        let mut words = Words::new(long.as_bytes(), 100);
        let w = words.next().unwrap().unwrap();
        assert_eq!((w.bytes, w.line, w.opens_line), (&b"12"[..], 3, true));
        assert_eq!(w.at, 100 + BUFFER_BYTES as u64 + 1);
        let w = words.next().unwrap().unwrap();
        assert_eq!((w.bytes, w.line, w.opens_line), (&b"-7"[..], 3, false));
        assert!(words.next().unwrap().is_none());
    }

    #[test]
    fn numbers_of_all_kinds() {
        let number = |w: &str| Decimal::default().number(w.as_bytes());
        for (word, value) in [
            ("7", 7.0),
            ("-0032768", -32768.0),
            ("+5", 5.0),
            ("9.", 9.0),
            (".5", 0.5),
            ("-9.999e3", -9999.0),
            ("1,25", 1.25),
            ("1234567890123", 1234567890123.0),
            ("-3.4028235e+38", -3.4028235e38),
        ] {
            assert_eq!(number(word), Some(value), "{word}");
        }
        for word in ["nan", "-NaN", "1.#QNAN", "-1.#IND"] {
            assert!(number(word).unwrap().is_nan(), "{word}");
        }
        for word in ["x1119", "", "-", "1,119,000", "1.119,5", "1e999", "12m", "--5", "1_000", "\u{ff11}"] {
            assert_eq!(number(word), None, "{word}");
        }
        let long = "1".repeat(100);
        assert_eq!(number(&long[..64]), None);
    }

    #[test]
    fn points_and_commas_do_not_mix() {
        let mut d = Decimal::default();
        assert_eq!(d.number(b"12"), Some(12.0));
        assert_eq!(d.number(b"1,5"), Some(1.5));
        assert_eq!(d.number(b"1e3"), Some(1000.0));
        assert_eq!((d.number(b"1.5"), d), (None, Decimal::Comma));
    }
}
