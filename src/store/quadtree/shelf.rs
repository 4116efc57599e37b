//! Decoded nodes as questions read them: in columns, with what follows from a record and its cell alone.
//!
//! A question looks at hundreds of nodes and takes some patches of each, so what decides about a record lies close together
//! and records themselves are touched only where they are taken. Sets of records of a shelf are masks: bit k is record k.

use super::node::{ChildRef, Node, Record};
use super::{CAPACITY, Domains};
use crate::base::lattice::{Bounds, Point, Quad, WORLD_HALF};
use crate::height::lod::cut::{Boxes, pack};
use std::sync::Arc;

/// Records that a mask has bits for.
pub const SHELF: usize = CAPACITY;
const _: () = assert!(SHELF == u64::BITS as usize);

/// What decides about a whole shelf, and what a question needs to go on to the children.
#[derive(Clone, Copy, Debug)]
pub struct Summary {
    /// All records.
    pub all: u64,
    pub floors: u64,
    /// Records whose domain has its middle in the cell. The nodes that hold a record have disjoint cells, and the one that
    /// the middle lies in is among them (invariants Q4 and Q6): a record is in this mask in exactly one node.
    pub own: u64,
    /// Records whose domain lies wholly in the cell: they are in no other node.
    pub alone: u64,
    pub top_least: f32,
    pub bot_least: f32,
    pub bot_most: f32,
    /// A disc around all domains: x, y, radius, CRS units.
    pub reach: [f64; 3],
    pub children: [Option<Below>; 4],
    /// The node has more records than these.
    pub rest: bool,
}

/// What a parent knows of the subtree of a child.
#[derive(Clone, Copy, Debug)]
pub struct Below {
    pub top_max: f32,
    pub bot_min: f32,
    pub floor: bool,
}

/// Columns have room for whole lots of so many: what is computed of a lot is one vector instruction.
const LOT: usize = 8;

/// Up to [`SHELF`] records of a node. A node holds more at the greatest depth only: then `rest` continues it, and the children
/// are those of the last part.
#[derive(Debug)]
pub struct Shelf {
    pub summary: Summary,
    /// In record order: tops descend.
    pub records: Arc<[Record]>,
    pub children: [Option<ChildRef>; 4],
    pub rest: Option<Arc<Shelf>>,
    /// Tops, then bots, then arms of domains (from the middle to two corners: x, y, x, y).
    singles: Box<[f32]>,
    /// x, then y, then radii of the discs around domains.
    discs: Box<[f64]>,
}

impl Shelf {
    /// The shelf of a node whose cell is `cell`; `size`: CRS units in a lattice unit.
    pub fn new(node: &Node, cell: &Bounds, domains: &dyn Domains, size: f64) -> Shelf {
        let mut parts = node.records.chunks(SHELF).rev();
        let last = Shelf::part(parts.next().unwrap_or(&[]), node.children, None, cell, domains, size);
        parts.fold(last, |rest, records| {
            Shelf::part(records, [None; 4], Some(Arc::new(rest)), cell, domains, size)
        })
    }

    fn part(
        records: &[Record],
        children: [Option<ChildRef>; 4],
        rest: Option<Arc<Shelf>>,
        cell: &Bounds,
        domains: &dyn Domains,
        size: f64,
    ) -> Shelf {
        let (count, n) = (records.len(), records.len().next_multiple_of(LOT));
        let below = |c: ChildRef| Below { top_max: c.top_max, bot_min: c.bot_min, floor: c.floor };
        let mut s = Summary {
            all: first(count),
            floors: 0,
            own: 0,
            alone: 0,
            top_least: f32::INFINITY,
            bot_least: f32::INFINITY,
            bot_most: f32::NEG_INFINITY,
            reach: [0.0; 3],
            children: children.map(|c| c.map(below)),
            rest: rest.is_some(),
        };
        let (mut singles, mut discs) = (vec![0.0; 6 * n], vec![0.0; 3 * n]);
        for (k, r) in records.iter().enumerate() {
            let quad = domains.domain(r);
            let b = quad.bounds();
            let middle = Point::new(b.min.x.midpoint(b.max.x), b.min.y.midpoint(b.max.y));
            let bit = 1 << k;
            s.floors |= if r.floor { bit } else { 0 };
            s.own |= if cell_holds(cell, middle) { bit } else { 0 };
            s.alone |= if within(&b, cell) { bit } else { 0 };
            s.top_least = s.top_least.min(r.top);
            s.bot_least = s.bot_least.min(r.bot);
            s.bot_most = s.bot_most.max(r.bot);
            let disc = around(&quad, middle, size);
            (discs[k], discs[n + k], discs[2 * n + k]) = (disc[0], disc[1], disc[2]);
            let arm = |c: usize| {
                let p = quad.0[c];
                [(p.x - middle.x) as f64 * size, (p.y - middle.y) as f64 * size]
            };
            let ([ax, ay], [bx, by]) = (arm(0), arm(1));
            let single = [r.top, r.bot, ax as f32, ay as f32, bx as f32, by as f32];
            single.into_iter().enumerate().for_each(|(column, v)| singles[column * n + k] = v);
        }
        s.reach = enclosing(&discs[..count], &discs[n..n + count], &discs[2 * n..2 * n + count]);
        Shelf {
            summary: s,
            records: records.into(),
            children,
            rest,
            singles: singles.into(),
            discs: discs.into(),
        }
    }

    pub fn tops(&self) -> &[f32] {
        self.single(0, self.records.len())
    }

    pub fn bots(&self) -> &[f32] {
        self.single(1, self.records.len())
    }

    /// The first `n` of a column.
    fn single(&self, column: usize, n: usize) -> &[f32] {
        let from = column * self.records.len().next_multiple_of(LOT);
        &self.singles[from..from + n]
    }

    /// The boxes of the first `n` records, and others up to a whole lot.
    pub fn boxes(&self, n: usize) -> Boxes<'_> {
        let (n, all) = (n.next_multiple_of(LOT), self.records.len().next_multiple_of(LOT));
        let column = |k: usize| &self.discs[k * all..k * all + n];
        Boxes {
            x: column(0),
            y: column(1),
            radius: column(2),
            top: self.single(0, n),
            bot: self.single(1, n),
            arms: [2, 3, 4, 5].map(|c| self.single(c, n)),
        }
    }

    /// How many records have at least this top; they come first.
    pub fn of_top(&self, least: f32) -> usize {
        self.tops().partition_point(|t| *t >= least)
    }

    /// Records with at most this bot.
    pub fn of_bot(&self, most: f32) -> u64 {
        let mut truths = [0; SHELF];
        for (truth, bot) in truths.iter_mut().zip(self.bots()) {
            *truth = u8::from(*bot <= most);
        }
        pack(&truths)
    }
}

/// The first `n` records.
pub fn first(n: usize) -> u64 {
    if n >= SHELF { u64::MAX } else { (1 << n) - 1 }
}

/// The numbers of the bits that are set.
pub fn bits(mut mask: u64) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let k = mask.trailing_zeros();
        mask &= mask.wrapping_sub(1);
        (k < u64::BITS).then_some(k as usize)
    })
}

/// Whether a half-open cell holds a point.
fn cell_holds(cell: &Bounds, p: Point) -> bool {
    (cell.min.x..cell.max.x).contains(&p.x) && (cell.min.y..cell.max.y).contains(&p.y)
}

fn within(b: &Bounds, cell: &Bounds) -> bool {
    cell.min.x <= b.min.x && cell.min.y <= b.min.y && b.max.x <= cell.max.x && b.max.y <= cell.max.y
}

/// A disc around a quad: x, y, radius. Without bound where the middle lies outside of the world: no node owns such a record.
fn around(quad: &Quad, middle: Point, size: f64) -> [f64; 3] {
    let world = -WORLD_HALF..WORLD_HALF;
    let m = [middle.x as f64 * size, middle.y as f64 * size];
    if !(world.contains(&middle.x) && world.contains(&middle.y)) {
        return [m[0], m[1], f64::MAX];
    }
    let away = |p: &Point| (p.x as f64 * size - m[0]).hypot(p.y as f64 * size - m[1]);
    [m[0], m[1], quad.0.iter().map(away).fold(0.0, f64::max)]
}

/// A disc around discs.
fn enclosing(xs: &[f64], ys: &[f64], radii: &[f64]) -> [f64; 3] {
    if xs.is_empty() {
        return [0.0; 3];
    }
    let middle = |column: &[f64]| {
        let (a, b) =
            column.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(*v), b.max(*v)));
        a.midpoint(b)
    };
    let (x, y) = (middle(xs), middle(ys));
    let away = |k: usize| (xs[k] - x).hypot(ys[k] - y) + radii[k];
    [x, y, (0..xs.len()).map(away).fold(0.0, f64::max)]
}
