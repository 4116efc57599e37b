//! Which patches a question needs, and what changes from one answer to the next.

use super::area::Area;
use super::asked::{Asked, Even, Met, Uneven, corners};
use super::database::Snapshot;
use super::found::Found;
use super::query::{Query, Tolerance};
use super::view::{Rules, Tables};
use crate::base::lattice::Bounds;
use crate::base::{Error, Result};
use crate::height::crs::AxisUnit;
use crate::height::lod::cut::{Clip, Cut, Region};
use crate::height::surface::Blend;
use crate::store::quadtree::{Domains, Explored, Node, Record, Shelf, Shelves, walk};
use crate::store::segment::PageRef;
use std::cmp::Ordering;
use std::sync::Arc;

/// The patches of an answer, ascending by id.
#[derive(Clone, Debug)]
pub struct Selection {
    pub version: u64,
    pub records: Vec<Record>,
    /// Nodes of the tree that were read.
    pub nodes: u64,
    /// Records that were looked at, those stored in several nodes counted each time.
    pub tested: u64,
    /// The region that was meant: a convex polygon in CRS units, around the area that was asked.
    pub region: Region,
}

/// What changed between two answers to the same question.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Difference {
    pub added: Vec<Record>,
    pub removed: Vec<Record>,
    /// Same patch, other top or floor, or of another survey (that was removed and came again): as it is now.
    pub changed: Vec<Record>,
}

/// The difference that turns the first answer into the second (section 6 of the LOD-space specification). Records of
/// both ascend by id.
pub fn difference(from: &[Record], to: &[Record]) -> Difference {
    let mut d = Difference::default();
    let (mut old, mut new) = (from.iter().peekable(), to.iter().peekable());
    loop {
        let order = match (old.peek(), new.peek()) {
            (None, None) => break,
            (Some(_), None) => Ordering::Less,
            (None, Some(_)) => Ordering::Greater,
            (Some(o), Some(n)) => o.id.cmp(&n.id),
        };
        let o = if order == Ordering::Greater { None } else { old.next() };
        let n = if order == Ordering::Less { None } else { new.next() };
        match (o, n) {
            (Some(o), None) => d.removed.push(*o),
            (None, Some(n)) => d.added.push(*n),
            (Some(o), Some(n)) if (o.top, o.floor, o.survey) != (n.top, n.floor, n.survey) => {
                d.changed.push(*n)
            }
            _ => {}
        }
    }
    d
}

/// The hash of a set of patches whose records are ascending by id, by which a client knows that it holds the same: the first 16 bytes of
/// BLAKE3 over the ids, end to end.
pub fn set_hash<'a>(records: impl Iterator<Item = &'a Record>) -> [u8; 16] {
    let ids: Vec<u8> = records.flat_map(|r| r.id.0).collect();
    let mut out = [0; 16];
    out.copy_from_slice(&blake3::hash(&ids).as_bytes()[..16]);
    out
}

/// Patches of several nodes that an answer is expected to have, so that the set of those met seldom grows.
const MET: usize = 1024;

impl Snapshot {
    pub(super) fn region(&self, query: &Query) -> Result<Region> {
        let whole = match query.area.convex() {
            Some(region) => {
                let b = region.bounds();
                if !(b.iter().all(|v| v.is_finite()) && b[0] < b[2] && b[1] < b[3]) {
                    return Err(Error::invalid(
                        "--bbox",
                        format!("{b:?} is empty; give xmin,ymin,xmax,ymax"),
                    ));
                }
                region
            }
            None => match self.bounds() {
                // A hair larger, so that the border posts are in.
                Some(b) => {
                    let pad = [(b[2] - b[0]) * 1e-9, (b[3] - b[1]) * 1e-9];
                    Region::from_box([b[0] - pad[0], b[1] - pad[1], b[2] + pad[0], b[3] + pad[1]])
                }
                None => Region { polygon: Vec::new() },
            },
        };
        if let (Tolerance::Camera(c), Some(z)) = (&query.tolerance, self.relief(query.how)) {
            if self.crs.unit == AxisUnit::Degree {
                return Err(Error::unsupported(
                    &self.crs.code,
                    "a camera needs metres, and this database is in degrees",
                    "ask with --error M, or make a database in a projected CRS",
                ));
            }
            let polygon = whole.clip(&c.footprint(z[0], z[1]).polygon);
            return Ok(Region { polygon: if polygon.len() < 3 { Vec::new() } else { polygon } });
        }
        Ok(whole)
    }

    /// The patches that the answer needs, ascending by id: for [`Blend::Exact`] the needed set of section 5.4, for
    /// [`Blend::Plain`] those whose box the tolerance cuts.
    pub fn select(&self, query: &Query) -> Result<Selection> {
        Ok(self.find(query)?.selection())
    }

    /// The same patches where they lie in the tree: no copy of any, and in no particular order.
    pub fn find(&self, query: &Query) -> Result<Found> {
        if let Tolerance::Constant(c) = query.tolerance
            && (c.is_nan() || c < 0.0)
        {
            return Err(Error::invalid("--error", format!("{c} m; it must not be negative")));
        }
        let mut found = self.find_in(self.region(query)?, &*self.cut(&query.tolerance), query.how.blend)?;
        if let Area::Polygon(polygon) = &query.area {
            let (rules, size) = (Rules(&self.view), self.unit.size());
            found.retain(|r| polygon.meets(&corners(&rules.domain(r), size)));
        }
        Ok(found)
    }

    pub(super) fn select_in(&self, region: Region, cut: &dyn Cut, blend: Blend) -> Result<Selection> {
        Ok(self.find_in(region, cut, blend)?.selection())
    }

    pub(super) fn find_in(&self, region: Region, cut: &dyn Cut, blend: Blend) -> Result<Found> {
        self.find_through(self.view.explored(), region, cut, blend)
    }

    /// By nodes that were reached before.
    pub(super) fn find_through(
        &self,
        tree: Arc<Explored>,
        region: Region,
        cut: &dyn Cut,
        blend: Blend,
    ) -> Result<Found> {
        let found = Found::none(self.number(), region, tree.clone());
        let (Some(root), false) = (&self.view.tree, found.region.is_empty()) else { return Ok(found) };
        let asked = Asked {
            domains: &Rules(&self.view),
            size: self.unit.size(),
            cut,
            exact: blend == Blend::Exact,
            clip: Clip::new(&found.region),
            met: Met::with_capacity_and_hasher(
                if cut.even().is_some() { 0 } else { MET },
                Default::default(),
            ),
            found,
        };
        let (nodes, asked) = match cut.even() {
            Some(c) => {
                let mut question = Even::new(asked, c);
                (walk(&tree, self, &root.page, &mut question)?, question.asked)
            }
            None => {
                let mut question = Uneven { asked };
                (walk(&tree, self, &root.page, &mut question)?, question.asked)
            }
        };
        let mut found = asked.found;
        found.nodes = nodes;
        Ok(found)
    }
}

impl Shelves for Snapshot {
    fn shelf(&self, at: &PageRef, cell: &Bounds) -> Result<Arc<Shelf>> {
        // A page with a right checksum and wrong contents: not ours, but no reason to panic.
        let check = |r: &Record| {
            let known = self.view.entries().get(&r.survey).map(|e| &e.geometry);
            match known.filter(|g| r.place.level <= g.level_max && r.place.rect().overlaps(&g.core)) {
                Some(_) => Ok(()),
                None => Err(Error::corrupt(
                    "tree",
                    format!("record of survey {}", r.survey.0),
                    "does not belong to a survey of the root page; run `terraquilt verify`",
                )),
            }
        };
        let shelf = self.view.caches.node(at, || {
            let node = Node::read(&self.view.files, at)?;
            node.records.iter().try_for_each(check)?;
            Ok(Shelf::new(&node, cell, &Rules(&self.view), self.unit.size()))
        })?;
        // The survey may have been another then: it has lost tiles, or the page is of another version.
        let mut part = Some(&shelf);
        while let Some(s) = part {
            s.records.iter().try_for_each(check)?;
            part = s.rest.as_ref();
        }
        Ok(shelf)
    }
}
