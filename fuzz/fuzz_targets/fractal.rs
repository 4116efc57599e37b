//! Fractal tiles. First byte even: any bytes as a file; odd: a small grid is encoded, bits of it flipped, the rest cut off.
#![no_main]

use libfuzzer_sys::fuzz_target;
use terraquilt_codecs::fractal::{Kind, Options, Partition, Search, Tile, encode_heights};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Alone;

/// 128 x 128 samples.
const SAMPLES_MAX: u64 = 1 << 14;

fuzz_target!(|data: &[u8]| {
    let [kind, rest @ ..] = data else { return };
    if kind % 2 == 0 {
        endure(rest);
        return;
    }
    let [cols, rows, how, flips, cut, rest @ ..] = rest else { return };
    let (cols, rows) = (1 + usize::from(cols % 40), 1 + usize::from(rows % 40));
    let z = (0..cols * rows).map(|k| i32::from(rest.get(k % rest.len().max(1)).copied().unwrap_or(9)) - 128);
    let mut heights = Heights::new(cols, rows, z.collect());
    if how & 1 == 1 {
        heights.void = heights.z.iter().map(|z| z % 5 == 0).collect();
    }
    let bound = (how & 2 == 2).then_some(u32::from(how >> 5));
    let options = Options {
        partition: Some(Partition::Slope(f64::from(how >> 2 & 7) * 8.0)),
        search: Search::Near(4),
        bound,
        ..Options::default()
    };
    let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).expect("a small grid");
    let whole = endure(&e.bytes).expect("what was written is read");
    assert!(whole.complete && whole.maps() as u64 == e.header.maps);
    if let Some(bound) = bound {
        let found = whole.heights().expect("heights");
        for k in (0..heights.z.len()).filter(|k| !heights.is_void(*k)) {
            assert!(found.z[k].abs_diff(heights.z[k]) <= bound);
        }
    }
    let mut bytes = e.bytes;
    for k in 0..usize::from(flips % 4) {
        let at = usize::from(rest.get(k).copied().unwrap_or(3)) * 7 % bytes.len();
        bytes[at] ^= 1 << (k + usize::from(*flips >> 5)) % 8;
    }
    let keep = bytes.len() - usize::from(*cut) % bytes.len();
    endure(&bytes[..keep]);
});

/// An error, or a tile that answers.
fn endure(bytes: &[u8]) -> Option<Tile> {
    let tile = Tile::read_within(SAMPLES_MAX, bytes).ok()?;
    match tile.header.kind {
        Kind::Heights => {
            assert_eq!(tile.heights().expect("heights").z.len() as u64, tile.header.samples());
            assert!(tile.walk(0).expect("a walk").value([1.5, 0.25], 7).is_finite());
        }
        Kind::Grey | Kind::Colour => drop(tile.picture(2).expect("a picture")),
        Kind::Volume => drop(tile.volume().expect("a volume")),
    }
    Some(tile)
}
