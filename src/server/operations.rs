//! Commits that the server was asked for: carried out one after the other, and where each stands.

use super::State;
use super::metrics;
use super::pools::Answer;
use crate::base::Result;
use crate::db::{Change, Outcome, Progress};
use crate::wire::v1::operation_status::State as Standing;
use crate::wire::v1::{CommitReply, OperationStatus};
use std::collections::{HashMap, VecDeque};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Semaphore;
use tonic::Status;

/// Operations whose standing is remembered. Those that were committed are known to the catalog for ever.
const REMEMBERED: usize = 4096;
/// Commits that may wait for their turn.
const QUEUED_MAX: usize = 256;
/// Stage of an operation that was computed and not committed.
pub const DRY_RUN: &str = "dry run: nothing was committed";

#[derive(Default)]
struct Book {
    standing: HashMap<String, OperationStatus>,
    order: VecDeque<String>,
}

/// Where the commits that were asked for stand.
pub struct Operations {
    book: Mutex<Book>,
    queue: Arc<Semaphore>,
}

impl Default for Operations {
    fn default() -> Operations {
        Operations { book: Mutex::default(), queue: Arc::new(Semaphore::new(QUEUED_MAX)) }
    }
}

impl Operations {
    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Where an operation stands, if it was asked for since the server started.
    pub fn standing(&self, id: &str) -> Option<OperationStatus> {
        self.book().standing.get(id).cloned()
    }

    /// Notes where an operation stands.
    pub fn note(&self, status: OperationStatus) {
        let mut book = self.book();
        let id = status.operation.clone();
        if book.standing.insert(id.clone(), status).is_none() {
            book.order.push_back(id);
            if book.order.len() > REMEMBERED
                && let Some(old) = book.order.pop_front()
            {
                book.standing.remove(&old);
            }
        }
    }
}

/// An id for a call whose caller gave none.
pub fn made_id(what: &str) -> Answer<String> {
    let mut random = [0u8; 12];
    getrandom::fill(&mut random).map_err(|e| Status::internal(format!("random numbers: {e}")))?;
    Ok(format!("{what}-{}", random.iter().map(|b| format!("{b:02x}")).collect::<String>()))
}

/// Carries out a change as one commit, after those that were asked for before, and makes its version the newest. The change
/// is made by `change` when its turn comes, in the pool of arrivals. What was asked for is carried out, whether the caller
/// waits for it or not.
pub async fn commit(
    state: &Arc<State>,
    id: String,
    dry_run: bool,
    change: impl FnOnce() -> Result<Change> + Send + 'static,
) -> Answer<Outcome> {
    let Ok(place) = state.operations.queue.clone().try_acquire_owned() else {
        return Err(Status::resource_exhausted(format!(
            "{QUEUED_MAX} commits wait already, no more are taken; try again when they are done"
        )));
    };
    let at = |id: &str, s: Standing| OperationStatus {
        operation: id.to_string(),
        state: s as i32,
        ..Default::default()
    };
    state.operations.note(at(&id, Standing::Queued));
    let state = state.clone();
    let task = tokio::spawn(async move {
        let _place = place;
        let (shared, operation) = (state.clone(), id.clone());
        let done = state.pools.arrival(move || carry_out(&shared, &operation, dry_run, change)).await;
        metrics::commit(done.is_ok());
        state.operations.note(match &done {
            Ok(o) => {
                let stage = if dry_run { DRY_RUN } else { "" };
                OperationStatus {
                    version: o.version,
                    share: 1.0,
                    stage: stage.into(),
                    ..at(&id, Standing::Done)
                }
            }
            Err(e) => OperationStatus { error: e.message().to_string(), ..at(&id, Standing::Failed) },
        });
        done
    });
    task.await.unwrap_or_else(|_| Err(Status::unavailable("the server is stopping; try again")))
}

fn carry_out(
    state: &State,
    id: &str,
    dry_run: bool,
    change: impl FnOnce() -> Result<Change>,
) -> Result<Outcome> {
    let report = |stage: &str, share: f64| {
        state.operations.note(OperationStatus {
            operation: id.to_string(),
            state: Standing::Running as i32,
            stage: stage.to_string(),
            share,
            ..Default::default()
        });
    };
    report("waiting for the writer lock", 0.0);
    let stop = AtomicBool::new(false);
    let progress = Progress { report: &report, stop: &stop };
    let outcome = state.live.db().change(change()?, Some(id), dry_run, &progress, &mut || {})?;
    // What is committed is committed: if this fails, the next look finds it.
    if let Err(e) = state.live.look() {
        tracing::warn!("operation '{id}' is committed, its version was not opened yet: {e}");
    }
    Ok(outcome)
}

/// What a commit did, as the wire says it.
pub fn reply(outcome: &Outcome, operation: &str) -> CommitReply {
    CommitReply {
        version: outcome.version,
        changed: outcome.changed,
        survey: outcome.survey.clone(),
        patches: outcome.patches,
        live: outcome.live,
        dormant: outcome.dormant,
        posts: outcome.posts,
        voids: outcome.voids,
        seconds: outcome.seconds,
        warnings: outcome.warnings.clone(),
        json: serde_json::to_string(outcome).unwrap_or_default(),
        operation: operation.to_string(),
    }
}
