//! PLY: texts and binary, what is passed over, what is refused.

use super::{hostile, refusal, tetrahedron};
use terraquilt::format::solid::{parse_solid, read_solid};
use terraquilt_codecs::solid::Mesh;

const TEXT: &str = "ply\nformat ascii 1.0\ncomment of \u{fc}bung\nobj_info none\nelement vertex 4\nproperty float x\nproperty float y\n\
    property uchar red\nproperty float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n\
    0 0 9 0\n1 0 9 0\n0 2 9 0\n0 0 9 4\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n";

/// The tetrahedron in binary, among an element that is not known, with a list before the corners and a number after them.
fn binary(big: bool) -> Vec<u8> {
    let order = if big { "big" } else { "little" };
    let mut out = format!(
        "ply\nformat binary_{order}_endian 1.0\nelement extra 2\nproperty list ushort double w\nelement face 4\n\
         property list uint8 float32 shade\nproperty list uchar uint vertex_index\nproperty short group\n\
         element vertex 4\nproperty double y\nproperty float64 x\nproperty int16 z\nproperty list uchar uchar tags\nend_header\n"
    )
    .into_bytes();
    let mut put = |bytes: &[u8]| match big {
        true => out.extend(bytes.iter().rev()),
        false => out.extend(bytes),
    };
    for n in [2u16, 0] {
        put(&n.to_le_bytes());
        (0..n).for_each(|k| put(&f64::from(k).to_le_bytes()));
    }
    let mesh = tetrahedron();
    for t in &mesh.triangles {
        put(&[1]);
        put(&0.5f32.to_le_bytes());
        put(&[3]);
        t.iter().for_each(|v| put(&v.to_le_bytes()));
        put(&(-7i16).to_le_bytes());
    }
    for p in &mesh.positions {
        put(&p[1].to_le_bytes());
        put(&p[0].to_le_bytes());
        put(&(p[2] as i16).to_le_bytes());
        put(&[2]);
        put(&[1]);
        put(&[2]);
    }
    out
}

fn read(bytes: &[u8]) -> Mesh {
    parse_solid("a.ply", bytes).unwrap()
}

#[test]
fn texts_and_binary_are_the_same_mesh() {
    assert_eq!(read(TEXT.as_bytes()), tetrahedron());
    assert_eq!(read(TEXT.replace('\n', "\r\n").as_bytes()), tetrahedron());
    assert_eq!(read(TEXT.replace('\n', "\r").as_bytes()), tetrahedron());
    assert_eq!(read(TEXT.replace("\n3 ", "\n\n  3\t").as_bytes()), tetrahedron());
    assert_eq!(read(TEXT.trim_end().as_bytes()), tetrahedron());
    assert_eq!(read(&binary(false)), tetrahedron());
    assert_eq!(read(&binary(true)), tetrahedron());
}

#[test]
fn greater_faces_are_fans_and_smaller_ones_nothing() {
    let text = TEXT.replace("element face 4", "element face 6").replace("3 1 2 3\n", "4 0 1 2 3\n2 0 1\n0\n");
    assert_eq!(read(text.as_bytes()).triangles[3..], [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn errors_name_element_and_row() {
    let said = |from: &str, to: &str| {
        assert!(TEXT.contains(from));
        refusal(TEXT.replacen(from, to, 1).as_bytes())
    };
    let holds = |said: String, words: &[&str]| {
        assert!(words.iter().all(|w| said.contains(w)) && said.contains("a.mesh"), "{said}: {words:?}")
    };
    holds(said("1 0 9 0", "1 zero 9 0"), &["element vertex, row 2", "'zero' is no number"]);
    holds(said("1 0 9 0", "1 0 9"), &["element vertex, row 2", "too soon"]);
    holds(said("1 0 9 0", "1 0 9 0 5"), &["element vertex, row 2", "'5' is left over"]);
    holds(said("3 0 3 2", "3 0 3 4"), &["element face, row 3", "corner 2 is vertex 4, there are 4"]);
    holds(said("3 0 3 2", "3 0 -3 2"), &["element face, row 3", "vertex -3"]);
    holds(said("3 0 3 2", "3 0 1.5 2"), &["element face, row 3", "vertex 1.5"]);
    holds(said("3 0 3 2", "-3 0 3 2"), &["element face, row 3", "length -3"]);
    holds(said("3 0 3 2", "nan"), &["element face, row 3", "length NaN"]);
    holds(said("3 1 2 3\n", ""), &["element face, row 4", "the file ends before it"]);
    holds(said("element face 4", "element face 4000000000000"), &["element face", "4000000000000 rows need"]);
    holds(said("vertex 4", "vertex 99999999999999999999"), &["line 5", "no number of rows"]);
    holds(said("vertex 4", "vertex 99999999"), &["vertices of a.mesh", "16777216"]);
    holds(said("float z", "float w"), &["element vertex", "no property z"]);
    holds(said("float z", "quad z"), &["line 9", "'quad' is no type"]);
    holds(said("float z", "float x"), &["line 9", "x is there twice"]);
    holds(said("element face", "element vertex"), &["line 10", "vertex is there twice"]);
    holds(said("element face", "element side"), &["points alone bound no solid"]);
    holds(said("vertex_indices", "corners"), &["no list vertex_indices"]);
    holds(said("list uchar", "list float"), &["no whole number"]);
    holds(said("ascii 1.0", "ascii 2.0"), &["format ascii 2.0"]);
    holds(said("format ascii 1.0\n", ""), &["no line format"]);
    holds(said("end_header\n", ""), &["header, line 12"]);
    holds(refusal(b""), &["empty"]);
    holds(refusal(b"solid cube"), &["write it as PLY or GLB"]);
    let cut = &binary(false)[..binary(false).len() - 3];
    holds(refusal(cut), &["element vertex, row 4", "the file ends within"]);
    // A list that says it is longer than the file.
    let huge = TEXT.replace("ascii", "binary_little_endian").replace("uchar int", "uint double");
    holds(refusal(huge.as_bytes()), &["a.mesh"]);
}

#[test]
fn damage_is_harmless() {
    hostile(TEXT.as_bytes(), 1);
    hostile(&binary(false), 2);
    hostile(&binary(true), 3);
}

#[test]
fn the_stanford_models_are_read() {
    for (file, positions, triangles) in
        [("mesh/stanford_bunny.ply", 35947, 69451), ("mesh/stanford_dragon_res3.ply", 22998, 47794)]
    {
        let Some(path) = crate::support::shared(file) else { continue };
        let mesh = read_solid(&path).unwrap();
        assert_eq!((mesh.positions.len(), mesh.triangles.len()), (positions, triangles), "{file}");
        assert!(mesh.check().is_ok());
    }
}
