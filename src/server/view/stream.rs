//! The stream of a view: the newest difference whenever there is room for one.

use super::parcel::Parcel;
use super::session::{Attached, Question};
use super::target::Target;
use crate::server::State;
use crate::server::status::status;
use crate::wire::v1;
use bytes::Bytes;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Permit};
use tokio::sync::watch;
use tokio::task::JoinHandle;
use tonic::Status;

/// How long a client may stop reading in the middle of a difference.
const STALLED: Duration = Duration::from_secs(120);

/// A message of the stream, or its end.
pub type Reply = std::result::Result<v1::ViewReply, Status>;

/// What a client presents that comes back.
#[derive(Clone, Debug, PartialEq)]
pub struct Presented {
    pub applied: u64,
    pub hash: Bytes,
}

/// A task that is not wanted longer than this lives.
pub struct Aborted(pub JoinHandle<()>);

impl Drop for Aborted {
    fn drop(&mut self) {
        self.0.abort();
    }
}

/// The client's side of a stream.
pub struct Incoming {
    /// What reads it.
    pub reader: Aborted,
    /// What it died of.
    pub failed: mpsc::Receiver<Status>,
}

/// What may end a stream while it waits.
struct Ends {
    attached: Attached,
    incoming: Option<Incoming>,
    stopping: watch::Receiver<bool>,
}

impl Ends {
    async fn end(&mut self) -> Status {
        let failed = async {
            match &mut self.incoming {
                Some(i) => i.failed.recv().await,
                None => None,
            }
        };
        tokio::select! {
            Some(status) = failed => status,
            () = self.attached.taken() => Status::aborted(
                "another stream has taken this view over; open a view of your own to go on",
            ),
            _ = self.stopping.wait_for(|s| *s) => Status::unavailable("the server is stopping; resume in a moment"),
        }
    }
}

/// How a stream ends: with a status, or because the client has gone.
enum End {
    With(Status),
    Gone,
}

impl From<Status> for End {
    fn from(s: Status) -> End {
        End::With(s)
    }
}

/// Sends differences until the client goes, another stream takes the view, or something fails.
pub async fn feed(
    state: Arc<State>,
    attached: Attached,
    presented: Option<Presented>,
    tx: mpsc::Sender<Reply>,
    incoming: Option<Incoming>,
) {
    let ends = Ends { attached, incoming, stopping: state.stop.subscribe() };
    // The session is free for the next stream before this one says its last word, which nobody may want to hear.
    if let End::With(status) = send(&state, ends, presented, &tx).await {
        let _ = tx.send(Err(status)).await;
    }
    drop(tx);
    let (kept, state) = (state.views.kept, Arc::downgrade(&state));
    tokio::time::sleep(kept).await;
    if let Some(state) = state.upgrade() {
        state.views.sweep();
    }
}

/// Room for a message.
async fn room<'a>(tx: &'a mpsc::Sender<Reply>, ends: &mut Ends) -> Result<Permit<'a, Reply>, End> {
    tokio::select! {
        biased;
        status = ends.end() => Err(status.into()),
        permit = tx.reserve() => permit.map_err(|_| End::Gone),
    }
}

async fn send(
    state: &Arc<State>,
    mut ends: Ends,
    presented: Option<Presented>,
    tx: &mpsc::Sender<Reply>,
) -> End {
    match steps(state, &mut ends, presented, tx).await {
        Ok(never) => match never {},
        Err(end) => end,
    }
}

async fn steps(
    state: &Arc<State>,
    ends: &mut Ends,
    presented: Option<Presented>,
    tx: &mpsc::Sender<Reply>,
) -> Result<std::convert::Infallible, End> {
    let session = ends.attached.session.clone();
    let mut ledger = tokio::select! {
        status = ends.end() => return Err(status.into()),
        ledger = session.ledger.clone().lock_owned() => ledger,
    };
    match presented {
        Some(p) if ledger.resume(p.applied, &p.hash) => {}
        _ => ledger.begin(),
    }
    let before = ledger.number();
    let mut wanted = session.wanted.subscribe();
    let mut arrivals = state.live.arrivals();
    let mut first = true;
    // What the last step answered, in which version.
    let mut done: Option<(Arc<Question>, u64)> = None;
    loop {
        let permit = room(tx, ends).await?;
        let (question, answers, snapshot) = loop {
            let now = wanted.borrow_and_update().clone();
            arrivals.borrow_and_update();
            let newest = state.live.newest().number();
            let asked = done.as_ref().is_none_or(|(q, _)| !Arc::ptr_eq(q, &now.question));
            let arrived = done.as_ref().is_none_or(|(_, v)| *v != newest);
            let under_way = ledger.number().saturating_sub(now.applied.max(before));
            if (asked || arrived) && (now.ahead == 0 || under_way < u64::from(now.ahead)) {
                ledger.applied(now.applied);
                break (now.question.clone(), asked.then_some(now.question.number), state.live.newest());
            }
            // No version is held meanwhile: it may be pruned.
            tokio::select! {
                status = ends.end() => return Err(status.into()),
                () = tx.closed() => return Err(End::Gone),
                _ = wanted.changed() => {}
                _ = arrivals.changed() => {}
            }
        };
        done = Some((question.clone(), snapshot.number()));
        let (manner, patches_max) = (session.manner, state.settings.patches_max);
        // The lock goes along: nothing else touches the ledger, and nobody waits for it in a pool.
        let step = state.pools.answer(move || {
            let target = Target::of(&snapshot, &question.query, manner, patches_max, ledger.last())?;
            let found = ledger.step(target, answers);
            let message = found.map(|d| {
                let mut parcel = Parcel::new(d, snapshot, !manner.descriptors_only);
                parcel.message().map(|m| (m, parcel))
            });
            Ok((ledger, message.transpose()?))
        });
        let (back, message) = step.await?;
        ledger = back;
        let grown = ledger.weight();
        if session.weighs(grown) < grown
            && let Err(e) = state.views.fits(&session)
        {
            ledger.begin();
            session.weighs(0);
            return Err(End::With(status(e)));
        }
        let Some((mut message, mut parcel)) = message else { continue };
        if std::mem::take(&mut first) {
            message.session = Bytes::copy_from_slice(&session.id);
            message.kept_s = state.views.kept.as_secs();
        }
        permit.send(Ok(message));
        while !parcel.done() {
            // A difference that goes on holds its version, so that it cannot be pruned: not for ever.
            let permit = tokio::time::timeout(STALLED, room(tx, ends)).await.map_err(|_| {
                let s = STALLED.as_secs();
                Status::deadline_exceeded(format!(
                    "no message was read for {s} s within a difference; resume"
                ))
            })??;
            let (message, back) = state.pools.answer(move || parcel.message().map(|m| (m, parcel))).await?;
            parcel = back;
            permit.send(Ok(message));
        }
    }
}
