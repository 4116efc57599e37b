//! Golden files: streams of version 1 as they were first written. They are read as then, and the same input still gives the same bytes.

use std::path::PathBuf;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::texture::{Cells, Reader, Settings, Writer};
use terraquilt_codecs::gtb::{Decoded, Heights, Options, Place, Profile, Stop, decode, encode};

/// Hills, with a lake of voids.
pub fn heights(with_voids: bool) -> Heights {
    let (cols, rows) = (61, 45);
    let hill = |x: i64, y: i64| {
        let bump = |cx: i64, cy: i64, h: i64| h * 400 / (400 + (x - cx) * (x - cx) + (y - cy) * (y - cy));
        (bump(15, 12, 900) + bump(44, 30, 1400) + (x * 7919 + y * 104_729) % 13) as i32
    };
    let at = |k: usize| ((k % cols) as i64, (k / cols) as i64);
    let z = (0..cols * rows).map(|k| hill(at(k).0, at(k).1)).collect();
    let lake = |k: usize| (at(k).0 - 30).pow(2) + (at(k).1 - 10).pow(2) < 50;
    let void = if with_voids { (0..cols * rows).map(lake).collect() } else { Vec::new() };
    Heights { cols, rows, z, void }
}

fn picture() -> Cells {
    let bytes = include_bytes!("data/landsat_sfbay_128.rgb");
    Cells { n: 7, rgb: bytes.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(), void: Vec::new() }
}

/// Name, profile, layers, voids and texture; checksums of the heights and of the picture that come out.
type Case = (&'static str, Profile, &'static [u32], bool, u32, Option<u32>);

const CASES: [Case; 5] = [
    ("cubic", Profile::Cubic, &[0], false, 0x9b79_7a09, None),
    ("cubic_layers_voids", Profile::Cubic, &[13, 4, 1, 0], true, 0xefcc_09dd, None),
    ("adaptive", Profile::Adaptive, &[2], true, 0xb987_0917, None),
    ("sparse", Profile::Sparse, &[1], false, 0x33a7_9e5c, None),
    ("texture", Profile::Cubic, &[1], false, 0x0ee8_c98b, Some(0x9618_c1ea)),
];

fn place() -> Place {
    Place {
        unit: 0.1,
        base: 100.0,
        given_error: 0.05,
        transform: [500_000.0, 30.0, 0.0, 4_100_000.0, 0.0, -30.0],
        crs: "EPSG:32611".to_string(),
        vertical: "m".to_string(),
        source: "golden".to_string(),
    }
}

fn file(name: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(format!("v1_{name}.gtb"))
}

fn written((_, profile, layers, voids, _, texture): &Case) -> Vec<u8> {
    let options = Options {
        layers: layers.to_vec(),
        place: place(),
        texture: texture.map(|_| 7),
        ..Options::new(*profile, 0)
    };
    let heights = heights(*voids);
    match texture {
        Some(_) => {
            let mut writer = Writer::new(&picture(), &Settings::default()).unwrap();
            encode(&heights, &options, &mut writer, &mut |_| true).unwrap().bytes
        }
        None => encode(&heights, &options, &mut Alone, &mut |_| true).unwrap().bytes,
    }
}

/// What comes out, with the checksums of heights and picture.
fn read(bytes: &[u8], texture: bool) -> (Decoded, u32, Option<u32>) {
    let mut body = Vec::new();
    let mut reader = Reader::new(7);
    let d = if texture {
        decode(bytes, &mut body, Stop::End, None, &mut reader, &mut |_| true)
    } else {
        decode(bytes, &mut body, Stop::End, None, &mut Alone, &mut |_| true)
    };
    let d = d.unwrap();
    let z: Vec<u8> = d.surface().iter().flat_map(|z| z.to_le_bytes()).collect();
    let rgb: Vec<u8> = reader.picture(1).rgb.into_iter().flatten().collect();
    let picture = texture.then(|| crc32c::crc32c(&rgb));
    (d, crc32c::crc32c(&z), picture)
}

#[test]
fn golden_files_are_read_and_written_as_ever() {
    for case in CASES {
        let (name, profile, layers, voids, z, picture) = case;
        let bytes = std::fs::read(file(name)).unwrap();
        let (d, got, painted) = read(&bytes, picture.is_some());
        assert!(d.complete && d.header.profile == profile && d.header.layers == layers, "{name}");
        assert_eq!(d.header.place, place(), "{name}");
        assert_eq!((got, painted), (z, picture), "{name}: heights, picture");
        let heights = heights(voids);
        let side = d.header.lattice.side();
        let surface = d.surface();
        for (k, wanted) in heights.z.iter().enumerate().filter(|(k, _)| !heights.is_void(*k)) {
            let z = surface[k / heights.cols * side + k % heights.cols];
            assert!((z - f64::from(*wanted)).abs() <= f64::from(d.bound), "{name}: post {k}");
        }
        assert!(written(&case) == bytes, "{name}: the same input gives other bytes");
    }
}

/// Writes them: `cargo test --test main make_golden_streams -- --ignored --nocapture`; then put the checksums that it prints into the
/// table above. For a new version of the format only.
#[test]
#[ignore = "writes the golden files: cargo test --test main make_golden_streams -- --ignored --nocapture"]
fn make_golden_streams() {
    std::fs::create_dir_all(file("x").parent().unwrap()).unwrap();
    for case in CASES {
        let bytes = written(&case);
        let (_, z, picture) = read(&bytes, case.5.is_some());
        println!("{}: {} bytes, heights {z:#010x}, picture {picture:x?}", case.0, bytes.len());
        std::fs::write(file(case.0), bytes).unwrap();
    }
}
