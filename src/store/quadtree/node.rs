//! Nodes and records, and their bytes.

use super::super::segment::{PageRef, Pages, file_name};
use crate::base::Result;
use crate::base::bytes::{Put, Reader};
use crate::base::lattice::{Bounds, Point, WORLD_HALF};
use crate::height::lod::{PatchId, Place, SurveyNumber};
use std::cmp::Ordering;

/// A live patch as the tree sees it: where its box is, and its key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    pub top: f32,
    pub bot: f32,
    pub floor: bool,
    pub survey: SurveyNumber,
    pub place: Place,
    pub id: PatchId,
}

impl Record {
    /// Record key order: top descending, then id ascending.
    pub fn order(&self, other: &Record) -> Ordering {
        other.top.total_cmp(&self.top).then_with(|| self.id.cmp(&other.id))
    }
}

/// A child as its parent knows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ChildRef {
    pub page: PageRef,
    /// Largest top in the subtree (that of the child's first record).
    pub top_max: f32,
    /// Smallest bottom in the subtree.
    pub bot_min: f32,
    /// Whether the subtree holds a floor patch.
    pub floor: bool,
}

/// A node as it is stored.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Node {
    /// Strictly ascending in record order.
    pub records: Vec<Record>,
    /// South-west, south-east, north-west, north-east.
    pub children: [Option<ChildRef>; 4],
}

/// The world cell.
pub fn root_cell() -> Bounds {
    Bounds { min: Point::new(-WORLD_HALF, -WORLD_HALF), max: Point::new(WORLD_HALF, WORLD_HALF) }
}

/// The half-open cell of a child.
pub fn child_cell(cell: &Bounds, k: usize) -> Bounds {
    let half = (cell.max.x - cell.min.x) / 2;
    let min = Point::new(
        cell.min.x + if k & 1 == 1 { half } else { 0 },
        cell.min.y + if k & 2 == 2 { half } else { 0 },
    );
    Bounds { min, max: Point::new(min.x + half, min.y + half) }
}

impl Node {
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::with_capacity(8 + self.records.len() * 40 + 4 * 32);
        out.put_u8(b'N');
        out.put_u8(self.children.iter().enumerate().fold(0, |m, (k, c)| m | u8::from(c.is_some()) << k));
        out.put_u16(0);
        out.put_u32(self.records.len() as u32);
        for c in self.children.iter().flatten() {
            c.page.put(&mut out);
            out.put_f32(c.top_max);
            out.put_f32(c.bot_min);
            out.put_u32(u32::from(c.floor));
        }
        for r in &self.records {
            out.put_f32(r.top);
            out.put_f32(r.bot);
            out.put_u32(r.survey.0);
            out.put_u8(r.place.level);
            out.put_u8(u8::from(r.floor));
            out.put_u16(0);
            out.put_i32(r.place.i);
            out.put_i32(r.place.j);
            out.put(&r.id.0);
        }
        out
    }

    pub fn decode(bytes: &[u8], file: &str) -> Result<Node> {
        let mut r = Reader::new(bytes, file, "tree node");
        let kind = r.u8()?;
        if kind != b'N' {
            return Err(r.bad(format!("page kind {kind:#04x} is not a tree node")));
        }
        let mask = r.u8()?;
        r.u16()?;
        let n = r.u32()? as usize;
        if n > r.remaining() / 40 {
            return Err(r.bad(format!("{n} records in {} bytes", r.remaining())));
        }
        let mut node = Node::default();
        for k in 0..4 {
            if mask >> k & 1 == 1 {
                let page = PageRef::read(&mut r)?;
                node.children[k] =
                    Some(ChildRef { page, top_max: r.f32()?, bot_min: r.f32()?, floor: r.u32()? != 0 });
            }
        }
        node.records.reserve_exact(n);
        for _ in 0..n {
            let (top, bot, survey) = (r.f32()?, r.f32()?, SurveyNumber(r.u32()?));
            let level = r.u8()?;
            if level > crate::height::lod::LEVEL_MAX {
                return Err(r.bad(format!("level {level}")));
            }
            let floor = r.u8()? != 0;
            r.u16()?;
            let place = Place { level, i: r.i32()?, j: r.i32()? };
            let id = PatchId(r.take(16)?.try_into().expect("16 bytes were taken"));
            if top.is_nan() || bot.is_nan() {
                return Err(r.bad(format!("a box from {bot} m to {top} m")));
            }
            let record = Record { top, bot, floor, survey, place, id };
            // Whoever searches a node relies on the order of its records.
            if node.records.last().is_some_and(|last| last.order(&record) != Ordering::Less) {
                return Err(r.bad(format!("record {id:?} is out of order")));
            }
            node.records.push(record);
        }
        r.end()?;
        Ok(node)
    }

    pub fn read(pages: &dyn Pages, at: &PageRef) -> Result<Node> {
        Node::decode(&pages.page(at)?, &file_name(at.file))
    }

    /// Aggregates of the subtree, from the records and the children's aggregates.
    pub fn aggregates(&self) -> (f32, f32, bool) {
        let top = self.records.first().map_or(f32::NEG_INFINITY, |r| r.top);
        let mut bot = f32::INFINITY;
        let mut floor = false;
        for r in &self.records {
            bot = bot.min(r.bot);
            floor |= r.floor;
        }
        for c in self.children.iter().flatten() {
            bot = bot.min(c.bot_min);
            floor |= c.floor;
        }
        (top, bot, floor)
    }
}
