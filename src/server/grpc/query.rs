//! The Query service.

use super::outgoing::{Stream, stream};
use crate::base::Error;
use crate::height::surface::Seams;
use crate::server::answer::{self, Asked, Budget, Parts};
use crate::server::{Answer, State, metrics, model};
use crate::wire::v1;
use crate::wire::v1::patches_reply::Kind;
use crate::wire::v1::query_server::Query;
use std::sync::Arc;
use tonic::{Request, Response};

/// The Query service.
pub struct QueryService(pub Arc<State>);

impl QueryService {
    /// Sends header, parts and end. A part is computed when there is room for it.
    fn send(&self, mut parts: Parts) -> Response<Stream<v1::PatchesReply>> {
        let state = self.0.clone();
        stream(|out| async move {
            let reply = |kind| v1::PatchesReply { kind: Some(kind) };
            out.send(reply(Kind::Header(std::mem::take(&mut parts.header)))).await?;
            loop {
                out.room().await?;
                let (part, left) = state
                    .pools
                    .answer(move || {
                        let part = parts.next_part()?;
                        Ok((part, parts))
                    })
                    .await?;
                parts = left;
                match part {
                    Some(part) => {
                        metrics::patches_sent("Query", part.patches.len());
                        out.send(reply(Kind::Part(part))).await?;
                    }
                    None => return out.send(reply(Kind::End(std::mem::take(&mut parts.end)))).await,
                }
            }
        })
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
    type PatchesStream = Stream<v1::PatchesReply>;
    type DifferenceStream = Stream<v1::PatchesReply>;

    async fn patches(&self, request: Request<v1::PatchesRequest>) -> Answer<Response<Self::PatchesStream>> {
        let state = self.0.clone();
        let parts = self.0.pools.answer(move || {
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
        let state = self.0.clone();
        let parts = self.0.pools.answer(move || {
            let r = request.into_inner();
            let how = model::how(r.blend, r.seams, Seams::Off)?;
            let asked = Asked::new(r.region.as_ref(), r.tolerance.as_ref(), how, r.descriptors_only, false)?;
            let from = if r.from == 0 { None } else { Some(state.live.snapshot(r.from)?) };
            answer::difference(from, state.live.snapshot(r.to)?, &asked, state.settings.patches_max)
        });
        Ok(self.send(parts.await?))
    }
}
