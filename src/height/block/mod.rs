//! Blocks of samples: 112 x 112 vertices of one level of a survey, compressed without loss.
//!
//! Block (bi, bj) of a level holds vertices `[112 bi, 112 bi + 112)` in each axis (indices of that level), clipped
//! to what exists. Samples keep their own type, bit for bit. Bytes are drawn in `docs/format.md`: differences to what
//! the neighbours suggest ([`lorenzo`]) in byte planes, each packed by itself ([`plane`]), most of them in a prefix
//! code that is read many bytes at a time ([`huffman`]).

mod heights;
mod huffman;
mod lorenzo;
mod plane;

pub use heights::Heights;

use super::source::SampleType;
use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result};
use std::cell::RefCell;

/// Vertices across a block: four level-0 kernels.
pub const BLOCK: i64 = 112;
const N: usize = BLOCK as usize;
/// As [`encode`] writes. Blocks of [`FIRST_CODEC`] are read.
const CODEC: u8 = 2;
/// The body is one frame of zstd.
const FIRST_CODEC: u8 = 1;
const HAS_VOIDS: u8 = 1;
const HAS_FILLS: u8 = 2;

/// A rectangle of samples inside one block.
#[derive(Clone, Debug, PartialEq)]
pub struct RawBlock {
    /// First vertex held, relative to the block's corner, and extent.
    pub col: usize,
    pub row: usize,
    pub cols: usize,
    pub rows: usize,
    pub sample_type: SampleType,
    /// Row-major little-endian samples.
    pub samples: Vec<u8>,
    /// One byte a vertex, 0 = void; `None` = all valid.
    pub valid: Option<Vec<u8>>,
    /// Heights that stand in for voids (levels above 0), one a void, row-major; empty at level 0.
    pub fills: Vec<f32>,
}

impl RawBlock {
    pub fn valid_count(&self) -> u32 {
        match &self.valid {
            None => (self.cols * self.rows) as u32,
            Some(v) => v.iter().filter(|x| **x != 0).count() as u32,
        }
    }
}

thread_local! {
    /// Byte planes and masks on their way between samples and bytes.
    static BODY: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// Compresses a block. The same block gives the same bytes.
pub fn encode(block: &RawBlock) -> Vec<u8> {
    let n = block.cols * block.rows;
    let mut flags = 0;
    if block.valid.is_some() {
        flags |= HAS_VOIDS | if block.fills.is_empty() { 0 } else { HAS_FILLS };
    }
    let mut out = Vec::with_capacity(8 + n * block.sample_type.bytes() / 2);
    out.put_u8(CODEC);
    out.put_u8(block.sample_type as u8);
    out.put_u8(flags);
    out.put_u8(0);
    out.put_u8(block.col as u8);
    out.put_u8(block.row as u8);
    out.put_u8(block.cols as u8);
    out.put_u8(block.rows as u8);
    BODY.with_borrow_mut(|planes| {
        planes.resize(n * block.sample_type.bytes(), 0);
        lorenzo::split(block.sample_type, &block.samples, block.cols, planes);
        planes.chunks_exact(n).for_each(|p| plane::pack(p, &mut out));
    });
    if let Some(valid) = &block.valid {
        let bits = |eight: &[u8]| eight.iter().enumerate().fold(0, |b, (k, v)| b | u8::from(*v != 0) << k);
        plane::pack(&valid.chunks(8).map(bits).collect::<Vec<u8>>(), &mut out);
        if flags & HAS_FILLS != 0 {
            let fills: Vec<u8> = block.fills.iter().flat_map(|f| f.to_le_bytes()).collect();
            plane::pack(&fills, &mut out);
        }
    }
    out
}

/// Reads a block back. Never panics and never allocates more than a block, whatever the bytes.
pub fn decode(bytes: &[u8], file: &str) -> Result<RawBlock> {
    let mut r = Reader::new(bytes, file, "sample block");
    let codec = r.u8()?;
    if ![FIRST_CODEC, CODEC].contains(&codec) {
        return Err(Error::unsupported(file, format!("block codec {codec}"), "use a newer terraquilt"));
    }
    let code = r.u8()?;
    let sample_type = SampleType::from_code(code).ok_or_else(|| r.bad(format!("sample type {code}")))?;
    let flags = r.u8()?;
    r.u8()?;
    let (col, row, cols, rows) = (r.u8()? as usize, r.u8()? as usize, r.u8()? as usize, r.u8()? as usize);
    if cols == 0 || rows == 0 || col + cols > N || row + rows > N {
        return Err(r.bad(format!("extent {cols} x {rows} at {col}, {row} leaves the block")));
    }
    let n = cols * rows;
    let sample_bytes = n * sample_type.bytes();
    let mut block =
        RawBlock { col, row, cols, rows, sample_type, samples: Vec::new(), valid: None, fills: Vec::new() };
    BODY.with_borrow_mut(|body| {
        let first = codec == FIRST_CODEC;
        // All parts in one frame.
        let mut whole = Reader::new(&[], file, "sample block");
        let mut unpacked = Vec::new();
        if first {
            unpacked.resize(sample_bytes + n.div_ceil(8) + 4 * n, 0);
            let came =
                plane::zstd_unpack(r.rest(), &mut unpacked).map_err(|e| r.bad(format!("zstd: {e}")))?;
            whole = Reader::new(&unpacked[..came], file, "sample block");
            r.take(r.remaining())?;
        }
        let mut part = |out: &mut [u8]| {
            if first {
                out.copy_from_slice(whole.take(out.len())?);
                return Ok(());
            }
            plane::unpack(&mut r, out)
        };
        if body.len() < sample_bytes {
            body.resize(sample_bytes, 0);
        }
        let planes = &mut body[..sample_bytes];
        planes.chunks_exact_mut(n).try_for_each(&mut part)?;
        block.samples = lorenzo::join(sample_type, planes, cols);
        if flags & HAS_VOIDS != 0 {
            let mut bits = vec![0; n.div_ceil(8)];
            part(&mut bits)?;
            let valid: Vec<u8> = (0..n).map(|k| bits[k / 8] >> (k % 8) & 1).collect();
            let voids = valid.iter().filter(|v| **v == 0).count();
            block.valid = Some(valid);
            if flags & HAS_FILLS != 0 && voids > 0 {
                let mut fills = vec![0; 4 * voids];
                part(&mut fills)?;
                let fill = |b: &[u8]| f32::from_le_bytes([b[0], b[1], b[2], b[3]]);
                block.fills = fills.chunks_exact(4).map(fill).collect();
            }
        }
        whole.end()?;
        r.end()
    })?;
    Ok(block)
}

#[cfg(test)]
pub mod tests {
    use super::*;

    pub fn sample(t: SampleType, cols: usize, rows: usize, voids: bool) -> RawBlock {
        let mut samples = Vec::new();
        let mut state = 88172645463325252u64;
        for k in 0..cols * rows {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let v = (k % cols) as f64 * 1.5 + (state % 7) as f64 - 20.0;
            match t {
                SampleType::U8 | SampleType::I8 => samples.push(v as i64 as u8),
                SampleType::U16 | SampleType::I16 => samples.extend((v as i16).to_le_bytes()),
                SampleType::U32 | SampleType::I32 => samples.extend((v as i32).to_le_bytes()),
                SampleType::F32 => samples.extend((v as f32).to_le_bytes()),
                SampleType::F64 => samples.extend((v * 1e-3).to_le_bytes()),
            }
        }
        let valid = voids.then(|| (0..cols * rows).map(|k| u8::from(k % 5 != 0)).collect::<Vec<u8>>());
        let fills =
            valid.as_ref().map_or(Vec::new(), |v| v.iter().filter(|x| **x == 0).map(|_| 7.5f32).collect());
        RawBlock { col: 3, row: 4, cols, rows, sample_type: t, samples, valid, fills }
    }

    #[test]
    fn every_type_comes_back_bit_for_bit() {
        for t in SampleType::ALL {
            for voids in [false, true] {
                for (c, r) in [(1, 1), (1, 9), (9, 1), (100, 100)] {
                    let b = sample(t, c, r, voids);
                    assert_eq!(decode(&encode(&b), "t").unwrap(), b, "{t:?} {c} {r}");
                }
            }
        }
    }

    /// Bytes are the same whatever the thread packed before: `verify` compares them.
    #[test]
    fn what_was_packed_before_leaves_no_trace() {
        for k in 0..200usize {
            let t = SampleType::ALL[k % 8];
            let b = sample(t, 1 + k * 7 % 109, 1 + k * 31 % 108, k % 3 == 0);
            let bytes = encode(&b);
            let fresh = std::thread::scope(|s| s.spawn(|| encode(&b)).join().expect("it does not panic"));
            assert_eq!(bytes, fresh, "{t:?} {k}");
            assert_eq!(decode(&bytes, "t").unwrap(), b);
            assert!(decode(&bytes[..bytes.len() - 1], "t").is_err());
        }
    }

    /// The bytes of the first codec, sample by sample.
    fn first(b: &RawBlock) -> Vec<u8> {
        let n = b.cols * b.rows;
        let mut body = lorenzo::tests::plainly(b.sample_type, &b.samples, b.cols);
        if let Some(valid) = &b.valid {
            let bit = |k: usize| valid.get(k).map_or(0, |v| u8::from(*v != 0) << (k % 8));
            body.extend((0..n.div_ceil(8)).map(|byte| (8 * byte..8 * byte + 8).map(bit).sum::<u8>()));
            body.extend(b.fills.iter().flat_map(|f| f.to_le_bytes()));
        }
        let flags = u8::from(b.valid.is_some()) + 2 * u8::from(!b.fills.is_empty());
        let mut out = vec![1, b.sample_type as u8, flags, 0];
        out.extend([b.col, b.row, b.cols, b.rows].map(|v| v as u8));
        out.extend(zstd::bulk::compress(&body, 1).unwrap());
        out
    }

    #[test]
    fn blocks_of_the_first_codec_are_read() {
        for t in SampleType::ALL {
            for (cols, rows, voids) in [(1, 1, false), (7, 9, true), (100, 100, true), (100, 3, false)] {
                let b = sample(t, cols, rows, voids);
                let bytes = first(&b);
                assert_eq!(decode(&bytes, "t").unwrap(), b, "{t:?} {cols} {rows}");
                assert!(decode(&bytes[..bytes.len() - 1], "t").is_err());
                let level_0 = RawBlock { fills: Vec::new(), ..b };
                assert_eq!(decode(&first(&level_0), "t").unwrap(), level_0);
            }
        }
    }

    #[test]
    fn special_floats_survive() {
        let values =
            [f32::NAN, f32::INFINITY, -0.0, 0.0, f32::MIN, f32::MAX, f32::from_bits(0x7fc0_1234), 1e-40];
        let samples: Vec<u8> = values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let b = RawBlock {
            col: 0,
            row: 0,
            cols: 4,
            rows: 2,
            sample_type: SampleType::F32,
            samples,
            valid: None,
            fills: Vec::new(),
        };
        assert_eq!(decode(&encode(&b), "t").unwrap().samples, b.samples);
    }

    #[test]
    fn damaged_bytes_are_errors_and_never_panics() {
        let block = sample(SampleType::I16, 50, 40, true);
        for bytes in [encode(&block), first(&block)] {
            for cut in 0..bytes.len() {
                assert!(decode(&bytes[..cut], "t").is_err(), "cut at {cut}");
            }
            for bit in 0..bytes.len() * 8 {
                let mut b = bytes.clone();
                b[bit / 8] ^= 1 << (bit % 8);
                let _ = decode(&b, "t");
            }
            let mut more = bytes.clone();
            more.push(0);
            assert!(decode(&more, "t").is_err());
        }
    }
}
