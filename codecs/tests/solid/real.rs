//! The Stanford models, where they are: the field of each, and the way back.

use super::bodies::bad_edges;
use crate::support::shared;
use terraquilt_codecs::solid::mending::mended;
use terraquilt_codecs::solid::{Border, Field, MARGIN, Mesh, Report, Window, separation, surface};
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

/// The part of most triangles, by corners that they share.
fn greatest_part(mesh: &Mesh) -> Mesh {
    let mut part: Vec<u32> = (0..mesh.positions.len() as u32).collect();
    let mut changed = true;
    while changed {
        changed = false;
        for t in mesh.triangles.iter().chain(mesh.triangles.iter().rev()) {
            let least = t.map(|v| part[v as usize]).into_iter().min().unwrap();
            for v in t {
                changed |= std::mem::replace(&mut part[*v as usize], least) != least;
            }
        }
    }
    let mut count = vec![0; part.len()];
    mesh.triangles.iter().for_each(|t| count[part[t[0] as usize] as usize] += 1);
    let most = (0..count.len()).max_by_key(|k| count[*k]).unwrap() as u32;
    let of = |t: &&[u32; 3]| part[t[0] as usize] == most;
    Mesh { positions: mesh.positions.clone(), triangles: mesh.triangles.iter().filter(of).copied().collect() }
}

/// Field, marching cubes, and the distance both ways in voxels: of the mesh as it came, and of the greatest part of the mended one (acceptance F8).
fn there_and_back(file: &str, n: usize) -> Option<(Report, [f64; 2])> {
    let mesh = read(&std::fs::read_to_string(shared(file)?).unwrap());
    let window = Window::around(mesh.bounds().unwrap(), [n; 3], MARGIN).unwrap();
    let clock = std::time::Instant::now();
    let (field, report) = Field::of(&mesh, window, &Alone).unwrap();
    println!("{file} at {n}^3 in {:.2?}: {report}", clock.elapsed());
    let clock = std::time::Instant::now();
    let again = surface(&field.samples(), 0.0, Border::Open, &Alone).unwrap();
    println!("marching cubes in {:.2?}: {} triangles", clock.elapsed(), again.triangles.len());
    assert_eq!(bad_edges(&again), 0);
    let sound = greatest_part(&mended(&mesh).unwrap().0);
    let [_, found] = [("as it came", &mesh), ("mended", &sound)].map(|(what, mesh)| {
        let off = separation(mesh, &again, window.voxel / 2.0, &Alone).unwrap();
        [off.there, off.back].map(|d| {
            let [max, rms] = [d.max, d.rms].map(|v| v / window.voxel);
            println!("{what}: {max:.3} voxels, rms {rms:.3}, at {:.1?}", window.to_voxels(d.place));
            max
        })
    });
    Some((report, found))
}

/// Inside out, and open below: two holes of its plaster cast and three that the scanner left.
#[test]
fn the_bunny() {
    let Some((report, off)) = there_and_back("mesh/stanford_bunny.ply", 64) else { return };
    assert_eq!((report.open_edges, report.holes, report.inside_out, report.torn), (223, 5, true, 0));
    assert!(off.iter().all(|d| *d <= 1.0), "{off:?}");
}

/// Flaps of triangles back to back, edges of four, and bits of a few triangles deep within, which no field can bring back. The greatest
/// part has a pit 0.7 voxels wide, buried 1.8 voxels deep: no sample meets it, so only the way back is within a voxel.
#[test]
fn the_dragon() {
    let Some((report, off)) = there_and_back("mesh/stanford_dragon_res3.ply", 128) else { return };
    assert_eq!((report.doubled, report.crowded_edges, report.components, report.torn), (2134, 47, 4, 0));
    assert!(off[0] <= 1.9 && off[1] <= 1.0, "{off:?}");
}
