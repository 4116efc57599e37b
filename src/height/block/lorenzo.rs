//! Samples as differences to what their neighbours suggest, in byte planes.
//!
//! The Lorenzo predictor (left + above - above left) on integers in the samples' order; zeros stand beyond the first row
//! and column. A difference is zigzagged, so that small ones of either sign are small numbers, and its bytes go to
//! planes: all lowest bytes, then all second ones, and so on. All arithmetic is modulo the width of a sample.

use super::N;
use crate::height::source::SampleType;
use multiversion::multiversion;

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

/// Samples of a row that are summed up side by side; 7 times that is a row of a block.
const LANES: usize = 16;

/// A row of bytes in a row of a whole block, so that loops have the same length for all.
#[inline(always)]
fn widened(row: &[u8]) -> [u8; N] {
    match row.first_chunk() {
        Some(whole) => *whole,
        None => {
            let mut wide = [0; N];
            wide[..row.len()].copy_from_slice(row);
            wide
        }
    }
}

macro_rules! planes {
    ($unsigned:ty, $split:ident, $join:ident, $add:ident) => {
        #[inline(always)]
        fn $split(samples: &[u8], cols: usize, planes: &mut [u8], map: impl Fn($unsigned) -> $unsigned) {
            const W: usize = size_of::<$unsigned>();
            let n = planes.len() / W;
            // A row and the one above, each after a zero.
            let (mut above, mut here, mut zigzag) = ([0; N + 1], [0; N + 1], [0; N]);
            for (r, row) in samples.chunks_exact(cols * W).enumerate() {
                for (v, b) in here[1..].iter_mut().zip(row.chunks_exact(W)) {
                    *v = map(<$unsigned>::from_le_bytes(b.try_into().expect("chunks of W bytes")));
                }
                for (k, z) in zigzag.iter_mut().enumerate() {
                    let predicted = (here[k] as $unsigned).wrapping_add(above[k + 1]).wrapping_sub(above[k]);
                    let d = here[k + 1].wrapping_sub(predicted);
                    let sign = (0 as $unsigned).wrapping_sub(d >> (<$unsigned>::BITS - 1));
                    *z = (d << 1) ^ sign;
                }
                for (p, plane) in planes.chunks_exact_mut(n).enumerate() {
                    for (byte, z) in plane[r * cols..(r + 1) * cols].iter_mut().zip(&zigzag) {
                        *byte = (z >> (8 * p)) as u8;
                    }
                }
                std::mem::swap(&mut above, &mut here);
            }
        }

        /// Adds to each lane the one `S` before it: by 1, 2, 4 and 8, that is the sum of all before it.
        #[inline(always)]
        fn $add<const S: usize>(lanes: [$unsigned; LANES]) -> [$unsigned; LANES] {
            std::array::from_fn(|k| if k < S { lanes[k] } else { lanes[k].wrapping_add(lanes[k - S]) })
        }

        #[inline(always)]
        fn $join(planes: &[u8], cols: usize, map: impl Fn($unsigned) -> $unsigned) -> Vec<u8> {
            const W: usize = size_of::<$unsigned>();
            let n = planes.len() / W;
            let mut out = vec![0; n * W];
            // Sums of differences down each column; a sample is the sum of those to its left and its own.
            let mut down: [$unsigned; N] = [0; N];
            for (r, row) in out.chunks_exact_mut(cols * W).enumerate() {
                let mut zigzag: [$unsigned; N] = [0; N];
                for (p, plane) in planes.chunks_exact(n).enumerate() {
                    let bytes = widened(&plane[r * cols..(r + 1) * cols]);
                    for (z, byte) in zigzag.iter_mut().zip(bytes) {
                        *z |= <$unsigned>::from(byte) << (8 * p);
                    }
                }
                for (sum, z) in down.iter_mut().zip(zigzag) {
                    *sum = sum.wrapping_add((z >> 1) ^ (0 as $unsigned).wrapping_sub(z & 1));
                }
                let mut line = down;
                let mut run: $unsigned = 0;
                for lanes in line.as_chunks_mut::<LANES>().0 {
                    *lanes = $add::<8>($add::<4>($add::<2>($add::<1>(*lanes))));
                    lanes.iter_mut().for_each(|v| *v = v.wrapping_add(run));
                    run = lanes[LANES - 1];
                }
                let line = line.map(|v| map(v).to_le_bytes());
                row.copy_from_slice(&line.as_flattened()[..cols * W]);
            }
            out
        }
    };
}

planes!(u8, split_u8, join_u8, add_u8);
planes!(u16, split_u16, join_u16, add_u16);
planes!(u32, split_u32, join_u32, add_u32);
planes!(u64, split_u64, join_u64, add_u64);

/// Writes the byte planes of samples, row-major in rows of `cols`. `planes` has as many bytes.
#[multiversion(targets("x86_64+avx2"))]
pub fn split(t: SampleType, samples: &[u8], cols: usize, planes: &mut [u8]) {
    match t {
        SampleType::U8 | SampleType::I8 => split_u8(samples, cols, planes, |v| v),
        SampleType::U16 | SampleType::I16 => split_u16(samples, cols, planes, |v| v),
        SampleType::U32 | SampleType::I32 => split_u32(samples, cols, planes, |v| v),
        SampleType::F32 => split_u32(samples, cols, planes, ordered32),
        SampleType::F64 => split_u64(samples, cols, planes, ordered64),
    }
}

/// The samples of byte planes.
#[multiversion(targets("x86_64+avx2"))]
pub fn join(t: SampleType, planes: &[u8], cols: usize) -> Vec<u8> {
    match t {
        SampleType::U8 | SampleType::I8 => join_u8(planes, cols, |v| v),
        SampleType::U16 | SampleType::I16 => join_u16(planes, cols, |v| v),
        SampleType::U32 | SampleType::I32 => join_u32(planes, cols, |v| v),
        SampleType::F32 => join_u32(planes, cols, unordered32),
        SampleType::F64 => join_u64(planes, cols, unordered64),
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Planes sample by sample, as they are defined.
    pub fn plainly(t: SampleType, samples: &[u8], cols: usize) -> Vec<u8> {
        let w = t.bytes();
        let (bits, n) = (8 * w as u32, samples.len() / w);
        let top = 1u64 << (bits - 1);
        let all = u64::MAX >> (64 - bits);
        let value = |k: usize| {
            let mut b = [0; 8];
            b[..w].copy_from_slice(&samples[k * w..(k + 1) * w]);
            let v = u64::from_le_bytes(b);
            match (t.is_float(), v & top != 0) {
                (true, true) => !v & all,
                (true, false) => v | top,
                _ => v,
            }
        };
        let mut planes = vec![0; n * w];
        for k in 0..n {
            let left = if k % cols > 0 { value(k - 1) } else { 0 };
            let above = if k >= cols { value(k - cols) } else { 0 };
            let corner = if k % cols > 0 && k >= cols { value(k - cols - 1) } else { 0 };
            let d = value(k).wrapping_sub(left.wrapping_add(above).wrapping_sub(corner)) & all;
            let zigzag = (d << 1 & all) ^ if d & top != 0 { all } else { 0 };
            zigzag.to_le_bytes()[..w].iter().enumerate().for_each(|(p, b)| planes[p * n + k] = *b);
        }
        planes
    }

    #[test]
    fn planes_are_what_they_are_sample_by_sample() {
        let mut state = 88172645463325252u64;
        for t in SampleType::ALL {
            for (cols, rows) in [(1, 1), (1, 112), (112, 1), (112, 112), (15, 33), (17, 16), (97, 5)] {
                let mut byte = || {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    state as u8
                };
                let samples: Vec<u8> = (0..cols * rows * t.bytes()).map(|_| byte()).collect();
                let mut planes = vec![1; samples.len()];
                split(t, &samples, cols, &mut planes);
                assert_eq!(planes, plainly(t, &samples, cols), "{t:?} {cols} x {rows}");
                assert_eq!(join(t, &planes, cols), samples, "{t:?} {cols} x {rows}");
            }
        }
    }
}
