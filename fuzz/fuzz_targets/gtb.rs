//! Streams of terrain. First byte even: any bytes as a file; odd: a small grid is coded, bits of it flipped, the rest cut off.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Heights, Options, Profile, Stop, decode_within, encode};

/// 257 x 257 posts.
const POSTS_MAX: u64 = 257 * 257;

fuzz_target!(|data: &[u8]| {
    let [kind, rest @ ..] = data else { return };
    if kind % 2 == 0 {
        endure(rest);
        return;
    }
    let [cols, rows, layers, flips, cut, rest @ ..] = rest else { return };
    let (cols, rows) = (1 + usize::from(cols % 20), 1 + usize::from(rows % 20));
    let z = (0..cols * rows).map(|k| i32::from(rest.get(k % rest.len().max(1)).copied().unwrap_or(9)) - 128);
    let mut heights = Heights::new(cols, rows, z.collect());
    if layers & 1 == 1 {
        heights.void = heights.z.iter().map(|z| z % 5 == 0).collect();
    }
    let profile = if layers & 2 == 2 { Profile::Sparse } else { Profile::Cubic };
    let bounds = match (profile, layers >> 2 & 3) {
        (Profile::Sparse, n) => vec![1 + u32::from(n)],
        (_, 0) => vec![0],
        (_, 1) => vec![13, 4, 1, 0],
        (_, 2) => vec![7, 2],
        _ => vec![60],
    };
    let options = Options { layers: bounds, ..Options::new(profile, 0) };
    let encoded = encode(&heights, &options, &mut Alone, &mut |_| true).expect("a small grid");
    let whole = endure(&encoded.bytes).expect("what was written is read");
    assert!(whole.complete && whole.z == encoded.z);
    assert_within(&heights, &whole);
    let mut bytes = encoded.bytes;
    for k in 0..usize::from(flips % 4) {
        let at = usize::from(rest.get(k).copied().unwrap_or(3)) * 7 % bytes.len();
        bytes[at] ^= 1 << (k + usize::from(*flips >> 5)) % 8;
    }
    let keep = bytes.len() - usize::from(*cut) % bytes.len();
    let prefix = endure(&bytes[..keep]);
    // Flipped bits are noticed where their checksum is there; in a prefix of unchanged bytes the bound holds.
    if let Some(d) = prefix.filter(|_| flips % 4 == 0) {
        assert_within(&heights, &d);
    }
});

/// An error, or a surface of the right size.
fn endure(bytes: &[u8]) -> Option<Decoded> {
    let mut body = Vec::new();
    let d = decode_within(POSTS_MAX, bytes, &mut body, Stop::End, None, &mut Alone, &mut |_| true).ok()?;
    let side = d.header.lattice.side();
    assert_eq!((d.z.len(), d.surface().len()), (side * side, side * side));
    Some(d)
}

fn assert_within(heights: &Heights, d: &Decoded) {
    let (side, surface) = (d.header.lattice.side(), d.surface());
    for (k, z) in heights.z.iter().enumerate().filter(|(k, _)| !heights.is_void(*k)) {
        let away = (surface[k / heights.cols * side + k % heights.cols] - f64::from(*z)).abs();
        assert!(away <= f64::from(d.bound), "{away} at post {k}, {} was promised", d.bound);
    }
}
