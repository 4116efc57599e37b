//! Patches of a region within a tolerance, and what changed between versions.

use super::{Connection, failed};
use crate::base::{Error, Result};
use crate::codec::vertices;
use crate::height::patch::Vertices;
use crate::wire::v1;
use crate::wire::v1::patches_reply::Kind;
use tonic::Streaming;

/// An answer, complete.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    pub header: v1::PatchesHeader,
    /// Coarse first; of a difference those that are added.
    pub patches: Vec<v1::Patch>,
    pub masks: Vec<v1::MaskBlock>,
    pub corrections: Vec<v1::CorrectionBlock>,
    /// Of a difference: ids, 16 bytes each.
    pub removed: Vec<u8>,
    /// Of a difference: other tops or floors.
    pub changed: Vec<v1::Patch>,
    pub masks_removed: Vec<v1::MaskBlock>,
    pub corrections_removed: Vec<v1::CorrectionBlock>,
    pub end: v1::PatchesEnd,
}

impl Connection {
    /// The patches that a question needs. Held in memory as a whole.
    pub async fn patches(&self, request: v1::PatchesRequest) -> Result<Patches> {
        let replies = self.query().patches(request).await.map_err(|s| self.failed(s))?;
        self.gathered(replies.into_inner()).await
    }

    /// What changed between two versions for a question.
    pub async fn difference(&self, request: v1::DifferenceRequest) -> Result<Patches> {
        let replies = self.query().difference(request).await.map_err(|s| self.failed(s))?;
        self.gathered(replies.into_inner()).await
    }

    async fn gathered(&self, mut replies: Streaming<v1::PatchesReply>) -> Result<Patches> {
        let mut out = Patches::default();
        let mut ended = false;
        while let Some(reply) = replies.message().await.map_err(|s| failed(&self.server, s))? {
            match reply.kind {
                Some(Kind::Header(header)) => out.header = header,
                Some(Kind::Part(part)) => {
                    out.patches.extend(part.patches);
                    out.masks.extend(part.masks);
                    out.corrections.extend(part.corrections);
                    out.removed.extend_from_slice(&part.removed);
                    out.changed.extend(part.changed);
                    out.masks_removed.extend(part.masks_removed);
                    out.corrections_removed.extend(part.corrections_removed);
                }
                Some(Kind::End(end)) => (out.end, ended) = (end, true),
                None => {}
            }
        }
        let came = out.patches.len() as u64;
        if !ended || came != out.header.patches {
            let message =
                format!("the answer ended after {came} of {} patches; ask again", out.header.patches);
            return Err(Error::Remote { server: self.server.clone(), message });
        }
        Ok(out)
    }
}

/// The heights of a patch that came with its payload.
pub fn unpacked(patch: &v1::Patch) -> Result<Box<Vertices>> {
    vertices::unpack(&patch.payload)
}
