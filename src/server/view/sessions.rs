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

    /// Whether there is room for what a view holds by now. Sessions without streams make room; if that is too little, a view that
    /// has more than its share is refused.
    ///
    /// # Errors
    /// `Limit`, if it has to let go.
    pub fn fits(&self, session: &Session) -> Result<()> {
        let mut known = self.known();
        let mut sum: usize = known.values().map(|s| s.weight.load(Ordering::Relaxed)).sum();
        while sum > WEIGHT_MAX {
            let first = known.values().filter_map(|s| Some((s.ended()?, s.id))).min();
            let Some(first) = first.and_then(|(_, id)| known.remove(&id)) else {
                let (share, own) = (WEIGHT_MAX / known.len().max(1), session.weight.load(Ordering::Relaxed));
                if own <= share {
                    return Ok(());
                }
                let what = "patches of a view while all open views together hold too many (look at less, or try again later)";
                return Err(Error::limit(what, share as u64, own as u64));
            };
            sum -= first.weight.load(Ordering::Relaxed).min(sum);
        }
        Ok(())
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::db::query::{Area, Query, Tolerance};
    use crate::height::surface::Blend;
    use crate::server::view::Question;

    #[test]
    fn views_that_hold_too_much_let_go_and_others_stay() {
        let sessions = Sessions::new(Duration::from_secs(300), 100);
        let open = || {
            let how = Blend::Exact.into();
            let query = Query { area: Area::Everything, tolerance: Tolerance::Constant(1.0), how };
            let question = Arc::new(Question { number: 0, query });
            let manner = Manner { how, descriptors_only: false };
            sessions.open(manner, Wanted { question, applied: 0, ahead: 0 }).unwrap()
        };
        let (small, ended, large) = (open(), open(), open());
        small.session.weighs(1000);
        ended.session.weighs(WEIGHT_MAX / 2);
        drop(ended);
        large.session.weighs(WEIGHT_MAX / 2);
        assert!(sessions.fits(&large.session).is_ok());
        assert_eq!(sessions.count(), 2, "what nobody streams makes room");
        large.session.weighs(WEIGHT_MAX);
        assert!(sessions.fits(&small.session).is_ok());
        let refused = sessions.fits(&large.session).unwrap_err();
        assert!(matches!(refused, Error::Limit { .. }), "{refused}");
    }
}
