//! The logical tree of section 4, straight from its recursive definition.

use super::PatchBox;
use super::exact::{Cut, Line, Polygon};
use std::cmp::Ordering;

/// A node and what it stores, in key order.
#[derive(Clone, Debug, PartialEq)]
pub struct Node {
    pub ids: Vec<String>,
    /// South-west, south-east, north-west, north-east.
    pub children: [Option<Box<Node>>; 4],
}

/// The tree of the live patches in the square `[low, high)`, with `capacity` patches a node.
///
/// The root has depth 0 and is there even without patches.
pub fn expected_tree(
    boxes: &[PatchBox],
    world: ([i64; 2], [i64; 2]),
    capacity: usize,
    maxdepth: u32,
) -> Node {
    let cell = (world.0.map(i128::from), world.1.map(i128::from));
    let mut live: Vec<&PatchBox> = boxes.iter().filter(|b| b.live && meets(b, cell)).collect();
    live.sort_by(|a, b| record_order(a, b));
    node(&live, cell, capacity, maxdepth)
}

/// Top descending, key ascending.
fn record_order(a: &PatchBox, b: &PatchBox) -> Ordering {
    b.top.total_cmp(&a.top).then_with(|| a.key.cmp(&b.key))
}

fn node(pending: &[&PatchBox], (low, high): ([i128; 2], [i128; 2]), capacity: usize, depth: u32) -> Node {
    let stored = if depth == 0 { pending.len() } else { capacity.min(pending.len()) };
    let middle = [0, 1].map(|axis| {
        let sum = low[axis] + high[axis];
        assert!(stored == pending.len() || sum % 2 == 0, "a cell of odd side cannot be divided");
        sum / 2
    });
    let child = |quarter: usize| {
        let upper = [quarter % 2 == 1, quarter / 2 == 1];
        let from = [0, 1].map(|axis| if upper[axis] { middle[axis] } else { low[axis] });
        let to = [0, 1].map(|axis| if upper[axis] { high[axis] } else { middle[axis] });
        let below: Vec<&PatchBox> =
            pending[stored..].iter().copied().filter(|b| meets(b, (from, to))).collect();
        (!below.is_empty()).then(|| Box::new(node(&below, (from, to), capacity, depth - 1)))
    };
    Node { ids: pending[..stored].iter().map(|b| b.id.clone()).collect(), children: [0, 1, 2, 3].map(child) }
}

/// Whether the open domain meets the half-open cell: iff their interiors do, as the domain is open.
fn meets(b: &PatchBox, (low, high): ([i128; 2], [i128; 2])) -> bool {
    let corners = b.domain.map(|p| p.map(i128::from));
    let mut lines = Vec::new();
    let mut left = Polygon::new(&corners, &mut lines);
    let sides = [
        Line::new(1, 0, -low[0]),
        Line::new(-1, 0, high[0]),
        Line::new(0, 1, -low[1]),
        Line::new(0, -1, high[1]),
    ];
    for side in sides {
        lines.push(side);
        let l = lines.len() as u32 - 1;
        match left.cut(&lines, l) {
            Cut::Below(_) => return false,
            Cut::Above(part) | Cut::Both(_, part) => left = part,
        }
    }
    true
}
