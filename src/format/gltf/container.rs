//! The container: header, JSON chunk, binary chunk (glTF 2.0, section 4).

use std::io::Write;

use serde_json::Value;

use crate::base::{Error, Result};

const MAGIC: u32 = 0x4654_6c67; // "glTF"
const CONTAINER_VERSION: u32 = 2;
const CHUNK_JSON: u32 = 0x4e4f_534a; // "JSON"
const CHUNK_BIN: u32 = 0x004e_4942; // "BIN\0"
const HEADER_BYTES: u64 = 12;
const CHUNK_HEADER_BYTES: u64 = 8;

const SINK_BYTES: usize = 1 << 16;

/// Writes a GLB: header and JSON first, then the bytes of the binary chunk, many small writes gathered.
pub(super) struct Sink<'a> {
    out: &'a mut dyn Write,
    buffer: Vec<u8>,
}

impl<'a> Sink<'a> {
    /// Writes the header, the JSON and, if there are any, the header of the binary chunk.
    pub fn begin(out: &'a mut dyn Write, document: &Value, bin_bytes: u64) -> Result<Sink<'a>> {
        let mut document = document.to_string().into_bytes();
        document.resize(document.len().next_multiple_of(4), b' ');
        let mut total = HEADER_BYTES + CHUNK_HEADER_BYTES + document.len() as u64;
        if bin_bytes > 0 {
            total += CHUNK_HEADER_BYTES + bin_bytes;
        }
        if total > u64::from(u32::MAX) {
            return Err(Error::limit("bytes of a GLB file", u64::from(u32::MAX), total));
        }
        let mut sink = Sink { out, buffer: Vec::with_capacity(SINK_BYTES + 64) };
        sink.u32s(&[MAGIC, CONTAINER_VERSION, total as u32, document.len() as u32, CHUNK_JSON])?;
        sink.bytes(&document)?;
        if bin_bytes > 0 {
            sink.u32s(&[bin_bytes as u32, CHUNK_BIN])?;
        }
        Ok(sink)
    }
    pub fn bytes(&mut self, bytes: &[u8]) -> Result<()> {
        self.buffer.extend_from_slice(bytes);
        if self.buffer.len() >= SINK_BYTES { self.drain() } else { Ok(()) }
    }
    pub fn u32s(&mut self, values: &[u32]) -> Result<()> {
        values.iter().try_for_each(|v| self.bytes(&v.to_le_bytes()))
    }
    pub fn floats(&mut self, values: [f32; 3]) -> Result<()> {
        values.iter().try_for_each(|v| self.bytes(&v.to_le_bytes()))
    }
    fn drain(&mut self) -> Result<()> {
        self.out.write_all(&self.buffer).map_err(|e| Error::io("GLB", e))?;
        self.buffer.clear();
        Ok(())
    }
    pub fn flush(&mut self) -> Result<()> {
        self.drain()?;
        self.out.flush().map_err(|e| Error::io("GLB", e))
    }
}
