//! The fields of a file's head: bytes, numbers of seven bits a byte, reals, texts.

use crate::{Error, Result};

/// Longest head of a file.
pub const HEADER_BYTES_MAX: usize = 16 << 10;

/// Appends fields.
pub(crate) struct Writer(pub Vec<u8>);

/// Bytes before the fields: magic, version, length.
pub(crate) const FIXED: usize = 11;

impl Writer {
    /// A head with its magic and version; its length comes last.
    pub fn new(magic: &[u8; 8], version: u8) -> Writer {
        let mut bytes = magic.to_vec();
        bytes.extend_from_slice(&[version, 0, 0]);
        Writer(bytes)
    }
    /// The bytes of the head, with its length and its CRC-32C.
    pub fn sealed(mut self) -> Vec<u8> {
        let len = (self.0.len() + 4) as u16;
        self.0[9..FIXED].copy_from_slice(&len.to_le_bytes());
        let crc = crc32c::crc32c(&self.0);
        self.0.extend_from_slice(&crc.to_le_bytes());
        self.0
    }
    pub fn varint(&mut self, mut v: u64) {
        while v >= 128 {
            self.0.push(v as u8 | 128);
            v >>= 7;
        }
        self.0.push(v as u8);
    }
    pub fn real(&mut self, v: f64) {
        self.0.extend_from_slice(&v.to_le_bytes());
    }
    pub fn text(&mut self, t: &str) {
        self.varint(t.len() as u64);
        self.0.extend_from_slice(t.as_bytes());
    }
}

/// The bytes of a head up to its checksum, which holds, and the head's length. `format`: what a file with this magic is called.
pub(crate) fn opened<'a>(
    bytes: &'a [u8],
    magic: &[u8; 8],
    version: u8,
    format: &str,
) -> Result<(&'a [u8], usize)> {
    let seen = bytes.len().min(magic.len());
    if bytes[..seen] != magic[..seen] {
        return Err(Error::damaged("head", format!("this is no {format} file: its first bytes are others")));
    }
    if bytes.len() < FIXED {
        return Err(Error::Short { what: "head", needs: FIXED as u64, has: bytes.len() as u64 });
    }
    if bytes[8] != version {
        return Err(Error::damaged(
            "head",
            format!(
                "version {} of {format}, this program reads version {version}; take a newer program",
                bytes[8]
            ),
        ));
    }
    let len = usize::from(u16::from_le_bytes([bytes[9], bytes[10]]));
    if !(16..=HEADER_BYTES_MAX).contains(&len) {
        return Err(Error::damaged(
            "head",
            format!("a head of {len} bytes, 16 to {HEADER_BYTES_MAX} are allowed"),
        ));
    }
    let Some(head) = bytes.get(..len) else {
        return Err(Error::Short { what: "head", needs: len as u64, has: bytes.len() as u64 });
    };
    let (fields, crc) = head.split_at(len - 4);
    let stored = u32::from_le_bytes([crc[0], crc[1], crc[2], crc[3]]);
    let found = crc32c::crc32c(fields);
    if stored != found {
        return Err(Error::damaged(
            "head",
            format!("its checksum is {found:08x}, {stored:08x} was stored; fetch the file again"),
        ));
    }
    Ok((fields, len))
}

/// Takes fields off.
pub(crate) struct Reader<'a> {
    pub bytes: &'a [u8],
    pub at: usize,
}

impl Reader<'_> {
    pub fn byte(&mut self) -> Result<u8> {
        let b = self.bytes.get(self.at).copied();
        self.at += 1;
        b.ok_or_else(|| Error::damaged("head", "its fields are longer than it says; fetch the file again"))
    }
    pub fn varint(&mut self) -> Result<u64> {
        let mut v = 0;
        for k in 0..10 {
            let b = self.byte()?;
            v |= u64::from(b & 127).checked_shl(7 * k).unwrap_or(0);
            if b < 128 {
                return Ok(v);
            }
        }
        Err(Error::damaged("head", "a number of more than ten bytes"))
    }
    pub fn real(&mut self) -> Result<f64> {
        let mut eight = [0; 8];
        for b in &mut eight {
            *b = self.byte()?;
        }
        Ok(f64::from_le_bytes(eight))
    }
    pub fn text(&mut self) -> Result<String> {
        let n = self.varint()?;
        if n > HEADER_BYTES_MAX as u64 {
            return Err(Error::damaged(
                "head",
                format!("a text of {n} bytes, {HEADER_BYTES_MAX} are allowed"),
            ));
        }
        let bytes = (0..n).map(|_| self.byte()).collect::<Result<Vec<u8>>>()?;
        String::from_utf8(bytes).map_err(|_| Error::damaged("head", "a text that is not UTF-8"))
    }
}
