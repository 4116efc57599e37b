//! Bytes and likeness of textures: `cargo run --release --example texture -- FILE...`.
//!
//! A file is one little-endian u32, the side (a power of two), and side x side x 3 bytes of red, green, blue. With `--out DIR` what was
//! painted is written there in the same form.

use terraquilt_codecs::gtb::texture::{Cells, Reader, Settings, Writer};
use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, decode, encode};

fn psnr(a: &Cells, b: &Cells) -> f64 {
    let square = |(a, b): (&u8, &u8)| (f64::from(*a) - f64::from(*b)).powi(2);
    let sum: f64 = a.rgb.iter().flatten().zip(b.rgb.iter().flatten()).map(square).sum();
    10.0 * (255.0 * 255.0 * 3.0 * a.rgb.len() as f64 / sum.max(1e-9)).log10()
}

/// The picture of a wavelet alone that takes as many bytes.
fn wavelet(cells: &Cells, bytes: usize) -> Cells {
    let settings = Settings { plain: bytes as f64 / (3.0 * cells.rgb.len() as f64), ..Settings::default() };
    let mut writer = Writer::new(cells, &settings).expect("a picture");
    let options = Options { texture: Some(cells.n), ..Options::new(Profile::Cubic, 0) };
    encode(&Heights::new(9, 9, vec![0; 81]), &options, &mut writer, &mut |_| true).expect("a picture");
    writer.sent()
}

fn main() {
    let mut args: Vec<String> = std::env::args().skip(1).collect();
    let out = args.iter().position(|a| a == "--out").map(|k| args.drain(k..k + 2).nth(1).unwrap_or_default());
    let modes = [("patterns", 0.0), ("hybrid", 0.005)];
    println!(
        "{:>16} {:>9} {:>8} {:>8} {:>8} {:>8} {:>8}",
        "picture", "", "bytes", "% raw", "classes", "PSNR dB", "wavelet"
    );
    // The last column: the wavelet alone, when it may take as many bytes as all.
    for file in &args {
        let bytes = std::fs::read(file).expect(file);
        let side = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
        let rgb = bytes[4..].chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect();
        let cells = Cells { n: side.trailing_zeros(), rgb, void: Vec::new() };
        let name = std::path::Path::new(file).file_stem().unwrap_or_default().to_string_lossy().into_owned();
        for (mode, plain) in modes {
            let settings = Settings { plain, ..Settings::default() };
            let mut writer = Writer::new(&cells, &settings).expect(file);
            let heights = Heights::new(9, 9, vec![0; 81]);
            let options = Options { texture: Some(cells.n), ..Options::new(Profile::Cubic, 0) };
            let encoded = encode(&heights, &options, &mut writer, &mut |_| true).expect(file);
            let mut reader = Reader::new(cells.n);
            let (mut body, mut going) = (Vec::new(), |_: f64| true);
            let got =
                decode(&encoded.bytes, &mut body, Stop::End, None, &mut reader, &mut going).expect(file);
            let painted = reader.picture(1);
            assert!(got.complete && painted == writer.picture(1), "{file}: both sides paint alike");
            println!(
                "{name:>16} {mode:>9} {:>8} {:>8.3} {:>8} {:>8.2} {:>8.2}",
                encoded.bytes.len(),
                100.0 * encoded.bytes.len() as f64 / (3.0 * cells.rgb.len() as f64),
                writer.sizes().classes,
                psnr(&cells, &painted),
                psnr(&cells, &wavelet(&cells, encoded.bytes.len()))
            );
            if let Some(dir) = &out {
                let head = side.to_le_bytes().into_iter();
                let bytes: Vec<u8> = head.chain(painted.rgb.iter().flatten().copied()).collect();
                std::fs::write(format!("{dir}/{name}_{mode}.rgb"), bytes).expect(dir);
            }
        }
    }
}
