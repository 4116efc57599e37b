//! The Query service.

use crate::base::Error;
use crate::height::surface::Seams;
use crate::server::answer::{self, Asked, Budget, Parts};
use crate::server::status::status;
use crate::server::{Answer, State, model};
use crate::wire::v1;
use crate::wire::v1::patches_reply::Kind;
use crate::wire::v1::query_server::Query;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Response, Status};

/// Messages that are ready before the transport takes them.
const READY: usize = 1;

type Reply = Result<v1::PatchesReply, Status>;

/// The Query service.
pub struct QueryService {
    state: Arc<State>,
}

impl QueryService {
    pub fn new(state: Arc<State>) -> QueryService {
        QueryService { state }
    }

    /// Sends header, parts and end. A part is computed when there is room for it.
    fn send(&self, parts: Parts) -> Response<ReceiverStream<Reply>> {
        let (tx, rx) = mpsc::channel(READY);
        let state = self.state.clone();
        tokio::spawn(async move {
            let mut parts = parts;
            let mut next = Some(Kind::Header(std::mem::take(&mut parts.header)));
            while let Some(kind) = next.take() {
                let last = matches!(kind, Kind::End(_));
                // Who asked may be gone.
                let Ok(()) = tx.send(Ok(v1::PatchesReply { kind: Some(kind) })).await else { return };
                if last {
                    return;
                }
                let Ok(room) = tx.reserve().await else { return };
                let made = state.pools.answer(move || {
                    let part = parts.next()?;
                    Ok((part, parts))
                });
                match made.await {
                    Ok((Some(part), left)) => {
                        parts = left;
                        drop(room);
                        next = Some(Kind::Part(part));
                    }
                    Ok((None, left)) => {
                        parts = left;
                        drop(room);
                        next = Some(Kind::End(std::mem::take(&mut parts.end)));
                    }
                    Err(s) => {
                        room.send(Err(s));
                        return;
                    }
                }
            }
        });
        Response::new(ReceiverStream::new(rx))
    }
}

/// A budget of nothing is a mistake.
fn positive(what: &str, n: Option<u64>) -> Result<Option<u64>, Error> {
    match n {
        Some(0) => Err(Error::invalid(what, "0 leaves room for nothing; leave it out for no budget")),
        n => Ok(n),
    }
}

#[tonic::async_trait]
impl Query for QueryService {
    type PatchesStream = ReceiverStream<Reply>;
    type DifferenceStream = ReceiverStream<Reply>;

    async fn patches(&self, request: Request<v1::PatchesRequest>) -> Answer<Response<Self::PatchesStream>> {
        let state = self.state.clone();
        let parts = self.state.pools.answer(move || {
            let r = request.into_inner();
            let how = model::how(r.blend, r.seams, Seams::Off)?;
            let asked =
                Asked::new(r.region.as_ref(), r.tolerance.as_ref(), how, r.descriptors_only, r.explain)?;
            let budget = Budget {
                bytes: positive("max_bytes", r.max_bytes)?,
                patches: positive("max_patches", r.max_patches)?,
                patches_max: state.settings.patches_max,
            };
            answer::patches(state.live.snapshot(r.at)?, &asked, &budget)
        });
        Ok(self.send(parts.await?))
    }

    async fn difference(
        &self,
        request: Request<v1::DifferenceRequest>,
    ) -> Answer<Response<Self::DifferenceStream>> {
        let state = self.state.clone();
        let parts = self.state.pools.answer(move || {
            let r = request.into_inner();
            let how = model::how(r.blend, r.seams, Seams::Off)?;
            let asked = Asked::new(r.region.as_ref(), r.tolerance.as_ref(), how, r.descriptors_only, false)?;
            let from = if r.from == 0 { None } else { Some(state.live.snapshot(r.from)?) };
            answer::difference(from, state.live.snapshot(r.to)?, &asked, state.settings.patches_max)
        });
        Ok(self.send(parts.await?))
    }
}
