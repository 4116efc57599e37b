//! What is wrong with a mesh, and its mending.

use super::mesh::Mesh;
use super::vector::Vector;
use crate::Result;
use std::fmt;

/// What was found in a mesh on the way to its field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Report {
    /// Triangles that are used.
    pub triangles: usize,
    /// Positions that they use, equal ones counted once.
    pub positions: usize,
    /// Parts that no edge connects.
    pub components: usize,
    /// Triangles left out: two corners at one place, or all on one line.
    pub degenerate: usize,
    /// Edges of one triangle: the mesh is open there.
    pub open_edges: usize,
    /// Edges of more than two triangles.
    pub crowded_edges: usize,
    /// Triangles that were turned over to face as their neighbours do.
    pub turned: usize,
    /// Edges whose two triangles face different ways, and cannot be made to agree: the mesh has one side only.
    pub one_sided_edges: usize,
    /// Whether the mesh was inside out, and turned as a whole.
    pub inside_out: bool,
    /// Voxels whose sign was set by that of their neighbours, or by lying beyond the mesh, against the nearest triangle's.
    pub resigned: usize,
    /// Pairs of neighbouring voxels whose distances differ by more than their own: the sign changes there without a surface.
    pub torn: usize,
}

impl Report {
    /// Whether every edge has two triangles that face the same way: the mesh bounds a solid, and the field's signs are certain where it does not
    /// cross itself.
    pub fn is_closed(&self) -> bool {
        self.open_edges == 0 && self.crowded_edges == 0 && self.one_sided_edges == 0
    }

    /// What a user should know, as one sentence; nothing if the mesh is as it should be.
    pub fn warning(&self) -> Option<String> {
        let mut parts = Vec::new();
        let mut note = |count: usize, one: &str, many: &str| {
            if count > 0 {
                parts.push(format!("{count} {}", if count == 1 { one } else { many }));
            }
        };
        note(self.open_edges, "open edge", "open edges");
        note(self.crowded_edges, "edge of more than two triangles", "edges of more than two triangles");
        note(
            self.one_sided_edges,
            "edge between two sides of one face",
            "edges between two sides of one face",
        );
        note(self.turned, "triangle turned over", "triangles turned over");
        note(self.degenerate, "triangle without area left out", "triangles without area left out");
        note(self.torn, "tear in the field", "tears in the field");
        if self.inside_out {
            parts.push("it was inside out".to_string());
        }
        (!parts.is_empty()).then(|| {
            let end = if self.is_closed() && self.torn == 0 {
                ""
            } else {
                "; what is inside is a best guess there: mend the mesh if it matters"
            };
            format!("the mesh is not as it should be: {}{end}", parts.join(", "))
        })
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} triangles, {} positions, {} components",
            self.triangles, self.positions, self.components
        )?;
        match self.warning() {
            Some(w) => write!(f, "; {w}"),
            None => write!(f, "; closed"),
        }
    }
}

/// A side of a triangle.
#[derive(Clone, Copy)]
struct Side {
    /// The lesser and the greater end.
    ends: [u32; 2],
    /// The triangle, and whether it runs from the greater end to the lesser.
    triangle: u32,
    back: bool,
}

/// The mesh with equal positions made one, positions that no triangle uses and degenerate triangles left out, and triangles turned so that neighbours
/// face the same way and the whole encloses a positive volume. Costs two sorts.
///
/// # Errors
/// As [`Mesh::check`]; [`Error::Invalid`](crate::Error::Invalid) also if all triangles are degenerate.
pub fn mended(mesh: &Mesh) -> Result<(Mesh, Report)> {
    mesh.check()?;
    let mut report = Report::default();
    let mut out = welded(mesh);
    let before = out.triangles.len();
    out.triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    let sides = sides(&out);
    let groups = || sides.chunk_by(|a, b| a.ends == b.ends);
    report.open_edges = groups().filter(|g| g.len() == 1).count();
    report.crowded_edges = groups().filter(|g| g.len() > 2).count();
    turn(&mut out, &sides, &mut report);
    if out.volume() < 0.0 {
        report.inside_out = true;
        out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    // Those on one line hold edges together, so they go last.
    let normals = out.face_normals();
    let mut kept = normals.iter().map(|n| *n != [0.0; 3]);
    out.triangles.retain(|_| kept.next().unwrap_or(false));
    report.degenerate = before - out.triangles.len();
    report.triangles = out.triangles.len();
    report.positions = out.positions.len();
    if out.triangles.is_empty() {
        let reason = format!("none of its {before} triangles has an area; give a mesh that has extent");
        return Err(crate::Error::invalid("mesh", reason));
    }
    Ok((out, report))
}

/// The mesh with each place once, in the order in which triangles meet them.
fn welded(mesh: &Mesh) -> Mesh {
    // A negative zero is a zero.
    let key = |p: Vector| p.map(|v| (v + 0.0).to_bits());
    let mut used: Vec<u32> = mesh.triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    used.sort_by_key(|v| key(mesh.positions[*v as usize]));
    const NONE: u32 = u32::MAX;
    // The first of those at one place stands for all.
    let mut same = vec![NONE; mesh.positions.len()];
    for group in used.chunk_by(|a, b| key(mesh.positions[*a as usize]) == key(mesh.positions[*b as usize])) {
        group.iter().for_each(|v| same[*v as usize] = group[0]);
    }
    let mut new = vec![NONE; mesh.positions.len()];
    let mut positions = Vec::new();
    let triangles = mesh.triangles.iter().map(|t| {
        t.map(|v| {
            let v = same[v as usize] as usize;
            if new[v] == NONE {
                new[v] = positions.len() as u32;
                positions.push(mesh.positions[v].map(|x| x + 0.0));
            }
            new[v]
        })
    });
    let triangles = triangles.collect();
    Mesh { positions, triangles }
}

/// All sides of triangles, sorted by their ends, then by triangle.
fn sides(mesh: &Mesh) -> Vec<Side> {
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
fn turn(mesh: &mut Mesh, sides: &[Side], report: &mut Report) {
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

/// The one that stands for all that were joined with `t`: the least.
pub(super) fn root(parents: &mut [u32], mut t: u32) -> u32 {
    while parents[t as usize] != t {
        parents[t as usize] = parents[parents[t as usize] as usize];
        t = parents[t as usize];
    }
    t
}

/// Makes two one.
pub(super) fn join(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parents, a), root(parents, b));
    let (least, other) = (a.min(b), a.max(b));
    parents[other as usize] = least;
}
