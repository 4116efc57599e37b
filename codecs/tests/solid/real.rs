//! The Stanford models, where they are: the field of each, and the way back.

use crate::support::shared;
use terraquilt_codecs::solid::mending::mended;
use terraquilt_codecs::solid::{Border, Field, MARGIN, Mesh, Window, separation, surface};
use terraquilt_codecs::work::Alone;

/// Vertices and triangles of a PLY text as those two files have them.
pub fn read(text: &str) -> Mesh {
    let count = |what: &str| -> usize {
        let line = text.lines().find_map(|l| l.strip_prefix(what)).expect("a count");
        line.trim().parse().expect("a number")
    };
    let (vertices, faces) = (count("element vertex "), count("element face "));
    let mut lines = text.lines().skip_while(|l| *l != "end_header").skip(1);
    let mut row = || lines.next().expect("a row").split_whitespace();
    let mut mesh = Mesh::default();
    for _ in 0..vertices {
        let mut words = row();
        mesh.positions.push([0; 3].map(|_| words.next().expect("three").parse().expect("a number")));
    }
    for _ in 0..faces {
        let mut words = row();
        assert_eq!(words.next(), Some("3"));
        mesh.triangles.push([0; 3].map(|_| words.next().expect("three").parse().expect("an index")));
    }
    mesh
}

fn there_and_back(file: &str, n: usize) {
    let Some(path) = shared(file) else { return };
    let mesh = read(&std::fs::read_to_string(path).unwrap());
    let window = Window::around(mesh.bounds().unwrap(), [n; 3], MARGIN).unwrap();
    let clock = std::time::Instant::now();
    let (field, report) = Field::of(&mesh, window, &Alone).unwrap();
    let built = clock.elapsed();
    println!("{file} at {n}^3 in {built:.2?}: {report}\n{report:?}");
    let clock = std::time::Instant::now();
    let again = surface(&field.samples(), 0.0, Border::Open, &Alone).unwrap();
    println!("marching cubes in {:.2?}: {} triangles", clock.elapsed(), again.triangles.len());
    assert_eq!(super::bodies::bad_edges(&again), 0);
    let clock = std::time::Instant::now();
    let (sound, _) = mended(&mesh).unwrap();
    for (what, mesh) in [("as it came", &mesh), ("mended", &sound)] {
        let off = separation(mesh, &again, window.voxel / 2.0, &Alone).unwrap();
        let [there, back] = [off.there, off.back].map(|d| {
            let voxels = [d.max, d.rms].map(|v| v / window.voxel);
            println!(
                "{what}: {:.3} voxels, rms {:.3}, at {:.1?}",
                voxels[0],
                voxels[1],
                window.to_voxels(d.place)
            );
            voxels[0]
        });
        let _ = (there, back);
    }
}

#[test]
fn the_bunny() {
    there_and_back("mesh/stanford_bunny.ply", 64);
}

#[test]
fn the_dragon() {
    there_and_back("mesh/stanford_dragon_res3.ply", 128);
}
