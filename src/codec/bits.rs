//! Streams of bits, the highest bit of a byte first.

use crate::base::{Error, Result};

/// What is unpacked, for errors.
const WHERE: &str = "packed bytes";

/// Appends bits to a byte vector.
#[derive(Default)]
pub struct BitWriter {
    bytes: Vec<u8>,
    held: u64,
    count: u32,
}

impl BitWriter {
    /// After bytes that are complete.
    pub fn after(bytes: Vec<u8>) -> BitWriter {
        BitWriter { bytes, held: 0, count: 0 }
    }

    /// The lowest `n <= 56` bits of a number.
    pub fn put(&mut self, v: u64, n: u32) {
        debug_assert!(n <= 56);
        self.held = self.held << n | v & ((1 << n) - 1);
        self.count += n;
        while self.count >= 8 {
            self.count -= 8;
            self.bytes.push((self.held >> self.count) as u8);
        }
        self.held &= (1 << self.count) - 1;
    }

    /// `n <= 55` ones, and a zero.
    pub fn put_ones(&mut self, n: u32) {
        self.put(((1 << n) - 1) << 1, n + 1);
    }

    /// Elias gamma: as many zeros as `v >= 1` has bits after its first, then `v`.
    pub fn put_gamma(&mut self, v: u32) {
        let n = 31 - v.leading_zeros();
        self.put(0, n);
        self.put(u64::from(v), n + 1);
    }

    /// All bytes; the last one is filled with zeros.
    pub fn end(mut self) -> Vec<u8> {
        if self.count > 0 {
            self.put(0, 8 - self.count);
        }
        self.bytes
    }
}

/// Reads bits from a byte slice.
pub struct BitReader<'a> {
    data: &'a [u8],
    at: usize,
}

impl<'a> BitReader<'a> {
    pub fn new(data: &'a [u8]) -> BitReader<'a> {
        BitReader { data, at: 0 }
    }

    fn short(&self) -> Error {
        Error::corrupt(WHERE, format!("bit {}", self.at), format!("they end after {} bytes", self.data.len()))
    }

    fn bit(&mut self) -> Result<u64> {
        let byte = *self.data.get(self.at / 8).ok_or_else(|| self.short())?;
        let bit = byte >> (7 - self.at % 8) & 1;
        self.at += 1;
        Ok(u64::from(bit))
    }

    /// A number of `n <= 56` bits.
    pub fn take(&mut self, n: u32) -> Result<u64> {
        let (mut v, mut left) = (0, n as usize);
        while left > 0 {
            let byte = u64::from(*self.data.get(self.at / 8).ok_or_else(|| self.short())?);
            let have = 8 - self.at % 8;
            let now = have.min(left);
            v = v << now | (byte >> (have - now) & ((1 << now) - 1));
            self.at += now;
            left -= now;
        }
        Ok(v)
    }

    /// How many ones come before the next zero, at most `most`: after so many no zero is read.
    pub fn take_ones(&mut self, most: u32) -> Result<u32> {
        let mut n = 0;
        while n < most && self.bit()? == 1 {
            n += 1;
        }
        Ok(n)
    }

    /// Elias gamma, of at most 16 bits after the first.
    pub fn take_gamma(&mut self) -> Result<u32> {
        let mut n = 0;
        while self.bit()? == 0 {
            n += 1;
            if n > 16 {
                return Err(Error::corrupt(WHERE, format!("bit {}", self.at), "a count above 131071"));
            }
        }
        Ok(1 << n | self.take(n)? as u32)
    }

    /// Fails unless less than a byte is left, all zeros.
    pub fn end(mut self) -> Result<()> {
        let left = self.data.len() * 8 - self.at;
        if left >= 8 || self.take(left as u32)? != 0 {
            return Err(Error::corrupt(WHERE, format!("bit {}", self.at), format!("{left} bits left over")));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_put_is_taken() {
        let mut w = BitWriter::after(Vec::new());
        w.put(5, 3);
        w.put_ones(9);
        w.put_gamma(1);
        w.put_gamma(1089);
        w.put(0x00ab_cdef_0123_4567, 56);
        w.put_ones(0);
        let bytes = w.end();
        let mut r = BitReader::new(&bytes);
        assert_eq!(r.take(3).unwrap(), 5);
        assert_eq!(r.take_ones(24).unwrap(), 9);
        assert_eq!(r.take_gamma().unwrap(), 1);
        assert_eq!(r.take_gamma().unwrap(), 1089);
        assert_eq!(r.take(56).unwrap(), 0x00ab_cdef_0123_4567);
        assert_eq!(r.take_ones(24).unwrap(), 0);
        r.end().unwrap();
        assert!(BitReader::new(&bytes[..3]).take(56).is_err());
        assert!(BitReader::new(&[0; 4]).take_gamma().is_err());
        assert!(BitReader::new(&[0, 0]).end().is_err() && BitReader::new(&[]).end().is_ok());
    }
}
