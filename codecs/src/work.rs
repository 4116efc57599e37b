//! Who does the work: the caller's threads, or nobody else.

use crate::{Error, Result};

/// Does work that falls into independent parts, and says when to stop.
pub trait Workers: Sync {
    /// Calls `part` once with each of `0..parts`, in any order, from any thread; returns when all are done.
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync));

    /// Told how much is done, 0 to 1; `false` stops the work.
    fn going(&self, share: f64) -> bool {
        let _ = share;
        true
    }
}

/// The caller's own thread.
pub struct Alone;

impl Workers for Alone {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        (0..parts).for_each(part);
    }
}

/// [`Error::Stopped`] if the work shall not go on.
pub fn check(workers: &dyn Workers, share: f64) -> Result<()> {
    if workers.going(share) { Ok(()) } else { Err(Error::Stopped) }
}
