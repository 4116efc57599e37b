//! Synthetic detail beside the truth (specification, F7): `cargo run --release --example detail -- [--bound E] [--factors 2,4] [--into FOLDER] GRID...`
//!
//! Each grid is reduced by the factors, powers of two (2 and 4), encoded with ranges of 4 alone and brought back to its size by bicubic interpolation, by the
//! interpolation that keeps the means of cells, by the maps alone, and by the maps with controlled gain. One line of JSON for each: the error against
//! bicubic's, the power of each new octave against the true one. Without --bound the tile has no residual. --into writes each result as little-endian u32
//! columns, u32 rows and f64 values to FOLDER/NAME.FACTOR.WAY.
//!
//! A grid is u32 columns, u32 rows, i32 each, little-endian; it is cut to multiples of 16 and 512.

use std::path::Path;
use terraquilt_codecs::fractal::Search;

#[path = "../tests/support/reduced.rs"]
mod reduced;
#[path = "../tests/support/spectrum.rs"]
mod spectrum;

type Any<T> = Result<T, Box<dyn std::error::Error>>;

fn read(file: &str) -> Any<(usize, Vec<f64>)> {
    let numbers: Vec<i32> =
        std::fs::read(file)?.chunks_exact(4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let [cols, rows, z @ ..] = numbers.as_slice() else { return Err("no columns and rows".into()) };
    let stride = *cols as usize;
    let (cols, rows) = ((stride / 16 * 16).min(512), (*rows as usize / 16 * 16).min(512));
    let cut = z.chunks_exact(stride).take(rows).flat_map(|row| &row[..cols]);
    Ok((cols, cut.map(|v| f64::from(*v)).collect()))
}

fn main() -> Any<()> {
    let (mut bound, mut into, mut files) = (None, None, Vec::new());
    let mut factors = vec![2_usize, 4];
    let mut arguments = std::env::args().skip(1);
    while let Some(a) = arguments.next() {
        match a.as_str() {
            "--bound" => bound = Some(arguments.next().ok_or("--bound E")?.parse()?),
            "--factors" => {
                let list = arguments.next().ok_or("--factors 2,4")?;
                factors = list.split(',').map(str::parse).collect::<Result<_, _>>()?;
            }
            "--into" => into = Some(arguments.next().ok_or("--into FOLDER")?),
            _ => files.push(a),
        }
    }
    for file in &files {
        let name = Path::new(file).file_stem().unwrap_or_default().to_string_lossy();
        let (cols, truth) = read(file)?;
        for factor in &factors {
            if !factor.is_power_of_two() || *factor > 16 {
                return Err(format!("factor {factor}; a power of two up to 16 is needed").into());
            }
            let k = factor.trailing_zeros();
            let back = reduced::there_and_back(&truth, cols, k, Search::Exact, bound)?;
            for way in &back.ways {
                println!(
                    "{{\"grid\": \"{name}\", \"factor\": {factor}, \"way\": \"{}\", \"error\": {:.3}, \"powers\": {:.2?}, \"holds\": {}, \"bicubic_rms\": {:.3}, \"gains\": {:.2?}}}",
                    way.name,
                    way.error,
                    way.powers,
                    way.holds(),
                    back.bicubic,
                    back.gains
                );
                if let Some(folder) = &into {
                    let mut bytes: Vec<u8> = [cols as u32, (truth.len() / cols) as u32]
                        .into_iter()
                        .flat_map(u32::to_le_bytes)
                        .collect();
                    bytes.extend(way.values.iter().flat_map(|v| v.to_le_bytes()));
                    std::fs::write(Path::new(folder).join(format!("{name}.{factor}.{}", way.name)), bytes)?;
                }
            }
        }
    }
    Ok(())
}
