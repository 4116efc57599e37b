//! The body of a file in blocks, each with its checksum.

/// Bytes of the body between two checksums.
pub const BLOCK: usize = 16 << 10;

/// The byte of the file at which a byte of the body lies, behind a head of `head` bytes.
pub(crate) fn file_position(head: usize, at: usize) -> u64 {
    (head + at + 4 * at.div_ceil(BLOCK)) as u64
}

/// The body with a CRC-32C after each [`BLOCK`] bytes, and after the last.
pub(crate) fn blocks(body: &[u8]) -> Vec<u8> {
    let mut out = Vec::with_capacity(body.len() + 4 * body.len().div_ceil(BLOCK));
    for block in body.chunks(BLOCK) {
        out.extend_from_slice(block);
        out.extend_from_slice(&crc32c::crc32c(block).to_le_bytes());
    }
    out
}

/// What can be read of a body.
pub(crate) struct Body {
    pub bytes: Vec<u8>,
    /// Nothing is missing behind the bytes.
    pub whole: bool,
    /// A block with a wrong checksum, by the place of its first byte in the body: it and all behind it are left out.
    pub damaged: Option<u64>,
}

/// The body of a file of which `bytes` follow the head. The bytes of a last block that is cut are taken as they are.
pub(crate) fn unblocked(bytes: &[u8], body: u64) -> Body {
    let mut out = Body { bytes: Vec::new(), whole: true, damaged: None };
    let mut left = body;
    let mut at = 0;
    while left > 0 {
        let n = left.min(BLOCK as u64) as usize;
        let rest = &bytes[at.min(bytes.len())..];
        if let Some(four) = rest.get(n..n + 4) {
            let stored = u32::from_le_bytes([four[0], four[1], four[2], four[3]]);
            if crc32c::crc32c(&rest[..n]) != stored {
                out.damaged = Some(body - left);
                out.whole = false;
                break;
            }
            out.bytes.extend_from_slice(&rest[..n]);
        } else {
            out.bytes.extend_from_slice(&rest[..n.min(rest.len())]);
            out.whole = false;
            break;
        }
        at += n + 4;
        left -= n as u64;
    }
    out
}
