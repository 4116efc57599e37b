//! `Catalog`: what is in the database, and changes that need no samples.

use super::super::model::{self, Page};
use super::super::operations::{self, made_id};
use super::super::pools::Answer;
use super::super::{State, status::status};
use super::report;
use crate::base::date::Date;
use crate::base::{Error, Result};
use crate::db::query::Area;
use crate::db::{self, Change, Progress, Snapshot};
use crate::height::crs::AxisUnit;
use crate::height::lod::SurveyNumber;
use crate::wire::v1;
use crate::wire::v1::catalog_server::{Catalog, CatalogServer};
use crate::wire::v1::operation_status::State as Standing;
use prost::Message;
use std::ops::Bound;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

/// How often a check says how far it is.
const SAY_EVERY: Duration = Duration::from_millis(250);

/// The service.
pub struct Service(Arc<State>);

/// The service, as the server takes it.
pub fn service(state: &Arc<State>) -> CatalogServer<Service> {
    CatalogServer::new(Service(state.clone()))
        .max_decoding_message_size(crate::wire::MESSAGE_BYTES_MAX)
        .max_encoding_message_size(crate::wire::MESSAGE_BYTES_MAX)
}

type Reply<T> = Answer<Response<T>>;
type Lines = ReceiverStream<Answer<v1::JsonLines>>;

impl Service {
    /// A version; opened in the pool unless it is the newest.
    async fn at(&self, at: u64) -> Answer<Arc<Snapshot>> {
        let live = self.0.live.clone();
        if at == 0 {
            return Ok(live.newest());
        }
        self.0.pools.answer(move || live.snapshot(at)).await
    }

    /// Answers from a version while somebody waits.
    async fn answer<T: Send + 'static>(
        &self,
        at: u64,
        f: impl FnOnce(&Snapshot) -> Result<T> + Send + 'static,
    ) -> Reply<T> {
        let s = self.at(at).await?;
        self.0.pools.answer(move || f(&s)).await.map(Response::new)
    }

    async fn commit(&self, change: Change, operation: String, what: &str) -> Reply<v1::CommitReply> {
        let id = match operation.as_str() {
            "" => made_id(what)?,
            given => model::upload::operation(given).map_err(status)?,
        };
        let outcome = operations::commit(&self.0, id.clone(), false, move || Ok(change)).await?;
        Ok(Response::new(operations::reply(&outcome, &id)))
    }
}

#[tonic::async_trait]
impl Catalog for Service {
    async fn info(&self, request: Request<v1::InfoRequest>) -> Reply<v1::InfoReply> {
        let v1::InfoRequest { at, sizes } = request.into_inner();
        let s = self.at(at).await?;
        let db = self.0.live.db().clone();
        let fill = move || {
            let (json, datum) = match sizes {
                true => (model::json(&db::info(&db, &s)?)?, db::vertical_datum(&s)?),
                false => (String::new(), None),
            };
            Ok(v1::InfoReply {
                ground: Some(model::ground(&s)),
                policy: s.policy().name().to_string(),
                format_version: db.format(),
                program: env!("CARGO_PKG_VERSION").to_string(),
                json,
                vertical_datum: datum.unwrap_or_default(),
                surveys: s.entries().count() as u64,
                metres_per_unit: match s.crs().unit {
                    AxisUnit::Metre(m) => m,
                    AxisUnit::Degree => 0.0,
                },
            })
        };
        let pools = &self.0.pools;
        let found = if sizes { pools.work(fill).await? } else { pools.answer(fill).await? };
        Ok(Response::new(found))
    }

    async fn list_surveys(&self, request: Request<v1::ListSurveysRequest>) -> Reply<v1::ListSurveysReply> {
        let r = request.into_inner();
        let (page, at) = Page::of(r.page_size, &r.page_token, r.at).map_err(status)?;
        let area = model::area(r.region.as_ref()).map_err(status)?;
        self.answer(at, move |s| surveys(s, page, &area, r.frames_only)).await
    }

    async fn get_survey(&self, request: Request<v1::GetSurveyRequest>) -> Reply<v1::GetSurveyReply> {
        let r = request.into_inner();
        self.answer(r.at, move |s| {
            let e = s.survey(&r.survey)?;
            Ok(v1::GetSurveyReply {
                version: s.number(),
                survey: Some(model::survey(e, &db::survey_row(s, e)?)?),
                frame: Some(model::survey_frame(s, e.number)?),
            })
        })
        .await
    }

    async fn list_tiles(&self, request: Request<v1::ListTilesRequest>) -> Reply<v1::ListTilesReply> {
        let r = request.into_inner();
        let (mut page, at) = Page::of(r.page_size, &r.page_token, r.at).map_err(status)?;
        self.answer(at, move |s| {
            let mut out = v1::ListTilesReply { version: s.number(), ..Default::default() };
            let rows = db::tiles(s, &r.survey)?;
            let first = page.after.map_or(0, |k| (k as usize).saturating_add(1));
            for (k, row) in rows.iter().enumerate().skip(first) {
                let tile = model::tile(row)?;
                if !page.takes(tile.encoded_len()) {
                    out.next_page_token = Page::next(s.number(), k as u64 - 1);
                    break;
                }
                out.tiles.push(tile);
            }
            Ok(out)
        })
        .await
    }

    async fn list_versions(&self, request: Request<v1::ListVersionsRequest>) -> Reply<v1::ListVersionsReply> {
        let r = request.into_inner();
        let (mut page, version) = Page::of(r.page_size, &r.page_token, 0).map_err(status)?;
        let (live, db) = (self.0.live.clone(), self.0.live.db().clone());
        let list = move || {
            // Later pages stop where the first one did.
            let version = if version == 0 { live.look()? } else { version };
            let mut out = v1::ListVersionsReply { version, ..Default::default() };
            let wanted = |n: u64| n <= version && page.after.is_none_or(|a| n > a);
            let found: Vec<_> = db.versions()?.into_iter().filter(|v| wanted(v.number)).collect();
            for v in found {
                let (number, operation, made_at_s, action) = (v.number, v.operation, v.made_at, v.action);
                let v = v1::VersionInfo { number, operation, made_at_s, action };
                if !page.takes(v.encoded_len()) {
                    out.next_page_token = Page::next(version, out.versions.last().map_or(0, |v| v.number));
                    break;
                }
                out.versions.push(v);
            }
            Ok(out)
        };
        self.0.pools.answer(list).await.map(Response::new)
    }

    async fn get_operation(&self, request: Request<v1::GetOperationRequest>) -> Reply<v1::OperationStatus> {
        let id = request.into_inner().operation;
        if let Some(standing) = self.0.operations.standing(&id) {
            return Ok(Response::new(standing));
        }
        let live = self.0.live.clone();
        let find = move || {
            let version = live.db().operation(&id)?.ok_or_else(|| {
                let what = format!("operation '{id}'");
                Error::missing(what, "it was never committed, and not asked for since the server started")
            })?;
            // Another process may have carried it out a moment ago: then its version is the newest from now on.
            live.look()?;
            let state = Standing::Done as i32;
            Ok(v1::OperationStatus { operation: id, state, version, share: 1.0, ..Default::default() })
        };
        self.0.pools.answer(find).await.map(Response::new)
    }

    async fn fingerprint(&self, request: Request<v1::FingerprintRequest>) -> Reply<v1::FingerprintReply> {
        let s = self.at(request.into_inner().at).await?;
        let find =
            move || Ok(v1::FingerprintReply { version: s.number(), fingerprint: db::fingerprint(&s)? });
        self.0.pools.work(find).await.map(Response::new)
    }

    type BoxesStream = Lines;

    async fn boxes(&self, request: Request<v1::BoxesRequest>) -> Reply<Lines> {
        let s = self.at(request.into_inner().at).await?;
        Ok(Response::new(report::boxes(&self.0, s)))
    }

    type ReportStream = Lines;

    async fn report(&self, request: Request<v1::ReportRequest>) -> Reply<Lines> {
        let r = request.into_inner();
        let s = self.at(r.at).await?;
        report::report(&self.0, s, r).map(Response::new).map_err(status)
    }

    async fn remove(&self, request: Request<v1::RemoveRequest>) -> Reply<v1::CommitReply> {
        let r = request.into_inner();
        if r.surveys.is_empty() {
            let e = Error::invalid("surveys", "none is named; Catalog.ListSurveys lists them");
            return Err(status(e));
        }
        let tile = Some(r.tile).filter(|t| !t.is_empty());
        self.commit(Change::Remove { surveys: r.surveys, tile }, r.operation, "remove").await
    }

    async fn set(&self, request: Request<v1::SetRequest>) -> Reply<v1::CommitReply> {
        let r = request.into_inner();
        if r.date.is_none() && r.precedence.is_none() {
            let e = Error::invalid("date, precedence", "neither is given; nothing would change");
            return Err(status(e));
        }
        let date = r.date.as_deref().map(Date::parse).transpose().map_err(status)?;
        let change = Change::Set { survey: r.survey, date, precedence: r.precedence };
        self.commit(change, r.operation, "set").await
    }

    async fn prune(&self, request: Request<v1::PruneRequest>) -> Reply<v1::PruneReply> {
        use v1::prune_request::What;
        let what = match request.into_inner().what {
            Some(What::Keep(0)) => Err("0 versions; the latest one always stays, so give at least 1"),
            None => Err("neither `keep` nor `before` is given; say which versions are to go"),
            Some(what) => Ok(what),
        }
        .map_err(|reason| status(Error::invalid("keep", reason)))?;
        let live = self.0.live.clone();
        let prune = move || {
            // Kept open only so that asking again is cheap: no reader.
            live.close_older();
            let choose = |all: &[u64]| -> Vec<u64> {
                match what {
                    What::Keep(k) => {
                        let keep = usize::try_from(k).unwrap_or(usize::MAX);
                        all[..all.len().saturating_sub(keep)].to_vec()
                    }
                    What::Before(b) => all.iter().copied().filter(|v| *v < b).collect(),
                }
            };
            let o = live.db().prune(choose, &mut || {})?;
            Ok(v1::PruneReply {
                version: live.look()?,
                json: model::json(&o)?,
                forgotten: o.pruned,
                kept_for_readers: o.kept_for_readers,
                bytes_freed: o.bytes_freed,
            })
        };
        self.0.pools.arrival(prune).await.map(Response::new)
    }

    type VerifyStream = ReceiverStream<Answer<v1::VerifyReply>>;

    async fn verify(&self, request: Request<v1::VerifyRequest>) -> Reply<Self::VerifyStream> {
        let s = self.at(request.into_inner().at).await?;
        let (out, replies) = mpsc::channel(1);
        tokio::spawn(verify(self.0.clone(), s, out));
        Ok(Response::new(ReceiverStream::new(replies)))
    }
}

/// A page of surveys whose box meets the box of the area.
fn surveys(s: &Snapshot, mut page: Page, area: &Area, frames_only: bool) -> Result<v1::ListSurveysReply> {
    let mut out = v1::ListSurveysReply { version: s.number(), ..Default::default() };
    let size = s.unit().size();
    let wanted = |e: &db::SurveyEntry| {
        let b = e.geometry.bounds();
        let (lo, hi) = ([b.min.x, b.min.y], [b.max.x, b.max.y]);
        area.bounds()
            .is_none_or(|a| (0..2).all(|k| lo[k] as f64 * size <= a[k + 2] && hi[k] as f64 * size >= a[k]))
    };
    let after = page
        .after
        .map_or(Bound::Unbounded, |n| Bound::Excluded(SurveyNumber(u32::try_from(n).unwrap_or(u32::MAX))));
    let mut last = 0;
    for e in s.entries_in((after, Bound::Unbounded)).filter(|e| wanted(e)) {
        let frame = model::survey_frame(s, e.number)?;
        let survey = match frames_only {
            true => None,
            false => Some(model::survey(e, &db::survey_row(s, e)?)?),
        };
        if !page.takes(frame.encoded_len() + survey.as_ref().map_or(0, |s| s.encoded_len() + 6)) {
            out.next_page_token = Page::next(s.number(), last);
            break;
        }
        last = u64::from(e.number.0);
        out.frames.push(frame);
        out.surveys.extend(survey);
    }
    Ok(out)
}

/// Checks a version, saying how far it is, until it is done or nobody listens any more.
async fn verify(state: Arc<State>, s: Arc<Snapshot>, out: mpsc::Sender<Answer<v1::VerifyReply>>) {
    let version = s.number();
    let (say, mut said) = watch::channel((String::new(), 0.0));
    let stop = Arc::new(AtomicBool::new(false));
    let check = {
        let (stop, db) = (stop.clone(), state.live.db().clone());
        state.pools.work(move || {
            let report = |stage: &str, share: f64| {
                say.send_replace((stage.to_string(), share));
            };
            let found = db::verify(&db, &s, &Progress { report: &report, stop: &stop })?;
            Ok((model::json(&found)?, found.ok))
        })
    };
    tokio::pin!(check);
    let mut ticks = tokio::time::interval(SAY_EVERY);
    let last = loop {
        tokio::select! {
            done = &mut check => break done,
            _ = ticks.tick(), if !out.is_closed() => {
                if said.has_changed().unwrap_or(false) {
                    let (stage, share) = said.borrow_and_update().clone();
                    // A client that does not read gets fewer of these.
                    let _ = out.try_send(Ok(v1::VerifyReply { version, stage, share, ..Default::default() }));
                }
            }
            () = out.closed(), if !stop.load(Ordering::Relaxed) => stop.store(true, Ordering::Relaxed),
        }
    };
    let last: std::result::Result<_, Status> = last.map(|(json, ok)| v1::VerifyReply {
        version,
        share: 1.0,
        done: true,
        json,
        ok,
        ..Default::default()
    });
    let _ = out.send(last).await;
}
