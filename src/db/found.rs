//! The patches of an answer where they lie in the tree.

use super::selection::Selection;
use crate::height::lod::cut::Region;
use crate::store::quadtree::{Explored, Record, Spot, bits};
use std::sync::Arc;

/// The patches of an answer, each once, in no particular order: masks of records in decoded nodes, which it keeps. Some bytes a
/// patch and no copy of what is known of it; [`Found::selection`] makes copies in the order of ids.
pub struct Found {
    pub version: u64,
    /// Nodes of the tree that were read.
    pub nodes: u64,
    /// Records that were looked at, those stored in several nodes counted each time.
    pub tested: u64,
    /// The region that was meant: a convex polygon in CRS units, around the area that was asked.
    pub region: Region,
    tree: Arc<Explored>,
    /// Numbers of spots, and which of their records.
    linked: Vec<(u32, u64)>,
    /// The same for nodes that are not linked.
    apart: Vec<(Arc<[Record]>, u64)>,
}

impl Found {
    pub(super) fn none(version: u64, region: Region, tree: Arc<Explored>) -> Found {
        Found { version, nodes: 0, tested: 0, region, tree, linked: Vec::new(), apart: Vec::new() }
    }

    #[inline]
    pub(super) fn take(&mut self, spot: &Spot, number: Option<u32>, mask: u64) {
        match number {
            _ if mask == 0 => {}
            Some(number) => self.linked.push((number, mask)),
            None => self.apart.push((spot.records.clone(), mask)),
        }
    }

    /// Keeps what a rule says of each.
    pub(super) fn retain(&mut self, mut keep: impl FnMut(&Record) -> bool) {
        let mut kept = |records: &[Record], mask: &mut u64| {
            for k in bits(*mask) {
                *mask &= !(u64::from(!keep(&records[k])) << k);
            }
            *mask != 0
        };
        let tree = &self.tree;
        self.linked.retain_mut(|(number, mask)| kept(&tree.spot(*number).records, mask));
        self.apart.retain_mut(|(records, mask)| kept(records, mask));
    }

    /// How many patches.
    pub fn len(&self) -> usize {
        let of = |mask: &u64| mask.count_ones() as usize;
        self.linked.iter().map(|(_, m)| of(m)).sum::<usize>()
            + self.apart.iter().map(|(_, m)| of(m)).sum::<usize>()
    }

    pub fn is_empty(&self) -> bool {
        self.linked.is_empty() && self.apart.is_empty()
    }

    fn nodes_taken(&self) -> impl Iterator<Item = (&[Record], u64)> {
        let linked = self.linked.iter().map(|(number, mask)| (&*self.tree.spot(*number).records, *mask));
        linked.chain(self.apart.iter().map(|(records, mask)| (&**records, *mask)))
    }

    pub fn records(&self) -> impl Iterator<Item = &Record> {
        self.nodes_taken().flat_map(|(records, mask)| bits(mask).map(|k| &records[k]))
    }

    /// The records, ascending by id.
    pub fn selection(self) -> Selection {
        let mut order: Vec<(u64, &Record)> = Vec::with_capacity(self.len());
        for (records, mask) in self.nodes_taken() {
            order.extend(bits(mask).map(|k| (leading(&records[k]), &records[k])));
        }
        // Ids are hashes: their first eight bytes tell nearly all of them apart.
        order.sort_unstable_by(|(a, x), (b, y)| a.cmp(b).then_with(|| x.id.cmp(&y.id)));
        let records = order.into_iter().map(|(_, r)| *r).collect();
        Selection {
            version: self.version,
            records,
            nodes: self.nodes,
            tested: self.tested,
            region: self.region,
        }
    }
}

/// The first eight bytes of an id, in its order.
fn leading(r: &Record) -> u64 {
    let mut first = [0; 8];
    first.copy_from_slice(&r.id.0[..8]);
    u64::from_be_bytes(first)
}
