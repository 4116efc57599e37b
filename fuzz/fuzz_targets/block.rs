//! Any bytes as a sample block. First byte even: as they are, so that headers and zstd are tried; odd: as samples, so
//! that the codec is: what is decoded is written again, and that comes back as it was.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt::height::block::{BLOCK, Heights, RawBlock, decode, encode};
use terraquilt::height::source::SampleType;

fuzz_target!(|data: &[u8]| {
    let Some((mode, rest)) = data.split_first() else { return };
    let block = if mode % 2 == 0 { decode(rest, "fuzz").ok() } else { made_of(rest) };
    let Some(block) = block else { return };
    let bytes = encode(&block);
    let again = decode(&bytes, "fuzz").expect("what encode wrote is read");
    // Compared as bytes, since a fill may be NaN.
    assert_eq!(encode(&again), bytes);
    assert_eq!(again.samples, block.samples);
    assert_eq!(again.valid_count(), block.valid_count());
    let mut heights = Heights::void();
    heights.lay(&again, 0.5, -1.0);
});

/// Four bytes of extent, then samples (repeated as often as needed), type and validity by the bits of the fifth.
fn made_of(data: &[u8]) -> Option<RawBlock> {
    let (head, rest) = data.split_at_checked(5)?;
    let n = BLOCK as usize;
    let (col, row) = (usize::from(head[0]) % n, usize::from(head[1]) % n);
    let (cols, rows) = (1 + usize::from(head[2]) % (n - col), 1 + usize::from(head[3]) % (n - row));
    let sample_type = SampleType::ALL[usize::from(head[4] & 7)];
    if rest.is_empty() {
        return None;
    }
    let count = cols * rows;
    let samples: Vec<u8> = rest.iter().copied().cycle().take(count * sample_type.bytes()).collect();
    let valid: Option<Vec<u8>> =
        (head[4] & 8 != 0).then(|| rest.iter().cycle().take(count).map(|b| b & 1).collect());
    let voids = valid.as_ref().map_or(0, |v| v.iter().filter(|x| **x == 0).count());
    let fills = if head[4] & 16 != 0 { (0..voids).map(|k| k as f32 / 3.0).collect() } else { Vec::new() };
    Some(RawBlock { col, row, cols, rows, sample_type, samples, valid, fills })
}
