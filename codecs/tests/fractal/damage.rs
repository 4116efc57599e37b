//! Bytes that are cut, changed or made up (acceptance F9): an error or a tile, no panic.

use super::ground;
use crate::support::random::Random;
use terraquilt_codecs::Error;
use terraquilt_codecs::fractal::{
    Kind, Options, Partition, Search, Space, Tile, encode_heights, encode_picture, encode_volume,
};
use terraquilt_codecs::heights::Place;
use terraquilt_codecs::work::Alone;

/// A tile of each kind.
fn files() -> Vec<Vec<u8>> {
    let near =
        Options { search: Search::Near(6), partition: Some(Partition::Slope(2.0)), ..Options::default() };
    let mut heights = ground(60, 40, 30.0, 3);
    let plain = encode_heights(&heights, &Place::default(), &[], &near, &Alone).unwrap();
    heights.void = (0..2400).map(|k| k % 60 < k / 60).collect();
    let bounded = Options { bound: Some(3), ..near.clone() };
    let bounded = encode_heights(&heights, &Place::default(), &[], &bounded, &Alone).unwrap();
    let single = Options { range_min: Some(1), ..near.clone() };
    let single = encode_heights(&ground(32, 32, 90.0, 4), &Place::default(), &[], &single, &Alone).unwrap();
    let samples: Vec<u8> = (0..40 * 30 * 3).map(|k| (k * k / 7) as u8).collect();
    let colour = encode_picture([40, 30], 3, &samples, "p", &[], &near, &Alone).unwrap();
    let values: Vec<i8> = (0..16 * 16 * 16).map(|k| ((k % 97) as i8).wrapping_sub(40)).collect();
    let space = Space { origin: [0.0; 3], voxel: 1.0 };
    let volume = encode_volume([16; 3], &values, space, "v", &near, &Alone).unwrap();
    [plain, bounded, single, colour, volume].map(|e| e.bytes).into()
}

/// Everything that a tile can be asked.
fn ask(tile: &Tile) {
    if tile.header.samples() > 1 << 16 {
        return;
    }
    match tile.header.kind {
        Kind::Heights => {
            let h = tile.heights().unwrap();
            assert_eq!(h.z.len() as u64, tile.header.samples());
            let walk = tile.walk(0).unwrap();
            assert!(walk.value([3.3, 1.7], 9).is_finite());
            tile.added(0, 0);
        }
        Kind::Grey | Kind::Colour => {
            tile.picture(2).unwrap();
        }
        Kind::Volume => {
            tile.volume().unwrap();
        }
    }
}

/// Every prefix: the head is needed, then each is a tile, the whole one alone complete.
#[test]
fn every_prefix_is_a_tile_or_an_error() {
    for bytes in files() {
        let head = u16::from_le_bytes([bytes[9], bytes[10]]) as usize;
        for cut in 0..=bytes.len() {
            match Tile::read(&bytes[..cut]) {
                Ok(tile) => {
                    assert!(cut >= head);
                    assert_eq!(tile.complete, cut == bytes.len(), "{cut} of {}", bytes.len());
                    if cut % 37 == 0 || cut < head + 40 {
                        ask(&tile);
                    }
                }
                Err(Error::Short { .. }) => assert!(cut < head),
                Err(e) => panic!("{cut}: {e}"),
            }
        }
    }
}

/// A prefix shows more and more of the ground: its error falls, but for steps of a part.
#[test]
fn prefixes_come_nearer() {
    let heights = ground(128, 128, 10.0, 6);
    let options =
        Options { search: Search::Near(8), partition: Some(Partition::Slope(1.0)), ..Options::default() };
    let e = encode_heights(&heights, &Place::default(), &[], &options, &Alone).unwrap();
    let mut last = f64::INFINITY;
    for eighths in 1..=8 {
        let tile = Tile::read(&e.bytes[..e.bytes.len() * eighths / 8]).unwrap();
        let found = tile.plane(0).unwrap();
        let sum: f64 = found.values.iter().zip(&heights.z).map(|(a, b)| (a - f64::from(*b)).powi(2)).sum();
        let rms = (sum / found.values.len() as f64).sqrt();
        println!("{eighths}/8 of the bytes: rms {rms:.2}");
        assert!(rms <= last * 1.05, "{rms} after {last}");
        last = rms;
    }
}

/// A bit that is flipped: an error, or a tile that says so.
#[test]
fn flips_are_seen() {
    let mut random = Random::new(1);
    for bytes in files() {
        for _ in 0..400 {
            let mut wrong = bytes.clone();
            let at = random.below(wrong.len() as u64) as usize;
            wrong[at] ^= 1 << random.below(8);
            if let Ok(tile) = Tile::read(&wrong) {
                assert!(!tile.complete && tile.damaged.is_some(), "byte {at}");
                ask(&tile);
            }
        }
    }
}

/// Rubbish behind a head and heads of rubbish, both with right checksums.
#[test]
fn rubbish_is_a_tile_or_an_error() {
    let seal = |mut head: Vec<u8>| {
        let len = head.len() - 4;
        let crc = crc32c::crc32c(&head[..len]);
        head[len..].copy_from_slice(&crc.to_le_bytes());
        head
    };
    let rounds = std::env::var("TERRAQUILT_FUZZ_ROUNDS").ok().and_then(|n| n.parse().ok()).unwrap_or(300);
    let mut random = Random::new(2);
    for bytes in files() {
        let head = u16::from_le_bytes([bytes[9], bytes[10]]) as usize;
        for round in 0..rounds {
            let mut file = bytes[..head].to_vec();
            if round % 2 == 1 {
                // Small numbers have a meaning in most fields.
                for _ in 0..=random.below(4) {
                    let at = 11 + random.below(head as u64 - 15) as usize;
                    file[at] = if random.below(2) == 0 { random.below(9) } else { random.next() } as u8;
                }
                file = seal(file);
            }
            // Blocks of rubbish, each with its checksum.
            let body: Vec<u8> = (0..bytes.len() - head)
                .map(|k| if round % 3 == 0 { 255 } else { (random.next() >> (k % 40)) as u8 })
                .collect();
            for block in body.chunks(16 << 10) {
                file.extend_from_slice(block);
                file.extend_from_slice(&crc32c::crc32c(block).to_le_bytes());
            }
            if let Ok(tile) = Tile::read_within(1 << 16, &file) {
                ask(&tile);
            }
        }
        for _ in 0..rounds {
            let length = random.below(200) as usize;
            let rubbish: Vec<u8> = (0..length).map(|_| random.next() as u8).collect();
            assert!(Tile::read(&rubbish).is_err());
        }
    }
}

/// A size beyond what is allowed is refused before anything is made for it.
#[test]
fn sizes_meet_their_limit_first() {
    let bytes = &files()[0];
    let refused = Tile::read_within(2399, bytes).err().unwrap();
    assert_eq!(refused, Error::Limit { what: "samples of the tile", limit: 2399, wanted: 2400 });
    assert!(Tile::read_within(2400, bytes).is_ok());
}
