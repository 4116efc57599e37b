//! Sides of triangles, and triangles that face as their neighbours do.

use super::mesh::Mesh;
use super::report::Report;
use super::sets::{join, root};

/// A side of a triangle.
#[derive(Clone, Copy)]
pub struct Side {
    /// The lesser and the greater end.
    pub ends: [u32; 2],
    /// The triangle.
    pub triangle: u32,
    /// Whether it runs from the greater end to the lesser.
    pub back: bool,
}

/// All sides of triangles, sorted by their ends, then by triangle.
pub fn sides(mesh: &Mesh) -> Vec<Side> {
    let mut out = Vec::with_capacity(mesh.triangles.len() * 3);
    for (triangle, t) in mesh.triangles.iter().enumerate() {
        for k in 0..3 {
            let (a, b) = (t[k], t[(k + 1) % 3]);
            out.push(Side { ends: [a.min(b), a.max(b)], triangle: triangle as u32, back: a > b });
        }
    }
    out.sort_unstable_by_key(|s| (s.ends, s.triangle, s.back));
    out
}

/// Counts components, and turns triangles to face as their neighbours do: in each part that edges of two triangles connect, the fewer ones are turned.
pub fn turn(mesh: &mut Mesh, sides: &[Side], report: &mut Report) {
    let count = mesh.triangles.len();
    let mut together: Vec<u32> = (0..count as u32).collect();
    // Neighbours over edges of two triangles, and whether they face different ways; three at most.
    const NONE: u32 = u32::MAX;
    let mut neighbours = vec![[(NONE, false); 3]; count];
    let mut link = |from: u32, to: u32, differ: bool| {
        if let Some(free) = neighbours[from as usize].iter_mut().find(|n| n.0 == NONE) {
            *free = (to, differ);
        }
    };
    for group in sides.chunk_by(|a, b| a.ends == b.ends) {
        group.windows(2).for_each(|w| join(&mut together, w[0].triangle, w[1].triangle));
        if let [a, b] = group {
            link(a.triangle, b.triangle, a.back == b.back);
            link(b.triangle, a.triangle, a.back == b.back);
        }
    }
    report.components = (0..count as u32).filter(|t| root(&mut together, *t) == *t).count();
    #[derive(Clone, Copy, PartialEq)]
    enum State {
        Unseen,
        Stays,
        Turns,
    }
    let mut states = vec![State::Unseen; count];
    let mut part = Vec::new();
    let mut one_sided = 0;
    for start in 0..count {
        if states[start] != State::Unseen {
            continue;
        }
        states[start] = State::Stays;
        part.clear();
        part.push(start);
        let mut next = 0;
        while next < part.len() {
            let t = part[next];
            next += 1;
            for (to, differ) in neighbours[t].into_iter().filter(|n| n.0 != NONE) {
                let to = to as usize;
                let wanted = if (states[t] == State::Turns) != differ { State::Turns } else { State::Stays };
                if states[to] == State::Unseen {
                    states[to] = wanted;
                    part.push(to);
                } else if states[to] != wanted {
                    one_sided += 1;
                }
            }
        }
        let turns = part.iter().filter(|t| states[**t] == State::Turns).count();
        let flip = if 2 * turns > part.len() { State::Stays } else { State::Turns };
        for &t in part.iter().filter(|t| states[**t] == flip) {
            mesh.triangles[t].swap(1, 2);
            report.turned += 1;
        }
    }
    // Each was met from both of its triangles.
    report.one_sided_edges = one_sided / 2;
}
