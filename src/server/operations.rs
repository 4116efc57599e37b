//! Commits that the server was asked for: carried out one after the other, and where each stands.

use super::State;
use super::metrics;
use super::pools::Answer;
use crate::base::{Error, Result};
use crate::db::{Change, Outcome, Progress};
use crate::wire::v1::OperationStatus;
use crate::wire::v1::operation_status::State as Standing;
use std::collections::{HashMap, VecDeque};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tonic::Status;

/// Operations whose standing is remembered. Those that were committed are known to the catalog for ever.
const REMEMBERED: usize = 4096;

#[derive(Default)]
struct Book {
    standing: HashMap<String, OperationStatus>,
    order: VecDeque<String>,
}

/// Where the commits that were asked for stand.
#[derive(Default)]
pub struct Operations {
    book: Mutex<Book>,
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
/// is made by `change` when its turn comes, in the pool of arrivals.
pub async fn commit(
    state: &Arc<State>,
    id: String,
    dry_run: bool,
    change: impl FnOnce() -> Result<Change> + Send + 'static,
) -> Answer<Outcome> {
    let at = |s: Standing| OperationStatus { operation: id.clone(), state: s as i32, ..Default::default() };
    state.operations.note(at(Standing::Queued));
    let (shared, operation) = (state.clone(), id.clone());
    let done = state
        .pools
        .arrival(move || {
            let report = |stage: &str, share: f64| {
                shared.operations.note(OperationStatus {
                    operation: operation.clone(),
                    state: Standing::Running as i32,
                    stage: stage.to_string(),
                    share,
                    ..Default::default()
                });
            };
            report("waiting for the writer lock", 0.0);
            let stop = AtomicBool::new(false);
            let progress = Progress { report: &report, stop: &stop };
            let outcome =
                shared.live.db().change(change()?, Some(&operation), dry_run, &progress, &mut || {})?;
            shared.live.look()?;
            Ok::<_, Error>(outcome)
        })
        .await;
    metrics::commit(done.is_ok());
    state.operations.note(match &done {
        Ok(o) => OperationStatus { version: o.version, ..at(Standing::Done) },
        Err(e) => OperationStatus { error: e.message().to_string(), ..at(Standing::Failed) },
    });
    done
}
