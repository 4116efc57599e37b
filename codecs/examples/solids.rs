//! Distance fields of meshes as fractal volumes, for tools that measure.
//!
//! - `solids field MESH.ply SIDE OUT`: the field of an ASCII PLY of triangles, SIDE samples along each axis
//! - `solids encode FIELD SIDE maps|const NUMBER OUT.ifs`: all domains are searched
//! - `solids decode FILE.ifs OUT`: at zoom 1, rounded
//!
//! Fields are raw signed bytes, x running fastest. All print one line of JSON.

use std::time::Instant;
use terraquilt_codecs::fractal::{Options, Partition, Space, Tile, encode_volume};
use terraquilt_codecs::solid::{Field, MARGIN, Mesh, Window};
use terraquilt_codecs::work::Workers;

type Any<T> = Result<T, Box<dyn std::error::Error>>;

/// As many threads as the machine has.
struct Threads;

impl Workers for Threads {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        let next = std::sync::atomic::AtomicUsize::new(0);
        std::thread::scope(|s| {
            for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
                s.spawn(|| {
                    loop {
                        let k = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                        if k >= parts {
                            return;
                        }
                        part(k);
                    }
                });
            }
        });
    }
}

fn mesh(text: &str) -> Any<Mesh> {
    let count = |what: &str| -> Any<usize> {
        let line = text.lines().find_map(|l| l.strip_prefix(what)).ok_or_else(|| format!("no '{what}'"))?;
        Ok(line.trim().parse()?)
    };
    let (vertices, faces) = (count("element vertex ")?, count("element face ")?);
    let mut rows = text.lines().skip_while(|l| *l != "end_header").skip(1).map(|l| l.split_whitespace());
    let mut out = Mesh::default();
    for mut row in rows.by_ref().take(vertices) {
        let mut next = || -> Any<f64> { Ok(row.next().ok_or("a vertex has three numbers")?.parse()?) };
        out.positions.push([next()?, next()?, next()?]);
    }
    for mut row in rows.take(faces) {
        let mut next = || -> Any<u32> { Ok(row.next().ok_or("a face has four numbers")?.parse()?) };
        if next()? != 3 {
            return Err("faces must be triangles".into());
        }
        out.triangles.push([next()?, next()?, next()?]);
    }
    Ok(out)
}

fn field(file: &str, side: &str, out: &str) -> Any<()> {
    let mesh = mesh(&std::fs::read_to_string(file)?)?;
    let bounds = mesh.bounds().ok_or("no vertices")?;
    let window = Window::around(bounds, [side.parse()?; 3], MARGIN)?;
    let started = Instant::now();
    let (field, report) = Field::of(&mesh, window, &Threads)?;
    println!("{{\"seconds\": {}, \"closed\": {}}}", started.elapsed().as_secs_f64(), report.is_closed());
    Ok(std::fs::write(out, field.values.iter().map(|v| *v as u8).collect::<Vec<u8>>())?)
}

fn encode(field: &str, side: &str, kind: &str, number: &str, out: &str) -> Any<()> {
    let values: Vec<i8> = std::fs::read(field)?.into_iter().map(|v| v as i8).collect();
    let partition = match kind {
        "maps" => Partition::Maps(number.parse()?),
        "const" => Partition::Const(number.parse()?),
        other => return Err(format!("{other}; maps or const").into()),
    };
    let options = Options { partition: Some(partition), ..Options::default() };
    let space = Space { origin: [0.5; 3], voxel: 1.0 };
    let started = Instant::now();
    let file = encode_volume([side.parse()?; 3], &values, space, field, &options, &Threads)?;
    println!(
        "{{\"bytes\": {}, \"maps\": {}, \"error_max\": {}, \"seconds\": {}}}",
        file.bytes.len(),
        file.header.maps,
        file.header.error_max,
        started.elapsed().as_secs_f64()
    );
    Ok(std::fs::write(out, file.bytes)?)
}

fn decode(file: &str, out: &str) -> Any<()> {
    let started = Instant::now();
    let volume = Tile::read(&std::fs::read(file)?)?.volume()?;
    println!("{{\"seconds\": {}}}", started.elapsed().as_secs_f64());
    Ok(std::fs::write(out, volume.values.iter().map(|v| v.round() as i8 as u8).collect::<Vec<u8>>())?)
}

fn main() -> Any<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..] {
        ["field", mesh, side, out] => field(mesh, side, out),
        ["encode", field, side, kind, number, out] => encode(field, side, kind, number, out),
        ["decode", file, out] => decode(file, out),
        _ => Err("usage: solids field MESH.ply SIDE OUT | encode FIELD SIDE KIND NUMBER OUT.ifs | decode FILE.ifs OUT".into()),
    }
}
