//! Pictures: what was measured, zooms, points, and what is no picture.

use super::{Folder, json, png};
use crate::support::{ground, printed, program, refused};
use std::path::Path;
use terraquilt::format::picture::Picture;
use terraquilt::height::source::Window;

fn pixels(path: &str) -> (usize, usize, Vec<[u8; 3]>) {
    let mut p = Picture::open(Path::new(path)).unwrap();
    let (cols, rows) = (p.info().cols as usize, p.info().rows as usize);
    (cols, rows, p.read(Window { col: 0, row: 0, cols, rows }).unwrap().rgb)
}

fn shade(x: usize, y: usize) -> u8 {
    (ground(x as f64 * 7.0, y as f64 * 7.0) - 380.0).clamp(0.0, 255.0) as u8
}

fn grey(path: &str, cols: usize, rows: usize) {
    let data: Vec<u8> = (0..cols * rows).map(|k| shade(k % cols, k / cols)).collect();
    png(path, [cols as u32, rows as u32], png::ColorType::Grayscale, png::BitDepth::Eight, &data);
}

fn colour(path: &str, cols: usize, rows: usize) {
    let one = |k: usize| {
        let v = shade(k % cols, k / cols);
        [v, 255 - v, (k % cols * 4) as u8]
    };
    let data: Vec<u8> = (0..cols * rows).flat_map(one).collect();
    png(path, [cols as u32, rows as u32], png::ColorType::Rgb, png::BitDepth::Eight, &data);
}

#[test]
fn grey_and_colours_are_as_near_as_they_say() {
    let f = Folder::new();
    let (pic, ifs, out) = (f.path("a.png"), f.path("a.ifs"), f.path("b.png"));
    for (kind, write) in
        [("grey", &grey as &dyn Fn(&str, usize, usize)), ("colour", &colour as &dyn Fn(&str, usize, usize))]
    {
        for (cols, rows) in [(70, 50), (1, 9), (5, 3), (9, 1), (1, 1), (13, 6)] {
            write(&pic, cols, rows);
            for more in [
                &["--slope", "1"][..],
                &["--maps", "600", "--chroma", "4"],
                &["--const", "2", "--chroma", "1"],
            ] {
                let told = json(&[&["fractal", "encode", &pic, &ifs, "--search", "near"][..], more].concat());
                let shown = json(&["fractal", "decode", &ifs, &out]);
                let (a, b) = (pixels(&pic), pixels(&out));
                assert_eq!((a.0, a.1), (b.0, b.1));
                let off = a.2.as_flattened().iter().zip(b.2.as_flattened()).map(|(a, b)| a.abs_diff(*b));
                let most = off.clone().max().unwrap();
                assert_eq!(
                    told["error_max"].as_f64(),
                    Some(f64::from(most)),
                    "{kind} {cols} x {rows} {more:?}"
                );
                assert_eq!(shown["error_max"], told["error_max"]);
                let mean = off.clone().map(|o| f64::from(o).powi(2)).sum::<f64>() / (3 * cols * rows) as f64;
                match told["psnr_db"].as_f64() {
                    Some(psnr) => assert!((psnr - 10.0 * (65025.0 / mean).log10()).abs() < 1e-6),
                    None => assert_eq!(most, 0),
                }
                for (zoom, detail) in [("2", "plain"), ("3", "controlled"), ("2", "none"), ("0.5", "none")] {
                    let told = json(&["fractal", "decode", &ifs, &out, "--zoom", zoom, "--detail", detail]);
                    assert_eq!(told["synthetic"], zoom != "0.5");
                    let z: f64 = zoom.parse().unwrap();
                    let size = |n: usize| ((n as f64 * z - 0.5).ceil() as usize).max(1);
                    assert_eq!(pixels(&out).2.len(), size(cols) * size(rows));
                }
            }
        }
    }
}

#[test]
fn points_of_pictures_are_their_pixels() {
    let f = Folder::new();
    let (pic, ifs, out) = (f.path("a.png"), f.path("a.ifs"), f.path("b.png"));
    colour(&pic, 40, 30);
    printed(&["fractal", "encode", &pic, &ifs, "--slope", "1", "--search", "near"]);
    printed(&["fractal", "decode", &ifs, &out]);
    let (cols, _, rgb) = pixels(&out);
    let rows = json(&["fractal", "point", &ifs, "0,0", "12.5,20.1", "39.99,30", "40.1,3"]);
    for (row, at) in rows.as_array().unwrap().iter().zip([0, 20 * cols + 12, 29 * cols + 39]) {
        let found = ["red", "green", "blue"].map(|c| row[c].as_f64().unwrap() as u8);
        assert_eq!(found, rgb[at]);
    }
    assert!(rows[3]["red"].is_null());
    let csv = printed(&["fractal", "point", &ifs, "1,1", "--zoom", "16"]);
    assert!(csv.starts_with("x,y,red,green,blue,error\n1,1,"), "{csv}");
    // A picture has no place to be a DEM or a mesh at.
    for (ending, word) in [("tif", ".png"), ("glb", ".png"), ("ply", ".png")] {
        assert!(refused(&["fractal", "decode", &ifs, &f.path(&format!("x.{ending}"))], 1).contains(word));
    }
}

#[test]
fn what_a_file_is_taken_for_is_said_and_can_be_chosen() {
    let f = Folder::new();
    let (pic, ifs) = (f.path("a.png"), f.path("a.ifs"));
    grey(&pic, 40, 30);
    let done = program(&["fractal", "encode", &pic, &ifs, "--const", "4"]);
    assert!(String::from_utf8_lossy(&done.stderr).contains("--as heights"));
    assert_eq!(json(&["fractal", "info", &ifs])["kind"], "grey");
    let told = json(&["fractal", "encode", &pic, &ifs, "--as", "heights", "--bound", "0"]);
    assert_eq!((told["kind"].as_str(), told["error_max"].as_f64()), (Some("heights"), Some(0.0)));
    // 16 bits of grey are heights.
    let deep: Vec<u8> = (0..40 * 30u16).flat_map(|k| (k * 50).to_be_bytes()).collect();
    png(&pic, [40, 30], png::ColorType::Grayscale, png::BitDepth::Sixteen, &deep);
    let told = json(&["fractal", "encode", &pic, &ifs, "--bound", "0"]);
    assert_eq!((told["kind"].as_str(), told["error_max"].as_f64()), (Some("heights"), Some(0.0)));
    assert!(
        refused(&["fractal", "encode", &pic, &ifs, "--as", "picture", "--bound", "1"], 1).contains("--bound")
    );
    // Boxes of interest of a picture are pixels, downwards.
    grey(&pic, 64, 64);
    printed(&["fractal", "encode", &pic, &ifs, "--maps", "100", "--interest", "0,0,16,16,100"]);
    let done = program(&["fractal", "encode", &pic, &ifs, "--maps", "100", "--interest", "-9,-9,-5,-5,100"]);
    assert!(String::from_utf8_lossy(&done.stderr).contains("no sample lies"));
}
