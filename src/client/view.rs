//! A view that a server keeps in step: what `proto/terraquilt/v1/view.proto` asks of a client.
//!
//! - [`Set`]: what the client holds; applies differences strictly;
//! - [`View`]: the stream: opens, steers, takes the next difference, comes back after a broken connection.

use super::connection::Wire;
use super::{Connection, failed};
use crate::base::{Error, Result};
use crate::wire::MESSAGE_BYTES_MAX;
use crate::wire::v1::view_client::ViewClient;
use crate::wire::v1::view_request::Kind;
use crate::wire::v1::{self, ViewReply, ViewRequest};
use bytes::Bytes;
use std::collections::{BTreeMap, HashMap};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::Streaming;

/// Questions that wait for the connection to take them.
const QUESTIONS_READY: usize = 4;

/// Survey, level, i, j of a block; level 0 for corrections.
pub type BlockKey = (u32, u32, i32, i32);

/// What a client holds of a view.
#[derive(Clone, Debug, Default)]
pub struct Set {
    /// Number of the last difference; 0: none.
    pub number: u64,
    pub version: u64,
    pub hash: Bytes,
    pub ground: Option<v1::Ground>,
    pub surveys: BTreeMap<u32, v1::SurveyFrame>,
    /// By handle.
    pub patches: HashMap<u32, v1::Patch>,
    /// Handles by id.
    pub ids: BTreeMap<[u8; 16], u32>,
    pub masks: BTreeMap<BlockKey, Bytes>,
    pub corrections: BTreeMap<BlockKey, Bytes>,
    /// Messages of a difference that goes on.
    pending: Vec<ViewReply>,
}

/// What a difference did.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Applied {
    pub from: u64,
    pub to: u64,
    /// The question that it answers; 0: a commit alone.
    pub answers: u64,
    pub version: u64,
    /// Handles.
    pub added: Vec<u32>,
    pub removed: Vec<u32>,
    pub changed: Vec<u32>,
    /// Blocks of masks and corrections that came or went.
    pub blocks: usize,
    pub messages: usize,
    /// Bytes of its messages.
    pub bytes: usize,
}

fn misfit(what: impl std::fmt::Display) -> Error {
    Error::invalid("difference of a view", format!("{what}; open the view anew"))
}

fn mask_key(m: &v1::MaskBlock) -> BlockKey {
    (m.survey, m.level, m.i, m.j)
}

fn correction_key(c: &v1::CorrectionBlock) -> BlockKey {
    (c.survey, 0, c.i, c.j)
}

/// Takes in and drops blocks.
fn blocks(
    held: &mut BTreeMap<BlockKey, Bytes>,
    gone: impl Iterator<Item = BlockKey>,
    come: impl Iterator<Item = (BlockKey, Bytes)>,
) -> Result<usize> {
    let mut n = 0;
    for key in gone {
        held.remove(&key).ok_or_else(|| misfit(format!("block {key:?} leaves, but was never there")))?;
        n += 1;
    }
    for (key, bytes) in come {
        if held.insert(key, bytes.clone()).is_some_and(|old| old == bytes) {
            return Err(misfit(format!("block {key:?} comes again as it was")));
        }
        n += 1;
    }
    Ok(n)
}

impl Set {
    /// Takes a message. When the difference is whole, it is applied: then says what it did.
    ///
    /// # Errors
    /// If it does not fit to what is held, or the hash differs: then the set is empty, and the view has to be opened anew.
    pub fn take(&mut self, message: ViewReply) -> Result<Option<Applied>> {
        let more = message.more;
        if let Some(first) = self.pending.first()
            && (first.from, first.to, first.answers) != (message.from, message.to, message.answers)
        {
            *self = Set::default();
            return Err(misfit("another one begins before it ended"));
        }
        self.pending.push(message);
        if more {
            return Ok(None);
        }
        let messages = std::mem::take(&mut self.pending);
        let applied = self.apply(messages);
        if applied.is_err() {
            *self = Set::default();
        }
        applied.map(Some)
    }

    /// Forgets messages of a difference that broke off.
    fn break_off(&mut self) {
        self.pending.clear();
    }

    fn apply(&mut self, messages: Vec<ViewReply>) -> Result<Applied> {
        let (Some(first), Some(last)) = (messages.first(), messages.last()) else {
            return Err(misfit("it has no messages"));
        };
        let mut done = Applied {
            from: first.from,
            to: first.to,
            answers: first.answers,
            version: last.version,
            messages: messages.len(),
            bytes: messages.iter().map(prost::Message::encoded_len).sum(),
            ..Applied::default()
        };
        if done.from == 0 {
            *self = Set::default();
        } else if done.from != self.number {
            return Err(misfit(format!("it begins at number {}, {} is held", done.from, self.number)));
        }
        if done.to <= done.from {
            return Err(misfit(format!("it leads from {} to {}", done.from, done.to)));
        }
        let (hash, patches) = (last.hash.clone(), last.patches);
        // Whatever leaves does so in the messages before the first that brings something: the lists are in this order.
        let mut gone_ids = Vec::new();
        for m in &messages {
            for handle in &m.removed {
                let p = self
                    .patches
                    .remove(handle)
                    .ok_or_else(|| misfit(format!("handle {handle} leaves, but was never there")))?;
                gone_ids.push(id_of(&p)?);
                done.removed.push(*handle);
            }
            for s in &m.surveys_removed {
                self.surveys
                    .remove(s)
                    .ok_or_else(|| misfit(format!("survey {s} leaves, but was never there")))?;
            }
        }
        ascending("removed", &gone_ids)?;
        gone_ids.iter().for_each(|id| {
            self.ids.remove(id);
        });
        let (mut came, mut changed) = (Vec::new(), Vec::new());
        for m in messages {
            done.blocks += blocks(
                &mut self.masks,
                m.masks_removed.iter().map(mask_key),
                m.masks.iter().map(|b| (mask_key(b), b.cells.clone())),
            )?;
            done.blocks += blocks(
                &mut self.corrections,
                m.corrections_removed.iter().map(correction_key),
                m.corrections.iter().map(|b| (correction_key(b), b.nodes.clone())),
            )?;
            if let Some(g) = m.ground {
                self.ground = Some(g);
            }
            for s in m.surveys {
                self.surveys.insert(s.survey, s);
            }
            for p in m.added {
                let (id, handle) = (id_of(&p)?, p.handle);
                if gone_ids.binary_search(&id).is_ok() {
                    return Err(misfit(format!("handle {handle} is a patch that it removes, too")));
                }
                if handle == 0 || self.patches.insert(handle, p).is_some() {
                    return Err(misfit(format!("handle {handle} comes, but is no new one")));
                }
                if self.ids.insert(id, handle).is_some() {
                    return Err(misfit(format!("handle {handle} is a patch that is there already")));
                }
                came.push(id);
                done.added.push(handle);
            }
            for c in m.changed {
                let p = self
                    .patches
                    .get_mut(&c.handle)
                    .ok_or_else(|| misfit(format!("handle {} changes, but is not there", c.handle)))?;
                (p.top_m, p.floor) = (c.top_m, c.floor);
                p.survey = c.survey.unwrap_or(p.survey);
                changed.push(id_of(p)?);
                done.changed.push(c.handle);
            }
        }
        ascending("added", &came)?;
        ascending("changed", &changed)?;
        if changed.iter().any(|id| came.binary_search(id).is_ok()) {
            return Err(misfit("it adds and changes the same patch"));
        }
        if let Some(p) = done.added.iter().find(|h| !self.surveys.contains_key(&self.patches[h].survey)) {
            return Err(misfit(format!("the survey of handle {p} was never told")));
        }
        if self.patches.len() as u64 != patches {
            return Err(misfit(format!("{} patches are held, {patches} should be", self.patches.len())));
        }
        let held = self.hashed();
        if held != hash {
            return Err(misfit(format!("the ids hash to {}, {} should be", hex(&held), hex(&hash))));
        }
        (self.number, self.version, self.hash) = (done.to, done.version, hash);
        Ok(done)
    }

    /// First 16 bytes of BLAKE3 over the ids, ascending.
    pub fn hashed(&self) -> Bytes {
        let ids: Vec<u8> = self.ids.keys().flatten().copied().collect();
        Bytes::copy_from_slice(&blake3::hash(&ids).as_bytes()[..16])
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

fn id_of(p: &v1::Patch) -> Result<[u8; 16]> {
    p.id.as_ref().try_into().map_err(|_| misfit(format!("an id has {} bytes, not 16", p.id.len())))
}

fn ascending(what: &str, ids: &[[u8; 16]]) -> Result<()> {
    match ids.is_sorted_by(|a, b| a < b) {
        true => Ok(()),
        false => Err(misfit(format!("`{what}` is not ascending by id"))),
    }
}

/// What a view is opened with.
#[derive(Clone, Debug, Default)]
pub struct Opening {
    pub region: Option<v1::Region>,
    pub tolerance: Option<v1::Tolerance>,
    pub blend: v1::Blend,
    pub seams: v1::Seams,
    pub descriptors_only: bool,
    /// Differences that may be under way; 0: as many as the transport takes in.
    pub ahead: u32,
    /// As browsers do: a server stream, steered by calls of their own.
    pub follow: bool,
}

/// How a view is steered.
enum Way {
    Hold(mpsc::Sender<ViewRequest>),
    Follow,
}

/// A view that a server keeps in step.
pub struct View {
    connection: Connection,
    client: ViewClient<Wire>,
    way: Way,
    incoming: Streaming<ViewReply>,
    opening: Opening,
    /// Number of the newest question.
    asked: u64,
    /// Names the view, from the first message on.
    pub session: Bytes,
    /// How long the server keeps it after the stream ended.
    pub kept: Duration,
    pub set: Set,
}

impl View {
    /// Opens a view. Its first question has number 1.
    pub async fn open(connection: &Connection, opening: Opening) -> Result<View> {
        View::start(connection, opening, 1, Bytes::new(), Set::default(), true).await
    }

    /// Comes back to a view over a new connection: goes on from what is held, if the server still knows it. `moved`: where
    /// to look now; else the last question goes on.
    pub async fn resume(
        mut self,
        connection: &Connection,
        moved: Option<(Option<v1::Region>, v1::Tolerance)>,
    ) -> Result<View> {
        let again = moved.is_some();
        if let Some((region, tolerance)) = moved {
            (self.opening.region, self.opening.tolerance) = (region, Some(tolerance));
            self.asked += 1;
        }
        self.set.break_off();
        View::start(connection, self.opening, self.asked, self.session, self.set, again).await
    }

    async fn start(
        connection: &Connection,
        opening: Opening,
        asked: u64,
        session: Bytes,
        set: Set,
        ask: bool,
    ) -> Result<View> {
        let mut client = connection.view().max_decoding_message_size(4 * MESSAGE_BYTES_MAX);
        let question = v1::Question {
            number: asked,
            region: opening.region.clone(),
            tolerance: opening.tolerance.clone(),
        };
        let open = v1::OpenView {
            question: ask.then_some(question),
            blend: opening.blend as i32,
            seams: opening.seams as i32,
            descriptors_only: opening.descriptors_only,
            ahead: opening.ahead,
            resume: (!session.is_empty()).then(|| v1::Resume {
                session: session.clone(),
                applied: set.number,
                hash: set.hash.clone(),
            }),
        };
        let failed = |s| connection.failed(s);
        let (way, incoming) = if opening.follow {
            (Way::Follow, client.follow(open).await.map_err(failed)?.into_inner())
        } else {
            let (tx, rx) = mpsc::channel(QUESTIONS_READY);
            let first = ViewRequest { kind: Some(Kind::Open(open)), applied: 0 };
            let _ = tx.send(first).await;
            let replies = client.hold(ReceiverStream::new(rx)).await.map_err(failed)?;
            (Way::Hold(tx), replies.into_inner())
        };
        let kept = Duration::ZERO;
        Ok(View { connection: connection.clone(), client, way, incoming, opening, asked, session, kept, set })
    }

    /// Number of the newest question.
    pub fn asked(&self) -> u64 {
        self.asked
    }

    /// Moves the view. Returns the number of the question.
    ///
    /// # Errors
    /// If the stream has ended (then [`View::next`] says why), or the server refuses the question.
    pub async fn steer(&mut self, region: Option<v1::Region>, tolerance: v1::Tolerance) -> Result<u64> {
        self.asked += 1;
        (self.opening.region, self.opening.tolerance) = (region.clone(), Some(tolerance.clone()));
        let q = v1::Question { number: self.asked, region, tolerance: Some(tolerance) };
        let applied = self.set.number;
        match &self.way {
            Way::Hold(tx) => {
                let request = ViewRequest { kind: Some(Kind::Steer(q)), applied };
                tx.send(request).await.map_err(|_| self.over())?;
            }
            Way::Follow => {
                let request = v1::SteerRequest { session: self.session.clone(), question: Some(q), applied };
                self.client.steer(request).await.map_err(|s| self.connection.failed(s))?;
            }
        }
        Ok(self.asked)
    }

    fn over(&self) -> Error {
        failed(&self.connection.server, tonic::Status::unavailable("the stream of the view has ended"))
    }

    /// Waits for the next difference, and applies it. Where `ahead` was asked for, tells the server. May be dropped while it
    /// waits: nothing is lost.
    ///
    /// # Errors
    /// If the stream ended (the view can be resumed), or the difference does not fit (open it anew).
    pub async fn next(&mut self) -> Result<Applied> {
        loop {
            let message = self.incoming.message().await.map_err(|s| self.connection.failed(s))?;
            let message = message.ok_or_else(|| self.over())?;
            if !message.session.is_empty() {
                self.session = message.session.clone();
                self.kept = Duration::from_secs(message.kept_s);
            }
            let Some(applied) = self.set.take(message)? else { continue };
            if self.opening.ahead > 0 {
                self.tell(applied.to).await?;
            }
            return Ok(applied);
        }
    }

    /// Says what was applied.
    async fn tell(&mut self, applied: u64) -> Result<()> {
        match &self.way {
            // If the stream has ended, the next message says so.
            Way::Hold(tx) => {
                let _ = tx.send(ViewRequest { kind: None, applied }).await;
            }
            Way::Follow => {
                let request = v1::SteerRequest { session: self.session.clone(), question: None, applied };
                self.client.steer(request).await.map_err(|s| self.connection.failed(s))?;
            }
        }
        Ok(())
    }
}
