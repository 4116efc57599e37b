//! From the triangulation to the mesh: the faces inside, one vertex a fan.

use std::collections::HashMap;

use spade::Triangulation;

use super::tin::{Tin, handle};

/// Triangles inside the region over `positions`; `source` names the vertex of the triangulation that each
/// position came from. A vertex whose triangles are several fans (the region touches itself there) comes
/// once for each.
pub(super) struct Extract {
    pub positions: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

pub(super) fn extract(tin: &Tin) -> Extract {
    let inside = |f: usize| f > 0 && tin.facets[f].inside;
    // For vertices in more than one fan: which copy each face uses.
    let mut copies: HashMap<(u32, u32), u32> = HashMap::new();
    let mut index = vec![u32::MAX; tin.vertex_count()];
    let mut positions = Vec::with_capacity(tin.vertex_count());
    for v in 0..tin.vertex_count() as u32 {
        let around: Vec<usize> = tin.cdt.vertex(handle(v)).out_edges().map(|e| e.face().index()).collect();
        let n = around.len();
        let starts = (0..n).filter(|&i| inside(around[i]) && !inside(around[(i + n - 1) % n])).count();
        if !around.iter().any(|&f| inside(f)) {
            continue;
        }
        index[v as usize] = positions.len() as u32;
        positions.push(tin.position(v));
        if starts > 1 {
            let first = (0..n).find(|&i| !inside(around[i])).unwrap_or(0);
            let mut copy = index[v as usize];
            let mut fans = 0;
            for k in 1..=n {
                let (before, here) = (around[(first + k - 1) % n], around[(first + k) % n]);
                if !inside(here) {
                    continue;
                }
                if !inside(before) {
                    fans += 1;
                    if fans > 1 {
                        copy = positions.len() as u32;
                        positions.push(tin.position(v));
                    }
                }
                copies.insert((v, here as u32), copy);
            }
        }
    }
    let mut triangles = Vec::new();
    for (f, facet) in tin.facets.iter().enumerate() {
        if inside(f) {
            triangles.push(
                facet.corners.map(|v| copies.get(&(v, f as u32)).copied().unwrap_or(index[v as usize])),
            );
        }
    }
    Extract { positions, triangles }
}
