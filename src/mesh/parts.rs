//! A triangulation taken apart into tiles, and put together again.
//!
//! A tile's triangles and heights fit into the nearest caches, and tiles can be worked at side by side. They are cut along
//! sides of triangles, which stay as they are; their vertices are looked at again in the end. Tiles are
//! those of the lattice, so the mesh does not depend on the number of threads.

use super::flat::{Flat, NONE, SEAM, is_outside, next};

/// Cells along the side of a tile.
const TILE_CELLS: f64 = 128.0;

/// One tile's triangles.
pub(super) struct Part {
    pub flat: Flat,
    /// The vertices of the whole that its first vertices are.
    pub whole: Vec<u32>,
}

/// The tile of each triangle, by its middle; tiles count from 0 in order of the first triangle that each has.
pub(super) fn tiles(flat: &Flat) -> (Vec<u32>, usize) {
    let mut numbers = std::collections::BTreeMap::new();
    let tile = |t: u32| {
        let at = flat.at(t);
        let middle = |of: [f64; 3]| ((of[0] + of[1] + of[2]) / 3.0 / TILE_CELLS) as u32;
        (middle(at.map(|v| v.j)), middle(at.map(|v| v.i)))
    };
    let mut part = Vec::with_capacity(flat.triangle_count());
    for t in 0..flat.triangle_count() as u32 {
        let count = numbers.len() as u32;
        part.push(*numbers.entry(tile(t)).or_insert(count));
    }
    (part, numbers.len())
}

/// The parts of a triangulation, by the part that each triangle is of.
pub(super) fn apart(flat: &Flat, part: &[u32], count: usize) -> Vec<Part> {
    let mut triangles: Vec<Vec<u32>> = vec![Vec::new(); count];
    let mut place = vec![NONE; flat.triangle_count()];
    for (t, p) in part.iter().enumerate() {
        place[t] = triangles[*p as usize].len() as u32;
        triangles[*p as usize].push(t as u32);
    }
    let mut name = vec![NONE; flat.vertices.len()];
    let mut parts = Vec::with_capacity(count);
    for (p, triangles) in triangles.iter().enumerate() {
        let mut whole = Vec::new();
        let mut one = Flat::default();
        for &t in triangles {
            for h in t * 3..t * 3 + 3 {
                let v = flat.corners[h as usize];
                if name[v as usize] == NONE {
                    name[v as usize] = one.push(*flat.vertex(v));
                    whole.push(v);
                }
                one.leaving[name[v as usize] as usize] = one.corners.len() as u32;
                one.corners.push(name[v as usize]);
                let twin = flat.twin(h);
                one.twins.push(match twin {
                    NONE => NONE,
                    twin if part[twin as usize / 3] == p as u32 => place[twin as usize / 3] * 3 + twin % 3,
                    _ => SEAM,
                });
            }
        }
        for h in 0..one.corners.len() as u32 {
            if one.twin(h) == SEAM {
                let (a, b) = one.ends(h);
                [a, b].into_iter().for_each(|v| one.vertices[v as usize].fixed = true);
            }
        }
        whole.iter().for_each(|v| name[*v as usize] = NONE);
        parts.push(Part { flat: one, whole });
    }
    parts
}

/// The parts put together, without what was taken out of them, and the vertices on seams, which are free again.
pub(super) fn together(parts: Vec<Part>, vertices: usize) -> (Flat, Vec<u32>) {
    let mut all = Flat::default();
    let mut seams: Vec<(u32, u32, u32)> = Vec::new();
    let mut name = vec![NONE; vertices];
    for Part { flat, whole } in parts {
        let from = all.corners.len() as u32;
        let (flat, kept) = flat.compacted();
        let names: Vec<u32> = kept
            .iter()
            .zip(&flat.vertices)
            .map(|(old, vertex)| match whole.get(*old as usize) {
                Some(&v) if name[v as usize] != NONE => name[v as usize],
                Some(&v) => {
                    name[v as usize] = all.push(*vertex);
                    name[v as usize]
                }
                None => all.push(*vertex),
            })
            .collect();
        for (h, v) in flat.corners.iter().enumerate() {
            all.leaving[names[*v as usize] as usize] = from + h as u32;
            all.corners.push(names[*v as usize]);
            let twin = flat.twins[h];
            all.twins.push(if is_outside(twin) { twin } else { from + twin });
        }
        for h in (0..flat.corners.len() as u32).filter(|h| flat.twin(*h) == SEAM) {
            let [a, b] = [h, next(h)].map(|h| names[flat.corners[h as usize] as usize]);
            seams.push((a.min(b), a.max(b), from + h));
        }
    }
    seams.sort_unstable();
    for pair in seams.chunks_exact(2) {
        debug_assert!((pair[0].0, pair[0].1) == (pair[1].0, pair[1].1));
        let (h, twin) = (pair[0].2, pair[1].2);
        (all.twins[h as usize], all.twins[twin as usize]) = (twin, h);
    }
    let mut free: Vec<u32> = seams.iter().flat_map(|s| [s.0, s.1]).collect();
    free.sort_unstable();
    free.dedup();
    free.iter().for_each(|v| all.vertices[*v as usize].fixed = false);
    for h in 0..all.corners.len() as u32 {
        if all.twin(h) == NONE {
            let (a, b) = all.ends(h);
            [a, b].into_iter().for_each(|v| all.vertices[v as usize].fixed = true);
        }
    }
    free.retain(|v| !all.vertices[*v as usize].fixed);
    (all, free)
}
