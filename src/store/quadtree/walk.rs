//! Walking the tree: shelves whose boxes may meet a cut.

use super::DEPTH_MAX;
use super::explored::{Explored, REST, Reached, Spot};
use super::node::{child_cell, root_cell};
use super::shelf::{Below, Shelf};
use crate::base::lattice::Bounds;
use crate::base::{Error, Result};
use crate::store::segment::PageRef;
use std::sync::Arc;

/// Gives decoded nodes.
pub trait Shelves {
    /// The node of a page, whose cell is `cell`.
    fn shelf(&self, at: &PageRef, cell: &Bounds) -> Result<Arc<Shelf>>;
}

/// The tolerance over the part of a cell that is asked about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Tops below or at this are not looked at.
    pub lo: f64,
    pub hi: f64,
    /// The whole cell is asked about.
    pub inside: bool,
}

impl Range {
    /// Whether a subtree may hold patches that the cut needs.
    #[inline]
    pub fn meets(&self, b: &Below) -> bool {
        f64::from(b.top_max) > self.lo && (f64::from(b.bot_min) <= self.hi || b.floor)
    }
}

/// What is asked of the tree.
pub trait Question {
    /// The tolerance over a cell of the tree; `None` where nothing is asked, or nothing of what lies below can be needed.
    /// `above`: over the cell around it; `below`: what is known of the subtree.
    fn range(&mut self, cell: &Bounds, above: Option<&Range>, below: Option<&Below>) -> Option<Range>;

    /// The same of the four cells below one, where there is something below.
    #[inline]
    fn ranges(
        &mut self,
        cells: &[Bounds; 4],
        above: &Range,
        below: &[Option<Below>; 4],
    ) -> [Option<Range>; 4] {
        std::array::from_fn(|k| self.range(&cells[k], Some(above), Some(below[k].as_ref()?)))
    }

    /// Takes what it needs of a shelf. False where it meets a top of at most `range.lo`: everything after it and below is no
    /// higher (invariant Q5).
    fn visit(&mut self, spot: &Spot, number: Option<u32>, range: &Range) -> Result<bool>;
}

/// Puts a question to the tree with this root: the pruning of section 4. A record that is stored in several nodes is met
/// several times. Returns the number of nodes read.
pub fn walk<Q: Question>(
    tree: &Explored,
    shelves: &dyn Shelves,
    root: &PageRef,
    question: &mut Q,
) -> Result<u64> {
    let cell = root_cell();
    let mut walk = Walk { tree, shelves, question, nodes: 0 };
    if let Some(range) = walk.question.range(&cell, None, None) {
        let at = tree.root(|| shelves.shelf(root, &cell))?;
        walk.node(&at, &cell, 0, &range)?;
    }
    Ok(walk.nodes)
}

struct Walk<'a, Q> {
    tree: &'a Explored,
    shelves: &'a dyn Shelves,
    question: &'a mut Q,
    nodes: u64,
}

impl<Q: Question> Walk<'_, Q> {
    fn node(&mut self, at: &Reached, cell: &Bounds, depth: u8, range: &Range) -> Result<()> {
        self.nodes += 1;
        match at {
            Reached::Linked(number, spot) => self.shelf(spot, Some(*number), cell, depth, range),
            Reached::Apart(spot) => self.shelf(spot, None, cell, depth, range),
        }
    }

    fn shelf(
        &mut self,
        spot: &Spot,
        number: Option<u32>,
        cell: &Bounds,
        depth: u8,
        range: &Range,
    ) -> Result<()> {
        if !self.question.visit(spot, number, range)? {
            return Ok(());
        }
        if spot.summary.rest
            && let Some(rest) = &spot.shelf.rest
        {
            return match self.tree.below(spot, REST, || Ok(rest.clone()))? {
                Reached::Linked(number, spot) => self.shelf(spot, Some(number), cell, depth, range),
                Reached::Apart(spot) => self.shelf(&spot, None, cell, depth, range),
            };
        }
        if spot.summary.children.iter().all(Option::is_none) {
            return Ok(());
        }
        let cells: [Bounds; 4] = std::array::from_fn(|k| child_cell(cell, k));
        let ranges = self.question.ranges(&cells, range, &spot.summary.children);
        for (k, (cell, range)) in cells.iter().zip(&ranges).enumerate() {
            let Some(range) = range else { continue };
            let page = || spot.shelf.children[k].expect("the summary tells of the children").page;
            if depth == DEPTH_MAX {
                return Err(Error::corrupt(
                    "tree",
                    page().place(),
                    format!("deeper than {DEPTH_MAX} nodes; run `terraquilt verify`"),
                ));
            }
            let at = self.tree.below(spot, k, || self.shelves.shelf(&page(), cell))?;
            self.node(&at, cell, depth + 1, range)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::super::Domains;
    use super::super::node::{ChildRef, Node, Record};
    use super::super::shelf::{SHELF, bits};
    use super::*;
    use crate::base::lattice::{Point, Quad};
    use crate::height::lod::{PatchId, Place, SurveyNumber};

    /// Squares of 2^30 units around places 2^29 units apart.
    struct Squares;

    impl Domains for Squares {
        fn domain(&self, r: &Record) -> Quad {
            let (x, y) = (i64::from(r.place.i) << 29, i64::from(r.place.j) << 29);
            let min = Point::new(x - (1 << 29), y - (1 << 29));
            Bounds { min, max: Point::new(x + (1 << 29), y + (1 << 29)) }.quad()
        }
    }

    fn record(k: i32) -> Record {
        let mut id = [0; 16];
        id[..4].copy_from_slice(&k.to_be_bytes());
        Record {
            top: 1000.0 - k as f32,
            bot: k as f32 / 100.0,
            floor: k % 3 == 0,
            survey: SurveyNumber(1),
            place: Place { level: 0, i: k - 75, j: 1 },
            id: PatchId(id),
        }
    }

    fn page(k: u32) -> PageRef {
        PageRef { file: 1, len: 0, offset: u64::from(k), crc: 0 }
    }

    /// A node of 150 records, as there may be at the greatest depth, with a child, and one of 10.
    struct Two(AtomicUsize);

    use std::sync::atomic::{AtomicUsize, Ordering};

    impl Shelves for Two {
        fn shelf(&self, at: &PageRef, cell: &Bounds) -> Result<Arc<Shelf>> {
            self.0.fetch_add(1, Ordering::Relaxed);
            let mut node = Node::default();
            if at.offset == 0 {
                node.records = (0..150).map(record).collect();
                node.children[3] =
                    Some(ChildRef { page: page(1), top_max: 850.0, bot_min: 1.5, floor: true });
            } else {
                node.records = (150..160).map(record).collect();
            }
            Ok(Arc::new(Shelf::new(&node, cell, &Squares, 1.0)))
        }
    }

    /// Takes every record above a top.
    struct Above(f64, Vec<Record>, u64);

    impl Question for Above {
        fn range(&mut self, _: &Bounds, _: Option<&Range>, below: Option<&Below>) -> Option<Range> {
            let range = Range { lo: self.0, hi: 1e9, inside: true };
            below.is_none_or(|b| range.meets(b)).then_some(range)
        }
        fn visit(&mut self, spot: &Spot, _: Option<u32>, range: &Range) -> Result<bool> {
            let n = spot.of_top((range.lo as f32).next_up()).count_ones() as usize;
            self.1.extend(&spot.shelf.records[..n]);
            self.2 += u64::from(spot.summary.own.count_ones());
            assert!(
                spot.shelf.records.len() <= SHELF
                    && spot.summary.all.count_ones() as usize == spot.shelf.records.len()
            );
            let floors: Vec<usize> = bits(spot.summary.floors).collect();
            assert!(floors.iter().all(|k| spot.shelf.records[*k].floor));
            assert_eq!(floors.len(), spot.shelf.records.iter().filter(|r| r.floor).count());
            for most in [-1.0, 0.3, 1.7, 9.0] {
                let low: Vec<usize> = bits(spot.of_bot(most)).collect();
                let wanted = (0..spot.shelf.records.len()).filter(|k| spot.shelf.records[*k].bot <= most);
                assert_eq!(low, wanted.collect::<Vec<_>>());
            }
            Ok(n == spot.shelf.records.len())
        }
    }

    #[test]
    fn nodes_of_many_records_are_read_in_parts_and_nodes_are_read_once() {
        for most in [0, 1, 3, 100] {
            let (tree, two) = (Explored::of(most), Two(AtomicUsize::new(0)));
            for (top, wanted) in
                [(0.0, 160), (845.0, 155), (850.0, 150), (899.5, 101), (936.0, 64), (2000.0, 0)]
            {
                let mut question = Above(top, Vec::new(), 0);
                let nodes = walk(&tree, &two, &page(0), &mut question).unwrap();
                assert_eq!(question.1, (0..wanted).map(record).collect::<Vec<_>>(), "above {top}");
                assert_eq!(nodes, if wanted > 150 { 2 } else { 1 });
            }
            // Of the root every middle lies in the cell, of the child those in its quarter.
            let mut question = Above(0.0, Vec::new(), 0);
            walk(&tree, &two, &page(0), &mut question).unwrap();
            assert_eq!(question.2, 160);
            let read = two.0.load(Ordering::Relaxed);
            assert!(if most == 100 { read == 2 } else { read > 2 }, "{read} nodes read with room for {most}");
            assert_eq!(tree.is_full(), most < 100);
        }
    }
}
