//! Wrong calls and wrong files: one clear line, and no file.

use super::{Folder, hills, tif};
use crate::support::{printed, program, refused};

#[test]
fn wrong_calls_get_one_clear_line_and_leave_no_file() {
    let f = Folder::new();
    let (dem, ifs, out) = (f.path("dem.tif"), f.path("a.ifs"), f.path("b.ifs"));
    tif(&dem, 40, 30, hills);
    printed(&["fractal", "encode", &dem, &ifs, "--bound", "1"]);
    let gtb = f.path("a.gtb");
    printed(&["gtb", "encode", &dem, &gtb]);
    let (png, glb, tif, txt) = (f.path("x.png"), f.path("x.glb"), f.path("x.tif"), f.path("x.txt"));
    std::fs::write(f.path("empty.ifs"), []).unwrap();
    std::fs::write(f.path("noise.ifs"), [7; 300]).unwrap();
    std::fs::write(f.path("photo.jpg"), [0xff, 0xd8, 0xff, 0xe0, 0, 0]).unwrap();
    let encode = |more: &[&'static str]| {
        let mut args = vec!["fractal", "encode", &dem, &out];
        args.extend(more);
        args.into_iter().map(str::to_string).collect::<Vec<String>>()
    };
    let words = |args: &[&str]| args.iter().map(|a| a.to_string()).collect::<Vec<String>>();
    let cases: Vec<(Vec<String>, &str)> = vec![
        (encode(&["--bound", "-1"]), "at least 0"),
        // Nothing is written over what is encoded, or under a name that says something else.
        (words(&["fractal", "encode", &dem, &dem, "--bound", "1"]), "ends with .ifs"),
        (words(&["fractal", "encode", &dem, &gtb, "--bound", "1"]), "ends with .ifs"),
        (words(&["gtb", "encode", &dem, &dem]), "ends with .gtb"),
        (words(&["gtb", "encode", &dem, &f.path("x")]), "ends with .gtb"),
        (encode(&["--bound", "nan"]), "at least 0"),
        (encode(&["--tolerance", "-1"]), "at least 0"),
        (encode(&["--const", "3"]), "power of two"),
        (encode(&["--const", "64"]), "power of two"),
        (encode(&["--maps", "0"]), "maps"),
        (encode(&["--maps", "9", "--jump", "3"]), "jump"),
        (encode(&["--maps", "900", "--isometries", "3"]), "isometries"),
        (encode(&["--bound", "1", "--unit", "0"]), "positive"),
        (encode(&["--bound", "1", "--unit", "0.0000001"]), "larger unit"),
        (encode(&["--bound", "1", "--step", "0"]), "means"),
        (encode(&["--bound", "1", "--interest", "1,2,3"]), "--interest"),
        (encode(&["--bound", "1", "--interest", "0,0,1,1,0.5"]), "--interest"),
        (encode(&["--bound", "1", "--voxels", "64"]), "--voxels"),
        (encode(&["--maps", "9", "--as", "picture"]), "colours"),
        (encode(&["--maps", "99", "--as", "mesh"]), "mesh"),
        (words(&["fractal", "encode", &f.path("none.tif"), &out, "--bound", "1"]), "not found"),
        (words(&["fractal", "encode", &f.path("photo.jpg"), &out, "--maps", "9"]), "JPEG"),
        (words(&["fractal", "encode", &ifs, &out, "--bound", "1"]), "gdal_translate"),
        (words(&["fractal", "decode", &ifs, &txt]), "'.txt'"),
        (words(&["fractal", "decode", &ifs, &tif, "--zoom", "0"]), "--zoom"),
        (words(&["fractal", "decode", &ifs, &tif, "--zoom", "nan"]), "--zoom"),
        (words(&["fractal", "decode", &ifs, &tif, "--zoom", "1000000"]), "smaller --zoom"),
        (words(&["fractal", "decode", &ifs, &tif, "--passes", "0"]), "--passes"),
        (words(&["fractal", "decode", &ifs, &tif, "--passes", "3", "--zoom", "2"]), "zoom 1"),
        (words(&["fractal", "decode", &ifs, &tif, "--window", "0,0,0,1,1,1"]), "solids"),
        (words(&["fractal", "decode", &ifs, &png, "--mesh-error", "1"]), ".glb"),
        (words(&["fractal", "decode", &ifs, &glb, "--mesh-error", "nan"]), "at least 0"),
        (words(&["fractal", "decode", &ifs, &f.path("x.ply")]), ".glb"),
        (words(&["fractal", "decode", &f.path("empty.ifs"), &tif]), "0 bytes are there"),
        (words(&["fractal", "decode", &f.path("noise.ifs"), &tif]), "no fractal tile"),
        (words(&["fractal", "info", &f.path("none.ifs")]), "not found"),
        (words(&["fractal", "info", &gtb]), "terraquilt gtb"),
        (words(&["fractal", "decode", &gtb, &tif]), "terraquilt gtb"),
        (words(&["gtb", "info", &ifs]), "terraquilt fractal"),
        (words(&["fractal", "point", &ifs, "here"]), "numbers"),
    ];
    for (args, word) in &cases {
        let args: Vec<&str> = args.iter().map(String::as_str).collect();
        let said = refused(&args, 1);
        assert!(said.contains(word), "{args:?}: {said}");
    }
    assert_eq!(f.files(), ["a.gtb", "a.ifs", "dem.tif", "empty.ifs", "noise.ifs", "photo.jpg"]);
    // How far to go must be said, once.
    assert_eq!(program(&["fractal", "encode", &dem, &out]).status.code(), Some(2));
    let twice = program(&["fractal", "encode", &dem, &out, "--maps", "9", "--const", "2"]);
    assert_eq!(twice.status.code(), Some(2));
    if !cfg!(feature = "gpu") {
        assert!(refused(&["fractal", "decode", &ifs, &tif, "--gpu"], 1).contains("--features gpu"));
    }
}

/// Heads that ask for much get an error before memory does.
#[test]
fn heads_that_ask_for_too_much_are_refused() {
    let f = Folder::new();
    let (dem, ifs) = (f.path("dem.tif"), f.path("a.ifs"));
    tif(&dem, 40, 30, hills);
    printed(&["fractal", "encode", &dem, &ifs, "--bound", "1"]);
    let (header, head) = terraquilt_codecs::fractal::Header::read(&std::fs::read(&ifs).unwrap()).unwrap();
    let body = std::fs::read(&ifs).unwrap()[head..].to_vec();
    for size in [[16_384, 16_384, 1], [9_000, 9_000, 1]] {
        let mut big = header.clone();
        big.size = size;
        if let terraquilt_codecs::fractal::Shapes::Planes(planes) = &mut big.shapes {
            planes[0].size = [size[0], size[1]];
        }
        let mut bytes = big.bytes();
        bytes.extend(&body);
        std::fs::write(&ifs, &bytes).unwrap();
        assert!(refused(&["fractal", "info", &ifs], 1).contains("allowed"));
    }
}
