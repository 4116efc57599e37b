//! Which patches a question needs, and what changes from one answer to the next.

use super::area::Area;
use super::database::Snapshot;
use super::query::{Query, Tolerance};
use super::view::{Rules, Tables};
use crate::base::lattice::{Bounds, Quad};
use crate::base::{Error, Result};
use crate::height::crs::AxisUnit;
use crate::height::lod::PatchId;
use crate::height::lod::cut::{Clip, Cut, Region};
use crate::height::surface::{Blend, KAPPA};
use crate::store::quadtree::{Domains, Record, walk};
use std::cmp::Ordering;
use std::collections::HashSet;
use std::hash::{BuildHasherDefault, Hasher};

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

/// The corners of a quad, CRS units.
fn corners(quad: &Quad, size: f64) -> [[f64; 2]; 4] {
    quad.0.map(|p| [p.x as f64 * size, p.y as f64 * size])
}

/// Patches that a camera's question looks at, so that the set of those seen seldom grows.
const SEEN: usize = 2048;

/// Ids are hashes already: their first bytes serve as they are.
#[derive(Default)]
struct OfContent(u64);

impl Hasher for OfContent {
    fn write(&mut self, id: &[u8]) {
        self.0 = id.iter().take(8).fold(self.0, |h, b| h << 8 | u64::from(*b));
    }

    // The length of an id says nothing.
    fn write_usize(&mut self, _: usize) {}

    fn finish(&self) -> u64 {
        self.0
    }
}

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

    /// The patches that the answer needs: for [`Blend::Exact`] the needed set of section 5.4, for
    /// [`Blend::Plain`] those whose box the tolerance cuts.
    pub fn select(&self, query: &Query) -> Result<Selection> {
        if let Tolerance::Constant(c) = query.tolerance
            && (c.is_nan() || c < 0.0)
        {
            return Err(Error::invalid("--error", format!("{c} m; it must not be negative")));
        }
        let mut found = self.select_in(self.region(query)?, &*self.cut(&query.tolerance), query.how.blend)?;
        if let Area::Polygon(polygon) = &query.area {
            let (rules, size) = (Rules(&self.view), self.unit.size());
            found.records.retain(|r| polygon.meets(&corners(&rules.domain(r), size)));
        }
        Ok(found)
    }

    pub(super) fn select_in(&self, region: Region, cut: &dyn Cut, blend: Blend) -> Result<Selection> {
        let mut out = Selection {
            version: self.number(),
            records: Vec::new(),
            nodes: 0,
            tested: 0,
            region: region.clone(),
        };
        let (Some(tree), false) = (&self.view.tree, region.is_empty()) else { return Ok(out) };
        let kappa = if blend == Blend::Exact { KAPPA } else { 1.0 };
        let size = self.unit.size();
        let mut seen: HashSet<PatchId, BuildHasherDefault<OfContent>> =
            HashSet::with_capacity_and_hasher(SEEN, Default::default());
        let (mut of_cell, mut of_record) = (Clip::new(&region), Clip::new(&region));
        let mut tested = 0;
        let mut records = Vec::new();
        let mut range = |cell: &Bounds| {
            let part = of_cell.part(&corners(&cell.quad(), size));
            if part.is_empty() {
                return None;
            }
            let (lo, hi) = cut.bounds(part);
            Some((lo / kappa, hi))
        };
        let mut visit = |r: &Record| -> Result<()> {
            tested += 1;
            // A page with a right checksum and wrong contents: not ours, but no reason to panic.
            let known = self.view.entries().get(&r.survey).map(|e| &e.geometry);
            let Some(g) = known.filter(|g| r.place.level <= g.level_max && r.place.rect().overlaps(&g.core))
            else {
                return Err(Error::corrupt(
                    "tree",
                    format!("record of survey {}", r.survey.0),
                    "does not belong to a survey of the root page; run `terraquilt verify`",
                ));
            };
            if !seen.insert(r.id) {
                return Ok(());
            }
            let part = of_record.part(&corners(&g.frame.quad(&r.place.domain()), size));
            if part.is_empty() {
                return Ok(());
            }
            let (lo, hi) = cut.bounds(part);
            let floor = blend == Blend::Exact && r.floor;
            if lo < kappa * f64::from(r.top) && (f64::from(r.bot) <= hi || floor) {
                records.push(*r);
            }
            Ok(())
        };
        out.nodes = walk(&self.view, &tree.page, &mut range, &mut visit)?;
        records.sort_unstable_by_key(|r| r.id);
        out.records = records;
        out.tested = tested;
        Ok(out)
    }
}
