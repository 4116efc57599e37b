//! Streams of terrain: `cargo bench -p terraquilt-codecs --bench gtb [NAME]`. Rates are of posts.
//!
//! Mountains made of octaves of noise from a seed; needs nothing else.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Encoded, Heights, Options, Profile, Stop, decode, encode};

const SIDE: usize = 513;

/// Ground of some 2000 units from valley to top: values at the corners of squares, smoothly between them, ten octaves.
fn mountains() -> Heights {
    let value = |octave: u64, y: u64, x: u64| {
        let mut v = (octave << 40 ^ y << 20 ^ x).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        v ^= v >> 29;
        v = v.wrapping_mul(0xbf58_476d_1ce4_e5b9);
        (v >> 40) as f64 / (1u64 << 24) as f64 - 0.5
    };
    let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
    let height = |y: usize, x: usize| {
        let octaves = (0..10).map(|k| {
            let step = 512 >> k;
            let (i, j) = ((y / step) as u64, (x / step) as u64);
            let (v, u) = (smooth((y % step) as f64 / step as f64), smooth((x % step) as f64 / step as f64));
            let row = |i: u64| value(k, i, j) * (1.0 - u) + value(k, i, j + 1) * u;
            (row(i) * (1.0 - v) + row(i + 1) * v) * 2000.0 * 0.45_f64.powi(k as i32)
        });
        octaves.sum::<f64>().round() as i32
    };
    Heights::new(SIDE, SIDE, (0..SIDE * SIDE).map(|k| height(k / SIDE, k % SIDE)).collect())
}

fn coded(heights: &Heights, profile: Profile, layers: &[u32]) -> Encoded {
    let options = Options { layers: layers.to_vec(), ..Options::new(profile, 0) };
    encode(heights, &options, &mut Alone, &mut |_| true).expect("mountains")
}

fn read(bytes: &[u8]) -> Decoded {
    decode(bytes, &mut Vec::new(), Stop::End, None, &mut Alone, &mut |_| true).expect("it was just written")
}

fn streams(c: &mut Criterion) {
    let ground = mountains();
    let mut holed = ground.clone();
    holed.void = (0..SIDE * SIDE).map(|k| (k / SIDE / 37 + k % SIDE / 53).is_multiple_of(7)).collect();
    let mut group = c.benchmark_group("gtb");
    group.throughput(Throughput::Elements((SIDE * SIDE) as u64)).sample_size(20);
    for (name, heights, profile, layers) in [
        ("cubic, 10", &ground, Profile::Cubic, &[10][..]),
        ("cubic, 0", &ground, Profile::Cubic, &[0]),
        ("cubic, 10, voids", &holed, Profile::Cubic, &[10]),
        ("cubic, 13 4 1 0", &ground, Profile::Cubic, &[13, 4, 1, 0]),
    ] {
        let bytes = coded(heights, profile, layers).bytes;
        group.bench_function(BenchmarkId::new("encode", name), |b| {
            b.iter(|| coded(black_box(heights), profile, layers));
        });
        group.bench_function(BenchmarkId::new("decode", name), |b| b.iter(|| read(black_box(&bytes))));
    }
}

criterion_group!(benches, streams);
criterion_main!(benches);
