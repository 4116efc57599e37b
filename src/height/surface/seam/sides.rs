//! The outline of a set of cells, side by side.

use crate::base::lattice::Point;
use crate::height::frame::{CellRect, Frame};
use std::collections::BTreeMap;

/// One side of a cell, between a cell of the set and one that is not in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Side {
    /// The cell of the set.
    pub cell: [i64; 2],
    /// Direction of the cell that is not: along the first or the second index, upwards or downwards.
    pub axis: usize,
    pub up: bool,
}

impl Side {
    /// Its first post, the step along it, and a step across it, outwards.
    pub fn of(&self, frame: &Frame) -> (Point, Point, Point) {
        let mut post = self.cell;
        post[self.axis] += i64::from(self.up);
        let (along, across) = if self.axis == 0 { (frame.v, frame.u) } else { (frame.u, frame.v) };
        let across = if self.up { across } else { Point::new(-across.x, -across.y) };
        (frame.post(post[0], post[1]), along, across)
    }
}

/// The sides of cells inside a window that border on cells that are not in the set. `cells`: the set as disjoint rectangles,
/// known one cell beyond the window. Sorted by axis, line and place; costs by the rectangles, not by the area.
pub fn outline(cells: &[CellRect], window: &CellRect) -> Vec<Side> {
    let mut out = Vec::new();
    for axis in 0..2 {
        // Per line across: stretches with a cell below it, and with a cell above it.
        let mut lines: BTreeMap<i64, [Vec<[i64; 2]>; 2]> = BTreeMap::new();
        for r in cells {
            let (a, b) = ([r.i0, r.j0], [r.i1, r.j1]);
            let stretch = [a[1 - axis], b[1 - axis]];
            lines.entry(b[axis]).or_default()[0].push(stretch);
            lines.entry(a[axis]).or_default()[1].push(stretch);
        }
        for (line, mut both) in lines {
            both.iter_mut().for_each(|s| s.sort_unstable());
            for (k, up) in [(0, true), (1, false)] {
                for t in without(&both[k], &both[1 - k]) {
                    for at in t[0]..t[1] {
                        let mut cell = [0; 2];
                        cell[axis] = if up { line - 1 } else { line };
                        cell[1 - axis] = at;
                        let [i, j] = cell;
                        if window.contains(&CellRect::new(i, j, i + 1, j + 1)) {
                            out.push(Side { cell, axis, up });
                        }
                    }
                }
            }
        }
    }
    out
}

/// The first stretches without the second ones; each list sorted and disjoint.
fn without(first: &[[i64; 2]], second: &[[i64; 2]]) -> Vec<[i64; 2]> {
    let mut out = Vec::new();
    let mut k = 0;
    for &[mut a, b] in first {
        while k < second.len() && second[k][1] <= a {
            k += 1;
        }
        let mut m = k;
        while m < second.len() && second[m][0] < b {
            if second[m][0] > a {
                out.push([a, second[m][0]]);
            }
            a = a.max(second[m][1]);
            m += 1;
        }
        if a < b {
            out.push([a, b]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_outline_is_where_a_cell_has_no_neighbour() {
        // An L and a bar that touches it, with a hole of one cell.
        let rects = [
            CellRect::new(0, 0, 6, 2),
            CellRect::new(0, 2, 2, 5),
            CellRect::new(2, 3, 4, 5),
            CellRect::new(3, 2, 6, 3),
        ];
        let inside = |i: i64, j: i64| rects.iter().any(|r| r.contains(&CellRect::new(i, j, i + 1, j + 1)));
        let window = CellRect::new(-3, -3, 9, 5);
        let found = outline(&rects, &window);
        let mut expected = 0;
        for j in -3..5 {
            for i in -3..9 {
                for (axis, up, a, b) in
                    [(0, true, 1, 0), (0, false, -1, 0), (1, true, 0, 1), (1, false, 0, -1)]
                {
                    let is = inside(i, j) && !inside(i + a, j + b);
                    expected += usize::from(is);
                    assert_eq!(found.contains(&Side { cell: [i, j], axis, up }), is, "{i} {j} {axis} {up}");
                }
            }
        }
        assert_eq!(found.len(), expected);
    }
}
