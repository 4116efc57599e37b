//! Walking the tree: records whose box may meet a cut.

use super::DEPTH_MAX;
use super::node::{Node, Record, child_cell, root_cell};
use crate::base::lattice::Bounds;
use crate::base::{Error, Result};
use crate::store::segment::PageRef;
use std::sync::Arc;

/// Reads decoded nodes.
pub trait Nodes {
    fn node(&self, at: &PageRef) -> Result<Arc<Node>>;
}

/// Visits every record that passes the pruning of section 4: in a cell where the tolerance lies in
/// `[lo, hi]`, records with `top > lo`; children with `top_max > lo` and (`bot_min <= hi` or a floor).
/// `range(cell)` gives `(lo, hi)` of the tolerance over the cell, or `None` if the region misses it.
/// A record that is stored in several nodes is visited several times. Returns the number of nodes read.
pub fn walk(
    nodes: &dyn Nodes,
    root: &PageRef,
    range: &mut dyn FnMut(&Bounds) -> Option<(f64, f64)>,
    visit: &mut dyn FnMut(&Record) -> Result<()>,
) -> Result<u64> {
    let cell = root_cell();
    let mut count = 0;
    if let Some((lo, _)) = range(&cell) {
        descend(nodes, root, (&cell, 0), lo, range, visit, &mut count)?;
    }
    Ok(count)
}

fn descend(
    nodes: &dyn Nodes,
    at: &PageRef,
    (cell, depth): (&Bounds, u8),
    lo: f64,
    range: &mut dyn FnMut(&Bounds) -> Option<(f64, f64)>,
    visit: &mut dyn FnMut(&Record) -> Result<()>,
    count: &mut u64,
) -> Result<()> {
    if depth > DEPTH_MAX {
        return Err(Error::corrupt(
            "tree",
            at.place(),
            format!("deeper than {DEPTH_MAX} nodes; run `terraquilt verify`"),
        ));
    }
    *count += 1;
    let node = nodes.node(at)?;
    for r in &node.records {
        if f64::from(r.top) <= lo {
            return Ok(());
        }
        visit(r)?;
    }
    // Everything below is no higher than the last record here (invariant Q5), so it is worth descending.
    for (k, child) in node.children.iter().enumerate() {
        let Some(c) = child else { continue };
        let cell = child_cell(cell, k);
        let Some((lo, hi)) = range(&cell) else { continue };
        if f64::from(c.top_max) > lo && (f64::from(c.bot_min) <= hi || c.floor) {
            descend(nodes, &c.page, (&cell, depth + 1), lo, range, visit, count)?;
        }
    }
    Ok(())
}
