//! Numbers of a text that stand in columns of fixed width, with or without blanks between them.

use std::io::{self, ErrorKind, Read};

/// Characters of a real number (Fortran's D24.15).
const REAL_CHARS: usize = 24;
const BUFFER_BYTES: usize = 64 << 10;

/// Reads integers and reals in order, a buffer at a time.
pub struct Fields<R> {
    reader: R,
    buffer: Vec<u8>,
    next: usize,
    filled: usize,
    base: u64,
}

impl<R: Read> Fields<R> {
    /// Begins at byte `at` of the text, where `reader` stands.
    pub fn new(reader: R, at: u64) -> Fields<R> {
        Fields { reader, buffer: vec![0; BUFFER_BYTES], next: 0, filled: 0, base: at }
    }

    /// Byte that comes next.
    pub fn at(&self) -> u64 {
        self.base + self.next as u64
    }

    fn peek(&mut self) -> io::Result<Option<u8>> {
        if self.next == self.filled {
            self.base += self.filled as u64;
            (self.next, self.filled) = (0, 0);
            self.filled = loop {
                match self.reader.read(&mut self.buffer) {
                    Err(e) if e.kind() == ErrorKind::Interrupted => {}
                    other => break other?,
                }
            };
        }
        Ok(self.buffer[..self.filled].get(self.next).copied())
    }

    /// The next integer; None if something else or nothing comes. It ends before the first byte that is no digit,
    /// since -32767 fills its column and touches its neighbour. Blanks and line ends before it are skipped.
    pub fn integer(&mut self) -> io::Result<Option<i32>> {
        while self.peek()?.is_some_and(|b| b.is_ascii_whitespace() || b == 0) {
            self.next += 1;
        }
        let negative = self.peek()? == Some(b'-');
        if negative || self.peek()? == Some(b'+') {
            self.next += 1;
        }
        let mut value = None;
        while let Some(b) = self.peek()?.filter(u8::is_ascii_digit) {
            let digit = i32::from(b - b'0');
            let Some(longer) = value.unwrap_or(0i32).checked_mul(10).and_then(|v| v.checked_add(digit))
            else {
                return Ok(None);
            };
            value = Some(longer);
            self.next += 1;
        }
        Ok(value.map(|v| if negative { -v } else { v }))
    }

    /// The real number in the next 24 characters; None if they are none.
    pub fn real(&mut self) -> io::Result<Option<f64>> {
        let mut text = [0; REAL_CHARS];
        for b in &mut text {
            let Some(found) = self.peek()? else { return Ok(None) };
            *b = found;
            self.next += 1;
        }
        Ok(real(&text))
    }
}

/// A real number as Fortran writes it (exponent `D` or `E`), blanks around it.
pub fn real(text: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(text).ok()?.trim_matches([' ', '\0']);
    text.replace(['D', 'd'], "E").parse().ok().filter(|v: &f64| v.is_finite())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn integers_may_touch_and_reals_fill_their_columns() {
        let text = b"  2869-32767-32767  4164\n   0.557945011821133D+06 0.100000D+01           x";
        let mut f = Fields::new(&text[..], 10);
        let four: Vec<_> = (0..4).map(|_| f.integer().unwrap()).collect();
        assert_eq!(four, [Some(2869), Some(-32767), Some(-32767), Some(4164)]);
        assert_eq!(f.at(), 34);
        assert_eq!(f.real().unwrap(), None);
        let mut f = Fields::new(&text[25..], 0);
        assert_eq!(f.real().unwrap(), Some(557945.011821133));
        assert_eq!(f.real().unwrap(), Some(1.0));
        assert_eq!(f.integer().unwrap(), None);
        assert_eq!(Fields::new(&b"99999999999"[..], 0).integer().unwrap(), None);
        assert_eq!(real(b" -0.5D+02 "), Some(-50.0));
        assert_eq!((real(b""), real(b"1E999"), real(b"NaN")), (None, None, None));
    }
}
