//! Golden files: tiles of version 1 as they were first written. They are read as then, and the same input still gives the same bytes.

use crate::golden::heights;
use std::path::PathBuf;
use terraquilt_codecs::fractal::grid::points;
use terraquilt_codecs::fractal::{
    Encoded, Kind, Options, Partition, Search, Space, Tile, Walk, encode_heights, encode_picture,
    encode_volume,
};
use terraquilt_codecs::heights::Place;
use terraquilt_codecs::work::Alone;

/// Names, and checksums of what comes out: at zoom 1, and of walks to depth 5.
const CASES: [(&str, u32, u32); 6] = [
    ("maps", 0x32ca_cebb, 0x8012_68c0),
    ("bounded_voids", 0x43fa_ea48, 0xa96a_344b),
    ("single", 0x2742_71a6, 0x1faa_a882),
    ("jump", 0xac0c_0424, 0x34b7_6beb),
    ("colour", 0x192c_ffd5, 0xccfd_489a),
    ("volume", 0x1b08_aceb, 0xa81b_c661),
];

fn written(name: &str) -> Encoded {
    let place = Place {
        unit: 0.1,
        base: 100.0,
        given_error: 0.05,
        transform: [500_000.0, 30.0, 0.5, 4_100_000.0, 0.0, -30.0],
        crs: "EPSG:32611".to_string(),
        vertical: "m".to_string(),
        source: "golden".to_string(),
    };
    let of = |partition| Options { partition: Some(partition), ..Options::default() };
    let ground = |voids, options: Options| encode_heights(&heights(voids), &place, &[], &options, &Alone);
    match name {
        "maps" => ground(false, of(Partition::Maps(200))),
        "bounded_voids" => {
            ground(true, Options { bound: Some(4), search: Search::Classes, ..Options::default() })
        }
        "single" => ground(
            false,
            Options { range_min: Some(1), search: Search::Near(6), ..of(Partition::Slope(3.0)) },
        ),
        "jump" => {
            let few = Options {
                jump: 6,
                bound: Some(2),
                range_min: Some(1),
                search: Search::Near(5),
                ..of(Partition::Slope(400.0))
            };
            ground(true, few)
        }
        "colour" => {
            let rgb = include_bytes!("../data/landsat_sfbay_128.rgb");
            encode_picture([128, 128], 3, rgb, "golden", &[], &of(Partition::Slope(200.0)), &Alone)
        }
        _ => {
            let size = [20, 24, 16];
            let ball = |p: [usize; 3]| {
                let d: i32 = p.iter().map(|v| (*v as i32 - 9).pow(2)).sum();
                (120 - 2 * d + (p[0] * p[1]) as i32 % 7).clamp(-127, 127) as i8
            };
            let values: Vec<i8> = points(size).map(ball).collect();
            let options = Options { isometries: Some(48), ..of(Partition::Slope(4.0)) };
            let space = Space { origin: [0.25, -1.5, 3.0], voxel: 0.5 };
            encode_volume(size, &values, space, "golden", &options, &Alone)
        }
    }
    .unwrap()
}

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("v1_{name}.ifs"))
}

/// Checksums of the samples at zoom 1 and of some walks, all to the last bit.
fn sums(tile: &Tile) -> (u32, u32) {
    let crc = |bytes: Vec<u8>| crc32c::crc32c(&bytes);
    let bits = |values: &[f64]| crc(values.iter().flat_map(|v| v.to_bits().to_le_bytes()).collect());
    let walked = |walk: Walk<2>| {
        let values: Vec<f64> = (0..500)
            .map(|k| walk.value([f64::from(k * 7 % 61) + 0.3, f64::from(k * 11 % 45) + 0.7], k as u32 % 6))
            .collect();
        bits(&values)
    };
    match tile.header.kind {
        Kind::Volume => {
            let walk = Walk::new(tile.volume.as_ref().unwrap()).unwrap();
            let values: Vec<f64> = (0..500)
                .map(|k| walk.value([3.3, 7.7, 0.01].map(|v| v * (1.0 + f64::from(k) / 250.0)), 5))
                .collect();
            (bits(&tile.volume().unwrap().values), bits(&values))
        }
        Kind::Heights => {
            let z = tile.heights().unwrap().z.iter().flat_map(|z| z.to_le_bytes()).collect();
            (crc(z), walked(tile.walk(0).unwrap()))
        }
        _ => (crc(tile.picture(1).unwrap().samples), walked(tile.walk(2).unwrap())),
    }
}

#[test]
fn golden_tiles_are_read_and_written_as_ever() {
    for (name, samples, walks) in CASES {
        let stored = std::fs::read(file(name)).unwrap();
        let tile = Tile::read(&stored).unwrap();
        assert!(tile.complete);
        assert_eq!(sums(&tile), (samples, walks), "{name}");
        assert!(written(name).bytes == stored, "{name}: other bytes than ever");
    }
}

#[test]
#[ignore = "writes the golden files: cargo test --test main make_golden_tiles -- --ignored --nocapture"]
fn make_golden_tiles() {
    for (name, ..) in CASES {
        let e = written(name);
        std::fs::write(file(name), &e.bytes).unwrap();
        let (samples, walks) = sums(&Tile::read(&e.bytes).unwrap());
        println!("    (\"{name}\", {samples:#06x}, {walks:#06x}), // {} bytes", e.bytes.len());
    }
}
