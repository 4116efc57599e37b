//! Parts of a block, packed each by itself: what is cheapest for its bytes.

use super::huffman::{self, Lengths};
use crate::base::Result;
use crate::base::bytes::{Put, Reader};
use std::cell::RefCell;
use zstd::bulk::{Compressor, Decompressor};

const ZSTD_LEVEL: i32 = 1;

// How a part is packed.
const AS_IS: u8 = 0;
const SPARSE: u8 = 1;
const HUFFMAN: u8 = 2;
const ZSTD: u8 = 3;
/// Bytes that may differ from all others in a sparse part.
const SPARSE_MAX: usize = 32;

// What zstd needs for its work takes as long to make as a block takes to read: each thread keeps its own.
thread_local! {
    static PACKER: RefCell<Compressor<'static>> =
        RefCell::new(Compressor::new(ZSTD_LEVEL).expect("zstd knows its first level"));
    static UNPACKER: RefCell<Decompressor<'static>> =
        RefCell::new(Decompressor::new().expect("zstd needs no dictionary"));
}

fn zstd_packed(part: &[u8]) -> Vec<u8> {
    PACKER.with_borrow_mut(|p| p.compress(part)).expect("zstd compresses any bytes into memory")
}

/// Unpacks one frame of zstd. Returns how many bytes came; `out` holds as many as may.
pub fn zstd_unpack(packed: &[u8], out: &mut [u8]) -> std::io::Result<usize> {
    UNPACKER.with_borrow_mut(|u| u.decompress_to_buffer(packed, out))
}

/// How often each byte comes.
fn counts(part: &[u8]) -> [u32; 256] {
    // Four tables: equal bytes in a row do not wait for one another.
    let mut four = [[0u32; 256]; 4];
    let mut chunks = part.chunks_exact(4);
    for c in &mut chunks {
        (0..4).for_each(|k| four[k][usize::from(c[k])] += 1);
    }
    chunks.remainder().iter().for_each(|b| four[0][usize::from(*b)] += 1);
    std::array::from_fn(|b| four.iter().map(|t| t[b]).sum())
}

/// Whether zstd may find what counts of bytes do not tell: much more bytes equal the one before than chance would have,
/// or one byte is nearly all there is, and deserves less than a bit.
fn has_runs(part: &[u8], counts: &[u32; 256]) -> bool {
    let n = part.len() as u64;
    let equal = part.iter().zip(&part[1..]).map(|(a, b)| u32::from(a == b)).sum::<u32>();
    let by_chance = counts.iter().map(|c| u64::from(*c).pow(2)).sum::<u64>() / n;
    let most = counts.iter().max().copied().unwrap_or(0);
    u64::from(equal) > by_chance + n / 8 || u64::from(most) > n - n / 4
}

/// Appends a part of one byte at least. The same part gives the same bytes.
pub fn pack(part: &[u8], out: &mut Vec<u8>) {
    // A byte that comes nearly everywhere is in the middle, too, or the part is packed in another way.
    let most = part[part.len() / 2];
    let others = part.iter().map(|b| u32::from(*b != most)).sum::<u32>() as usize;
    if others <= SPARSE_MAX && 3 * others < part.len() {
        out.put(&[SPARSE, most, others as u8]);
        for (k, b) in part.iter().enumerate().filter(|(_, b)| **b != most) {
            out.put_u16(k as u16);
            out.put_u8(*b);
        }
        return;
    }
    let counts = counts(part);
    let lengths = Lengths::of(&counts);
    let huffman = lengths.bytes(&counts);
    if has_runs(part, &counts) {
        let packed = zstd_packed(part);
        if packed.len() + 2 < part.len().min(huffman) {
            out.put_u8(ZSTD);
            out.put_u16(packed.len() as u16);
            out.put(&packed);
            return;
        }
    }
    if huffman < part.len() {
        out.put_u8(HUFFMAN);
        huffman::encode(part, &lengths, out);
    } else {
        out.put_u8(AS_IS);
        out.put(part);
    }
}

/// Reads a part back, of known length.
///
/// # Errors
/// If the bytes are none that [`pack`] writes.
pub fn unpack(r: &mut Reader, out: &mut [u8]) -> Result<()> {
    match r.u8()? {
        AS_IS => out.copy_from_slice(r.take(out.len())?),
        SPARSE => {
            out.fill(r.u8()?);
            for _ in 0..r.u8()? {
                let k = usize::from(r.u16()?);
                let place = out.get_mut(k).ok_or_else(|| r.bad(format!("byte {k} of a smaller part")))?;
                *place = r.u8()?;
            }
        }
        HUFFMAN => {
            let took = huffman::decode(r.rest(), out).map_err(|e| r.bad(e))?;
            r.take(took)?;
        }
        ZSTD => {
            let len = r.u16()?;
            let packed = r.take(usize::from(len))?;
            let came = zstd_unpack(packed, out).map_err(|e| r.bad(format!("zstd: {e}")))?;
            if came != out.len() {
                return Err(r.bad(format!("{came} bytes in a part of {}", out.len())));
            }
        }
        other => return Err(r.bad(format!("a part packed in way {other}"))),
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_way_is_taken_where_it_is_cheapest_and_comes_back() {
        let mut state = 88172645463325252u64;
        let mut next = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            state
        };
        let noise: Vec<u8> = (0..5000).map(|_| next() as u8).collect();
        let small: Vec<u8> = (0..5000).map(|_| (next() & next()) as u8 & 15).collect();
        let mut few = vec![9; 5000];
        [(0, 1), (77, 2), (4999, 255)].iter().for_each(|(k, b)| few[*k] = *b);
        let runs: Vec<u8> = (0..5000).map(|k| (k / 100 * 37) as u8).collect();
        for (way, part) in [
            (AS_IS, noise),
            (SPARSE, vec![7; 5000]),
            (SPARSE, few),
            (SPARSE, vec![3]),
            (AS_IS, vec![1, 2]),
            (HUFFMAN, small),
            (ZSTD, runs),
        ] {
            let mut packed = Vec::new();
            pack(&part, &mut packed);
            assert_eq!(packed[0], way);
            let mut out = vec![1; part.len()];
            let mut r = Reader::new(&packed, "t", "part");
            unpack(&mut r, &mut out).unwrap();
            r.end().unwrap();
            assert_eq!(out, part);
            for cut in 0..packed.len() {
                assert!(unpack(&mut Reader::new(&packed[..cut], "t", "part"), &mut out).is_err());
            }
            // Another length than it was packed with.
            let mut longer = vec![0; part.len() + 1];
            let long = unpack(&mut Reader::new(&packed, "t", "part"), &mut longer);
            assert!(long.is_err() || way == SPARSE || way == HUFFMAN);
        }
        assert!(unpack(&mut Reader::new(&[SPARSE, 0, 1, 9, 0, 1], "t", "part"), &mut [0; 9]).is_err());
        assert!(unpack(&mut Reader::new(&[4, 0], "t", "part"), &mut [0; 9]).is_err());
    }
}
