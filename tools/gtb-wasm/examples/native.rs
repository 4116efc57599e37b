//! The same answers without a browser, to compare: `native streams FOLDER` writes a few streams, `native decode FILE [BYTES...]`
//! prints a line for each prefix as `decode.mjs` does.

use sha2::{Digest, Sha256};
use std::time::Instant;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Heights, Options, Profile, encode};

type Any = Result<(), Box<dyn std::error::Error>>;

/// Ridges by integer arithmetic alone, some posts void if asked for.
fn ground(cols: usize, rows: usize, voids: bool) -> Heights {
    let mut noise = 1_u32;
    let mut z = Vec::new();
    for y in 0..rows as i32 {
        for x in 0..cols as i32 {
            noise = noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let ridge = |t: i32, every: i32| (t.rem_euclid(2 * every) - every).abs();
            let wide = 9 * ridge(x + y / 3, 83) + 5 * ridge(y - x / 5, 59);
            z.push(wide + ridge(x * y / 64, 7) + (noise >> 29) as i32);
        }
    }
    let void = (0..cols * rows).map(|k| voids && (k % cols / 19 + k / cols / 23) % 7 == 3).collect();
    Heights { void: if voids { void } else { Vec::new() }, ..Heights::new(cols, rows, z) }
}

fn streams(folder: &str) -> Any {
    for (name, profile, layers, cols, rows, voids) in [
        ("cubic", Profile::Cubic, vec![0], 513, 513, false),
        ("cubic_layers_voids", Profile::Cubic, vec![13, 4, 1, 0], 300, 201, true),
        ("cubic_bound", Profile::Cubic, vec![1], 257, 257, false),
    ] {
        let options = Options { layers, ..Options::new(profile, 0) };
        let stream = encode(&ground(cols, rows, voids), &options, &mut Alone, &mut |_| true)?;
        std::fs::write(format!("{folder}/{name}.gtb"), stream.bytes)?;
    }
    Ok(())
}

const SEED: u32 = 1;

fn print(bytes: &[u8]) {
    match gtb_wasm::surface(bytes, SEED) {
        Ok(s) => {
            let mut hash = Sha256::new();
            s.z.iter().for_each(|v| hash.update(v.to_le_bytes()));
            let cells = s.picture.map_or(0, |p| {
                hash.update(p.rgb.concat());
                1_u32 << p.n
            });
            println!(
                "{} bytes: {} x {}, {} used, complete {}, bound {}, {cells} cells a side, sha256 {:x}",
                bytes.len(),
                s.decoded.header.cols,
                s.decoded.header.rows,
                s.decoded.bytes_used,
                s.decoded.complete,
                s.decoded.bound,
                hash.finalize()
            );
        }
        Err(e) => println!("{} bytes: {e}", bytes.len()),
    }
}

fn main() -> Any {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match args.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["streams", folder] => streams(folder)?,
        ["decode", file, cuts @ ..] => {
            let bytes = std::fs::read(file)?;
            for cut in cuts {
                print(&bytes[..bytes.len().min(cut.parse()?)]);
            }
            let begun = Instant::now();
            gtb_wasm::surface(&bytes, SEED)?;
            eprintln!("native: {:.4} s", begun.elapsed().as_secs_f64());
            print(&bytes);
        }
        _ => return Err("usage: native streams FOLDER | native decode FILE [BYTES...]".into()),
    }
    Ok(())
}
