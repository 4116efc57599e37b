//! Raw grids to streams and back, for tools that measure.
//!
//! - `raw encode cubic|adaptive BOUND[,BOUND...] GRID OUT.gtb`
//! - `raw decode FILE.gtb OUT [BYTES]`: of the file, or of its first BYTES
//!
//! A grid is two little-endian u32 (columns, rows) and columns x rows little-endian i32 heights, the least of which, -2^31, marks a
//! void. OUT of a decode is two little-endian u32 and columns x rows little-endian f64, NaN where the stream says void. Both print
//! one line of JSON.

use std::time::Instant;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Heights, Options, Profile, Stop, decode, encode};

type Any = Result<(), Box<dyn std::error::Error>>;

fn read(file: &str) -> Result<Heights, Box<dyn std::error::Error>> {
    let bytes = std::fs::read(file)?;
    let numbers: Vec<i32> =
        bytes.chunks_exact(4).map(|b| i32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect();
    let [cols, rows, z @ ..] = numbers.as_slice() else { return Err("no columns and rows".into()) };
    let void = if z.contains(&i32::MIN) { z.iter().map(|v| *v == i32::MIN).collect() } else { Vec::new() };
    let z = z.iter().map(|v| if *v == i32::MIN { 0 } else { *v }).collect();
    Ok(Heights { void, ..Heights::new(*cols as usize, *rows as usize, z) })
}

fn to_stream(profile: &str, layers: &str, grid: &str, out: &str) -> Any {
    let profile = match profile {
        "cubic" => Profile::Cubic,
        "adaptive" => Profile::Adaptive,
        other => return Err(format!("profile {other}; cubic and adaptive are known").into()),
    };
    let layers = layers.split(',').map(str::parse).collect::<Result<Vec<u32>, _>>()?;
    let heights = read(grid)?;
    let options = Options { layers, ..Options::new(profile, 0) };
    let begun = Instant::now();
    let stream = encode(&heights, &options, &mut Alone, &mut |_| true)?;
    let seconds = begun.elapsed().as_secs_f64();
    let ends: Vec<String> =
        stream.passes.iter().map(|p| format!("[{}, {}, {}]", p.layer, p.bytes, p.bound)).collect();
    println!(
        "{{\"bytes\": {}, \"error_max\": {}, \"seconds\": {seconds}, \"ends\": [{}]}}",
        stream.bytes.len(),
        stream.error_max,
        ends.join(", ")
    );
    Ok(std::fs::write(out, stream.bytes)?)
}

fn to_grid(file: &str, out: &str, cut: Option<&String>) -> Any {
    let bytes = std::fs::read(file)?;
    let stop = cut.map(|n| n.parse().map(Stop::Bytes)).transpose()?.unwrap_or(Stop::End);
    let begun = Instant::now();
    let mut body = Vec::new();
    let decoded = decode(&bytes, &mut body, stop, None, &mut Alone, &mut |_| true)?;
    let z = decoded.surface();
    let seconds = begun.elapsed().as_secs_f64();
    let h = &decoded.header;
    let mut raw: Vec<u8> = [h.cols as u32, h.rows as u32].into_iter().flat_map(u32::to_le_bytes).collect();
    for (y, row) in z.chunks_exact(h.lattice.side()).take(h.rows).enumerate() {
        for (x, z) in row.iter().take(h.cols).enumerate() {
            let v = if decoded.is_free(y * h.lattice.side() + x) { f64::NAN } else { *z };
            raw.extend_from_slice(&v.to_le_bytes());
        }
    }
    println!(
        "{{\"bytes_used\": {}, \"error_bound\": {}, \"complete\": {}, \"seconds\": {seconds}}}",
        decoded.bytes_used, decoded.bound, decoded.complete
    );
    Ok(std::fs::write(out, raw)?)
}

fn main() -> Any {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match args.iter().map(String::as_str).collect::<Vec<_>>().as_slice() {
        ["encode", profile, layers, grid, out] => to_stream(profile, layers, grid, out),
        ["decode", file, out, ..] if args.len() <= 4 => to_grid(file, out, args.get(3)),
        _ => Err("usage: raw encode PROFILE BOUNDS GRID OUT.gtb | raw decode FILE.gtb OUT [BYTES]".into()),
    }
}
