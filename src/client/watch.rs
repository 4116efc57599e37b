//! Commits of a server, as they happen.

use super::Connection;
use crate::base::Result;
use crate::wire::v1;
use tonic::Streaming;

/// Commits after a version (0: the first), or new ones only; those whose footprint meets the region, if one is given.
pub struct Commits<'a> {
    connection: &'a Connection,
    stream: Streaming<v1::Commit>,
}

impl<'a> Commits<'a> {
    /// # Errors
    /// If the version is not kept any more.
    pub async fn watch(
        connection: &'a Connection,
        region: Option<v1::Region>,
        after: Option<u64>,
    ) -> Result<Commits<'a>> {
        let call = connection.watch().commits(v1::CommitsRequest { region, after }).await;
        let stream = call.map_err(|s| connection.failed(s))?.into_inner();
        Ok(Commits { connection, stream })
    }

    /// Waits for the next one; `None`: the server has ended the stream.
    pub async fn next(&mut self) -> Result<Option<v1::Commit>> {
        self.stream.message().await.map_err(|s| self.connection.failed(s))
    }
}
