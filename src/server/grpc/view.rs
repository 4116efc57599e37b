//! The View service.

use crate::base::{Error, Result};
use crate::height::surface::Seams;
use crate::server::status::status;
use crate::server::view::{
    Aborted, Attached, Incoming, Manner, Presented, Question, Reins, Reply, Wanted, feed,
};
use crate::server::{Answer, State, model};
use crate::wire::v1;
use crate::wire::v1::view_request::Kind;
use crate::wire::v1::view_server::View;
use prost::Message;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status, Streaming};

/// Messages that are ready before the transport takes them.
const READY: usize = 1;
/// Questions above this size (polygons, rasters) are read in a pool.
const SMALL_BYTES: usize = 16 << 10;
/// How long a stream may take until it says what it wants.
const OPEN_WITHIN: Duration = Duration::from_secs(30);

/// The View service.
pub struct ViewService {
    state: Arc<State>,
}

impl ViewService {
    pub fn new(state: Arc<State>) -> ViewService {
        ViewService { state }
    }
}

/// A question, checked. In which manner the surface is made is the session's.
async fn question(state: &State, q: v1::Question, manner: Manner) -> Answer<Question> {
    let large = q.encoded_len() > SMALL_BYTES;
    let read = move || {
        let query = model::query(q.region.as_ref(), q.tolerance.as_ref(), manner.how)?;
        Ok(Question { number: q.number, query })
    };
    if large { state.pools.answer(read).await } else { read().map_err(status) }
}

/// In which manner a view is opened.
fn manner(open: &v1::OpenView) -> Result<Manner> {
    let how = model::how(open.blend, open.seams, Seams::Off)?;
    Ok(Manner { how, descriptors_only: open.descriptors_only })
}

/// Opens a view, or comes back to one.
async fn open(state: &Arc<State>, open: v1::OpenView) -> Answer<(Attached, Option<Presented>)> {
    let known = open.resume.as_ref().and_then(|r| state.views.find(&r.session));
    let manner = match &known {
        Some(session) => session.manner,
        None => manner(&open).map_err(status)?,
    };
    let asked = match open.question {
        Some(q) => Some(Arc::new(question(state, q, manner).await?)),
        None => None,
    };
    let comes_back = open.resume.is_some();
    let applied = open.resume.as_ref().map_or(0, |r| r.applied);
    // Looked up again: a session may have been swept while the question was read.
    if let Some(r) = open.resume
        && let Some(attached) = state.views.resume(&r.session)
    {
        attached.session.wanted.send_modify(|w| {
            if let Some(q) = asked {
                w.question = q;
            }
            (w.applied, w.ahead) = (applied, open.ahead);
        });
        return Ok((attached, Some(Presented { applied, hash: r.hash })));
    }
    let Some(question) = asked else {
        return Err(status(if comes_back {
            Error::missing(
                "session",
                "it was kept for a while after its stream ended; open the view anew, with a question",
            )
        } else {
            Error::invalid("question", "is missing; say where to look and how exact")
        }));
    };
    let wanted = Wanted { question, applied: 0, ahead: open.ahead };
    Ok((state.views.open(manner, wanted).map_err(status)?, None))
}

/// The client's side of a stream: reads questions until one cannot be answered or the client goes.
async fn read(state: &State, reins: &Reins, incoming: &mut Streaming<v1::ViewRequest>) -> Answer<()> {
    while let Some(request) = incoming.message().await? {
        reins.applied(request.applied);
        match request.kind {
            Some(Kind::Steer(q)) => {
                let q = question(state, q, reins.manner()).await?;
                reins.steer(q).map_err(status)?;
            }
            Some(Kind::Open(_)) => {
                let reason = "this stream is open already; steer it, or begin another stream";
                return Err(status(Error::invalid("open", reason)));
            }
            // Only says what was applied.
            None => {}
        }
    }
    Ok(())
}

#[tonic::async_trait]
impl View for ViewService {
    type HoldStream = ReceiverStream<Reply>;
    type FollowStream = ReceiverStream<Reply>;

    async fn hold(
        &self,
        request: Request<Streaming<v1::ViewRequest>>,
    ) -> Answer<Response<ReceiverStream<Reply>>> {
        let mut incoming = request.into_inner();
        let first = tokio::time::timeout(OPEN_WITHIN, incoming.message()).await.map_err(|_| {
            let s = OPEN_WITHIN.as_secs();
            Status::deadline_exceeded(format!("no view was opened within {s} s; send `open` first"))
        })??;
        let Some(v1::ViewRequest { kind: Some(Kind::Open(first)), .. }) = first else {
            return Err(status(Error::invalid(
                "open",
                "is not the first request of the stream; send it first",
            )));
        };
        let (attached, presented) = open(&self.state, first).await?;
        let (state, reins) = (self.state.clone(), attached.reins());
        let (tx, rx) = mpsc::channel(READY);
        let (bad, failed) = mpsc::channel(1);
        let reader = tokio::spawn(async move {
            if let Err(s) = read(&state, &reins, &mut incoming).await {
                let _ = bad.send(s).await;
            }
        });
        let incoming = Incoming { reader: Aborted(reader), failed };
        tokio::spawn(feed(self.state.clone(), attached, presented, tx, Some(incoming)));
        Ok(Response::new(ReceiverStream::new(rx)))
    }

    async fn follow(&self, request: Request<v1::OpenView>) -> Answer<Response<ReceiverStream<Reply>>> {
        let (attached, presented) = open(&self.state, request.into_inner()).await?;
        let (tx, rx) = mpsc::channel(READY);
        tokio::spawn(feed(self.state.clone(), attached, presented, tx, None));
        Ok(Response::new(ReceiverStream::new(rx)))
    }

    async fn steer(&self, request: Request<v1::SteerRequest>) -> Answer<Response<v1::SteerReply>> {
        let r = request.into_inner();
        let session = self.state.views.find(&r.session).ok_or_else(|| {
            let remedy = "open a view; sessions are kept for a while after their stream ended";
            status(Error::missing("session", remedy))
        })?;
        session.applied(r.applied);
        let number = match r.question {
            Some(q) => {
                let q = question(&self.state, q, session.manner).await?;
                let number = q.number;
                session.steer(q).err().unwrap_or(number)
            }
            None => session.wanted.borrow().question.number,
        };
        Ok(Response::new(v1::SteerReply { number }))
    }
}
