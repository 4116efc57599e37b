//! Cells joined into polygons.

/// Cells that hang together by their sides, as a polygon with holes.
#[derive(Clone, Debug, PartialEq)]
pub struct Piece {
    pub cells: u64,
    /// Rings of corners (column, row), the first repeated at the end; the outer one first. In the plane of column and
    /// row the outer ring is counter-clockwise, holes are clockwise.
    pub rings: Vec<Vec<[usize; 2]>>,
}

/// Joins the cells for which `inside(column, row)` holds. Cells that touch at a corner only stay apart.
///
/// Returns the pieces, by their first cell row by row, and for each cell the number of its piece plus 1, or 0.
pub fn dissolve(cols: usize, rows: usize, inside: impl Fn(usize, usize) -> bool) -> (Vec<Piece>, Vec<u32>) {
    let mut piece_of = vec![0u32; cols * rows];
    let mut pieces: Vec<Piece> = Vec::new();
    let mut stack = Vec::new();
    for k in 0..cols * rows {
        if piece_of[k] != 0 || !inside(k % cols, k / cols) {
            continue;
        }
        pieces.push(Piece { cells: 0, rings: Vec::new() });
        let number = pieces.len() as u32;
        piece_of[k] = number;
        stack.push(k);
        while let Some(k) = stack.pop() {
            pieces[number as usize - 1].cells += 1;
            let (c, r) = (k % cols, k / cols);
            let beside = [
                (c > 0).then(|| k - 1),
                (c + 1 < cols).then_some(k + 1),
                (r > 0).then(|| k - cols),
                (r + 1 < rows).then_some(k + cols),
            ];
            for n in beside.into_iter().flatten() {
                if piece_of[n] == 0 && inside(n % cols, n / cols) {
                    piece_of[n] = number;
                    stack.push(n);
                }
            }
        }
    }
    // Sides of pieces, each with its piece to the left: bit d of a corner = one leaves it towards STEP[d].
    const STEP: [[isize; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
    let width = cols + 1;
    let at = |c: isize, r: isize| {
        let there = c >= 0 && r >= 0 && (c as usize) < cols && (r as usize) < rows;
        if there { piece_of[r as usize * cols + c as usize] } else { 0 }
    };
    let mut leaving = vec![0u8; width * (rows + 1)];
    for r in 0..rows as isize {
        for c in 0..cols as isize {
            if at(c, r) == 0 {
                continue;
            }
            for (d, (beside, corner)) in [
                (at(c, r - 1), (c, r)),
                (at(c + 1, r), (c + 1, r)),
                (at(c, r + 1), (c + 1, r + 1)),
                (at(c - 1, r), (c, r + 1)),
            ]
            .into_iter()
            .enumerate()
            {
                if beside == 0 {
                    leaving[corner.1 as usize * width + corner.0 as usize] |= 1 << d;
                }
            }
        }
    }
    for first in 0..leaving.len() {
        while leaving[first] != 0 {
            let mut d = leaving[first].trailing_zeros() as usize;
            let (c, r) = ((first % width) as isize, (first / width) as isize);
            let piece = [at(c, r), at(c - 1, r), at(c - 1, r - 1), at(c, r - 1)][d];
            let mut ring: Vec<[usize; 2]> = vec![[first % width, first / width]];
            let (mut k, mut area) = (first, 0isize);
            loop {
                leaving[k] &= !(1 << d);
                let from = [(k % width) as isize, (k / width) as isize];
                let to = [from[0] + STEP[d][0], from[1] + STEP[d][1]];
                area += from[0] * to[1] - to[0] * from[1];
                k = to[1] as usize * width + to[0] as usize;
                if k == first && (leaving[k] == 0 || ring_closes(leaving[k], d)) {
                    break;
                }
                // To the left first: that stays with the same cell where two touch at a corner.
                let next = [1, 0, 3].map(|t| (d + t) % 4).into_iter().find(|n| leaving[k] >> n & 1 == 1);
                let Some(next) = next else { break };
                if next != d {
                    ring.push([to[0] as usize, to[1] as usize]);
                }
                d = next;
            }
            ring.push(ring[0]);
            let rings = &mut pieces[piece as usize - 1].rings;
            if area > 0 {
                rings.insert(0, ring);
            } else {
                rings.push(ring);
            }
        }
    }
    (pieces, piece_of)
}

/// Whether a ring that comes back to its first corner ends there although another side leaves it: it does unless that
/// side is the one to the left, which belongs to the same cell.
fn ring_closes(leaving: u8, d: usize) -> bool {
    leaving >> ((d + 1) % 4) & 1 == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &[&str]) -> Vec<Piece> {
        let inside = |c: usize, r: usize| text[r].as_bytes()[c] == b'#';
        let (pieces, numbers) = dissolve(text[0].len(), text.len(), inside);
        for (k, n) in numbers.iter().enumerate() {
            assert_eq!(*n > 0, inside(k % text[0].len(), k / text[0].len()));
        }
        // Twice the area of the rings is twice the cells, holes counted negative.
        for p in &pieces {
            let twice: i64 = p
                .rings
                .iter()
                .flat_map(|r| r.windows(2))
                .map(|w| w[0][0] as i64 * w[1][1] as i64 - w[1][0] as i64 * w[0][1] as i64)
                .sum();
            assert_eq!(twice, 2 * p.cells as i64, "{p:?}");
        }
        pieces
    }

    #[test]
    fn a_ring_has_a_hole_and_straight_sides_have_no_corners() {
        let p = of(&["####", "#..#", "####"]);
        assert_eq!(p.len(), 1);
        assert_eq!(p[0].rings[0], [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]);
        assert_eq!(p[0].rings[1].len(), 5);
    }

    #[test]
    fn cells_that_touch_at_a_corner_stay_apart() {
        assert_eq!(of(&["#.", ".#"]).len(), 2);
        assert_eq!(of(&[".#", "#."]).len(), 2);
        // Joined elsewhere, they are one piece whose ring meets itself at the corner.
        assert_eq!(of(&["##.", "#.#", "###"]).len(), 1);
        assert_eq!(of(&[".##", "#.#", "###"]).len(), 1);
        assert_eq!(of(&["###", "#.#", "##."]).len(), 1);
    }

    #[test]
    fn random_cells_keep_their_area() {
        let mut seed = 1u64;
        for _ in 0..200 {
            let rows: Vec<String> = (0..9)
                .map(|_| {
                    (0..11)
                        .map(|_| {
                            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                            if seed >> 62 != 0 { '#' } else { '.' }
                        })
                        .collect()
                })
                .collect();
            let text: Vec<&str> = rows.iter().map(String::as_str).collect();
            for p in of(&text) {
                assert!(!p.rings.is_empty());
            }
        }
        assert!(of(&["..", ".."]).is_empty());
    }
}
