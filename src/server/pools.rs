//! Threads that compute. None of it runs on the threads that carry messages.
//!
//! - answers: what somebody waits for this instant: steps of views, queries, heights;
//! - work: files, checks: takes what answers leave;
//! - arrivals: commits, one at a time. One core fewer than there are, and the lowest priority: an arriving survey never holds
//!   all cores.
//!
//! Code that runs in a pool and uses rayon stays in that pool. A thread that waits for parts of its task takes up other tasks of
//! its pool meanwhile: so nothing that another task may wait for is held across such parts. Commits hold the writer lock: hence
//! their turns.

use super::status::status;
use crate::base::{Error, Result};
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::{Mutex, oneshot};
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
    /// Where tasks take turns.
    turn: Option<Arc<Mutex<()>>>,
}

/// A task that waits: counted as long as this lives.
struct Waiting(Arc<AtomicUsize>);

impl Waiting {
    fn of(pool: &Pool) -> Waiting {
        pool.waiting.fetch_add(1, Ordering::Relaxed);
        Waiting(pool.waiting.clone())
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

impl Pools {
    pub fn new() -> Result<Pools> {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        Ok(Pools {
            answers: pool("answer", cores, 0)?,
            work: pool("work", cores, 5)?,
            arrivals: Pool {
                turn: Some(Arc::default()),
                ..pool("arrival", cores.saturating_sub(1).max(1), 15)?
            },
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

    /// Carries out a commit, or something that waits for the writer lock: after those that came before.
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
    Ok(Pool { name, threads, waiting: Arc::default(), turn: None })
}

async fn run<T: Send + 'static>(pool: &Pool, f: impl FnOnce() -> Result<T> + Send + 'static) -> Answer<T> {
    let (done, answer) = oneshot::channel();
    let waiting = Waiting::of(pool);
    let turn = match &pool.turn {
        Some(turn) => Some(turn.clone().lock_owned().await),
        None => None,
    };
    pool.threads.spawn_fifo(move || {
        drop(waiting);
        // It ends with the task, not with the caller.
        let _turn = turn;
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

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;
    use std::sync::atomic::AtomicBool;

    /// A task that uses all threads of its pool while it holds what the next one needs.
    fn task(held: &AtomicBool) -> Result<bool> {
        let alone = !held.swap(true, Ordering::SeqCst);
        (0..64).into_par_iter().for_each(|_| std::thread::sleep(std::time::Duration::from_micros(200)));
        held.store(false, Ordering::SeqCst);
        Ok(alone)
    }

    #[tokio::test]
    async fn arrivals_take_turns_even_if_their_callers_go() {
        let pool = Arc::new(Pool { turn: Some(Arc::default()), ..pool("test", 3, 0).unwrap() });
        let held = Arc::new(AtomicBool::new(false));
        for k in 0..24 {
            let (p, h) = (pool.clone(), held.clone());
            let call = tokio::spawn(async move { run(&p, move || task(&h)).await.unwrap() });
            if k % 3 == 0 {
                tokio::time::sleep(std::time::Duration::from_millis(1)).await;
                call.abort();
            }
        }
        let (p, h) = (pool.clone(), held.clone());
        let calls: Vec<_> = (0..24)
            .map(|_| {
                let (pool, held) = (p.clone(), h.clone());
                tokio::spawn(async move { run(&pool, move || task(&held)).await.unwrap() })
            })
            .collect();
        for call in calls {
            assert!(call.await.unwrap(), "a task was begun while another held what it needs");
        }
        assert_eq!(pool.waiting.load(Ordering::Relaxed), 0);
    }
}
