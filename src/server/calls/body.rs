//! The bodies of a call: counted, watched, and ended when the call's time has come.

use super::record::Record;
use crate::server::listen::CallMark;
use axum::body::{Body, HttpBody};
use bytes::Bytes;
use http::HeaderMap;
use http_body::{Frame, SizeHint};
use std::future::Future;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
use std::task::{Context, Poll};
use tokio::sync::OwnedSemaphorePermit;
use tonic::Status;

/// Gives the status with which a call is ended from outside.
pub type Ending = Pin<Box<dyn Future<Output = Status> + Send>>;

/// The status of a call in which the server panicked.
pub fn fault() -> Status {
    Status::internal("the server met a fault of its own while answering; it goes on, and its log says where")
}

/// What a client sends, counted.
pub struct Counted {
    inner: Body,
    bytes: Arc<AtomicU64>,
    whole: Arc<AtomicBool>,
}

impl Counted {
    pub fn new(inner: Body, bytes: Arc<AtomicU64>) -> Counted {
        let whole = Arc::new(AtomicBool::new(inner.is_end_stream()));
        Counted { inner, bytes, whole }
    }

    /// Becomes true when everything has come.
    pub fn whole(&self) -> Arc<AtomicBool> {
        self.whole.clone()
    }
}

impl HttpBody for Counted {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let poll = Pin::new(&mut self.inner).poll_frame(cx);
        if let Poll::Ready(Some(Ok(frame))) = &poll
            && let Some(data) = frame.data_ref()
        {
            self.bytes.fetch_add(data.len() as u64, Relaxed);
        }
        if matches!(poll, Poll::Ready(None)) || self.inner.is_end_stream() {
            self.whole.store(true, Relaxed);
        }
        poll
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

/// What a client gets. Holds the call's place until its end.
pub struct CallBody {
    inner: Body,
    ending: Ending,
    over: bool,
    record: Record,
    mark: Option<CallMark>,
    _place: OwnedSemaphorePermit,
}

impl CallBody {
    pub fn new(
        inner: Body,
        ending: Ending,
        record: Record,
        mark: Option<CallMark>,
        place: OwnedSemaphorePermit,
    ) -> CallBody {
        CallBody { inner, ending, over: false, record, mark, _place: place }
    }

    /// The last frame: the call ends with this status, whatever was sent before.
    fn end(&mut self, status: &Status) -> Option<Result<Frame<Bytes>, axum::Error>> {
        self.over = true;
        self.inner = Body::empty();
        self.record.refused(status);
        let mut trailers = HeaderMap::new();
        match status.add_header(&mut trailers) {
            Ok(()) => Some(Ok(Frame::trailers(trailers))),
            Err(e) => Some(Err(axum::Error::new(e))),
        }
    }
}

impl HttpBody for CallBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        let this = &mut *self;
        if this.over {
            return Poll::Ready(None);
        }
        if let Some(mark) = &this.mark {
            mark.taken();
        }
        let poll = catch_unwind(AssertUnwindSafe(|| Pin::new(&mut this.inner).poll_frame(cx)));
        let frame = match poll {
            Ok(Poll::Ready(frame)) => frame,
            Ok(Poll::Pending) => {
                return match this.ending.as_mut().poll(cx) {
                    Poll::Ready(status) => Poll::Ready(this.end(&status)),
                    Poll::Pending => Poll::Pending,
                };
            }
            Err(_) => return Poll::Ready(this.end(&fault())),
        };
        match &frame {
            None => this.over = true,
            Some(Ok(frame)) => {
                if let Some(data) = frame.data_ref() {
                    // An answer that never pauses is ended between its parts, too.
                    if let Poll::Ready(status) = this.ending.as_mut().poll(cx) {
                        return Poll::Ready(this.end(&status));
                    }
                    this.record.sent(data.len() as u64);
                    if let Some(mark) = &this.mark {
                        mark.offered();
                    }
                } else if let Some(trailers) = frame.trailers_ref() {
                    this.record.ended(trailers);
                }
            }
            Some(Err(_)) => this.over = true,
        }
        Poll::Ready(frame)
    }

    fn is_end_stream(&self) -> bool {
        self.over || self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}
