//! The database as it is now: the newest version, opened once and shared by all who ask; who waits for newer ones is told.

use crate::base::Result;
use crate::db::{Db, Progress, Snapshot};
use crate::height::lod::SurveyNumber;
use arc_swap::ArcSwap;
use std::collections::{BTreeSet, VecDeque};
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::watch;

/// Older versions, and subsets of surveys, that stay open, so that asking for them again is cheap.
const OPEN_MAX: usize = 4;
/// How long they stay open when nobody asks for them: an open version cannot be pruned, and holds memory.
const OPEN_FOR: Duration = Duration::from_secs(60);
/// How often the catalog is asked for commits of other processes.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// A version that has become the newest.
#[derive(Clone)]
pub struct Arrival {
    pub snapshot: Arc<Snapshot>,
}

/// A version that stays open for a while, or a subset of its surveys.
struct Open {
    surveys: BTreeSet<SurveyNumber>,
    snapshot: Arc<Snapshot>,
    asked: Instant,
}

/// The one asked for lately comes to the front.
fn again(open: &Mutex<VecDeque<Open>>, at: u64, surveys: &BTreeSet<SurveyNumber>) -> Option<Arc<Snapshot>> {
    let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
    let k = open.iter().position(|o| o.snapshot.number() == at && o.surveys == *surveys)?;
    let mut found = open.remove(k)?;
    found.asked = Instant::now();
    let snapshot = found.snapshot.clone();
    open.push_front(found);
    Some(snapshot)
}

fn keep(open: &Mutex<VecDeque<Open>>, surveys: BTreeSet<SurveyNumber>, snapshot: &Arc<Snapshot>) {
    let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
    open.push_front(Open { surveys, snapshot: snapshot.clone(), asked: Instant::now() });
    open.truncate(OPEN_MAX);
}

/// A database and its newest version.
pub struct Live {
    db: Arc<Db>,
    newest: ArcSwap<Snapshot>,
    arrivals: watch::Sender<Arrival>,
    older: Mutex<VecDeque<Open>>,
    subsets: Mutex<VecDeque<Open>>,
    making: Arc<tokio::sync::Mutex<()>>,
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
    ///
    /// Once a version was answered for, no later question for the newest one is answered with an older one.
    pub fn snapshot(&self, at: u64) -> Result<Arc<Snapshot>> {
        if at > self.newest().number() {
            // Another process has made it a moment ago, or nobody has.
            self.look()?;
        }
        let newest = self.newest();
        if at == 0 || newest.number() == at {
            return Ok(newest);
        }
        if let Some(found) = again(&self.older, at, &BTreeSet::new()) {
            return Ok(found);
        }
        let opened = Arc::new(self.db.snapshot(Some(at))?);
        keep(&self.older, BTreeSet::new(), &opened);
        Ok(opened)
    }

    /// Closes versions that nobody reads any more.
    pub fn close_older(&self) {
        self.close(|_| false);
    }

    fn close(&self, stays: impl Fn(&Open) -> bool) {
        for open in [&self.older, &self.subsets] {
            let mut open = open.lock().unwrap_or_else(PoisonError::into_inner);
            let (left, gone): (VecDeque<Open>, VecDeque<Open>) = open.drain(..).partition(&stays);
            *open = left;
            drop((open, gone));
        }
    }

    /// A version as if only some of its surveys were in it. Takes the time of a commit unless the same was asked lately: call
    /// it where that is allowed, with [`Live::one_subset`] held.
    pub fn only(&self, at: u64, surveys: &[String]) -> Result<Arc<Snapshot>> {
        let whole = self.snapshot(at)?;
        let kept: BTreeSet<SurveyNumber> =
            surveys.iter().map(|n| Ok(whole.survey(n)?.number)).collect::<Result<_>>()?;
        if let Some(found) = again(&self.subsets, whole.number(), &kept) {
            return Ok(found);
        }
        let (report, stop) = (|_: &str, _: f64| {}, AtomicBool::new(false));
        let made = Arc::new(whole.only(surveys, &Progress { report: &report, stop: &stop })?);
        keep(&self.subsets, kept, &made);
        Ok(made)
    }

    /// Each subset that is being made holds memory of its own: one at a time. Goes along with the making, which does not end
    /// with its caller.
    pub async fn one_subset(&self) -> tokio::sync::OwnedMutexGuard<()> {
        self.making.clone().lock_owned().await
    }

    /// Looks for a newer version and makes it the newest. Returns its number.
    pub fn look(&self) -> Result<u64> {
        let _one = self.looking.lock().unwrap_or_else(PoisonError::into_inner);
        if self.db.newest()? > self.newest().number() {
            // The newest by now: the one just seen may be pruned already.
            let snapshot = Arc::new(self.db.snapshot(None)?);
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
                let look = move || {
                    live.close(|o| o.asked.elapsed() < OPEN_FOR);
                    live.look()
                };
                if let Ok(Err(e)) = tokio::task::spawn_blocking(look).await {
                    tracing::warn!("looking for new versions: {e}");
                }
            }
        });
    }
}
