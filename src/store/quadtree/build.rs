//! Changing the tree: deletions one by one, insertions as one sorted batch, and writing what changed.

use super::node::{ChildRef, Node, Record, child_cell, root_cell};
use super::{CAPACITY, DEPTH_MAX};
use crate::base::Result;
use crate::base::lattice::{Bounds, Point, Quad};
use crate::store::segment::{PageRef, Pages, SegmentWriter};
use std::cmp::Ordering;
use std::collections::HashMap;

/// Tells where the domain of a record lies.
pub trait Domains: Sync {
    fn domain(&self, record: &Record) -> Quad;
}

/// A node that may change: children are on disk until touched.
#[derive(Default)]
struct Open {
    records: Vec<Record>,
    children: [Child; 4],
}

#[derive(Default)]
enum Child {
    #[default]
    None,
    Stored(ChildRef),
    Open(Box<Open>),
}

/// Records on their way down, each with its domain. Lists on the way name them by number: 4 bytes instead of 108.
struct Known {
    records: Vec<Record>,
    quads: Vec<Quad>,
}

impl Known {
    fn add(&mut self, record: Record, quad: Quad) -> u32 {
        self.records.push(record);
        self.quads.push(quad);
        self.records.len() as u32 - 1
    }
}

/// A tree being changed.
pub struct Editor<'a> {
    pages: &'a dyn Pages,
    domains: &'a dyn Domains,
    root: Open,
    /// Pages whose nodes were replaced: their bytes are dead in the new version.
    pub replaced: Vec<PageRef>,
}

impl<'a> Editor<'a> {
    /// Opens the tree at `root` (`None`: an empty one). `domains` must know every record, old and new.
    pub fn open(pages: &'a dyn Pages, domains: &'a dyn Domains, root: Option<PageRef>) -> Result<Editor<'a>> {
        let mut replaced = Vec::new();
        let root = match root {
            None => Open::default(),
            Some(at) => {
                replaced.push(at);
                Open::from(Node::read(pages, &at)?)
            }
        };
        Ok(Editor { pages, domains, root, replaced })
    }

    /// Takes `gone` out and puts `come` in. The result depends on the resulting set only.
    pub fn apply(&mut self, gone: &[Record], mut come: Vec<Record>, live_before: u64) -> Result<()> {
        if gone.len() as u64 * 3 > live_before {
            // So much goes that collecting the rest and starting afresh is cheaper than pulling records up.
            let mut rest = HashMap::new();
            let root = std::mem::take(&mut self.root);
            self.collect(root, &mut rest)?;
            for g in gone {
                rest.remove(&(g.survey, g.place));
            }
            come.extend(rest.into_values());
        } else {
            let mut root = std::mem::take(&mut self.root);
            for g in gone {
                let quad = self.domains.domain(g);
                self.delete(&mut root, &root_cell(), g, &quad)?;
            }
            self.root = root;
        }
        come.sort_unstable_by(|a, b| a.order(b));
        let order = (0..come.len() as u32).collect();
        let quads = come.iter().map(|r| self.domains.domain(r)).collect();
        let mut known = Known { records: come, quads };
        let mut root = std::mem::take(&mut self.root);
        self.insert(&mut root, &root_cell(), 0, order, &mut known)?;
        self.root = root;
        Ok(())
    }

    fn collect(
        &mut self,
        node: Open,
        out: &mut HashMap<(crate::height::lod::SurveyNumber, crate::height::lod::Place), Record>,
    ) -> Result<()> {
        for r in node.records {
            out.insert((r.survey, r.place), r);
        }
        for mut c in node.children {
            if self.touch(&mut c)?.is_some()
                && let Child::Open(n) = c
            {
                self.collect(*n, out)?;
            }
        }
        Ok(())
    }

    /// Loads a child so that it can change.
    fn touch<'c>(&mut self, child: &'c mut Child) -> Result<Option<&'c mut Open>> {
        if let Child::Stored(c) = child {
            let node = Node::read(self.pages, &c.page)?;
            self.replaced.push(c.page);
            *child = Child::Open(Box::new(Open::from(node)));
        }
        Ok(match child {
            Child::Open(n) => Some(n),
            _ => None,
        })
    }

    /// Puts records (by number, in record order) into a subtree.
    fn insert(
        &mut self,
        node: &mut Open,
        cell: &Bounds,
        depth: u8,
        come: Vec<u32>,
        known: &mut Known,
    ) -> Result<()> {
        if come.is_empty() {
            return Ok(());
        }
        let room = if depth < DEPTH_MAX { CAPACITY } else { usize::MAX };
        let mut here = Vec::with_capacity((node.records.len() + come.len()).min(room));
        let mut rest: Vec<u32> = Vec::new();
        let mut old = std::mem::take(&mut node.records).into_iter().peekable();
        let mut new = come.into_iter().peekable();
        loop {
            let next = match (old.peek(), new.peek()) {
                (None, None) => break,
                (Some(o), Some(n)) => known.records[*n as usize].order(o) == Ordering::Less,
                (o, _) => o.is_none(),
            };
            match (here.len() < room, next) {
                (true, true) => here.extend(new.next().map(|n| known.records[n as usize])),
                (true, false) => here.extend(old.next()),
                (false, true) => rest.extend(new.next()),
                (false, false) => rest.extend(old.next().map(|r| known.add(r, self.domains.domain(&r)))),
            }
        }
        node.records = here;
        let cells: [Bounds; 4] = std::array::from_fn(|k| child_cell(cell, k));
        let mut down: [Vec<u32>; 4] = Default::default();
        for n in rest {
            let quad = &known.quads[n as usize];
            // Below the root each domain is known to meet the cell, so it meets the one child whose side of the middle it is on.
            let only = if depth > 0 { quarter(&quad.bounds(), &cells[0].max) } else { None };
            for (k, (c, down)) in cells.iter().zip(&mut down).enumerate() {
                if only.map_or_else(|| quad.meets_cell(c), |o| o == k) {
                    down.push(n);
                }
            }
        }
        for (k, down) in down.into_iter().enumerate().filter(|(_, d)| !d.is_empty()) {
            if matches!(node.children[k], Child::None) {
                node.children[k] = Child::Open(Box::default());
            }
            let mut child = std::mem::take(&mut node.children[k]);
            if let Some(n) = self.touch(&mut child)? {
                self.insert(n, &cells[k], depth + 1, down, known)?;
            }
            node.children[k] = child;
        }
        Ok(())
    }

    fn delete(&mut self, node: &mut Open, cell: &Bounds, record: &Record, quad: &Quad) -> Result<()> {
        if let Ok(at) = node.records.binary_search_by(|r| r.order(record)) {
            node.records.remove(at);
            // The smallest head over the children heads the list of every child that it meets.
            let mut head: Option<Record> = None;
            for k in 0..4 {
                if let Some(n) = self.touch(&mut node.children[k])?
                    && let Some(first) = n.records.first()
                    && head.is_none_or(|h| first.order(&h) == Ordering::Less)
                {
                    head = Some(*first);
                }
            }
            if let Some(head) = head {
                let q = self.domains.domain(&head);
                self.delete_below(node, cell, &head, &q)?;
                node.records.push(head);
            }
            return Ok(());
        }
        self.delete_below(node, cell, record, quad)
    }

    fn delete_below(&mut self, node: &mut Open, cell: &Bounds, record: &Record, quad: &Quad) -> Result<()> {
        for k in 0..4 {
            let c = child_cell(cell, k);
            if matches!(node.children[k], Child::None) || !quad.meets_cell(&c) {
                continue;
            }
            let mut child = std::mem::take(&mut node.children[k]);
            if let Some(n) = self.touch(&mut child)? {
                self.delete(n, &c, record, quad)?;
                if n.records.is_empty() {
                    child = Child::None;
                }
            }
            node.children[k] = child;
        }
        Ok(())
    }

    /// Writes the changed nodes, children before parents, and returns the root.
    pub fn write(self, out: &mut SegmentWriter) -> Result<(ChildRef, Vec<PageRef>)> {
        Ok((write(self.root, out)?, self.replaced))
    }
}

/// The child in which a box lies wholly, if there is one.
fn quarter(b: &Bounds, middle: &Point) -> Option<usize> {
    let side = |min, max, middle| if max <= middle { Some(0) } else { (min >= middle).then_some(1) };
    Some(side(b.min.x, b.max.x, middle.x)? + 2 * side(b.min.y, b.max.y, middle.y)?)
}

fn write(open: Open, out: &mut SegmentWriter) -> Result<ChildRef> {
    let mut node = Node { records: open.records, children: [None; 4] };
    for (k, c) in open.children.into_iter().enumerate() {
        node.children[k] = match c {
            Child::None => None,
            Child::Stored(r) => Some(r),
            Child::Open(n) => Some(write(*n, out)?),
        };
    }
    let (top_max, bot_min, floor) = node.aggregates();
    Ok(ChildRef { page: out.append(&node.encode())?, top_max, bot_min, floor })
}

impl From<Node> for Open {
    fn from(n: Node) -> Open {
        Open { records: n.records, children: n.children.map(|c| c.map_or(Child::None, Child::Stored)) }
    }
}
