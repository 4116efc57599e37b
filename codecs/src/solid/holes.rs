//! Holes of a mesh, closed.

use super::mesh::Mesh;
use super::turning::sides;
use super::vector::{add, scaled};

/// Closes every hole by a fan round the middle of its edge; returns how many there were. A side that no other triangle runs back along bounds a hole.
/// As many such sides end at a corner as begin there, so they are loops; where loops touch, they are taken apart.
pub fn close(mesh: &mut Mesh) -> usize {
    let mut free = free_sides(mesh);
    free.sort_unstable();
    let mut used = vec![false; free.len()];
    // The place of each corner on the path, while it is on it.
    let mut place = vec![usize::MAX; mesh.positions.len()];
    let (mut path, mut holes): (Vec<u32>, usize) = (Vec::new(), 0);
    for start in 0..free.len() {
        let mut at = free[start].0;
        // On from the end of each side by the first one that is left, until none is.
        while let Some(next) = leaving(&free, &used, at) {
            place[at as usize] = path.len();
            path.push(at);
            used[next] = true;
            at = free[next].1;
            let back = place[at as usize];
            if back != usize::MAX {
                fan(mesh, &path[back..]);
                holes += 1;
                path.drain(back..).for_each(|v| place[v as usize] = usize::MAX);
            }
        }
        path.drain(..).for_each(|v| place[v as usize] = usize::MAX);
    }
    holes
}

/// From where to where triangles are missing: against the sides that nothing runs back along.
fn free_sides(mesh: &Mesh) -> Vec<(u32, u32)> {
    let mut out = Vec::new();
    for group in sides(mesh).chunk_by(|a, b| a.ends == b.ends) {
        let back = group.iter().filter(|s| s.back).count();
        let forth = group.len() - back;
        let [low, high] = group[0].ends;
        let missing = if forth > back { (high, low) } else { (low, high) };
        out.extend(std::iter::repeat_n(missing, forth.abs_diff(back)));
    }
    out
}

/// The first unused side that begins at a corner.
fn leaving(free: &[(u32, u32)], used: &[bool], at: u32) -> Option<usize> {
    let first = free.partition_point(|s| s.0 < at);
    (first..free.len()).take_while(|k| free[*k].0 == at).find(|k| !used[*k])
}

/// Closes one loop.
fn fan(mesh: &mut Mesh, path: &[u32]) {
    if let [a, b, c] = path {
        mesh.triangles.push([*a, *b, *c]);
        return;
    }
    if path.len() < 3 {
        return;
    }
    let sum = path.iter().fold([0.0; 3], |sum, v| add(sum, mesh.positions[*v as usize]));
    let middle = mesh.positions.len() as u32;
    mesh.positions.push(scaled(sum, 1.0 / path.len() as f64));
    for (k, v) in path.iter().enumerate() {
        mesh.triangles.push([*v, path[(k + 1) % path.len()], middle]);
    }
}
