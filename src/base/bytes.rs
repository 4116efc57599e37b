//! Little-endian fields. Readers never panic: a short buffer is an error that names its place.

use super::{Error, Result};

/// Reads fields one after another from a byte slice.
pub struct Reader<'a> {
    data: &'a [u8],
    at: usize,
    /// What is being read, for errors.
    what: &'a str,
    file: &'a str,
}

macro_rules! read_int {
    ($name:ident, $t:ty) => {
        pub fn $name(&mut self) -> Result<$t> {
            const N: usize = std::mem::size_of::<$t>();
            let b = self.take(N)?;
            Ok(<$t>::from_le_bytes(b.try_into().expect("take returned N bytes")))
        }
    };
}

impl<'a> Reader<'a> {
    pub fn new(data: &'a [u8], file: &'a str, what: &'a str) -> Self {
        Reader { data, at: 0, what, file }
    }
    pub fn take(&mut self, n: usize) -> Result<&'a [u8]> {
        if n > self.data.len() - self.at {
            return Err(Error::corrupt(
                self.file,
                self.what,
                format!("{} bytes wanted at byte {}, {} left", n, self.at, self.data.len() - self.at),
            ));
        }
        let s = &self.data[self.at..self.at + n];
        self.at += n;
        Ok(s)
    }
    read_int!(u8, u8);
    read_int!(u16, u16);
    read_int!(u32, u32);
    read_int!(u64, u64);
    read_int!(i32, i32);
    read_int!(i64, i64);
    read_int!(f32, f32);
    read_int!(f64, f64);
    /// What is left, without taking it.
    pub fn rest(&self) -> &'a [u8] {
        &self.data[self.at..]
    }
    pub fn remaining(&self) -> usize {
        self.data.len() - self.at
    }
    /// A UTF-8 text with a `u32` length before it.
    pub fn text(&mut self) -> Result<String> {
        let n = self.u32()? as usize;
        if n > super::limits::TEXT_BYTES_MAX {
            return Err(self.bad(format!("text of {n} bytes")));
        }
        String::from_utf8(self.take(n)?.to_vec()).map_err(|_| self.bad("text is not UTF-8"))
    }
    /// Fails if bytes are left over.
    pub fn end(&self) -> Result<()> {
        if self.remaining() != 0 {
            return Err(self.bad(format!("{} bytes left over", self.remaining())));
        }
        Ok(())
    }
    pub fn bad(&self, reason: impl ToString) -> Error {
        Error::corrupt(self.file, self.what, reason)
    }
}

/// Appends fields to a byte vector.
pub trait Put {
    fn put(&mut self, bytes: &[u8]);
    fn put_u8(&mut self, v: u8) {
        self.put(&[v]);
    }
    fn put_u16(&mut self, v: u16) {
        self.put(&v.to_le_bytes());
    }
    fn put_u32(&mut self, v: u32) {
        self.put(&v.to_le_bytes());
    }
    fn put_u64(&mut self, v: u64) {
        self.put(&v.to_le_bytes());
    }
    fn put_i32(&mut self, v: i32) {
        self.put(&v.to_le_bytes());
    }
    fn put_i64(&mut self, v: i64) {
        self.put(&v.to_le_bytes());
    }
    fn put_f32(&mut self, v: f32) {
        self.put(&v.to_le_bytes());
    }
    fn put_f64(&mut self, v: f64) {
        self.put(&v.to_le_bytes());
    }
    fn put_text(&mut self, v: &str) {
        self.put_u32(v.len() as u32);
        self.put(v.as_bytes());
    }
}

impl Put for Vec<u8> {
    fn put(&mut self, bytes: &[u8]) {
        self.extend_from_slice(bytes);
    }
}

impl Put for blake3::Hasher {
    fn put(&mut self, bytes: &[u8]) {
        self.update(bytes);
    }
}
