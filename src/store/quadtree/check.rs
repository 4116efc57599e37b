//! The checker of the tree: invariants Q1 to Q8 of the LOD-space specification, section 4.

use super::node::{ChildRef, Node, Record, child_cell, root_cell};
use super::{CAPACITY, DEPTH_MAX, Domains};
use crate::base::Result;
use crate::base::lattice::Bounds;
use crate::height::lod::{Place, SurveyNumber};
use crate::store::segment::{PageRef, Pages};
use std::cmp::Ordering;
use std::collections::HashMap;

/// What was counted.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Stats {
    pub nodes: u64,
    /// Records over all nodes; a patch may be in several.
    pub records: u64,
    pub depth: u8,
    /// Different patches.
    pub patches: u64,
}

/// Checks the whole tree against the set of live records. Problems are told in words, most at `limit`.
pub fn check(
    pages: &dyn Pages,
    domains: &dyn Domains,
    root: &ChildRef,
    live: &HashMap<(SurveyNumber, Place), Record>,
    problems: &mut Vec<String>,
) -> Result<Stats> {
    let mut c = Checker { pages, domains, live, problems, stats: Stats::default(), seen: HashMap::new() };
    let everything: Vec<Record> = {
        let mut v: Vec<Record> = live.values().copied().collect();
        v.sort_unstable_by(|a, b| a.order(b));
        v
    };
    let told = Some((root.top_max, root.bot_min, root.floor));
    c.node(&root.page, &root_cell(), 0, everything, told)?;
    c.stats.patches = c.seen.len() as u64;
    let (stats, seen) = (c.stats, c.seen);
    for (k, r) in live {
        if !seen.contains_key(k) {
            problems.push(format!("live patch {} is nowhere in the tree", r.id));
        }
    }
    Ok(stats)
}

struct Checker<'a> {
    pages: &'a dyn Pages,
    domains: &'a dyn Domains,
    live: &'a HashMap<(SurveyNumber, Place), Record>,
    problems: &'a mut Vec<String>,
    stats: Stats,
    seen: HashMap<(SurveyNumber, Place), ()>,
}

impl Checker<'_> {
    /// `pending`: what the definition sends to this node, sorted. Q2, Q4, Q5, Q6 and Q7 follow from the node
    /// holding exactly the first of them.
    fn node(
        &mut self,
        at: &PageRef,
        cell: &Bounds,
        depth: u8,
        mut pending: Vec<Record>,
        told: Option<(f32, f32, bool)>,
    ) -> Result<(f32, f32, bool)> {
        if depth > DEPTH_MAX {
            self.problems.push(format!("a node of depth {depth}, at most {DEPTH_MAX}"));
            return Ok(told.unwrap_or((0.0, 0.0, false)));
        }
        let node = Node::read(self.pages, at)?;
        self.stats.nodes += 1;
        self.stats.records += node.records.len() as u64;
        self.stats.depth = self.stats.depth.max(depth);
        let place = || format!("node of depth {depth} at {}, {}", cell.min.x, cell.min.y);
        if !node.records.windows(2).all(|w| w[0].order(&w[1]) == Ordering::Less) {
            self.problems.push(format!("Q1: records not in order, {}", place()));
        }
        for r in &node.records {
            self.seen.insert((r.survey, r.place), ());
            if self.live.get(&(r.survey, r.place)) != Some(r) {
                self.problems.push(format!("record of patch {} differs from the tables, {}", r.id, place()));
            } else if !self.domains.domain(r).meets_cell(cell) {
                self.problems.push(format!("Q3: patch {} does not meet its cell, {}", r.id, place()));
            }
        }
        let keep = if depth == DEPTH_MAX { pending.len() } else { pending.len().min(CAPACITY) };
        let rest = pending.split_off(keep);
        if node.records != pending {
            self.problems.push(format!(
                "Q2/Q4-Q7: {} records, the definition gives {} here, {}",
                node.records.len(),
                pending.len(),
                place()
            ));
        }
        let mut found = node.clone();
        for k in 0..4 {
            let c = child_cell(cell, k);
            let down: Vec<Record> =
                rest.iter().filter(|r| self.domains.domain(r).meets_cell(&c)).copied().collect();
            match (&node.children[k], down.is_empty()) {
                (None, true) => {}
                (None, false) => self.problems.push(format!("Q6: child {k} is missing, {}", place())),
                (Some(_), true) => self.problems.push(format!("Q7: child {k} should be empty, {}", place())),
                (Some(child), false) => {
                    let told = Some((child.top_max, child.bot_min, child.floor));
                    let (top_max, bot_min, floor) = self.node(&child.page, &c, depth + 1, down, told)?;
                    if let Some(f) = &mut found.children[k] {
                        (f.top_max, f.bot_min, f.floor) = (top_max, bot_min, floor);
                    }
                }
            }
        }
        let real = found.aggregates();
        if told.is_some_and(|t| t != real) {
            self.problems.push(format!("Q8: aggregates {told:?}, really {real:?}, {}", place()));
        }
        Ok(real)
    }
}
