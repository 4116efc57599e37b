//! What a client holds.

use crate::db::query::set_hash;
use crate::db::{CorrectionPart, MaskPart};
use crate::store::quadtree::Record;
use crate::wire::v1;
use bytes::Bytes;
use std::sync::Arc;

/// A patch that a client holds: as it was last told, and the handle that stands for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Member {
    pub record: Record,
    pub handle: u32,
}

/// Where a block of a mask lies, or of a correction: then level 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct BlockKey {
    pub survey: u32,
    pub level: u8,
    pub i: i32,
    pub j: i32,
}

/// A block of a mask or a correction.
#[derive(Clone, Debug, PartialEq)]
pub struct Block {
    pub key: BlockKey,
    pub bytes: Bytes,
}

impl From<MaskPart> for Block {
    fn from(m: MaskPart) -> Block {
        Block { key: BlockKey { survey: m.survey.0, level: m.level, i: m.i, j: m.j }, bytes: m.cells }
    }
}

impl From<CorrectionPart> for Block {
    fn from(c: CorrectionPart) -> Block {
        Block { key: BlockKey { survey: c.survey.0, level: 0, i: c.i, j: c.j }, bytes: c.nodes }
    }
}

/// What a client holds after it applied a difference. What did not change from one set to the next is shared.
#[derive(Clone, Debug, Default)]
pub struct Set {
    /// That of the difference; 0: the empty set that every view begins with.
    pub number: u64,
    pub version: u64,
    /// Ascending by id.
    pub members: Arc<Vec<Member>>,
    /// First 16 bytes of BLAKE3 over the ids, ascending.
    pub hash: [u8; 16],
    /// Ascending by number.
    pub surveys: Arc<Vec<Arc<v1::SurveyFrame>>>,
    /// Ascending by key.
    pub masks: Arc<Vec<Block>>,
    /// Ascending by key.
    pub corrections: Arc<Vec<Block>>,
    /// As the client knows it, but for its version.
    pub ground: Option<Arc<v1::Ground>>,
}

impl Set {
    /// The set that every view begins with.
    pub fn empty() -> Set {
        Set { hash: hash(&[]), ..Set::default() }
    }

    /// The frame of a survey.
    pub fn survey(&self, number: u32) -> Option<&Arc<v1::SurveyFrame>> {
        self.surveys.binary_search_by_key(&number, |s| s.survey).ok().map(|k| &self.surveys[k])
    }

    /// Patches and blocks that it keeps in memory beside another set.
    pub fn weight_beside(&self, other: &Set) -> usize {
        let of = |shared: bool, n: usize| if shared { 0 } else { n };
        of(Arc::ptr_eq(&self.members, &other.members), self.members.len())
            + of(Arc::ptr_eq(&self.masks, &other.masks), self.masks.len())
            + of(Arc::ptr_eq(&self.corrections, &other.corrections), self.corrections.len())
    }
}

/// The hash of a set whose members are ascending by id.
pub fn hash(members: &[Member]) -> [u8; 16] {
    set_hash(members.iter().map(|m| &m.record))
}
