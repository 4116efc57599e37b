//! The 256 cases of marching cubes, derived when the crate is compiled.
//!
//! A cube's corner `c` is at `(c & 1, c >> 1 & 1, c >> 2)`; bit `c` of a case says that it is inside. On each face of the cube, seen from outside, every
//! run of inside corners is cut off by one line. Where two inside corners lie across from each other, each is cut off by itself: inside is
//! never joined over a face's diagonal. The rule looks at nothing but the face, so the two cubes on it agree, and no surface has a gap.
//! The lines join to loops of 3 to 7 edges round the cube; a loop becomes a fan from the first edge that shares no face with any edge that it is not
//! next to. So no side of a triangle lies in a face except along such a line: each side belongs to two triangles exactly.

/// The two corners of each edge of a cube, the lesser first; edge `4 a + n` runs along axis `a`.
pub const EDGES: [[usize; 2]; 12] = edges();
/// Triangles of each case, at most 5, by their three edges, counter-clockwise seen from outside the solid; [`NONE`] ends the list.
pub const CASES: [[u8; 16]; 256] = cases();
/// No edge.
pub const NONE: u8 = 255;

const fn edges() -> [[usize; 2]; 12] {
    let mut out = [[0; 2]; 12];
    let (mut axis, mut n) = (0, 0);
    while axis < 3 {
        let mut corner = 0;
        while corner < 8 {
            if corner >> axis & 1 == 0 {
                out[n] = [corner, corner | 1 << axis];
                n += 1;
            }
            corner += 1;
        }
        axis += 1;
    }
    out
}

const fn edge(a: usize, b: usize) -> usize {
    let mut n = 0;
    loop {
        if (EDGES[n][0] == a && EDGES[n][1] == b) || (EDGES[n][0] == b && EDGES[n][1] == a) {
            return n;
        }
        n += 1;
    }
}

/// The corners of face `2 axis + side`, counter-clockwise seen from outside the cube.
const fn face(n: usize) -> [usize; 4] {
    let (axis, side) = (n / 2, n % 2);
    let (base, u, v) = (side << axis, 1 << ((axis + 1) % 3), 1 << ((axis + 2) % 3));
    if side == 1 {
        [base, base + u, base + u + v, base + v]
    } else {
        [base + v, base + u + v, base + u, base]
    }
}

/// Whether two edges lie on one face.
const fn share_a_face(a: usize, b: usize) -> bool {
    let mut axis = 0;
    while axis < 3 {
        let mut side = 0;
        while side < 2 {
            if EDGES[a][0] >> axis & 1 == side
                && EDGES[a][1] >> axis & 1 == side
                && EDGES[b][0] >> axis & 1 == side
                && EDGES[b][1] >> axis & 1 == side
            {
                return true;
            }
            side += 1;
        }
        axis += 1;
    }
    false
}

/// For each edge that the surface crosses, the edge that follows it on its loop; [`NONE`] for the others.
const fn following(case: usize) -> [u8; 12] {
    let mut out = [NONE; 12];
    let mut n = 0;
    while n < 6 {
        let corners = face(n);
        let mut k = 0;
        while k < 4 {
            let next = corners[(k + 1) % 4];
            if case >> corners[k] & 1 == 1 && case >> next & 1 == 0 {
                // The run of inside corners that ends here, back to where it begins.
                let mut first = k;
                while case >> corners[(first + 3) % 4] & 1 == 1 {
                    first = (first + 3) % 4;
                }
                out[edge(corners[k], next)] = edge(corners[(first + 3) % 4], corners[first]) as u8;
            }
            k += 1;
        }
        n += 1;
    }
    out
}

/// Where in a loop of `count` edges the fan begins.
const fn fan(edges: &[u8; 12], count: usize) -> usize {
    let mut first = 0;
    while first < count {
        let mut k = 2;
        while k + 1 < count && !share_a_face(edges[first] as usize, edges[(first + k) % count] as usize) {
            k += 1;
        }
        if k + 1 >= count {
            return first;
        }
        first += 1;
    }
    panic!("a loop has no fan")
}

const fn cases() -> [[u8; 16]; 256] {
    let mut out = [[NONE; 16]; 256];
    let mut case = 0;
    while case < 256 {
        let mut next = following(case);
        let (mut written, mut start) = (0, 0);
        while start < 12 {
            let (mut edges, mut count, mut at) = ([0; 12], 0, start);
            while next[at] != NONE {
                edges[count] = at as u8;
                count += 1;
                let to = next[at] as usize;
                next[at] = NONE;
                at = to;
            }
            if count > 0 {
                let first = fan(&edges, count);
                let mut k = 1;
                while k + 1 < count {
                    out[case][written] = edges[first];
                    out[case][written + 1] = edges[(first + k + 1) % count];
                    out[case][written + 2] = edges[(first + k) % count];
                    written += 3;
                    k += 1;
                }
            }
            start += 1;
        }
        case += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangles(case: usize) -> Vec<[usize; 3]> {
        let used =
            CASES[case].iter().take_while(|e| **e != NONE).map(|e| usize::from(*e)).collect::<Vec<_>>();
        used.as_chunks().0.to_vec()
    }

    fn middle(e: usize) -> [f64; 3] {
        let at = |c: usize, k: usize| (c >> k & 1) as f64;
        [0, 1, 2].map(|k| (at(EDGES[e][0], k) + at(EDGES[e][1], k)) / 2.0)
    }

    /// Sides of triangles that are met once lie in a face, on one line of it; the others are met twice, once in each direction.
    #[test]
    fn sides_are_inner_or_on_a_face() {
        for case in 0..256 {
            let sides: Vec<[usize; 2]> =
                triangles(case).iter().flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]]).collect();
            for side in &sides {
                let same = sides.iter().filter(|s| *s == side).count();
                let back = sides.iter().filter(|s| **s == [side[1], side[0]]).count();
                assert_eq!((same, back), (1, usize::from(!share_a_face(side[0], side[1]))), "case {case}");
            }
            let crossed = |e: &usize| (case >> EDGES[*e][0] & 1) != (case >> EDGES[*e][1] & 1);
            for e in 0..12 {
                let met = sides.iter().any(|s| s[0] == e);
                assert_eq!(met, crossed(&e), "case {case}, edge {e}");
            }
        }
    }

    /// One corner inside: the normal points away from it.
    #[test]
    fn triangles_face_outwards() {
        for corner in 0..8 {
            let [[a, b, c]] = triangles(1 << corner)[..] else { panic!("corner {corner}") };
            let (p, q, r) = (middle(a), middle(b), middle(c));
            let normal =
                crate::solid::vector::cross(crate::solid::vector::sub(q, p), crate::solid::vector::sub(r, p));
            let inside = [0, 1, 2].map(|k| (corner >> k & 1) as f64);
            assert!(crate::solid::vector::dot(normal, crate::solid::vector::sub(p, inside)) > 0.0);
        }
    }

    /// What one cube draws on a face is what its neighbour draws there, backwards.
    #[test]
    fn neighbours_agree() {
        for axis in 0..3 {
            for case in 0..256 {
                for other in 0..256 {
                    // The corners of one on its far face are the corners of the other on its near one.
                    let agree = (0..8)
                        .filter(|c| c >> axis & 1 == 1)
                        .all(|c| case >> c & 1 == other >> (c & !(1 << axis)) & 1);
                    if !agree || (case * 7 + other) % 5 != 0 {
                        continue;
                    }
                    let lines = |case: usize, side: usize| {
                        let mut out: Vec<[[i32; 3]; 2]> = Vec::new();
                        for t in triangles(case) {
                            for [a, b] in [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]] {
                                let place = |e| middle(e).map(|v| (2.0 * v) as i32);
                                if [a, b].iter().all(|e| place(*e)[axis] == 2 * side as i32) {
                                    let flat = |e| {
                                        let mut p = place(e);
                                        p[axis] = 0;
                                        p
                                    };
                                    out.push([flat(a), flat(b)]);
                                }
                            }
                        }
                        out
                    };
                    let mut mine = lines(case, 1);
                    let mut its: Vec<_> = lines(other, 0).into_iter().map(|[a, b]| [b, a]).collect();
                    mine.sort();
                    its.sort();
                    assert_eq!(mine, its, "axis {axis}: {case} and {other}");
                }
            }
        }
    }
}
