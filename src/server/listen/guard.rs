//! Watches over one connection, and says when it is to be closed.
//!
//! - Greeting: within a time, a whole preface of HTTP/2 (24 bytes) or a call has come.
//! - Idle: nothing moved for a time, and no call is under way. HTTP/2's pings move bytes: a living client may stay.
//! - Stall: the peer takes nothing of what is ready for it for a time: bytes that the socket does not take, or, behind HTTP/2's
//!   flow control, parts of an answer that it gives no room for.

use std::collections::HashMap;
use std::io;
use std::pin::Pin;
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::Instant;

/// Length of the preface with which HTTP/2 begins.
const PREFACE_BYTES: u64 = 24;
/// "Not now" in the fields that hold a time.
const NEVER: u64 = u64::MAX;

/// What is known of one connection. Times are milliseconds since it was opened.
pub struct Guard {
    opened: Instant,
    greet_within: Duration,
    idle: Duration,
    stall: Duration,
    bytes_in: AtomicU64,
    moved: AtomicU64,
    write_waits: AtomicU64,
    calls: AtomicUsize,
    calls_ever: AtomicU64,
    /// Calls whose client has a part of the answer before it, and since when.
    untaken: Mutex<HashMap<u64, u64>>,
}

impl Guard {
    pub fn new(greet_within: Duration, idle: Duration, stall: Duration) -> Guard {
        Guard {
            opened: Instant::now(),
            greet_within,
            idle,
            stall,
            bytes_in: AtomicU64::new(0),
            moved: AtomicU64::new(0),
            write_waits: AtomicU64::new(NEVER),
            calls: AtomicUsize::new(0),
            calls_ever: AtomicU64::new(0),
            untaken: Mutex::default(),
        }
    }

    /// A call has begun; it lasts until the mark is dropped.
    pub fn call(self: &Arc<Self>) -> CallMark {
        self.calls.fetch_add(1, Relaxed);
        CallMark { number: self.calls_ever.fetch_add(1, Relaxed), guard: self.clone() }
    }

    fn now(&self) -> u64 {
        u64::try_from(self.opened.elapsed().as_millis()).unwrap_or(NEVER - 1)
    }

    fn untaken(&self) -> MutexGuard<'_, HashMap<u64, u64>> {
        self.untaken.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns when the connection is to be closed, with the reason.
    pub async fn expired(&self) -> String {
        loop {
            let left = match self.look() {
                Ok(left) => left,
                Err(why) => return why,
            };
            tokio::time::sleep(left.max(Duration::from_millis(1))).await;
        }
    }

    /// The time that can pass before anything can run out, or what has run out.
    fn look(&self) -> Result<Duration, String> {
        let now = Duration::from_millis(self.now());
        let since = |t: u64| now.saturating_sub(Duration::from_millis(t));
        let quiet = since(self.moved.load(Relaxed));
        let mut left = self.idle.min(self.stall);
        let greeted = self.bytes_in.load(Relaxed) >= PREFACE_BYTES || self.calls_ever.load(Relaxed) > 0;
        if !greeted {
            if now >= self.greet_within {
                return Err(format!("nothing that HTTP begins with came within {:?}", self.greet_within));
            }
            left = left.min(self.greet_within - now);
        }
        if self.calls.load(Relaxed) == 0 {
            if quiet >= self.idle {
                return Err(format!("idle for {:?}", self.idle));
            }
            left = left.min(self.idle - quiet);
        }
        let oldest = self.untaken().values().copied().min().unwrap_or(NEVER);
        let waits = oldest.min(self.write_waits.load(Relaxed));
        if waits != NEVER {
            if since(waits) >= self.stall {
                return Err(format!("its client took nothing for {:?}", self.stall));
            }
            left = left.min(self.stall - since(waits));
        }
        Ok(left)
    }
}

/// A call that is under way on a connection.
pub struct CallMark {
    guard: Arc<Guard>,
    number: u64,
}

impl CallMark {
    /// A part of the answer lies ready for the client.
    pub fn offered(&self) {
        let now = self.guard.now();
        self.guard.untaken().insert(self.number, now);
    }

    /// The client has room for more.
    pub fn taken(&self) {
        self.guard.untaken().remove(&self.number);
    }
}

impl Drop for CallMark {
    fn drop(&mut self) {
        self.taken();
        // The time of being idle begins now.
        self.guard.moved.fetch_max(self.guard.now(), Relaxed);
        self.guard.calls.fetch_sub(1, Relaxed);
    }
}

/// A stream whose guard sees what moves.
pub struct Watched<S> {
    inner: S,
    guard: Arc<Guard>,
}

impl<S> Watched<S> {
    pub fn new(inner: S, guard: Arc<Guard>) -> Watched<S> {
        Watched { inner, guard }
    }

    fn wrote<T>(&self, poll: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        let now = self.guard.now();
        if poll.is_pending() {
            let _ = self.guard.write_waits.compare_exchange(NEVER, now, Relaxed, Relaxed);
        } else {
            self.guard.write_waits.store(NEVER, Relaxed);
            self.guard.moved.store(now, Relaxed);
        }
        poll
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Watched<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buf: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let before = buf.filled().len();
        let poll = Pin::new(&mut self.inner).poll_read(cx, buf);
        let came = buf.filled().len() - before;
        if came > 0 {
            self.guard.bytes_in.fetch_add(came as u64, Relaxed);
            self.guard.moved.store(self.guard.now(), Relaxed);
        }
        poll
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Watched<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.inner).poll_write(cx, buf);
        self.wrote(poll)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let poll = Pin::new(&mut self.inner).poll_write_vectored(cx, bufs);
        self.wrote(poll)
    }

    fn is_write_vectored(&self) -> bool {
        self.inner.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.inner).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard() -> Arc<Guard> {
        let ms = Duration::from_millis;
        Arc::new(Guard::new(ms(200), ms(400), ms(800)))
    }

    /// Milliseconds until the guard says that the connection is to be closed. A busy machine may be late, never early.
    async fn after(guard: &Guard) -> u64 {
        let why = guard.expired().await;
        println!("{} ms: {why}", guard.now());
        guard.now()
    }

    #[tokio::test]
    async fn a_connection_that_says_nothing_is_closed_after_the_greeting() {
        assert!((200..390).contains(&after(&guard()).await));
    }

    #[tokio::test]
    async fn one_that_greeted_is_closed_when_idle_and_a_call_keeps_it() {
        let guard = guard();
        guard.bytes_in.store(24, Relaxed);
        let call = guard.call();
        assert!(tokio::time::timeout(Duration::from_millis(1000), guard.expired()).await.is_err());
        drop(call);
        assert!((1400..1900).contains(&after(&guard).await));
    }

    #[tokio::test]
    async fn a_client_that_takes_nothing_is_closed_though_its_call_goes_on() {
        let guard = guard();
        let (quick, slow) = (guard.call(), guard.call());
        quick.offered();
        quick.taken();
        tokio::time::sleep(Duration::from_millis(300)).await;
        slow.offered();
        assert!((1100..1600).contains(&after(&guard).await));
    }
}
