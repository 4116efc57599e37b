//! A difference on its way: cut into messages, each made when there is room for it.

use super::difference::Difference;
use super::set::{BlockKey, Member};
use crate::base::Result;
use crate::db::Snapshot;
use crate::server::{metrics, model};
use crate::wire::{MESSAGE_BYTES, v1};
use bytes::Bytes;
use std::sync::Arc;

/// Bytes of a block beside its contents, of a change, of a handle, at most.
const BLOCK_BYTES: usize = 40;
const CHANGE_BYTES: usize = 32;
const HANDLE_BYTES: usize = 5;
/// Bytes of a patch beside its payload, and of a frame beside its name, at most.
const PATCH_BYTES: usize = 64;
const FRAME_BYTES: usize = 160;

/// Lists of a difference.
const LISTS: usize = 9;

/// A difference that is being sent. Payloads are read from the version that it leads to.
pub struct Parcel {
    snapshot: Arc<Snapshot>,
    payload: bool,
    d: Difference,
    /// How far each list is sent, in the order of their sending.
    at: [usize; LISTS],
    done: bool,
}

/// Takes from a list until it ends or the message is full. True: the message is full.
fn take<T>(
    list: &[T],
    at: &mut usize,
    room: &mut usize,
    mut put: impl FnMut(&T) -> Result<usize>,
) -> Result<bool> {
    while let Some(item) = list.get(*at) {
        if *room == 0 {
            return Ok(true);
        }
        *room = room.saturating_sub(put(item)?);
        *at += 1;
    }
    Ok(false)
}

impl Parcel {
    pub fn new(d: Difference, snapshot: Arc<Snapshot>, payload: bool) -> Parcel {
        Parcel { snapshot, payload, d, at: [0; LISTS], done: false }
    }

    /// Whether its last message was made.
    pub fn done(&self) -> bool {
        self.done
    }

    /// The next message.
    ///
    /// # Errors
    /// If a payload cannot be read.
    pub fn message(&mut self) -> Result<v1::ViewReply> {
        let d = &self.d;
        let mut m = v1::ViewReply { from: d.from, to: d.to, answers: d.answers, ..Default::default() };
        if self.at == [0; LISTS] {
            m.ground = d.ground.as_deref().cloned();
        }
        m.more = self.fill(&mut m)?;
        metrics::patches_sent("View", m.added.len());
        if !m.more {
            let d = &self.d;
            m.hash = Bytes::copy_from_slice(&d.hash);
            m.patches = d.patches;
            m.version = d.version;
            self.done = true;
        }
        Ok(m)
    }

    /// Fills a message; true: it is full and something is left.
    fn fill(&mut self, m: &mut v1::ViewReply) -> Result<bool> {
        let (d, at, room) = (&self.d, &mut self.at, &mut { MESSAGE_BYTES });
        let [gone, gone_s, gone_m, gone_c, surveys, added, changed, masks, corrections] = at;
        let (snapshot, payload) = (&self.snapshot, self.payload);
        Ok(take(&d.removed, gone, room, |x| {
            m.removed.push(x.handle);
            Ok(HANDLE_BYTES)
        })? || take(&d.surveys_removed, gone_s, room, |x| {
            m.surveys_removed.push(*x);
            Ok(HANDLE_BYTES)
        })? || take(&d.masks_removed, gone_m, room, |x| {
            m.masks_removed.push(mask(x, Bytes::new()));
            Ok(BLOCK_BYTES)
        })? || take(&d.corrections_removed, gone_c, room, |x| {
            m.corrections_removed.push(correction(x, Bytes::new()));
            Ok(BLOCK_BYTES)
        })? || take(&d.surveys, surveys, room, |x| {
            m.surveys.push((**x).clone());
            Ok(FRAME_BYTES + x.name.len())
        })? || take(&d.added, added, room, |x| {
            let patch = patch(snapshot, x, payload)?;
            let bytes = PATCH_BYTES + patch.payload.len();
            m.added.push(patch);
            Ok(bytes)
        })? || take(&d.changed, changed, room, |(x, moved)| {
            m.changed.push(change(x, *moved));
            Ok(CHANGE_BYTES)
        })? || take(&d.masks, masks, room, |x| {
            m.masks.push(mask(&x.key, x.bytes.clone()));
            Ok(BLOCK_BYTES + x.bytes.len())
        })? || take(&d.corrections, corrections, room, |x| {
            m.corrections.push(correction(&x.key, x.bytes.clone()));
            Ok(BLOCK_BYTES + x.bytes.len())
        })?)
    }
}

fn patch(snapshot: &Snapshot, x: &Member, payload: bool) -> Result<v1::Patch> {
    let payload = if payload { snapshot.payload(&x.record)? } else { Bytes::new() };
    Ok(model::patch(&x.record, x.handle, payload))
}

fn change(x: &Member, moved: bool) -> v1::PatchChange {
    let r = &x.record;
    v1::PatchChange { handle: x.handle, top_m: r.top, floor: r.floor, survey: moved.then_some(r.survey.0) }
}

fn correction(k: &BlockKey, nodes: Bytes) -> v1::CorrectionBlock {
    v1::CorrectionBlock { survey: k.survey, i: k.i, j: k.j, nodes }
}

fn mask(k: &BlockKey, cells: Bytes) -> v1::MaskBlock {
    v1::MaskBlock { survey: k.survey, level: u32::from(k.level), i: k.i, j: k.j, cells }
}
