//! Every part of the format at once: profiles, masks, layers, given heights, textures; cut anywhere, and made of rubbish.

use crate::support::random::Random;
use crate::support::streams::wrong;
use terraquilt_codecs::Error;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::heights::HEIGHT_MAX;
use terraquilt_codecs::gtb::texture::{Cells, Reader, Settings, Writer};
use terraquilt_codecs::gtb::{Decoded, Encoded, Given, Header, Heights, Options, Place, Profile, Stop};
use terraquilt_codecs::gtb::{decode, decode_within, encode};
use terraquilt_codecs::lattice::{Lattice, N_MAX};

const PROFILES: [Profile; 3] = [Profile::Sparse, Profile::Cubic, Profile::Adaptive];

/// How many rounds of a fuzz loop: `TERRAQUILT_FUZZ_ROUNDS` asks for more.
fn rounds(few: u64) -> u64 {
    std::env::var("TERRAQUILT_FUZZ_ROUNDS").ok().and_then(|v| v.parse().ok()).unwrap_or(few)
}

fn layers(r: &mut Random, profile: Profile) -> Vec<u32> {
    match profile {
        Profile::Sparse => vec![[1, 1, 3, 8, 1 << 20][r.below(5) as usize]],
        _ => [&[0][..], &[3], &[1 << 20], &[13, 4, 1, 0], &[127, 0], &[60, 5]][r.below(6) as usize].to_vec(),
    }
}

fn cells(r: &mut Random) -> Cells {
    let n = 1 + r.below(6) as u32;
    let side = 1usize << n;
    let kind = r.below(4);
    let rgb = (0..side * side)
        .map(|k| match kind {
            0 => [7; 3],
            1 => [r.next() as u8, r.next() as u8, r.next() as u8],
            _ if k % side + k / side < side => [20, (k / side * 3) as u8, 90],
            _ => [200, 100 + r.below(40) as u8, 30],
        })
        .collect();
    let void = match r.below(4) {
        0 => (0..side * side).map(|k| k % side < side / 2).collect(),
        1 => vec![true; side * side],
        _ => Vec::new(),
    };
    Cells { n, rgb, void }
}

fn heights(r: &mut Random) -> Heights {
    let (cols, rows) = (1 + r.below(36) as usize, 1 + r.below(36) as usize);
    let rough = [1, 30, 4000, 2 * HEIGHT_MAX as u64][r.below(4) as usize];
    let z = (0..cols * rows)
        .map(|k| match rough {
            1 => (k % cols / 2 * 5) as i32 - (k / cols) as i32,
            _ => r.below(rough) as i32 - (rough / 2) as i32,
        })
        .collect();
    let void = match r.below(3) {
        0 => (0..cols * rows).map(|k| (k % cols) / 7 % 2 == 0 || r.below(9) == 0).collect(),
        1 if r.below(5) == 0 => vec![true; cols * rows],
        _ => Vec::new(),
    };
    Heights { cols, rows, z, void }
}

/// Heights of some posts with data, not far from what they are.
fn held(r: &mut Random, h: &Heights) -> Given {
    let side = Lattice::around(h.cols, h.rows).unwrap().side();
    let mut out = Given { z: vec![0; side * side], known: vec![false; side * side] };
    let every = 1 + r.below(5);
    for k in 0..h.z.len() {
        if !h.is_void(k) && r.below(every) == 0 {
            let at = k / h.cols * side + k % h.cols;
            out.known[at] = true;
            out.z[at] = h.z[k] + r.below(7) as i32 - 3;
        }
    }
    out
}

fn read(bytes: &[u8], stop: Stop, given: Option<&Given>, n: Option<u32>) -> Result<Decoded, Error> {
    let mut body = Vec::new();
    match n {
        None => decode(bytes, &mut body, stop, given, &mut Alone, &mut |_| true),
        Some(n) => {
            let mut reader = Reader::new(n);
            let got = decode(bytes, &mut body, stop, given, &mut reader, &mut |_| true);
            assert_eq!(reader.picture(5).rgb.len(), 1 << (2 * n));
            got
        }
    }
}

fn write(h: &Heights, options: &Options, cells: Option<&Cells>, r: &mut Random) -> Encoded {
    match cells {
        None => encode(h, options, &mut Alone, &mut |_| true).unwrap(),
        Some(cells) => {
            let plain = [0.0, 0.005, 0.3][r.below(3) as usize];
            let settings = Settings { plain, depth_max: r.below(40) as u32, ..Settings::default() };
            encode(h, options, &mut Writer::new(cells, &settings).unwrap(), &mut |_| true).unwrap()
        }
    }
}

/// Whatever travels together, wherever it is cut, whyever it stops: the surface is as good as it says.
#[test]
fn bounds_hold_for_everything_together() {
    // Seed 2836: a given post among posts that all lie lower.
    for seed in (0..rounds(150)).chain([2836]) {
        let mut r = Random::new(seed);
        let h = heights(&mut r);
        let lattice = Lattice::around(h.cols, h.rows).unwrap();
        let profile = PROFILES[r.below(3) as usize];
        let given = (r.below(3) == 0).then(|| held(&mut r, &h));
        let picture = (r.below(3) == 0).then(|| cells(&mut r));
        let selected = (r.below(2) == 0).then(|| r.selection(lattice));
        let options = Options {
            layers: layers(&mut r, profile),
            given: given.as_ref(),
            texture: picture.as_ref().map(|c| c.n),
            selected: selected.as_deref().filter(|_| profile == Profile::Sparse),
            ..Options::new(profile, 0)
        };
        let made = write(&h, &options, picture.as_ref(), &mut r);
        let what = format!("seed {seed}: {} x {}, {profile:?} {:?}", h.cols, h.rows, options.layers);
        let n = options.texture;
        let whole = read(&made.bytes, Stop::End, given.as_ref(), n).unwrap();
        assert!(whole.complete && whole.z == made.z && whole.bound == made.error_max, "{what}");
        let mut stops: Vec<Stop> =
            (0..12).map(|_| Stop::Bytes(r.below(made.bytes.len() as u64 + 1))).collect();
        stops
            .extend(made.passes.iter().flat_map(|p| [Stop::Bytes(p.bytes), Stop::Error(f64::from(p.bound))]));
        stops.extend([Stop::End, Stop::Error(0.0), Stop::Error(f64::NAN)]);
        for stop in stops {
            let Ok(d) = read(&made.bytes, stop, given.as_ref(), n) else { continue };
            let (most, _) = wrong(&h, &d);
            assert!(most <= f64::from(d.bound), "{what}, {stop:?}: {most} and not {}", d.bound);
            if let Stop::Error(e) = stop {
                assert!(f64::from(d.bound) <= e || d.complete || e.is_nan(), "{what}, {stop:?}: {}", d.bound);
            }
            for k in 0..h.z.len() {
                let at = k / h.cols * lattice.side() + k % h.cols;
                assert_eq!(d.is_free(at), h.is_void(k), "{what}, {stop:?}: post {k}");
            }
        }
        // At the end of a pass at least that pass is there.
        for p in &made.passes {
            let d = read(&made.bytes, Stop::Bytes(p.bytes), given.as_ref(), n).unwrap();
            let there = |at: &terraquilt_codecs::gtb::PassEnd| (at.layer, at.pass) == (p.layer, p.pass);
            assert!(d.passes.iter().any(there), "{what}: {p:?} is not there after its bytes");
        }
    }
}

/// Bodies of rubbish behind true heads, with right checksums.
#[test]
fn rubbish_behind_true_heads() {
    for seed in 0..rounds(400) {
        let mut r = Random::new(seed ^ 0x5eed);
        let profile = PROFILES[r.below(3) as usize];
        let layers = layers(&mut r, profile);
        let side = 1 + r.below(60) as usize;
        let lattice = Lattice::around(side, side).unwrap();
        let posts = lattice.side() * lattice.side();
        let given = (r.below(3) == 0).then(|| Given {
            z: (0..posts).map(|_| r.next() as i32 >> (r.below(2) * 20)).collect(),
            known: (0..posts).map(|_| r.below(3) == 0).collect(),
        });
        let texture = (r.below(2) == 0).then(|| 1 + r.below(7) as u32);
        let (length, like) = (r.below(1500), r.below(4));
        let body: Vec<u8> = (0..length)
            .map(|k| match like {
                0 => 255,
                1 => 0,
                2 if k > 40 => (r.next() & r.next() & r.next()) as u8,
                _ => r.next() as u8,
            })
            .collect();
        let header = Header {
            cols: 1 + r.below(side as u64) as usize,
            rows: 1 + r.below(side as u64) as usize,
            lattice,
            profile,
            bounds: vec![9; 2 * lattice.n() as usize + layers.len()],
            layers,
            mask: r.below(2) == 0,
            texture,
            given: given.as_ref().map(Given::state),
            place: Place::default(),
            body: body.len() as u64,
        };
        let mut bytes = header.bytes();
        bytes.extend_from_slice(&body);
        bytes.extend_from_slice(&crc32c::crc32c(&body).to_le_bytes());
        for stop in [Stop::End, Stop::Bytes(bytes.len() as u64 - 5)] {
            if let Ok(d) = read(&bytes, stop, given.as_ref(), texture) {
                assert!(d.surface().len() == posts && d.surface().iter().all(|z| z.is_finite()));
            }
        }
    }
}

/// A head of a few bytes that asks for the greatest texture is refused before anything is allocated for it, by whoever sets a limit.
#[test]
fn a_great_texture_meets_the_limit() {
    let heights = Heights::new(3, 3, vec![0; 9]);
    let small = Cells { n: 1, rgb: vec![[9; 3]; 4], void: Vec::new() };
    let options = Options { texture: Some(1), ..Options::new(Profile::Cubic, 0) };
    let mut writer = Writer::new(&small, &Settings::default()).unwrap();
    let bytes = encode(&heights, &options, &mut writer, &mut |_| true).unwrap().bytes;
    let (mut header, length) = Header::read(&bytes).unwrap();
    header.texture = Some(N_MAX);
    let great = [header.bytes(), bytes[length..].to_vec()].concat();
    let mut body = Vec::new();
    let mut reader = Reader::new(N_MAX);
    let found = decode_within(1 << 20, &great, &mut body, Stop::End, None, &mut reader, &mut |_| true);
    assert!(matches!(found, Err(Error::Limit { what: "cells of the texture", .. })));
    header.texture = Some(0);
    let none = [header.bytes(), bytes[length..].to_vec()].concat();
    assert!(Header::read(&none).is_err());
}

/// A companion that does not take what the head says, or takes something else, is refused: the rest would be read as heights.
#[test]
fn another_companion_is_refused() {
    let heights = Heights::new(9, 9, (0..81).collect());
    let picture = Cells { n: 3, rgb: vec![[9; 3]; 64], void: Vec::new() };
    let options = Options { texture: Some(3), ..Options::new(Profile::Cubic, 0) };
    let mut writer = Writer::new(&picture, &Settings::default()).unwrap();
    let bytes = encode(&heights, &options, &mut writer, &mut |_| true).unwrap().bytes;
    assert!(read(&bytes, Stop::End, None, Some(3)).is_ok());
    for n in [None, Some(2), Some(4), Some(N_MAX)] {
        let said = match n {
            None => decode(&bytes, &mut Vec::new(), Stop::End, None, &mut Alone, &mut |_| true),
            Some(n) => decode(&bytes, &mut Vec::new(), Stop::End, None, &mut Reader::new(n), &mut |_| true),
        };
        assert!(said.err().is_some_and(|e| e.to_string().contains("2^3 cells")), "{n:?}");
    }
    assert!(encode(&heights, &Options::new(Profile::Cubic, 0), &mut writer, &mut |_| true).is_err());
    assert!(encode(&heights, &options, &mut Alone, &mut |_| true).is_err());
}

/// A writer and a reader that have gone with one stream go with another just as well.
#[test]
fn companions_begin_anew() {
    let mut r = Random::new(11);
    let picture = loop {
        let found = cells(&mut r);
        if found.n == 6 && found.void.is_empty() {
            break found;
        }
    };
    let heights = Heights::new(9, 9, (0..81).collect());
    let options = Options { texture: Some(6), ..Options::new(Profile::Cubic, 0) };
    let mut writer = Writer::new(&picture, &Settings { plain: 0.05, ..Settings::default() }).unwrap();
    let first = encode(&heights, &options, &mut writer, &mut |_| true).unwrap().bytes;
    let sizes = writer.sizes();
    assert_eq!(encode(&heights, &options, &mut writer, &mut |_| true).unwrap().bytes, first);
    assert_eq!(writer.sizes(), sizes);
    let mut reader = Reader::new(6);
    for cut in [first.len() / 2, first.len(), first.len()] {
        let _ = decode(&first[..cut], &mut Vec::new(), Stop::End, None, &mut reader, &mut |_| true);
        let mut fresh = Reader::new(6);
        let _ = decode(&first[..cut], &mut Vec::new(), Stop::End, None, &mut fresh, &mut |_| true);
        assert_eq!(reader.picture(3), fresh.picture(3), "{cut} bytes");
    }
    assert_eq!(reader.picture(3), writer.picture(3));
}

/// What no reader takes is not written.
#[test]
fn places_that_make_no_head_are_refused() {
    let heights = Heights::new(2, 2, vec![0; 4]);
    let bad = [
        Place { unit: 0.0, ..Place::default() },
        Place { base: f64::NAN, ..Place::default() },
        Place { given_error: -1.0, ..Place::default() },
        Place { transform: [f64::INFINITY; 6], ..Place::default() },
        Place { crs: "x".repeat(70_000), ..Place::default() },
    ];
    for place in bad {
        let options = Options { place: place.clone(), ..Options::new(Profile::Cubic, 0) };
        assert!(encode(&heights, &options, &mut Alone, &mut |_| true).is_err(), "{place:?}");
    }
    let place = Place { crs: "x".repeat(15 << 10), ..Place::default() };
    let options = Options { place: place.clone(), ..Options::new(Profile::Cubic, 0) };
    let bytes = encode(&heights, &options, &mut Alone, &mut |_| true).unwrap().bytes;
    assert_eq!(read(&bytes, Stop::End, None, None).unwrap().header.place, place);
}
