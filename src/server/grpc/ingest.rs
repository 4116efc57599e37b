//! Surveys arrive: streams of samples, and files that the server can see.

use super::arrival::{Told, blocking, done, follow, known, reply, settle};
use super::files::files;
use crate::base::{Error, Result};
use crate::db::Outcome;
use crate::height::frame::CellRect;
use crate::server::model::upload::{self, Said};
use crate::server::operations;
use crate::server::pools::Answer;
use crate::server::state::State;
use crate::server::status::status;
use crate::server::uploads::staging::{self, Described, Staging};
use crate::server::uploads::{Claimed, Listed};
use crate::wire::v1::ingest_server::{Ingest, IngestServer};
use crate::wire::v1::operation_status::State as Standing;
use crate::wire::v1::upload_request::Kind;
use crate::wire::{MESSAGE_BYTES_MAX, v1};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::mpsc;
use tokio::time::timeout;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Request, Response, Status, Streaming};

/// Replies that wait for a client; one that does not read is waited for.
const AHEAD: usize = 4;
/// Samples are made durable when there are so many bytes of them, or after so long.
const SYNC_BYTES: u64 = 8 << 20;
const SYNC_AFTER: Duration = Duration::from_millis(250);
/// How often an upload that is coming in says that it is alive.
const TOUCH_EVERY: Duration = Duration::from_secs(10);
/// Spans of rows in one reply.
const SPANS_MAX: usize = 100_000;

/// Takes surveys.
pub struct Service {
    state: Arc<State>,
}

/// The service `Ingest`.
pub fn service(state: &Arc<State>) -> IngestServer<Service> {
    IngestServer::new(Service { state: state.clone() })
        .max_decoding_message_size(MESSAGE_BYTES_MAX)
        .max_encoding_message_size(MESSAGE_BYTES_MAX)
}

type Replies = ReceiverStream<Answer<v1::UploadReply>>;

#[tonic::async_trait]
impl Ingest for Service {
    type UploadStream = Replies;
    type FilesStream = Replies;

    async fn upload(
        &self,
        request: Request<Streaming<v1::UploadRequest>>,
    ) -> Answer<Response<Self::UploadStream>> {
        let state = self.state.clone();
        let mut requests = request.into_inner();
        Ok(stream(&self.state, |told| async move { receive(&state, &mut requests, &told).await }))
    }

    async fn files(&self, request: Request<v1::FilesRequest>) -> Answer<Response<Self::FilesStream>> {
        let state = self.state.clone();
        let request = request.into_inner();
        Ok(stream(&self.state, |told| async move { files(&state, request, &told).await }))
    }

    async fn list_uploads(
        &self,
        _: Request<v1::ListUploadsRequest>,
    ) -> Answer<Response<v1::ListUploadsReply>> {
        let (uploads, version) = (self.state.uploads.clone(), self.state.live.newest().number());
        let found = blocking(move || uploads.list()).await?;
        let info = |u: Listed| v1::UploadInfo {
            operation: u.operation,
            name: u.name,
            grids: u.grids,
            rows_received: u.rows_received,
            rows: u.rows,
            touched_at_s: u.touched_at,
            active: u.active,
        };
        let uploads = found.into_iter().map(info).collect();
        Ok(Response::new(v1::ListUploadsReply { version, uploads }))
    }

    async fn abandon(&self, request: Request<v1::AbandonRequest>) -> Answer<Response<v1::AbandonReply>> {
        let uploads = self.state.uploads.clone();
        let operation = upload::operation(&request.into_inner().operation).map_err(status)?;
        let abandoned = blocking(move || uploads.abandon(&operation)).await?;
        Ok(Response::new(v1::AbandonReply { abandoned }))
    }
}

/// Runs `work` beside the call, with a channel for its replies; what it ends with ends the stream.
fn stream<F>(state: &State, work: impl FnOnce(Told) -> F) -> Response<Replies>
where
    F: Future<Output = Answer<()>> + Send + 'static,
{
    let (send, replies) = mpsc::channel(AHEAD);
    let work = work(Told::new(send.clone(), state.settings.upload_idle));
    tokio::spawn(async move {
        if let Err(status) = work.await {
            let _ = send.send(Err(status)).await;
        }
    });
    Response::new(ReceiverStream::new(replies))
}

/// The next message of an upload; `None`: the stream ended.
async fn next(
    state: &State,
    requests: &mut Streaming<v1::UploadRequest>,
    told: &Told,
    within: Duration,
) -> Answer<Option<Kind>> {
    let message = tokio::select! {
        biased;
        () = state.uploads.stopping() => {
            return Err(Status::unavailable(
                "the server is stopping; what arrived is kept: call again with the same header",
            ));
        }
        // What comes behind the end of a call has no right to be heard.
        status = told.closed() => return Err(status),
        message = timeout(within, requests.message()) => message,
    };
    match message {
        Err(_) => Err(idle(state)),
        Ok(Err(e)) => Err(e),
        Ok(Ok(None)) => Ok(None),
        Ok(Ok(Some(v1::UploadRequest { kind: Some(kind) }))) => Ok(Some(kind)),
        Ok(Ok(Some(v1::UploadRequest { kind: None }))) => {
            Err(Status::invalid_argument("a message is neither header, block nor finish; see ingest.proto"))
        }
    }
}

fn idle(state: &State) -> Status {
    Status::deadline_exceeded(format!(
        "nothing new was sent for {} s; what arrived is kept: call again with the same header",
        state.settings.upload_idle.as_secs_f64()
    ))
}

/// Checks a header, and what it says against the newest version. The outcome is there if that holds all samples already, by
/// their hashes.
async fn check(state: &Arc<State>, header: v1::UploadHeader) -> Answer<(Arc<Said>, Option<Outcome>)> {
    let (live, uploads) = (state.live.clone(), state.uploads.clone());
    let check = move || {
        live.look()?;
        let said = upload::said(&header, live.db().crs())?;
        let sources = said.grids.iter().map(|g| Box::new(Described(g.info.clone())) as _).collect();
        let delivered = |k: usize, at: &CellRect| uploads.delivered(&said.grids[k], at);
        let outcome = live.db().foresee(&live.newest(), &said.change(sources), &delivered)?;
        Ok((Arc::new(said), outcome))
    };
    state.pools.work(check).await
}

/// One upload, from its header to its commit.
async fn receive(state: &Arc<State>, requests: &mut Streaming<v1::UploadRequest>, told: &Told) -> Answer<()> {
    let header = match next(state, requests, told, state.settings.upload_idle).await? {
        Some(Kind::Header(header)) => header,
        Some(_) => return Err(Status::invalid_argument("the first message of an upload is its header")),
        None => return Err(Status::invalid_argument("the stream ended before a header came")),
    };
    let operation = upload::operation(&header.operation).map_err(status)?;
    if let Some(commit) = known(state, &operation).await? {
        return done(told, &operation, commit).await;
    }
    let (said, held) = check(state, header.clone()).await?;
    if let Some(outcome) = held {
        state.operations.note(v1::OperationStatus {
            version: outcome.version,
            share: 1.0,
            operation: operation.clone(),
            state: Standing::Done as i32,
            ..Default::default()
        });
        return done(told, &operation, operations::reply(&outcome, &operation)).await;
    }
    let (uploads, h, id) = (state.uploads.clone(), header.clone(), operation.clone());
    let claimed = blocking(move || {
        uploads.compare(&h)?;
        uploads.claim(&id)
    });
    let claim = match claimed.await? {
        Claimed::Mine(claim) => claim,
        Claimed::Committing(ending) => return follow(state, &operation, ending, told).await,
    };
    // Another stream may have ended between the two.
    if let Some(commit) = known(state, &operation).await? {
        return done(told, &operation, commit).await;
    }
    let (uploads, s) = (state.uploads.clone(), said.clone());
    let opened = blocking(move || uploads.open(&claim, &header, &s).map(|staging| (claim, staging)));
    let (claim, staging) = opened.await?;
    let first = v1::UploadReply {
        received: staging.rows().spans(true, SPANS_MAX),
        kept_s: state.settings.uploads_kept.as_secs(),
        ..reply(&operation, Standing::Uploading)
    };
    told.tell(first).await?;
    note(state, &operation, staging.rows().there() as f64 / said.rows as f64);

    let staging = Arc::new(Mutex::new(staging));
    let finish = match blocks(state, requests, told, &said, &staging).await {
        Ok(finish) => finish,
        Err(e) => {
            // What arrived is kept, also of a stream that broke.
            if let Err(also) = on_disk(&staging, Staging::sync).await {
                tracing::warn!("upload '{operation}': what arrived last is not kept: {}", also.message());
            }
            return Err(e);
        }
    };
    let hashes = hashes(&finish, said.grids.len()).map_err(status)?;
    let spans = on_disk(&staging, |s| {
        let spans = s.sync()?;
        s.complete().map(|()| spans)
    });
    let spans = spans.await?;
    if !spans.is_empty() {
        let last = v1::UploadReply { received: spans, share: 1.0, ..reply(&operation, Standing::Uploading) };
        told.tell(last).await?;
    }
    let ending = settle(claim, |claim| {
        let state = state.clone();
        async move {
            let (s, checked, told) = (said.clone(), staging.clone(), hashes.clone());
            let prepare = move || {
                let mut staging = checked.lock().unwrap_or_else(PoisonError::into_inner);
                staging.check_hashes(&told)?;
                Ok(s.change(staging.sources()?))
            };
            let change = state.pools.arrival(prepare).await?;
            let (id, dry_run) = (said.operation.clone(), said.dry_run);
            let outcome = operations::commit(&state, id.clone(), dry_run, move || Ok(change)).await?;
            if !dry_run {
                let (uploads, done) = (state.uploads.clone(), outcome.clone());
                // If this fails, the next sweep removes what is left.
                let cleared = blocking(move || {
                    let noted = uploads.deliver(&said, &hashes, &done);
                    uploads.remove(&claim).and(noted)
                });
                if let Err(e) = cleared.await {
                    tracing::warn!("upload '{id}' is committed, its samples were not removed: {e}");
                }
            }
            Ok(operations::reply(&outcome, &id))
        }
    });
    follow(state, &operation, ending, told).await
}

/// Notes that samples of an operation come in.
fn note(state: &State, operation: &str, share: f64) {
    state.operations.note(v1::OperationStatus {
        operation: operation.to_string(),
        state: Standing::Uploading as i32,
        stage: "receiving samples".into(),
        share,
        ..Default::default()
    });
}

fn hashes(finish: &v1::UploadFinish, grids: usize) -> Result<Vec<Option<[u8; 32]>>> {
    if !finish.hashes.is_empty() && finish.hashes.len() != grids {
        let reason = format!("{} for {grids} grids; give one for each, or none", finish.hashes.len());
        return Err(Error::invalid("finish.hashes", reason));
    }
    finish.hashes.iter().map(|h| upload::hash("finish.hashes", h)).collect()
}

type Shared = Arc<Mutex<Staging>>;

/// Reads or writes what was staged, on a thread that may wait for the disk.
async fn on_disk<T: Send + 'static>(
    staging: &Shared,
    f: impl FnOnce(&mut Staging) -> Result<T> + Send + 'static,
) -> Answer<T> {
    let staging = staging.clone();
    blocking(move || f(&mut staging.lock().unwrap_or_else(PoisonError::into_inner))).await
}

/// Takes blocks until `finish` comes, and tells what is durable. Holds one block at a time.
async fn blocks(
    state: &Arc<State>,
    requests: &mut Streaming<v1::UploadRequest>,
    told: &Told,
    said: &Arc<Said>,
    staging: &Shared,
) -> Answer<v1::UploadFinish> {
    let within = state.settings.upload_idle;
    let (mut heard, mut synced, mut touched) = (Instant::now(), Instant::now(), Instant::now());
    let (mut fresh_bytes, mut there) = (0, 0);
    loop {
        let left = within.saturating_sub(heard.elapsed());
        if left.is_zero() {
            return Err(idle(state));
        }
        // While the next block is waited for, what is there becomes durable.
        let until_sync = if fresh_bytes > 0 { SYNC_AFTER.saturating_sub(synced.elapsed()) } else { left };
        match next(state, requests, told, until_sync.min(left)).await {
            Err(e) if e.code() == Code::DeadlineExceeded => {}
            Err(e) => return Err(e),
            Ok(Some(Kind::Finish(finish))) => return Ok(finish),
            Ok(Some(Kind::Block(block))) => {
                let s = said.clone();
                let block = state.pools.work(move || staging::unpack(&block, &s.grids)).await?;
                let written = on_disk(staging, move |s| {
                    s.write(&block)?;
                    Ok((s.fresh_bytes(), s.rows().there()))
                });
                let now;
                (fresh_bytes, now) = written.await?;
                // Rows that are there already do not keep a stream alive.
                if now > there {
                    (heard, there) = (Instant::now(), now);
                }
            }
            Ok(Some(Kind::Header(_))) => {
                return Err(Status::invalid_argument("an upload has one header; a second one came"));
            }
            Ok(None) => {
                return Err(Status::failed_precondition(
                    "the stream ended without `finish`; what arrived is kept: call again with the same header",
                ));
            }
        }
        if fresh_bytes >= SYNC_BYTES || (fresh_bytes > 0 && synced.elapsed() >= SYNC_AFTER) {
            let received = on_disk(staging, Staging::sync).await?;
            (synced, fresh_bytes) = (Instant::now(), 0);
            let share = there as f64 / said.rows as f64;
            note(state, &said.operation, share);
            told.tell(v1::UploadReply { received, share, ..reply(&said.operation, Standing::Uploading) })
                .await?;
        }
        if touched.elapsed() >= TOUCH_EVERY {
            touched = Instant::now();
            let (uploads, id) = (state.uploads.clone(), said.operation.clone());
            blocking(move || uploads.touch(&id)).await?;
        }
    }
}
