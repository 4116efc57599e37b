//! Every session that there is: found by id, kept for a while after its stream ended.

use super::session::{Attached, Session, SessionId, Wanted};
use super::target::Manner;
use crate::base::{Error, Result};
use std::collections::HashMap;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Patches and blocks that all sessions may keep in memory, about 60 bytes each.
const WEIGHT_MAX: usize = 20_000_000;

/// Every session that there is.
pub struct Sessions {
    known: Mutex<HashMap<SessionId, Arc<Session>>>,
    /// How long one is kept after its stream ended.
    pub kept: Duration,
    max: usize,
}

impl Sessions {
    pub fn new(kept: Duration, max: usize) -> Sessions {
        Sessions { known: Mutex::default(), kept, max }
    }

    fn known(&self) -> MutexGuard<'_, HashMap<SessionId, Arc<Session>>> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// How many there are.
    pub fn count(&self) -> usize {
        self.known().len()
    }

    /// A new session, and its stream. If there are too many, the one whose stream ended first makes room.
    ///
    /// # Errors
    /// `Limit` if all of them have streams, or together hold too many patches.
    pub fn open(&self, manner: Manner, wanted: Wanted) -> Result<Attached> {
        let mut id = SessionId::default();
        getrandom::fill(&mut id).map_err(|e| Error::invalid("random numbers", e))?;
        self.sweep();
        let mut known = self.known();
        loop {
            let weight: usize = known.values().map(|s| s.weight.load(Ordering::Relaxed)).sum();
            if known.len() < self.max && weight <= WEIGHT_MAX {
                break;
            }
            let first = known.values().filter_map(|s| Some((s.ended()?, s.id))).min();
            match first {
                Some((_, id)) => known.remove(&id),
                None if known.len() >= self.max => {
                    let what = "open views (close one, or try again later)";
                    return Err(Error::limit(what, self.max as u64, known.len() as u64 + 1));
                }
                None => {
                    let what = "patches of all open views (close one, or try again later)";
                    return Err(Error::limit(what, WEIGHT_MAX as u64, weight as u64));
                }
            };
        }
        let session = Arc::new(Session::new(id, manner, wanted));
        let attached = session.attach();
        known.insert(id, session);
        Ok(attached)
    }

    /// A new stream for a session that is still there; an older stream ends.
    pub fn resume(&self, id: &[u8]) -> Option<Attached> {
        self.sweep();
        self.known().get(id).map(Session::attach)
    }

    pub fn find(&self, id: &[u8]) -> Option<Arc<Session>> {
        self.known().get(id).filter(|s| self.keeps(s)).cloned()
    }

    /// Forgets sessions whose streams ended long ago.
    pub fn sweep(&self) {
        self.known().retain(|_, s| self.keeps(s));
    }

    fn keeps(&self, s: &Session) -> bool {
        s.ended().is_none_or(|at| at.elapsed() < self.kept)
    }
}
