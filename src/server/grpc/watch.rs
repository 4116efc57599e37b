//! `Watch`: commits as they happen, each with what it did and where.

use super::outgoing::{Outgoing, Stream, stream};
use crate::base::{Error, Result};
use crate::db::query::Area;
use crate::db::{Footprint, Snapshot};
use crate::server::model::area;
use crate::server::status::status;
use crate::server::{Answer, Live, State};
use crate::wire::v1;
use crate::wire::v1::watch_server::Watch;
use std::collections::VecDeque;
use std::sync::Arc;
use tokio::sync::Mutex;
use tonic::{Request, Response, Status};

/// Footprints that are remembered, so that all who watch share one look.
const REMEMBERED: usize = 64;

/// The service.
pub struct WatchService {
    state: Arc<State>,
    footprints: Arc<Footprints>,
}

impl WatchService {
    pub fn new(state: Arc<State>) -> WatchService {
        WatchService { state, footprints: Arc::default() }
    }
}

#[tonic::async_trait]
impl Watch for WatchService {
    type CommitsStream = Stream<v1::Commit>;

    async fn commits(&self, request: Request<v1::CommitsRequest>) -> Answer<Response<Self::CommitsStream>> {
        let r = request.into_inner();
        let (state, footprints) = (self.state.clone(), self.footprints.clone());
        let live = state.live.clone();
        let (area, from) = state
            .pools
            .answer(move || {
                let area = r.region.as_ref().map(|_| area(r.region.as_ref())).transpose()?;
                Ok((area, start(&live, r.after)?))
            })
            .await?;
        let mut stop = state.stop.subscribe();
        Ok(stream(|out| async move {
            tokio::select! {
                done = tell(&state, &footprints, area, from, &out) => done,
                _ = stop.wait_for(|s| *s) => {
                    Err(Status::unavailable("the server is stopping; call again with `after`: nothing is missed"))
                }
            }
        }))
    }
}

/// The version after which commits are told; `None`: from the first.
fn start(live: &Live, after: Option<u64>) -> Result<Option<Arc<Snapshot>>> {
    let newest = live.newest();
    let after = match after {
        None => newest.number(),
        Some(after) => after,
    };
    if after == 0 {
        return Ok(None);
    }
    let last = live.look()?.max(newest.number());
    if after > last {
        let remedy = format!("the newest is {last}; leave `after` out for new commits only");
        return Err(Error::missing(format!("version {after}"), remedy));
    }
    match live.snapshot(after) {
        Err(Error::Missing { .. }) => Err(Error::missing(
            format!("version {after}"),
            format!(
                "it is not kept any more, so what changed since cannot be told; read the database anew (the newest is {last}) \
                 and watch from there"
            ),
        )),
        found => found.map(Some),
    }
}

/// Tells of every commit after a version, until the client goes. What is told last is held, so that it is not pruned before
/// the next was compared with it.
async fn tell(
    state: &Arc<State>,
    footprints: &Footprints,
    area: Option<Area>,
    mut last: Option<Arc<Snapshot>>,
    out: &Outgoing<v1::Commit>,
) -> Answer<()> {
    let mut arrivals = state.live.arrivals();
    loop {
        out.room().await?;
        let told = last.as_ref().map_or(0, |s| s.number());
        let newest = arrivals.borrow_and_update().snapshot.number();
        let (live, next) = (state.live.clone(), told);
        let found = match newest > told {
            false => None,
            true => state.pools.answer(move || following(&live, next)).await?,
        };
        let Some(now) = found else {
            if arrivals.changed().await.is_err() {
                return Err(Status::unavailable("the server is stopping; call again with `after`"));
            }
            continue;
        };
        let footprint = footprints.of(state, last.as_ref(), &now).await?;
        if area.as_ref().is_none_or(|a| footprint.meets(a)) {
            out.send(commit(&now, told, &footprint)?).await?;
        }
        last = Some(now);
    }
}

/// The first version after one that is still there when it is opened.
fn following(live: &Live, told: u64) -> Result<Option<Arc<Snapshot>>> {
    for v in live.db().versions()?.iter().filter(|v| v.number > told) {
        match live.snapshot(v.number) {
            // Pruned a moment ago.
            Err(Error::Missing { .. }) => continue,
            found => return found.map(Some),
        }
    }
    Ok(None)
}

fn commit(now: &Snapshot, since: u64, f: &Footprint) -> Answer<v1::Commit> {
    let Some(v) = now.version() else {
        return Err(status(Error::missing("version 0", "nothing was committed yet")));
    };
    let [added, removed, changed] = [f.added, f.removed, f.changed];
    let footprint = f.boxes.iter().map(|b| v1::Box { xmin: b[0], ymin: b[1], xmax: b[2], ymax: b[3] });
    Ok(v1::Commit {
        version: v.number,
        operation: v.operation.clone(),
        made_at_s: v.made_at,
        action: v.action.clone(),
        footprint: footprint.collect(),
        added,
        removed,
        changed,
        since,
    })
}

/// From version, to version, what changed.
type Known = (u64, u64, Arc<Footprint>);

/// What changed from one version to the next: looked at once for all who watch.
#[derive(Default)]
struct Footprints {
    known: Mutex<VecDeque<Known>>,
}

impl Footprints {
    async fn of(
        &self,
        state: &Arc<State>,
        before: Option<&Arc<Snapshot>>,
        now: &Arc<Snapshot>,
    ) -> Answer<Arc<Footprint>> {
        let key = (before.map_or(0, |b| b.number()), now.number());
        // Held while it is computed: who asks for the same waits for it.
        let mut known = self.known.lock().await;
        if let Some((_, _, f)) = known.iter().find(|(a, b, _)| (*a, *b) == key) {
            return Ok(f.clone());
        }
        let (before, now) = (before.cloned(), now.clone());
        let found = state.pools.work(move || now.footprint(before.as_deref()).map(Arc::new)).await?;
        known.push_front((key.0, key.1, found.clone()));
        known.truncate(REMEMBERED);
        Ok(found)
    }
}
