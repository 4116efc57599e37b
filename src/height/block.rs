//! Blocks of samples: 112 x 112 vertices of one level of a survey, compressed without loss.
//!
//! Block (bi, bj) of a level holds vertices `[112 bi, 112 bi + 112)` in each axis (indices of that level), clipped
//! to what exists. Samples keep their own type, bit for bit. Bytes are drawn in `docs/format.md`:
//! Lorenzo predictor on order-preserving integers, zigzag, byte planes, zstd level 1.

use super::source::SampleType;
use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result};
use std::cell::RefCell;
use zstd::bulk::{Compressor, Decompressor};

/// Vertices across a block: four level-0 kernels.
pub const BLOCK: i64 = 112;
const N: usize = BLOCK as usize;
const CODEC: u8 = 1;
const HAS_VOIDS: u8 = 1;
const HAS_FILLS: u8 = 2;
const ZSTD_LEVEL: i32 = 1;

// What zstd needs for its work takes as long to make as a block takes to read: each thread keeps its own.
thread_local! {
    static PACKER: RefCell<Compressor<'static>> =
        RefCell::new(Compressor::new(ZSTD_LEVEL).expect("zstd knows its first level"));
    static UNPACKER: RefCell<Decompressor<'static>> =
        RefCell::new(Decompressor::new().expect("zstd needs no dictionary"));
}

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

macro_rules! planes {
    ($unsigned:ty, $encode:ident, $decode:ident) => {
        fn $encode(samples: &[u8], cols: usize, map: impl Fn($unsigned) -> $unsigned) -> Vec<u8> {
            const W: usize = std::mem::size_of::<$unsigned>();
            let values: Vec<$unsigned> = samples
                .chunks_exact(W)
                .map(|b| map(<$unsigned>::from_le_bytes(b.try_into().expect("chunks of W bytes"))))
                .collect();
            let n = values.len();
            let mut out = vec![0u8; n * W];
            for k in 0..n {
                let (c, r) = (k % cols, k / cols);
                let predicted = match (c > 0, r > 0) {
                    (true, true) => {
                        values[k - 1].wrapping_add(values[k - cols]).wrapping_sub(values[k - cols - 1])
                    }
                    (true, false) => values[k - 1],
                    (false, true) => values[k - cols],
                    (false, false) => 0,
                };
                let d = values[k].wrapping_sub(predicted);
                let sign = (0 as $unsigned).wrapping_sub(d >> (<$unsigned>::BITS - 1));
                let zigzag = (d << 1) ^ sign;
                for (plane, byte) in zigzag.to_le_bytes().into_iter().enumerate() {
                    out[plane * n + k] = byte;
                }
            }
            out
        }

        fn $decode(planes: &[u8], cols: usize, map: impl Fn($unsigned) -> $unsigned) -> Vec<u8> {
            const W: usize = std::mem::size_of::<$unsigned>();
            let n = planes.len() / W;
            let mut values: Vec<$unsigned> = vec![0; n];
            for (k, v) in values.iter_mut().enumerate() {
                let mut z: $unsigned = 0;
                for plane in 0..W {
                    z |= <$unsigned>::from(planes[plane * n + k]) << (8 * plane);
                }
                *v = (z >> 1) ^ (0 as $unsigned).wrapping_sub(z & 1);
            }
            let (first, rest) = values.split_at_mut(cols.min(n));
            let mut run: $unsigned = 0;
            for v in first.iter_mut() {
                run = run.wrapping_add(*v);
                *v = run;
            }
            let mut above: &[$unsigned] = first;
            for row in rest.chunks_exact_mut(cols) {
                // The running sum of differences to the row above, plus the row above.
                let mut run: $unsigned = 0;
                for (v, a) in row.iter_mut().zip(above) {
                    run = run.wrapping_add(*v);
                    *v = run.wrapping_add(*a);
                }
                above = row;
            }
            let mut out = Vec::with_capacity(n * W);
            for v in values {
                out.extend_from_slice(&map(v).to_le_bytes());
            }
            out
        }
    };
}

planes!(u8, encode_u8, decode_u8);
planes!(u16, encode_u16, decode_u16);
planes!(u32, encode_u32, decode_u32);
planes!(u64, encode_u64, decode_u64);

// Bits of a float as an integer in the same order, and back.
fn ordered32(b: u32) -> u32 {
    if b >> 31 == 1 { !b } else { b | 1 << 31 }
}
fn unordered32(o: u32) -> u32 {
    if o >> 31 == 1 { o & !(1 << 31) } else { !o }
}
fn ordered64(b: u64) -> u64 {
    if b >> 63 == 1 { !b } else { b | 1 << 63 }
}
fn unordered64(o: u64) -> u64 {
    if o >> 63 == 1 { o & !(1 << 63) } else { !o }
}

/// Compresses a block. The same block gives the same bytes.
pub fn encode(block: &RawBlock) -> Vec<u8> {
    let mut body = match block.sample_type {
        SampleType::U8 | SampleType::I8 => encode_u8(&block.samples, block.cols, |v| v),
        SampleType::U16 | SampleType::I16 => encode_u16(&block.samples, block.cols, |v| v),
        SampleType::U32 | SampleType::I32 => encode_u32(&block.samples, block.cols, |v| v),
        SampleType::F32 => encode_u32(&block.samples, block.cols, ordered32),
        SampleType::F64 => encode_u64(&block.samples, block.cols, ordered64),
    };
    let mut flags = 0;
    if let Some(valid) = &block.valid {
        flags |= HAS_VOIDS;
        for bits in valid.chunks(8) {
            body.put_u8(bits.iter().enumerate().fold(0, |b, (k, v)| b | u8::from(*v != 0) << k));
        }
        if !block.fills.is_empty() {
            flags |= HAS_FILLS;
            for f in &block.fills {
                body.put_f32(*f);
            }
        }
    }
    let packed =
        PACKER.with_borrow_mut(|p| p.compress(&body)).expect("zstd compresses any bytes into memory");
    let mut out = Vec::with_capacity(packed.len() + 8);
    out.put_u8(CODEC);
    out.put_u8(block.sample_type as u8);
    out.put_u8(flags);
    out.put_u8(0);
    out.put_u8(block.col as u8);
    out.put_u8(block.row as u8);
    out.put_u8(block.cols as u8);
    out.put_u8(block.rows as u8);
    out.put(&packed);
    out
}

/// Reads a block back. Never panics and never allocates more than a block, whatever the bytes.
pub fn decode(bytes: &[u8], file: &str) -> Result<RawBlock> {
    let mut r = Reader::new(bytes, file, "sample block");
    let codec = r.u8()?;
    if codec != CODEC {
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
    let most = sample_bytes + n.div_ceil(8) + 4 * n;
    let packed = r.take(r.remaining())?;
    let body = UNPACKER.with_borrow_mut(|u| u.decompress(packed, most));
    let body = body.map_err(|e| r.bad(format!("zstd: {e}")))?;
    let mut b = Reader::new(&body, file, "sample block");
    let planes = b.take(sample_bytes)?;
    let samples = match sample_type {
        SampleType::U8 | SampleType::I8 => decode_u8(planes, cols, |v| v),
        SampleType::U16 | SampleType::I16 => decode_u16(planes, cols, |v| v),
        SampleType::U32 | SampleType::I32 => decode_u32(planes, cols, |v| v),
        SampleType::F32 => decode_u32(planes, cols, unordered32),
        SampleType::F64 => decode_u64(planes, cols, unordered64),
    };
    let mut valid = None;
    let mut fills = Vec::new();
    if flags & HAS_VOIDS != 0 {
        let bits = b.take(n.div_ceil(8))?;
        let mask: Vec<u8> = (0..n).map(|k| bits[k / 8] >> (k % 8) & 1).collect();
        if flags & HAS_FILLS != 0 {
            let voids = mask.iter().filter(|v| **v == 0).count();
            for _ in 0..voids {
                fills.push(b.f32()?);
            }
        }
        valid = Some(mask);
    }
    b.end()?;
    Ok(RawBlock { col, row, cols, rows, sample_type, samples, valid, fills })
}

/// Heights of a whole block, metres: what is evaluated.
#[derive(Clone, Debug)]
pub struct Heights {
    /// 112 x 112, row-major; voids hold their fill, or 0.
    pub z: Vec<f64>,
    /// 112 x 112; `None` = all valid.
    pub valid: Option<Vec<u8>>,
}

impl Heights {
    /// A block with nothing in it.
    pub fn void() -> Heights {
        Heights { z: vec![0.0; N * N], valid: Some(vec![0; N * N]) }
    }

    /// Lays the block's samples over what is here: valid ones win.
    pub fn lay(&mut self, b: &RawBlock, scale: f64, offset: f64) {
        let w = b.sample_type.bytes();
        let plain = scale == 1.0 && offset == 0.0;
        let whole = b.cols == N && b.rows == N;
        let mut fill = b.fills.iter();
        let mut row = [0.0; N];
        let row = &mut row[..b.cols];
        for r in 0..b.rows {
            let (at, from) = ((b.row + r) * N + b.col, r * b.cols);
            b.sample_type.values(&b.samples[from * w..(from + b.cols) * w], row);
            if !plain {
                row.iter_mut().for_each(|h| *h = *h * scale + offset);
            }
            let z = &mut self.z[at..at + b.cols];
            let valid = b.valid.as_ref().map(|v| &v[from..from + b.cols]);
            let Some(valid) = valid.filter(|v| v.contains(&0)) else {
                z.copy_from_slice(row);
                if let Some(mask) = &mut self.valid {
                    mask[at..at + b.cols].fill(1);
                }
                continue;
            };
            let mask = self.valid.get_or_insert_with(|| vec![1; N * N]);
            for (((z, m), h), v) in z.iter_mut().zip(&mut mask[at..]).zip(row.iter()).zip(valid) {
                if *v != 0 {
                    (*z, *m) = (*h, 1);
                } else if let Some(f) = fill.next()
                    && *m == 0
                {
                    *z = f64::from(*f);
                }
            }
        }
        if whole && b.valid.as_ref().is_none_or(|v| !v.contains(&0)) {
            self.valid = None;
        }
    }

    #[inline]
    pub fn is_valid(&self, a: usize, b: usize) -> bool {
        self.valid.as_ref().is_none_or(|v| v[b * N + a] != 0)
    }

    /// Bytes in memory.
    pub fn weight(&self) -> u64 {
        (self.z.len() * 8 + self.valid.as_ref().map_or(0, Vec::len)) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(t: SampleType, cols: usize, rows: usize, voids: bool) -> RawBlock {
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

    /// Sample by sample, as the heights of a block are defined.
    fn plainly(h: &mut Heights, b: &RawBlock, scale: f64, offset: f64) {
        let w = b.sample_type.bytes();
        let mut fill = b.fills.iter();
        let mask = h.valid.get_or_insert_with(|| vec![1; N * N]);
        for k in 0..b.cols * b.rows {
            let at = (b.row + k / b.cols) * N + b.col + k % b.cols;
            if b.valid.as_ref().is_none_or(|v| v[k] != 0) {
                let raw = b.sample_type.value(&b.samples[k * w..]);
                h.z[at] = if scale == 1.0 && offset == 0.0 { raw } else { raw * scale + offset };
                mask[at] = 1;
            } else if let Some(f) = fill.next()
                && mask[at] == 0
            {
                h.z[at] = f64::from(*f);
            }
        }
    }

    #[test]
    fn blocks_lie_over_one_another_as_sample_by_sample() {
        let corner = |b: RawBlock| RawBlock { col: N - b.cols, row: N - b.rows, ..b };
        for (k, t) in SampleType::ALL.into_iter().enumerate() {
            let (scale, offset) = if k % 2 == 0 { (1.0, 0.0) } else { (0.1, -3.0) };
            for whole in [false, true] {
                let (mut fast, mut plain) = (Heights::void(), Heights::void());
                for b in [
                    sample(t, 60, 70, true),
                    RawBlock { fills: Vec::new(), ..sample(t, 80, 33, true) },
                    sample(t, 20, 10, false),
                    corner(sample(t, if whole { N } else { 90 }, N, k % 3 == 0)),
                    sample(t, 50, 50, true),
                ] {
                    fast.lay(&b, scale, offset);
                    plainly(&mut plain, &b, scale, offset);
                    let bits = |h: &Heights| h.z.iter().map(|z| z.to_bits()).collect::<Vec<u64>>();
                    assert_eq!(bits(&fast), bits(&plain), "{t:?}");
                    assert!((0..N * N).all(|p| fast.is_valid(p % N, p / N) == plain.is_valid(p % N, p / N)));
                }
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
        let bytes = encode(&sample(SampleType::I16, 50, 40, true));
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
