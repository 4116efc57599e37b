//! Walking the tree: shelves whose boxes may meet a cut.

use super::explored::{Explored, REST, Reached, Spot};
use super::node::{child_cell, root_cell};
use super::shelf::{Below, Shelf};
use super::DEPTH_MAX;
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
        if let Some(rest) = &spot.shelf.rest {
            return match self.tree.below(spot, REST, || Ok(rest.clone()))? {
                Reached::Linked(number, spot) => self.shelf(spot, Some(number), cell, depth, range),
                Reached::Apart(spot) => self.shelf(&spot, None, cell, depth, range),
            };
        }
        for k in 0..4 {
            let Some(below) = &spot.summary.children[k] else { continue };
            let cell = child_cell(cell, k);
            let Some(range) = self.question.range(&cell, Some(range), Some(below)) else { continue };
            let page = || spot.shelf.children[k].expect("the summary tells of the children").page;
            if depth == DEPTH_MAX {
                return Err(Error::corrupt(
                    "tree",
                    page().place(),
                    format!("deeper than {DEPTH_MAX} nodes; run `terraquilt verify`"),
                ));
            }
            let at = self.tree.below(spot, k, || self.shelves.shelf(&page(), &cell))?;
            self.node(&at, &cell, depth + 1, &range)?;
        }
        Ok(())
    }
}
