//! Which patches a region needs, from a server.

use super::Connection;
use crate::base::{Error, Result};
use crate::wire::v1;
use crate::wire::v1::patches_reply::Kind;

/// The parts of an answer, put together.
#[derive(Clone, Debug, Default)]
pub struct Patches {
    pub header: v1::PatchesHeader,
    pub patches: Vec<v1::Patch>,
    pub masks: Vec<v1::MaskBlock>,
    pub corrections: Vec<v1::CorrectionBlock>,
    pub end: v1::PatchesEnd,
}

/// Asks and waits for the whole answer.
///
/// # Errors
/// What the server refuses; an answer that breaks off.
pub async fn patches(c: &Connection, request: v1::PatchesRequest) -> Result<Patches> {
    let mut stream = c.query().patches(request).await.map_err(|s| c.failed(s))?.into_inner();
    let mut out = Patches::default();
    while let Some(reply) = stream.message().await.map_err(|s| c.failed(s))? {
        match reply.kind {
            Some(Kind::Header(header)) => out.header = header,
            Some(Kind::Part(part)) => {
                out.patches.extend(part.patches);
                out.masks.extend(part.masks);
                out.corrections.extend(part.corrections);
            }
            Some(Kind::End(end)) => {
                if end.patches != out.patches.len() as u64 {
                    let message = format!("sent {} patches of {}; ask again", out.patches.len(), end.patches);
                    return Err(Error::Remote { server: c.server.clone(), message });
                }
                out.end = end;
                return Ok(out);
            }
            None => {}
        }
    }
    let message = "ended the answer without its end; ask again".to_string();
    Err(Error::Remote { server: c.server.clone(), message })
}
