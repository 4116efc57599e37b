//! What turns the set that a client holds into the one it should hold (section 6 of the LOD-space specification).

use super::set::{Block, BlockKey, Member, Set, hash};
use super::target::Target;
use crate::wire::v1;
use std::cmp::Ordering;
use std::sync::Arc;

/// The difference between two sets. No id is in two of the lists of patches; every list is ascending.
#[derive(Clone, Debug, Default)]
pub struct Difference {
    pub from: u64,
    pub to: u64,
    /// The question that it answers; 0: none.
    pub answers: u64,
    pub version: u64,
    /// Of the set that it leads to.
    pub hash: [u8; 16],
    pub patches: u64,
    /// Fixed facts, if they are others than the client knows.
    pub ground: Option<Arc<v1::Ground>>,
    /// Whether the lowest or highest sample is among them.
    pub other_heights: bool,
    pub surveys: Vec<Arc<v1::SurveyFrame>>,
    pub surveys_removed: Vec<u32>,
    pub removed: Vec<Member>,
    pub added: Vec<Member>,
    /// As they are now; `true`: they belong to another survey than before.
    pub changed: Vec<(Member, bool)>,
    pub masks: Vec<Block>,
    pub masks_removed: Vec<BlockKey>,
    pub corrections: Vec<Block>,
    pub corrections_removed: Vec<BlockKey>,
}

impl Difference {
    /// Whether patches, masks, corrections and surveys are the same. Fixed facts may be others.
    pub fn is_empty(&self) -> bool {
        self.removed.is_empty()
            && self.added.is_empty()
            && self.changed.is_empty()
            && self.surveys.is_empty()
            && self.surveys_removed.is_empty()
            && self.masks.is_empty()
            && self.masks_removed.is_empty()
            && self.corrections.is_empty()
            && self.corrections_removed.is_empty()
    }
}

/// Two ascending lists side by side: what is in the first, in both, in the second.
fn merge<A, B>(
    old: &[A],
    new: &[B],
    order: impl Fn(&A, &B) -> Ordering,
    mut meet: impl FnMut(Option<&A>, Option<&B>),
) {
    let (mut a, mut b) = (0, 0);
    while a < old.len() || b < new.len() {
        let o = match (old.get(a), new.get(b)) {
            (Some(x), Some(y)) => order(x, y),
            (Some(_), None) => Ordering::Less,
            _ => Ordering::Greater,
        };
        meet(old.get(a).filter(|_| o.is_le()), new.get(b).filter(|_| o.is_ge()));
        a += usize::from(o.is_le());
        b += usize::from(o.is_ge());
    }
}

/// What differs between blocks.
fn blocks(old: &Arc<Vec<Block>>, new: Vec<Block>) -> (Arc<Vec<Block>>, Vec<Block>, Vec<BlockKey>) {
    if **old == new {
        return (old.clone(), Vec::new(), Vec::new());
    }
    let (mut come, mut gone) = (Vec::new(), Vec::new());
    merge(
        old,
        &new,
        |a, b| a.key.cmp(&b.key),
        |a, b| match (a, b) {
            (Some(a), None) => gone.push(a.key),
            (Some(a), Some(b)) if a.bytes == b.bytes => {}
            (_, Some(b)) => come.push(b.clone()),
            (None, None) => {}
        },
    );
    (Arc::new(new), come, gone)
}

/// Whether the facts that clients know are the same.
fn same_facts(a: &v1::Ground, b: &v1::Ground) -> bool {
    v1::Ground { version: 0, ..a.clone() } == v1::Ground { version: 0, ..b.clone() }
}

/// Leads from a set to a target: the new set, and the difference. New patches get handles from `handle` on.
pub fn lead(from: &Set, to: Target, handle: &mut u32) -> (Set, Difference) {
    let mut d = Difference { from: from.number, version: to.version, ..Difference::default() };
    let same = from.members.len() == to.records.len()
        && from.members.iter().zip(&to.records).all(|(m, r)| m.record == *r);
    let members = if same {
        from.members.clone()
    } else {
        let mut members = Vec::with_capacity(to.records.len());
        merge(
            &from.members,
            &to.records,
            |m, r| m.record.id.cmp(&r.id),
            |old, new| match (old, new) {
                (Some(m), None) => d.removed.push(*m),
                (None, Some(r)) => {
                    let m = Member { record: *r, handle: *handle };
                    *handle += 1;
                    d.added.push(m);
                    members.push(m);
                }
                (Some(m), Some(r)) => {
                    let now = Member { record: *r, handle: m.handle };
                    if m.record != *r {
                        d.changed.push((now, m.record.survey != r.survey));
                    }
                    members.push(now);
                }
                (None, None) => {}
            },
        );
        Arc::new(members)
    };
    d.hash = if d.removed.is_empty() && d.added.is_empty() { from.hash } else { hash(&members) };
    d.patches = members.len() as u64;
    merge(
        &from.surveys,
        &to.surveys,
        |a, b| a.survey.cmp(&b.survey),
        |old, new| match (old, new) {
            (Some(a), None) => d.surveys_removed.push(a.survey),
            (Some(a), Some(b)) if Arc::ptr_eq(a, b) || a == b => {}
            (_, Some(b)) => d.surveys.push(b.clone()),
            (None, None) => {}
        },
    );
    let surveys = if d.surveys.is_empty() && d.surveys_removed.is_empty() {
        from.surveys.clone()
    } else {
        Arc::new(to.surveys)
    };
    let (masks, come, gone) = blocks(&from.masks, to.masks);
    (d.masks, d.masks_removed) = (come, gone);
    let (corrections, come, gone) = blocks(&from.corrections, to.corrections);
    (d.corrections, d.corrections_removed) = (come, gone);
    let known = from.ground.as_ref().is_some_and(|g| Arc::ptr_eq(g, &to.ground) || same_facts(g, &to.ground));
    let heights = |g: &v1::Ground| (g.z_min, g.z_max);
    d.other_heights = from.ground.as_ref().is_none_or(|g| heights(g) != heights(&to.ground));
    d.ground = (!known).then(|| to.ground.clone());
    let set = Set {
        number: from.number,
        version: to.version,
        members,
        hash: d.hash,
        surveys,
        masks,
        corrections,
        ground: Some(to.ground),
    };
    (set, d)
}
