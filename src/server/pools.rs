//! Threads that compute. None of it runs on the threads that carry messages.
//!
//! - answers: what somebody waits for this instant: steps of views, queries, heights;
//! - work: files, checks: takes what answers leave;
//! - arrivals: commits. One core fewer than there are, and the lowest priority: an arriving survey never holds all cores.
//!
//! Code that runs in a pool and uses rayon stays in that pool.

use super::status::status;
use crate::base::{Error, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::oneshot;
use tonic::Status;

/// What a call ends with.
pub type Answer<T> = std::result::Result<T, Status>;

/// Threads that compute.
pub struct Pools {
    answers: Pool,
    work: Pool,
    arrivals: Pool,
}

/// Threads of one priority, and how many tasks wait for one of them.
struct Pool {
    name: &'static str,
    threads: ThreadPool,
    waiting: Arc<AtomicUsize>,
}

impl Pools {
    pub fn new() -> Result<Pools> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Ok(Pools {
            answers: pool("answer", cores, 0)?,
            work: pool("work", cores, 5)?,
            arrivals: pool("arrival", cores.saturating_sub(1).max(1), 15)?,
        })
    }

    /// How many tasks wait for a thread, by pool.
    pub fn waiting(&self) -> [(&'static str, usize); 3] {
        [&self.answers, &self.work, &self.arrivals].map(|p| (p.name, p.waiting.load(Ordering::Relaxed)))
    }

    /// Computes something that somebody waits for.
    pub async fn answer<T: Send + 'static>(
        &self,
        f: impl FnOnce() -> Result<T> + Send + 'static,
    ) -> Answer<T> {
        run(&self.answers, f).await
    }

    /// Computes something that may take its time.
    pub async fn work<T: Send + 'static>(&self, f: impl FnOnce() -> Result<T> + Send + 'static) -> Answer<T> {
        run(&self.work, f).await
    }

    /// Carries out a commit.
    pub async fn arrival<T: Send + 'static>(
        &self,
        f: impl FnOnce() -> Result<T> + Send + 'static,
    ) -> Answer<T> {
        run(&self.arrivals, f).await
    }
}

fn pool(name: &'static str, threads: usize, nice: i32) -> Result<Pool> {
    let threads = ThreadPoolBuilder::new()
        .num_threads(threads)
        .thread_name(move |k| format!("{name}-{k}"))
        .start_handler(move |_| {
            if nice > 0 {
                // On Linux this is the priority of the calling thread. A system that refuses leaves it as it was.
                let _ = rustix::process::nice(nice);
            }
        })
        .build()
        .map_err(|e| Error::invalid("threads", e))?;
    Ok(Pool { name, threads, waiting: Arc::default() })
}

async fn run<T: Send + 'static>(pool: &Pool, f: impl FnOnce() -> Result<T> + Send + 'static) -> Answer<T> {
    let (done, answer) = oneshot::channel();
    let waiting = pool.waiting.clone();
    waiting.fetch_add(1, Ordering::Relaxed);
    pool.threads.spawn_fifo(move || {
        waiting.fetch_sub(1, Ordering::Relaxed);
        // Who asked may be gone: then nobody wants it any more.
        if done.is_closed() {
            return;
        }
        let found = catch_unwind(AssertUnwindSafe(f));
        let _ = done.send(found);
    });
    match answer.await {
        Ok(Ok(found)) => found.map_err(status),
        Ok(Err(_)) => Err(Status::internal(
            "the server met a fault of its own while answering; it goes on, and its log says where",
        )),
        Err(_) => Err(Status::unavailable("the server is stopping; try again")),
    }
}
