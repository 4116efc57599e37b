//! The database as it is now: the newest version, opened once and shared by all who ask; who waits for newer ones is told.

use crate::base::Result;
use crate::db::{Db, Progress, Snapshot};
use crate::height::lod::SurveyNumber;
use arc_swap::ArcSwap;
use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;

/// Older versions that stay open, so that asking for them again is cheap.
const OLDER_OPEN: usize = 4;
/// How often the catalog is asked for commits of other processes.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// A version that has become the newest.
#[derive(Clone)]
pub struct Arrival {
    pub snapshot: Arc<Snapshot>,
}

/// A database and its newest version.
pub struct Live {
    db: Arc<Db>,
    newest: ArcSwap<Snapshot>,
    arrivals: watch::Sender<Arrival>,
    older: Mutex<VecDeque<Arc<Snapshot>>>,
    subsets: Mutex<VecDeque<(BTreeSet<SurveyNumber>, Arc<Snapshot>)>>,
    making: tokio::sync::Mutex<()>,
    looking: Mutex<()>,
}

impl Live {
    pub fn open(db: Db) -> Result<Live> {
        let newest = Arc::new(db.snapshot(None)?);
        let (arrivals, _) = watch::channel(Arrival { snapshot: newest.clone() });
        Ok(Live {
            db: Arc::new(db),
            newest: ArcSwap::new(newest),
            arrivals,
            older: Mutex::default(),
            subsets: Mutex::default(),
            making: Default::default(),
            looking: Mutex::default(),
        })
    }

    pub fn db(&self) -> &Arc<Db> {
        &self.db
    }

    /// The newest version that was seen. Never waits.
    pub fn newest(&self) -> Arc<Snapshot> {
        self.newest.load_full()
    }

    /// A version; 0: the newest. Reads the catalog unless it is open already: call it where blocking is allowed.
    pub fn snapshot(&self, at: u64) -> Result<Arc<Snapshot>> {
        let newest = self.newest();
        if at == 0 || newest.number() == at {
            return Ok(newest);
        }
        let mut older = self.older.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(k) = older.iter().position(|s| s.number() == at) {
            let found = older.remove(k).expect("the position was found");
            older.push_front(found.clone());
            return Ok(found);
        }
        let opened = Arc::new(self.db.snapshot(Some(at))?);
        older.push_front(opened.clone());
        older.truncate(OLDER_OPEN);
        Ok(opened)
    }

    /// Closes versions that nobody reads any more.
    pub fn close_older(&self) {
        self.older.lock().unwrap_or_else(PoisonError::into_inner).clear();
        self.subsets.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// A version as if only some of its surveys were in it. Takes the time of a commit unless the same was asked lately: call
    /// it where that is allowed, with [`Live::one_subset`] held.
    pub fn only(&self, at: u64, surveys: &[String]) -> Result<Arc<Snapshot>> {
        let whole = self.snapshot(at)?;
        let kept: BTreeSet<SurveyNumber> =
            surveys.iter().map(|n| Ok(whole.survey(n)?.number)).collect::<Result<_>>()?;
        let subsets = || self.subsets.lock().unwrap_or_else(PoisonError::into_inner);
        let known = |k: &BTreeSet<SurveyNumber>, s: &Snapshot| *k == kept && s.number() == whole.number();
        if let Some((_, s)) = subsets().iter().find(|(k, s)| known(k, s)) {
            return Ok(s.clone());
        }
        let (report, stop) = (|_: &str, _: f64| {}, AtomicBool::new(false));
        let made = Arc::new(whole.only(surveys, &Progress { report: &report, stop: &stop })?);
        let mut subsets = subsets();
        subsets.push_front((kept, made.clone()));
        subsets.truncate(OLDER_OPEN);
        Ok(made)
    }

    /// Each subset that is being made holds memory of its own: one at a time.
    pub async fn one_subset(&self) -> tokio::sync::MutexGuard<'_, ()> {
        self.making.lock().await
    }

    /// Looks for a newer version and makes it the newest. Returns its number.
    pub fn look(&self) -> Result<u64> {
        let _one = self.looking.lock().unwrap_or_else(PoisonError::into_inner);
        let found = self.db.newest()?;
        if found > self.newest().number() {
            let snapshot = Arc::new(self.db.snapshot(Some(found))?);
            self.newest.store(snapshot.clone());
            self.arrivals.send_replace(Arrival { snapshot });
        }
        Ok(self.newest().number())
    }

    /// Tells of each version that becomes the newest; of several in a row only of the last.
    pub fn arrivals(&self) -> watch::Receiver<Arrival> {
        self.arrivals.subscribe()
    }

    /// Looks for commits of other processes until told to stop.
    pub fn follow(self: &Arc<Self>, mut stopped: watch::Receiver<bool>) {
        let live = self.clone();
        tokio::spawn(async move {
            while !*stopped.borrow() {
                tokio::select! {
                    _ = tokio::time::sleep(LOOK_EVERY) => {}
                    _ = stopped.changed() => break,
                }
                let live = live.clone();
                if let Ok(Err(e)) = tokio::task::spawn_blocking(move || live.look()).await {
                    tracing::warn!("looking for new versions: {e}");
                }
            }
        });
    }
}
