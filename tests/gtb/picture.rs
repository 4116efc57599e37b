//! Pictures onto the cells of a lattice: where each colour lands, by whatever way the picture is placed.

use super::{made, read, request, text};
use crate::support::{printed, refused, shared};
use serde_json::Value;
use std::path::{Path, PathBuf};
use terraquilt::export::drape::{Drape, Square};
use terraquilt::export::gtb::{Grid, MeshRequest, Request, Until, send, write_mesh};
use terraquilt::format::picture::Picture;
use terraquilt::height::crs::{Crs, DatumChoice, Transform};
use terraquilt::height::source::Affine;
use terraquilt_codecs::gtb::Profile;
use terraquilt_codecs::gtb::texture::Cells;
use terraquilt_codecs::lattice::Lattice;

/// Writes a PNG whose red grows with the column and whose green grows with the row; pixels without alpha where `clear` says so.
fn png(path: &Path, cols: u32, rows: u32, clear: impl Fn(u32, u32) -> bool) {
    let pixels: Vec<u8> = (0..rows)
        .flat_map(|y| (0..cols).map(move |x| (x, y)))
        .flat_map(|(x, y)| {
            let part = |v: u32, n: u32| (v * 250 / n.max(1)) as u8;
            [part(x, cols), part(y, rows), 77, if clear(x, y) { 0 } else { 255 }]
        })
        .collect();
    let mut encoder = png::Encoder::new(std::fs::File::create(path).unwrap(), cols, rows);
    encoder.set_color(png::ColorType::Rgba);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.write_header().unwrap().write_image_data(&pixels).unwrap();
}

/// An uncompressed GeoTIFF of interleaved bands of 8 bits, of one strip, with a place in EPSG:26910.
fn tif(path: &Path, (cols, rows): (u32, u32), bands: usize, nodata: Option<&str>, data: &[u8], a: Affine) {
    let doubles = |v: &[f64]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let shorts = |v: &[u16]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let long = |v: u32| v.to_le_bytes().to_vec();
    let corner = [0, 1].map(|k| a.origin[k] - 0.5 * a.col_step[k] - 0.5 * a.row_step[k]);
    let mut tags: Vec<(u16, u16, u32, Vec<u8>)> = vec![
        (256, 4, 1, long(cols)),
        (257, 4, 1, long(rows)),
        (258, 3, bands as u32, shorts(&vec![8; bands])),
        (259, 3, 1, shorts(&[1])),
        (262, 3, 1, shorts(&[if bands >= 3 { 2 } else { 1 }])),
        (273, 4, 1, long(8)),
        (277, 3, 1, shorts(&[bands as u16])),
        (278, 4, 1, long(rows)),
        (279, 4, 1, long(data.len() as u32)),
        (33550, 12, 3, doubles(&[a.col_step[0], -a.row_step[1], 0.0])),
        (33922, 12, 6, doubles(&[0.0, 0.0, 0.0, corner[0], corner[1], 0.0])),
        (34735, 3, 16, shorts(&[1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 26910])),
    ];
    if bands == 4 {
        tags.push((338, 3, 1, shorts(&[2])));
    }
    if let Some(n) = nodata {
        tags.push((42113, 2, n.len() as u32 + 1, [n.as_bytes(), &[0]].concat()));
    }
    tags.sort();
    let mut out = [&b"II*\0"[..], &[0; 4], data].concat();
    let mut entries = Vec::new();
    for (tag, kind, count, value) in tags {
        let mut four = value.clone();
        if value.len() > 4 {
            out.resize(out.len().next_multiple_of(8), 0);
            four = (out.len() as u32).to_le_bytes().to_vec();
            out.extend(&value);
        }
        four.resize(4, 0);
        entries.extend([&tag.to_le_bytes()[..], &kind.to_le_bytes(), &count.to_le_bytes(), &four].concat());
    }
    out.resize(out.len().next_multiple_of(8), 0);
    let at = (out.len() as u32).to_le_bytes();
    out[4..8].copy_from_slice(&at);
    out.extend(((entries.len() / 12) as u16).to_le_bytes());
    out.extend(entries);
    out.extend([0; 4]);
    std::fs::write(path, out).unwrap();
}

/// Beside a picture: its place and CRS.
fn place(path: &Path, a: Affine, crs: &str) {
    let numbers = [a.col_step[0], a.col_step[1], a.row_step[0], a.row_step[1], a.origin[0], a.origin[1]];
    let lines: Vec<String> = numbers.iter().map(f64::to_string).collect();
    std::fs::write(path.with_extension("pgw"), lines.join("\n")).unwrap();
    std::fs::write(path.with_extension("prj"), crs).unwrap();
}

fn cells(grid: &Grid, path: &Path, n: Option<u32>) -> (Cells, Vec<String>) {
    let mut picture = Picture::open(path).unwrap();
    let lattice = Lattice::around(grid.cols, grid.rows).unwrap();
    let square =
        Square { lattice, cols: grid.cols, rows: grid.rows, affine: grid.affine, crs: grid.crs.as_ref() };
    let mut drape = Drape::new(square, &mut picture).unwrap();
    let n = n.unwrap_or_else(|| drape.usual_n());
    let cells = drape.cells(n, &|_, _| true).unwrap();
    (cells, drape.notes.clone())
}

/// Column and row of the picture that a cell shows, by its colour; `None`: void.
fn shown(cells: &Cells, i: usize, j: usize, (cols, rows): (u32, u32)) -> Option<[f64; 2]> {
    let at = (i << cells.n) + j;
    if cells.void.get(at).copied().unwrap_or(false) {
        return None;
    }
    assert_eq!(cells.rgb[at][2], 77);
    let of = |v: u8, n: u32| f64::from(v) * f64::from(n) / 250.0;
    Some([of(cells.rgb[at][0], cols), of(cells.rgb[at][1], rows)])
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

#[test]
fn without_a_place_a_picture_is_spread_over_the_grid() {
    let f = folder();
    let path = f.path().join("a.png");
    // Of the grid's size: a pixel a post. Of another: its sides are those of the grid.
    for (cols, rows) in [(50, 40), (100, 20), (7, 9)] {
        png(&path, cols, rows, |_, _| false);
        let (cells, notes) = cells(&made(50, 40, |_, _| false), &path, Some(6));
        assert!(notes.iter().any(|n| n.contains("spread")), "{notes:?}");
        for (i, j) in [(3, 4), (20, 30), (35, 45)] {
            let p = shown(&cells, i, j, (cols, rows)).unwrap();
            // The lattice has 65 posts a side: a cell a post.
            let expected = [
                (j as f64 + 1.0) * f64::from(cols) / 50.0 - 0.5,
                (i as f64 + 1.0) * f64::from(rows) / 40.0 - 0.5,
            ];
            for k in 0..2 {
                let slack = 0.6 + f64::from([cols, rows][k]) / 250.0;
                assert!((p[k] - expected[k]).abs() < slack, "{cols} x {rows}: {p:?} {expected:?}");
            }
        }
        // Off the grid, where nobody looks, the last cells go on.
        let same = |a: [usize; 2], b: [usize; 2]| {
            shown(&cells, a[0], a[1], (cols, rows)) == shown(&cells, b[0], b[1], (cols, rows))
        };
        assert!(same([45, 10], [38, 10]) && same([10, 60], [10, 48]) && same([63, 63], [38, 48]));
    }
}

#[test]
fn a_picture_of_another_system_that_covers_a_part_lands_where_its_pixels_lie() {
    let f = folder();
    let path = f.path().join("a.png");
    let grid = made(90, 70, |_, _| false);
    let posts = grid.affine.unwrap();
    let way =
        Transform::new(grid.crs.as_ref().unwrap(), &Crs::parse("EPSG:4326").unwrap(), &DatumChoice::None)
            .unwrap();
    let middle = way.forward([posts.origin[0] + 450.0, posts.origin[1] - 350.0]).unwrap();
    // From the middle to the east and south, and beyond the grid; turned by a little.
    let a = Affine { origin: middle, col_step: [8e-5, 1e-5], row_step: [2e-6, -6e-5] };
    png(&path, 200, 200, |x, y| x < 10 && y < 10);
    place(&path, a, "EPSG:4326");
    let (cells, _) = cells(&grid, &path, Some(7));
    let (mut met, mut void) = (0, 0);
    for i in 0..69 {
        for j in 0..89 {
            let (row, col) = (i as f64 + 0.5, j as f64 + 0.5);
            let p = way.forward([posts.origin[0] + 10.0 * col, posts.origin[1] - 10.0 * row]).unwrap();
            let d = [p[0] - a.origin[0], p[1] - a.origin[1]];
            let area = a.col_step[0] * a.row_step[1] - a.col_step[1] * a.row_step[0];
            let u = (d[0] * a.row_step[1] - d[1] * a.row_step[0]) / area;
            let v = (a.col_step[0] * d[1] - a.col_step[1] * d[0]) / area;
            let on = u >= -0.5 && v >= -0.5 && u < 199.5 && v < 199.5;
            match shown(&cells, i, j, (200, 200)) {
                None => {
                    void += 1;
                    assert!(!on || (u < 12.0 && v < 12.0), "cell {i} {j} at pixel {u} {v} is void");
                }
                Some(q) => {
                    met += 1;
                    assert!(on && (q[0] - u).abs() < 1.6 && (q[1] - v).abs() < 1.6, "{q:?} {u} {v}");
                }
            }
        }
    }
    assert!(met > 800 && void > 3000, "{met} {void}");
}

#[test]
fn geotiffs_give_their_colours_and_voids() {
    let f = folder();
    let path = f.path().join("a.tif");
    let grid = made(33, 33, |_, _| false);
    let posts = grid.affine.unwrap();
    // A pixel a cell: their centres lie between posts.
    let a = Affine { origin: [posts.origin[0] + 5.0, posts.origin[1] - 5.0], ..posts };
    for (bands, nodata) in [(1, None), (3, None), (3, Some("0")), (4, None)] {
        let data: Vec<u8> = (0..32 * 32 * bands)
            .map(|k| {
                let (pixel, band) = (k / bands, k % bands);
                match band {
                    _ if pixel == 37 => 0,
                    3 => 255,
                    // One band at the nodata value is a colour.
                    0 if pixel == 40 && bands > 1 => 0,
                    _ => (pixel % 120) as u8 + 1 + 40 * band as u8,
                }
            })
            .collect();
        tif(&path, (32, 32), bands, nodata, &data, a);
        let (cells, _) = cells(&grid, &path, None);
        assert_eq!((cells.n, cells.rgb.len()), (5, 1024));
        let has_void = bands == 4 || nodata.is_some();
        for k in 0..1024 {
            let is_void = cells.void.get(k).copied().unwrap_or(false);
            assert_eq!(is_void, has_void && k == 37, "{bands} bands, {nodata:?}, pixel {k}");
            let band = |b: usize| data[k * bands + if bands == 1 { 0 } else { b }];
            assert!(is_void || cells.rgb[k] == [band(0), band(1), band(2)], "pixel {k}");
        }
    }
}

#[test]
fn pictures_that_cannot_be_draped_say_why() {
    let f = folder();
    let path = f.path().join("a.png");
    let grid = made(20, 20, |_, _| false);
    let posts = grid.affine.unwrap();
    let tried = |grid: &Grid, path: &Path| {
        let mut picture = Picture::open(path)?;
        let r = Request { picture: Some(&mut picture), ..request(Profile::Cubic, &[0.0]) };
        send(grid, r, &|_, _| true).map(|_| ())
    };
    let said = |grid: &Grid, path: &Path| tried(grid, path).unwrap_err().to_string();
    png(&path, 20, 20, |_, _| false);
    tried(&grid, &path).unwrap();
    place(&path, Affine { origin: [0.0, 0.0], ..posts }, "EPSG:26910");
    assert!(said(&grid, &path).contains("beside the grid"));
    place(&path, posts, "EPSG:26910");
    assert!(said(&Grid { affine: None, crs: None, ..grid.clone() }, &path).contains("the grid has none"));
    // An old datum needs a shift that nobody states.
    place(&path, posts, "EPSG:26710");
    assert!(tried(&grid, &path).is_err());
    let cut: PathBuf = f.path().join("cut.png");
    std::fs::write(&cut, &std::fs::read(&path).unwrap()[..90]).unwrap();
    assert!(said(&grid, &cut).contains("cut.png"));
    std::fs::write(&cut, b"\xff\xd8\xff\xe0").unwrap();
    assert!(said(&grid, &cut).contains("JPEG"));
    std::fs::write(&cut, b"").unwrap();
    assert!(said(&grid, &cut).contains("empty"));
}

#[test]
fn a_picture_travels_and_lies_on_the_mesh() {
    let f = folder();
    let path = f.path().join("a.png");
    let grid = made(50, 40, |x, y| x > 30 && y > 30);
    png(&path, 50, 40, |_, _| false);
    let mut picture = Picture::open(&path).unwrap();
    let r = Request { picture: Some(&mut picture), ..request(Profile::Cubic, &[0.0]) };
    let sent = send(&grid, r, &|_, _| true).unwrap();
    assert_eq!(sent.told.texture_side, Some(64));
    let p = read(&sent.encoded.bytes, Until::End);
    assert!(p.reached.complete && p.grid.z.len() == 2000);
    assert_eq!(p.picture.as_ref().map(|c| (c.n, c.rgb.len())), Some((6, 4096)));
    let mut bytes = Vec::new();
    write_mesh(&mut bytes, &p, MeshRequest::default(), &|_, _| true).unwrap();
    let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let json: Value = serde_json::from_slice(&bytes[20..20 + word(12)]).unwrap();
    assert_eq!(json["asset"]["extras"]["texture"], "synthetic");
    let bin = &bytes[28 + word(12)..];
    let view = |n: &Value| {
        let v = &json["bufferViews"][n.as_u64().unwrap() as usize];
        let at = v["byteOffset"].as_u64().unwrap() as usize;
        &bin[at..at + v["byteLength"].as_u64().unwrap() as usize]
    };
    let mut reader =
        png::Decoder::new(std::io::Cursor::new(view(&json["images"][0]["bufferView"]))).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut pixels).unwrap();
    // The part of the square that lies over the grid.
    assert_eq!((frame.width, frame.height), (49, 39));
    let attributes = &json["meshes"][0]["primitives"][0]["attributes"];
    let floats = |n: &Value, parts: usize| -> Vec<Vec<f32>> {
        let bytes = view(&json["accessors"][n.as_u64().unwrap() as usize]["bufferView"]);
        let all: Vec<f32> =
            bytes.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
        all.chunks_exact(parts).map(<[f32]>::to_vec).collect()
    };
    let (at, uv) = (floats(&attributes["POSITION"], 3), floats(&attributes["TEXCOORD_0"], 2));
    assert_eq!(at.len(), uv.len());
    for (p, t) in at.iter().zip(&uv) {
        // The middle of the grid is the origin: 49 by 39 cells of 10 m.
        assert!(
            (p[0] - (t[0] - 0.5) * 490.0).abs() < 1e-3 && (p[2] - (t[1] - 0.5) * 390.0).abs() < 1e-3,
            "{p:?} {t:?}"
        );
    }
}

#[test]
fn san_francisco_under_its_satellite_picture() {
    let (Some(dem), Some(rgb)) =
        (shared("dem/sanfrancisco_usgs_1s.tif"), shared("imagery/sfbay_landsat7_rgb.tif"))
    else {
        return;
    };
    let f = folder();
    let (gtb, glb) = (f.path().join("sf.gtb"), f.path().join("sf.glb"));
    let told: Value = serde_json::from_str(&printed(&[
        "gtb",
        "encode",
        text(&dem),
        text(&gtb),
        "--image",
        text(&rgb),
        "--bound",
        "2",
        "--json",
    ]))
    .unwrap();
    assert_eq!(told["texture_side"], 1024);
    let told: Value =
        serde_json::from_str(&printed(&["gtb", "decode", text(&gtb), text(&glb), "--error", "20", "--json"]))
            .unwrap();
    assert!(told["error_bound"].as_f64().unwrap() <= 20.0 && told["triangles"].as_u64().unwrap() > 1000);
    // Golden Gate Park is brighter than the sea to the west of it.
    let grid = {
        let mut source = terraquilt::format::open(&dem).unwrap();
        Grid::read(source.as_mut(), &|_, _| true).unwrap()
    };
    let (cells, _) = cells(&grid, &rgb, Some(10));
    let at = |lon: f64, lat: f64| {
        let [col, row] = [(lon + 122.522) / 0.00028, (37.84 - lat) / 0.00028].map(|v| v as usize);
        cells.rgb[row * 1024 + col].map(i32::from)
    };
    let (park, sea) = (at(-122.480, 37.7690), at(-122.519, 37.7690));
    assert!(park.iter().sum::<i32>() > 2 * sea.iter().sum::<i32>(), "{park:?} {sea:?}");
    let wrong =
        refused(&["gtb", "encode", text(&dem), text(&gtb), "--image", text(&rgb), "--image-cells", "100"], 1);
    assert!(wrong.contains("power of two"));
}
