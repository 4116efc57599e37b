//! The texture half (acceptance G-e, G-h and G-i).

use crate::support::shared;
use terraquilt_codecs::gtb::heights::Heights;
use terraquilt_codecs::gtb::texture::{Cells, Reader, Settings, Writer};
use terraquilt_codecs::gtb::{Options, Profile, Stop, decode, encode};

/// Water in the north-west, land with grain elsewhere.
fn shore(n: u32) -> Cells {
    let side = 1usize << n;
    let mut state = 7u32;
    let rgb = (0..side * side)
        .map(|at| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let grain = (state >> 27) as u8;
            if at / side + at % side < side {
                [10, 20, 60 + grain / 8]
            } else {
                [120 + grain, 90 + grain, 40]
            }
        })
        .collect();
    Cells { n, rgb, void: Vec::new() }
}

fn written(cells: &Cells, settings: &Settings, posts: usize) -> Vec<u8> {
    let heights = Heights::new(posts, posts, (0..posts * posts).map(|k| (k % posts) as i32).collect());
    let options = Options { texture: Some(cells.n), ..Options::new(Profile::Cubic, 0) };
    let mut writer = Writer::new(cells, settings).unwrap();
    encode(&heights, &options, &mut writer, &mut |_| true).unwrap().bytes
}

fn read(bytes: &[u8], n: u32) -> Cells {
    let (mut body, mut reader) = (Vec::new(), Reader::new(n));
    // A prefix too short for heights is an error; the picture is grey then.
    let _ = decode(bytes, &mut body, Stop::End, None, &mut reader, &mut |_| true);
    reader.picture(1)
}

fn squares(a: &Cells, b: &Cells) -> f64 {
    a.rgb
        .iter()
        .zip(&b.rgb)
        .flat_map(|(p, q)| (0..3).map(|k| (f64::from(p[k]) - f64::from(q[k])).powi(2)))
        .sum()
}

/// Lattices coarser and finer than the labels, pictures smaller than a pattern: every byte cut paints a picture, and the
/// whole is nearer to the truth than grey.
#[test]
fn every_cut_paints() {
    for (n, posts) in [(1, 5), (2, 9), (4, 3), (7, 5), (7, 33)] {
        let cells = shore(n);
        let bytes = written(&cells, &Settings { plain: 0.02, ..Settings::default() }, posts);
        for cut in 0..=bytes.len() {
            assert_eq!(read(&bytes[..cut], n).rgb.len(), cells.rgb.len(), "{cut} bytes");
        }
        let grey = Cells { n, rgb: vec![[128; 3]; cells.rgb.len()], void: Vec::new() };
        let whole = read(&bytes, n);
        assert!(squares(&cells, &whole) < 0.5 * squares(&cells, &grey), "n {n}, {posts} posts");
    }
}

/// The same picture gives the same bytes, the same seed the same picture, another seed another.
#[test]
fn the_same_again() {
    let cells = shore(7);
    let settings = Settings { plain: 0.0, ..Settings::default() };
    let bytes = written(&cells, &settings, 9);
    assert_eq!(bytes, written(&cells, &settings, 9));
    assert_eq!(read(&bytes, 7), read(&bytes, 7));
    let (mut body, mut reader) = (Vec::new(), Reader::new(7));
    decode(&bytes, &mut body, Stop::End, None, &mut reader, &mut |_| true).unwrap();
    assert_ne!(reader.picture(1), reader.picture(2));
}

/// Voids come back as voids, but for squares of labels that are cut.
#[test]
fn voids() {
    let mut cells = shore(7);
    cells.void = (0..1 << 14).map(|at| at % 128 < 64).collect();
    let painted = read(&written(&cells, &Settings::default(), 9), 7);
    let wrong = painted.void.iter().zip(&cells.void).filter(|(a, b)| a != b).count();
    assert!(!painted.void.is_empty() && wrong < 1 << 10, "{wrong} of {} cells", cells.void.len());
}

/// Flipped bytes give an error or a picture.
#[test]
fn rubbish() {
    let bytes = written(&shore(6), &Settings { plain: 0.05, ..Settings::default() }, 9);
    for at in 0..bytes.len() {
        let mut bad = bytes.clone();
        bad[at] ^= 0x5a;
        assert_eq!(read(&bad, 6).rgb.len(), 1 << 12);
    }
}

/// A picture of the repository, 128 cells a side.
fn landsat() -> Cells {
    let bytes = include_bytes!("data/landsat_sfbay_128.rgb");
    Cells { n: 7, rgb: bytes.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(), void: Vec::new() }
}

fn psnr(a: &Cells, b: &Cells) -> f64 {
    10.0 * (255.0 * 255.0 * 3.0 * a.rgb.len() as f64 / squares(a, b).max(1e-9)).log10()
}

/// The writer and its bytes, without heights to speak of.
fn coded(cells: &Cells, plain: f64) -> (Writer, usize) {
    let mut writer = Writer::new(cells, &Settings { plain, ..Settings::default() }).unwrap();
    let options = Options { texture: Some(cells.n), ..Options::new(Profile::Cubic, 0) };
    let bytes = encode(&Heights::new(9, 9, vec![0; 81]), &options, &mut writer, &mut |_| true).unwrap().bytes;
    (writer, bytes.len())
}

/// Acceptance G-h: classes and patterns take less than 1 % of raw; the hybrid loses less than 1 dB to the wavelet at the same bytes, and
/// the bands that it paints have the energy of the source. It paints few: three to fourteen of some 160 bands of classes, for all others would
/// cost more than that; they stay smooth.
fn held_to_g_h(what: &str, cells: &Cells) {
    let raw = 3 * cells.rgb.len();
    let (_, alone) = coded(cells, 0.0);
    assert!(alone * 100 < raw, "{what}: {alone} bytes of classes and patterns for {raw}");
    let (hybrid, bytes) = coded(cells, 0.005);
    let (wavelet, _) = coded(cells, bytes as f64 / raw as f64);
    let (ours, theirs) = (psnr(cells, &hybrid.picture(1)), psnr(cells, &wavelet.sent()));
    println!("{what}: patterns {alone} bytes, hybrid {bytes} bytes {ours:.2} dB, wavelet {theirs:.2} dB");
    assert!(ours >= theirs - 1.0, "{what}: {ours} dB, the wavelet {theirs}");
    let painted = hybrid.energies(1);
    assert!(!painted.is_empty(), "{what}: nothing is painted");
    println!("{what}: {} bands of classes are painted of {}", painted.len(), 18 * hybrid.sizes().classes);
    for (place, wanted, got) in painted {
        assert!((got / wanted - 1.0).abs() <= 0.1, "{what}, {place}: energy {got}, the source's is {wanted}");
    }
}

#[test]
fn satellite_crops() {
    // Two squares of Landsat 7, and one of Blue Marble.
    for (file, rows, cols) in [
        ("imagery/sfbay_landsat7_rgb.tif", 760, 1180),
        ("imagery/sfbay_landsat7_rgb.tif", 265, 1669),
        ("imagery/bluemarble_asia.tif", 40, 14),
    ] {
        let Some(path) = shared(file) else { return };
        let picture = tiff_reader::TiffFile::open(&path).unwrap().read_image::<u8>(0).unwrap();
        let rgb = (0..512 * 512).map(|k| {
            let at = |band: usize| picture[[rows + k / 512, cols + k % 512, band]];
            [at(0), at(1), at(2)]
        });
        held_to_g_h(
            &format!("{file} at {rows}, {cols}"),
            &Cells { n: 9, rgb: rgb.collect(), void: Vec::new() },
        );
    }
}

/// The same picture gives the same texture in streams of every kind, and the heights do not mind.
#[test]
fn beside_heights_of_every_profile() {
    let cells = landsat();
    let heights = Heights::new(40, 33, (0..40 * 33).map(|k| (k % 40) * (k / 40) % 97).collect());
    for (profile, layers) in
        [(Profile::Cubic, vec![13, 4, 1, 0]), (Profile::Adaptive, vec![1]), (Profile::Sparse, vec![1])]
    {
        let options = Options { texture: Some(7), layers, ..Options::new(profile, 0) };
        let alone = Options { texture: None, layers: options.layers.clone(), ..Options::new(profile, 0) };
        let mut writer = Writer::new(&cells, &Settings::default()).unwrap();
        let with = encode(&heights, &options, &mut writer, &mut |_| true).unwrap();
        let without =
            encode(&heights, &alone, &mut terraquilt_codecs::gtb::companion::Alone, &mut |_| true).unwrap();
        assert_eq!(with.z, without.z);
        assert_eq!(read(&with.bytes, 7), writer.picture(1));
    }
}
