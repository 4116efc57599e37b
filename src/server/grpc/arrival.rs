//! What uploads and files have in common: telling how far they are, and committing whether anybody listens or not.

use crate::base::Result;
use crate::db::Outcome;
use crate::server::operations::{self, DRY_RUN};
use crate::server::pools::Answer;
use crate::server::state::State;
use crate::server::status::status;
use crate::server::uploads::{Claim, Ending};
use crate::wire::v1;
use crate::wire::v1::operation_status::State as Standing;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio::time::timeout;
use tonic::Status;

/// How often a client is told how far its commit is.
const TELL_EVERY: Duration = Duration::from_millis(200);

/// Takes replies to a client.
pub struct Told {
    send: mpsc::Sender<Answer<v1::UploadReply>>,
    patience: Duration,
}

impl Told {
    /// `patience`: how long a client may not read.
    pub fn new(send: mpsc::Sender<Answer<v1::UploadReply>>, patience: Duration) -> Told {
        Told { send, patience }
    }

    /// Sends a reply.
    ///
    /// # Errors
    /// If the client is gone, or does not read.
    pub async fn tell(&self, reply: v1::UploadReply) -> Answer<()> {
        let sent = timeout(self.patience, self.send.send(Ok(reply))).await;
        let unread =
            |_| Status::deadline_exceeded(format!("no reply was read for {} s", self.patience.as_secs()));
        sent.map_err(unread)?.map_err(|_| gone())
    }

    /// Waits until nobody can be told any more: the caller is gone, or the call was ended (a revoked token, a deadline).
    pub async fn closed(&self) -> Status {
        self.send.closed().await;
        gone()
    }
}

fn gone() -> Status {
    Status::cancelled("the caller is gone")
}

pub fn reply(operation: &str, state: Standing) -> v1::UploadReply {
    v1::UploadReply { operation: operation.to_string(), state: state as i32, ..Default::default() }
}

/// The last reply.
pub async fn done(told: &Told, operation: &str, commit: v1::CommitReply) -> Answer<()> {
    told.tell(v1::UploadReply { commit: Some(commit), share: 1.0, ..reply(operation, Standing::Done) }).await
}

/// Reads or writes files on a thread that may wait for a disk.
pub async fn blocking<T: Send + 'static>(f: impl FnOnce() -> Result<T> + Send + 'static) -> Answer<T> {
    let fault = "the server met a fault of its own; it goes on, and its log says where";
    tokio::task::spawn_blocking(f).await.map_err(|_| Status::internal(fault))?.map_err(status)
}

/// What became of an operation before: its commit, or the version in which its samples were found.
pub async fn known(state: &Arc<State>, operation: &str) -> Answer<Option<v1::CommitReply>> {
    let (db, id) = (state.live.db().clone(), operation.to_string());
    let committed = blocking(move || db.operation(&id)).await?;
    // What found everything there was not committed: no catalog knows it.
    let unchanged = state.operations.standing(operation);
    let unchanged = unchanged.filter(|s| s.state == Standing::Done as i32 && s.stage != DRY_RUN);
    let Some(version) = committed.or(unchanged.map(|s| s.version)) else { return Ok(None) };
    let warnings = vec![format!(
        "operation '{operation}' was carried out before, as version {version}; nothing was changed"
    )];
    Ok(Some(operations::reply(&Outcome { version, warnings, ..Outcome::default() }, operation)))
}

/// Carries `work` out, whether the caller waits for it or not. The claim is given back before the ending is told.
pub fn settle<F>(claim: Claim, work: impl FnOnce(Arc<Claim>) -> F) -> Ending
where
    F: Future<Output = Answer<v1::CommitReply>> + Send + 'static,
{
    let (end, ending) = watch::channel(None);
    claim.committing(ending.clone());
    let claim = Arc::new(claim);
    let work = work(claim.clone());
    tokio::spawn(async move {
        let ended = work.await;
        drop(claim);
        let _ = end.send(Some(ended));
    });
    ending
}

/// Tells how far a commit is until it has ended.
pub async fn follow(state: &State, operation: &str, mut ending: Ending, told: &Told) -> Answer<()> {
    let mut last = None;
    loop {
        let ended = ending.borrow_and_update().clone();
        match ended {
            Some(Ok(commit)) => return done(told, operation, commit).await,
            Some(Err(e)) => return Err(e),
            None => {}
        }
        match timeout(TELL_EVERY, ending.changed()).await {
            Ok(Ok(())) => continue,
            Ok(Err(_)) => {
                return Err(Status::unavailable("the server is stopping; call again with the same header"));
            }
            Err(_) => {}
        }
        let Some(s) = state.operations.standing(operation) else { continue };
        if matches!(s.state(), Standing::Queued | Standing::Running) && last.as_ref() != Some(&s) {
            told.tell(v1::UploadReply {
                stage: s.stage.clone(),
                share: s.share,
                ..reply(operation, s.state())
            })
            .await?;
            last = Some(s);
        }
    }
}
