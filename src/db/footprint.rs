//! What a commit did to the set of patches, and where.
//!
//! Two versions share the pages of every subtree that is the same in both, so their trees are walked together only where the
//! references differ. A record that meets several nodes is looked at where its middle lies: once.

use super::database::Snapshot;
use super::query::Area;
use super::view::{Rules, View};
use crate::base::lattice::{Bounds, Point};
use crate::base::{Error, Result};
use crate::height::frame::LatticeUnit;
use crate::store::quadtree::{DEPTH_MAX, Domains, Node, Record, child_cell, root_cell};
use crate::store::segment::PageRef;

/// Boxes of a footprint.
const BOXES_MAX: usize = 64;

/// How the patches of two versions differ.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Footprint {
    pub added: u64,
    pub removed: u64,
    /// Same patch, other top or floor, or of another survey.
    pub changed: u64,
    /// xmin, ymin, xmax, ymax in CRS units: outside of them no patch came, went or changed. 64 at most.
    pub boxes: Vec<[f64; 4]>,
}

impl Footprint {
    /// Whether something changed within an area.
    pub fn meets(&self, area: &Area) -> bool {
        self.boxes.iter().any(|b| match area {
            Area::Everything => true,
            Area::Box(a) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3],
            Area::Polygon(p) => p.meets(&[[b[0], b[1]], [b[2], b[1]], [b[2], b[3]], [b[0], b[3]]]),
        })
    }
}

impl Snapshot {
    /// How the patches of this version differ from those of an earlier one; `None`: from none.
    pub fn footprint(&self, before: Option<&Snapshot>) -> Result<Footprint> {
        let new = &self.view;
        let old = before.map(|b| &b.view);
        let mut walk = Walk { old, new, found: Footprint::default(), boxes: Vec::new() };
        let root = |v: &View| v.tree.as_ref().map(|t| t.page);
        let pages = [old.and_then(root), root(new)];
        if pages[0] != pages[1] {
            walk.pair(pages, (&root_cell(), 0), [Vec::new(), Vec::new()])?;
        }
        let mut boxes: Vec<[f64; 4]> = walk.boxes.iter().map(|b| outward(b, self.unit())).collect();
        boxes.sort_by(|a, b| a.iter().map(|v| v.to_bits()).cmp(b.iter().map(|v| v.to_bits())));
        Ok(Footprint { boxes, ..walk.found })
    }
}

/// A record and its domain's box.
type Met = (Record, Bounds);

struct Walk<'a> {
    old: Option<&'a View>,
    new: &'a View,
    found: Footprint,
    boxes: Vec<Bounds>,
}

impl Walk<'_> {
    /// One node of both trees, where they differ. `open`: records of the nodes above whose middle lies here and that the other
    /// tree has not shown yet.
    fn pair(
        &mut self,
        pages: [Option<PageRef>; 2],
        (cell, depth): (&Bounds, u8),
        open: [Vec<Met>; 2],
    ) -> Result<()> {
        if depth > DEPTH_MAX {
            let reason = format!("deeper than {DEPTH_MAX} nodes; run `terraquilt verify`");
            return Err(Error::corrupt("tree", "a version's nodes", reason));
        }
        let [mut old, mut new] = open;
        let mut children = [[None; 4]; 2];
        let sides = [(self.old, &mut old), (Some(self.new), &mut new)];
        for ((side, met), (page, below)) in sides.into_iter().zip(pages.iter().zip(&mut children)) {
            let (Some(side), Some(page)) = (side, page) else { continue };
            let node = Node::read(&side.files, page)?;
            *below = node.children.map(|c| c.map(|c| c.page));
            for r in node.records {
                side.entry(r.survey)?;
                let b = Rules(side).domain(&r).bounds();
                if cell_holds(cell, middle(&b)) {
                    met.push((r, b));
                }
            }
        }
        old.retain(|(o, b)| {
            let Some(k) = new.iter().position(|(n, _)| n.id == o.id) else { return true };
            let (n, _) = new.swap_remove(k);
            if (n.top, n.floor, n.survey) != (o.top, o.floor, o.survey) {
                self.found.changed += 1;
                cover(&mut self.boxes, *b);
            }
            false
        });
        for (k, pages) in children[0].into_iter().zip(children[1]).enumerate() {
            let pages = [pages.0, pages.1];
            let below = child_cell(cell, k);
            let here = |met: &mut Vec<Met>| -> Vec<Met> {
                met.extract_if(.., |(_, b)| cell_holds(&below, middle(b))).collect()
            };
            let open = [here(&mut old), here(&mut new)];
            if pages[0] == pages[1] {
                // Nothing below differs: what is open here is not in the other tree.
                self.close(open);
            } else {
                self.pair(pages, (&below, depth + 1), open)?;
            }
        }
        Ok(())
    }

    fn close(&mut self, [gone, come]: [Vec<Met>; 2]) {
        self.found.removed += gone.len() as u64;
        self.found.added += come.len() as u64;
        gone.into_iter().chain(come).for_each(|(_, b)| cover(&mut self.boxes, b));
    }
}

fn middle(b: &Bounds) -> Point {
    let half = |a: i64, b: i64| ((i128::from(a) + i128::from(b)).div_euclid(2)) as i64;
    Point::new(half(b.min.x, b.max.x), half(b.min.y, b.max.y))
}

/// Cells are half open: every point lies in one.
fn cell_holds(cell: &Bounds, p: Point) -> bool {
    cell.min.x <= p.x && p.x < cell.max.x && cell.min.y <= p.y && p.y < cell.max.y
}

fn within(outer: &Bounds, b: &Bounds) -> bool {
    outer.min.x <= b.min.x && outer.min.y <= b.min.y && b.max.x <= outer.max.x && b.max.y <= outer.max.y
}

fn area(b: &Bounds) -> f64 {
    (b.max.x as f64 - b.min.x as f64) * (b.max.y as f64 - b.min.y as f64)
}

/// Puts a box to the others. Of too many, the two whose union wastes least become one.
fn cover(boxes: &mut Vec<Bounds>, b: Bounds) {
    if boxes.iter().any(|o| within(o, &b)) {
        return;
    }
    boxes.retain(|o| !within(&b, o));
    boxes.push(b);
    if boxes.len() <= BOXES_MAX {
        return;
    }
    let mut best = (f64::INFINITY, 0, 1);
    for i in 0..boxes.len() {
        for j in i + 1..boxes.len() {
            let waste = area(&boxes[i].union(&boxes[j])) - area(&boxes[i]) - area(&boxes[j]);
            if waste < best.0 {
                best = (waste, i, j);
            }
        }
    }
    let (_, i, j) = best;
    let joined = boxes[i].union(&boxes[j]);
    boxes.retain(|o| !within(&joined, o));
    boxes.push(joined);
}

/// A box in CRS units, never smaller than it is.
fn outward(b: &Bounds, unit: LatticeUnit) -> [f64; 4] {
    let size = unit.size();
    let low = |v: i64| {
        let f = v as f64;
        (if f as i128 > i128::from(v) { f.next_down() } else { f }) * size
    };
    let high = |v: i64| {
        let f = v as f64;
        (if (f as i128) < i128::from(v) { f.next_up() } else { f }) * size
    };
    [low(b.min.x), low(b.min.y), high(b.max.x), high(b.max.y)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(x: i64, y: i64, side: i64) -> Bounds {
        Bounds { min: Point::new(x, y), max: Point::new(x + side, y + side) }
    }

    #[test]
    fn boxes_are_few_and_cover_everything() {
        let all: Vec<Bounds> =
            (0..500).map(|k| square(k * 7919 % 1000 * 10, k * 104_729 % 1000 * 10, 15)).collect();
        let mut boxes = Vec::new();
        all.iter().for_each(|b| cover(&mut boxes, *b));
        assert!(boxes.len() <= BOXES_MAX && boxes.len() > 1, "{}", boxes.len());
        assert!(all.iter().all(|b| boxes.iter().any(|o| within(o, b))));
        // Two heaps far apart are not joined.
        let mut boxes = Vec::new();
        for k in 0..100 {
            cover(&mut boxes, square(k * 10, 0, 10));
            cover(&mut boxes, square(1_000_000 + k * 10, 0, 10));
        }
        assert!(boxes.iter().all(|b| b.max.x < 500_000 || b.min.x > 500_000), "{boxes:?}");
    }

    #[test]
    fn boxes_in_floats_are_no_smaller() {
        let unit = LatticeUnit { exponent: 0 };
        let odd = (1i64 << 53) + 1;
        let b = Bounds { min: Point::new(-odd, odd - 4), max: Point::new(odd, odd + 2) };
        let f = outward(&b, unit);
        assert!((f[0] as i128) <= i128::from(-odd) && (f[2] as i128) >= i128::from(odd), "{f:?}");
        assert_eq!(outward(&square(-8, 4, 16), unit), [-8.0, 4.0, 8.0, 20.0]);
    }
}
