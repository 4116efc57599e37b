//! Profile `adaptive`: what went in comes out, within the bound, from any prefix, whatever the bytes.

use proptest::prelude::*;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Encoded, Given, Heights, Options, Profile, Stop, decode, encode};

/// Numbers from a seed, below `under`.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, under: u32) -> i32 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) % u64::from(under.max(1))) as i32
    }
}

/// Ground: displaced midpoints, each level `smooth` halvings calmer, with roofs and a flat lake.
fn ground(side: usize, seed: u64, smooth: u32, roofs: bool) -> Vec<i32> {
    let (mut dice, mut z) = (Dice(seed), vec![0i32; side * side]);
    let mut step = side.next_power_of_two();
    let mut height = 4000u32;
    while step > 0 {
        for y in (0..side).step_by(step) {
            for x in (0..side).step_by(step) {
                let (v, u) = (y / step / 2 * step * 2, x / step / 2 * step * 2);
                let (v1, u1) = ((v + 2 * step).min(side - 1), (u + 2 * step).min(side - 1));
                if (v, u) != (y, x) || step == side.next_power_of_two() {
                    let four = [[v, u], [v, u1], [v1, u], [v1, u1]].map(|[a, b]| z[a * side + b]);
                    z[y * side + x] = four.iter().sum::<i32>() / 4 + dice.roll(height) - height as i32 / 2;
                }
            }
        }
        height = (height >> smooth).max(2);
        step /= 2;
    }
    if roofs {
        for _ in 0..side / 4 {
            let (y, x) = (dice.roll(side as u32) as usize, dice.roll(side as u32) as usize);
            let up = 300 + dice.roll(500);
            for v in y..(y + 5).min(side) {
                z[v * side + x..v * side + (x + 7).min(side)].iter_mut().for_each(|h| *h += up);
            }
        }
    }
    z.iter().map(|h| (*h).max(-900)).collect()
}

fn encoded(heights: &Heights, e: u32) -> Encoded {
    encode(heights, &Options::new(Profile::Adaptive, e), &mut Alone, &mut |_| true).unwrap()
}

fn decoded(bytes: &[u8]) -> Result<Decoded, terraquilt_codecs::Error> {
    decode(bytes, &mut Vec::new(), Stop::End, None, &mut Alone, &mut |_| true)
}

/// Encodes, decodes, compares; gives the stream.
fn there_and_back(heights: &Heights, e: u32) -> Encoded {
    let stream = encoded(heights, e);
    let back = decoded(&stream.bytes).unwrap();
    assert!(back.complete, "E = {e}");
    assert!(back.z == stream.z, "E = {e}: the decoder has other heights than the encoder");
    let side = back.header.lattice.side();
    for (k, z) in heights.z.iter().enumerate() {
        let got = back.z[k / heights.cols * side + k % heights.cols];
        assert!(heights.is_void(k) || got.abs_diff(*z) <= e, "post {k}: {got} for {z}, E = {e}");
    }
    stream
}

#[test]
fn every_bound_on_every_ground() {
    for e in [0, 1, 2, 5, 10, 20, 60] {
        for (side, smooth, roofs) in [(65, 1, false), (65, 0, false), (129, 1, true), (100, 2, false)] {
            there_and_back(&Heights::new(side, side, ground(side, u64::from(e) + 5, smooth, roofs)), e);
        }
    }
}

#[test]
fn shapes_from_one_post_on() {
    for (cols, rows) in
        [(1, 1), (2, 1), (1, 2), (2, 2), (3, 3), (3, 2), (5, 4), (9, 1), (1, 33), (40, 17), (70, 3)]
    {
        let z = ground(cols.max(rows), 3, 1, false)[..cols * rows].to_vec();
        for e in [0, 1, 10] {
            there_and_back(&Heights::new(cols, rows, z.clone()), e);
        }
    }
}

/// Heights as far apart as they may be, in a chessboard and at random: nothing overflows.
#[test]
fn extremes() {
    let most = 1 << 25;
    for e in [0, 1, 60, 100_000] {
        let board = (0..33 * 33).map(|k| if k % 2 == 0 { most } else { -most }).collect();
        there_and_back(&Heights::new(33, 33, board), e);
        let mut dice = Dice(9);
        let noise = (0..65 * 65).map(|_| dice.roll(1 << 26) - most).collect();
        there_and_back(&Heights::new(65, 65, noise), e);
        there_and_back(&Heights::new(65, 65, vec![-most; 65 * 65]), e);
    }
}

#[test]
fn voids_and_given_heights_cost_nothing() {
    let side = 65;
    let z = ground(side, 11, 1, false);
    let whole = there_and_back(&Heights::new(side, side, z.clone()), 0);
    let void = (0..side * side).map(|k| k % side > 20 && k / side > 10).collect();
    let holed = there_and_back(&Heights { void, ..Heights::new(side, side, z.clone()) }, 0);
    assert!(holed.bytes.len() * 2 < whole.bytes.len());
    there_and_back(&Heights { void: vec![true; side * side], ..Heights::new(side, side, z.clone()) }, 1);
    // A receiver that has three quarters already.
    let known: Vec<bool> = (0..side * side).map(|k| k % 2 == 0 || k / side % 2 == 0).collect();
    let given = Given { z: z.iter().zip(&known).map(|(z, k)| if *k { *z } else { 0 }).collect(), known };
    let options = Options { given: Some(&given), ..Options::new(Profile::Adaptive, 0) };
    let rest = encode(&Heights::new(side, side, z.clone()), &options, &mut Alone, &mut |_| true).unwrap();
    assert!(rest.bytes.len() * 2 < whole.bytes.len());
    let mut body = Vec::new();
    let back = decode(&rest.bytes, &mut body, Stop::End, Some(&given), &mut Alone, &mut |_| true).unwrap();
    assert_eq!(back.z, z);
}

/// Every prefix decodes to a beginning of the whole: what it knows is as in the whole, and more bytes know no less.
#[test]
fn every_cut() {
    for (e, roofs) in [(0, false), (1, true), (10, false)] {
        let stream = encoded(&Heights::new(33, 33, ground(33, 21, 1, roofs)), e);
        let mut most = 0;
        for cut in 0..=stream.bytes.len() {
            let Ok(part) = decoded(&stream.bytes[..cut]) else {
                assert_eq!(most, 0, "cut {cut}: an error after a surface");
                continue;
            };
            let known = part.known();
            let count = known.iter().filter(|k| **k).count();
            assert!(count >= most, "cut {cut}: {count} posts, {most} before");
            most = count;
            for at in (0..known.len()).filter(|at| known[*at]) {
                assert_eq!(part.z[at], stream.z[at], "cut {cut}, post {at}");
            }
            assert_eq!(part.complete, cut == stream.bytes.len());
        }
        assert_eq!(most, 33 * 33);
    }
}

/// The same heights give the same bytes; smooth ground takes few of them.
#[test]
fn same_bytes_and_few() {
    let plane = |k: usize| (k % 129) as i32 * 7 + (k / 129) as i32 * 3;
    let heights = Heights::new(129, 129, (0..129 * 129).map(plane).collect());
    let stream = encoded(&heights, 0);
    assert_eq!(stream.bytes, encoded(&heights, 0).bytes);
    assert!(stream.bytes.len() < 129 * 129 / 16, "a plane takes {} bytes", stream.bytes.len());
    let cubic = encode(&heights, &Options::new(Profile::Cubic, 0), &mut Alone, &mut |_| true).unwrap();
    assert!(stream.bytes.len() < cubic.bytes.len() + 64);
}

/// The body of a stream with other bytes and true checksums.
fn forged(stream: &[u8], body: &[u8]) -> Vec<u8> {
    let head = terraquilt_codecs::gtb::Header::read(stream).unwrap().1;
    let mut out = stream[..head].to_vec();
    for block in body.chunks(1 << 14) {
        out.extend_from_slice(block);
        out.extend_from_slice(&crc32c::crc32c(block).to_le_bytes());
    }
    out
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn random_heights_come_back(
        cols in 1usize..40,
        rows in 1usize..40,
        e in prop::sample::select(vec![0u32, 1, 2, 5, 10, 20, 60]),
        range in prop::sample::select(vec![1u32, 2, 30, 4000, 1 << 26]),
        seed in any::<u64>(),
    ) {
        let mut dice = Dice(seed);
        let z = (0..cols * rows).map(|_| dice.roll(range) - (range / 2) as i32).collect();
        let void = (0..cols * rows).map(|_| range == 30 && dice.roll(3) == 0).collect();
        there_and_back(&Heights { void, ..Heights::new(cols, rows, z) }, e);
    }

    /// Arbitrary bytes give a surface or an error, in debug builds, too.
    #[test]
    fn rubbish_decodes_to_something(body in prop::collection::vec(any::<u8>(), 200..3000), e in 0u32..30) {
        let stream = encoded(&Heights::new(65, 65, ground(65, 2, 0, true)), e);
        let head = terraquilt_codecs::gtb::Header::read(&stream.bytes).unwrap().1;
        // One block, and its checksum.
        let body_at = head..stream.bytes.len() - 4;
        assert!(body_at.len() <= 1 << 14);
        let long: Vec<u8> = body.iter().copied().cycle().take(body_at.len()).collect();
        let bytes = forged(&stream.bytes, &long);
        for cut in [bytes.len(), bytes.len() / 2] {
            if let Ok(part) = decoded(&bytes[..cut]) {
                prop_assert!(part.surface().iter().all(|z| z.is_finite()));
            }
        }
        // A true beginning, then rubbish.
        let mut mixed = stream.bytes[body_at].to_vec();
        let from = mixed.len() / 3;
        for (k, b) in mixed[from..].iter_mut().enumerate() {
            *b ^= body[k % body.len()];
        }
        let part = decoded(&forged(&stream.bytes, &mixed)).unwrap();
        prop_assert!(part.damaged.is_none() && (part.reached.layer == 1 || part.reached.passes > 3));
    }
}
