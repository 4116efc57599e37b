//! Acceptance G-i: whatever the bytes, an error or a true smaller answer.

use crate::support::grids;
use crate::support::random::Random;
use crate::support::streams::{DENSE, coded, read, whole, wrong};
use terraquilt_codecs::blocks::BLOCK;
use terraquilt_codecs::gtb::{Header, Heights, Profile, Stop};
use terraquilt_codecs::lattice::{Lattice, N_MAX};

/// One bit of each byte of a whole file: never a surface that is worse than it says, never silence.
#[test]
fn a_flipped_bit_is_noticed() {
    let crater = grids::bundled("crater_2005-06-15_10m");
    // More than a block of body, and less.
    for (side, layers) in [(24, &[4, 0][..]), (220, &[0])] {
        for profile in DENSE {
            let heights = crater.cut(80, 150, side, side);
            let good = coded(&heights, profile, layers).bytes;
            assert!(side < 100 || good.len() > BLOCK + 4);
            for at in (0..good.len()).step_by(if side < 100 { 1 } else { 61 }) {
                let mut bytes = good.clone();
                bytes[at] ^= 1 << (at % 8);
                if let Ok(d) = read(&bytes, Stop::End) {
                    assert!(d.damaged.is_some() && !d.complete, "byte {at}");
                    assert!(d.damaged <= Some(at as u64));
                    assert!(wrong(&heights, &d).0 <= f64::from(d.bound), "byte {at}");
                }
            }
        }
    }
}

/// A damaged second block leaves the first: the answer is what that block gives.
#[test]
fn what_lies_before_the_damage_is_true() {
    let heights = grids::bundled("crater_2005-06-15_10m").heights;
    let mut bytes = coded(&heights, Profile::Cubic, &[0]).bytes;
    let (_, head) = Header::read(&bytes).unwrap();
    bytes[head + BLOCK + 4 + 100] ^= 1;
    let d = read(&bytes, Stop::End).unwrap();
    assert_eq!(d.damaged, Some(BLOCK as u64));
    let short = read(&bytes[..head + BLOCK + 4], Stop::End).unwrap();
    assert_eq!((d.reached, &d.z), (short.reached, &short.z));
    assert!(wrong(&heights, &d).0 <= f64::from(d.bound));
    bytes[head + 7] ^= 1;
    let e = read(&bytes, Stop::End).err().unwrap().to_string();
    assert!(e.contains("block at byte 0") && e.contains("fetch the file again"), "{e}");
}

/// Bodies of arbitrary bytes with right checksums, heads of any sizes: decoded to something, in memory that the head allows.
#[test]
fn arbitrary_bodies() {
    let mut r = Random::new(3);
    for seed in 0..600 {
        let side = 1 + r.below(40) as usize;
        let cols = 1 + r.below(side as u64) as usize;
        let body: Vec<u8> =
            (0..r.below(400)).map(|_| if seed % 3 == 0 { 255 } else { r.next() as u8 }).collect();
        let layers = [&[0][..], &[1 << 20], &[13, 4, 1, 0], &[127, 0]][r.below(4) as usize].to_vec();
        let lattice = Lattice::around(side, side).unwrap();
        let header = Header {
            cols,
            rows: side,
            lattice,
            profile: DENSE[r.below(DENSE.len() as u64) as usize],
            bounds: vec![7; 2 * lattice.n() as usize + layers.len()],
            layers,
            mask: r.below(2) == 0,
            texture: None,
            given: None,
            place: Default::default(),
            body: body.len() as u64,
        };
        let mut bytes = header.bytes();
        bytes.extend_from_slice(&body);
        bytes.extend_from_slice(&crc(&body).to_le_bytes());
        for stop in [Stop::End, Stop::Bytes(bytes.len() as u64 - 5), Stop::Error(7.0)] {
            if let Ok(d) = read(&bytes, stop) {
                let posts = lattice.side() * lattice.side();
                assert_eq!((d.surface().len(), d.z.len()), (posts, posts));
            }
        }
    }
}

/// CRC-32C, bit by bit.
fn crc(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, b| {
        (0..8).fold(crc ^ u32::from(*b), |c, _| if c & 1 == 1 { c >> 1 ^ 0x82f6_3b78 } else { c >> 1 })
    })
}

/// Heads with right checksums that ask for what cannot be: refused before anything is allocated.
#[test]
fn absurd_heads() {
    let good = coded(&Heights::new(9, 9, (0..81).collect()), Profile::Cubic, &[4, 1, 0]).bytes;
    let (_, length) = Header::read(&good).unwrap();
    // Profile, flags, n, columns, rows, layers, bounds.
    let fields = [
        (11, 9),
        (11, 0),
        (12, 16),
        (12, 128),
        (13, 14),
        (13, 255),
        (14, 0),
        (14, 10),
        (15, 0),
        (15, 99),
        (16, 0),
        (16, 9),
    ];
    for (at, value) in fields.into_iter().chain([(17, 3), (17, 1), (18, 4), (18, 2)]) {
        let mut bytes = good.clone();
        bytes[at] = value;
        let crc = crc(&bytes[..length - 4]);
        bytes[length - 4..length].copy_from_slice(&crc.to_le_bytes());
        assert!(Header::read(&bytes).is_err(), "{value} at byte {at}");
    }
    let mut r = Random::new(8);
    for _ in 0..20_000 {
        let mut bytes = good[..length].to_vec();
        for _ in 0..1 + r.below(6) {
            let at = 9 + r.below(length as u64 - 13) as usize;
            bytes[at] = r.next() as u8;
        }
        let crc = crc(&bytes[..length - 4]);
        bytes[length - 4..length].copy_from_slice(&crc.to_le_bytes());
        if let Ok((header, _)) = Header::read(&bytes) {
            assert!(header.lattice.n() <= N_MAX && header.cols <= header.lattice.side());
            assert_eq!(header.bounds.len(), 2 * header.lattice.n() as usize + header.layers.len());
        }
    }
}

#[test]
fn arbitrary_bytes() {
    let mut r = Random::new(4);
    let good = coded(&Heights::new(9, 9, (0..81).collect()), Profile::Cubic, &[1]).bytes;
    for _ in 0..5000 {
        let mut bytes: Vec<u8> = (0..r.below(300)).map(|_| r.next() as u8).collect();
        let keep = r.below(good.len() as u64 + 1) as usize;
        bytes.splice(..0, good[..keep].iter().copied());
        let _ = read(&bytes, Stop::End);
    }
    assert_eq!(whole(&good).bound, 1);
}
