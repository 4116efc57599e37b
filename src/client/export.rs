//! Files from a server.

use super::Connection;
use crate::base::{Error, Result};
use crate::wire::v1;
use std::io::Write;

/// Writes a file as it comes. Returns the last message: what there is to say of it.
///
/// # Errors
/// What the server refuses, and a stream that ends before the file does: what was written is no whole file then.
pub async fn file(
    connection: &Connection,
    request: v1::FileRequest,
    out: &mut impl Write,
) -> Result<v1::FileChunk> {
    let call = connection.export().file(request).await;
    let mut stream = call.map_err(|s| connection.failed(s))?.into_inner();
    let mut came = 0;
    let mut last = None;
    while let Some(chunk) = stream.message().await.map_err(|s| connection.failed(s))? {
        out.write_all(&chunk.data).map_err(|e| Error::io("the file to write", e))?;
        came += chunk.data.len() as u64;
        last = Some(chunk);
    }
    match last {
        Some(end) if !end.json.is_empty() && end.bytes == came => Ok(end),
        _ => Err(Error::Remote {
            server: connection.server.clone(),
            message: format!("ended the file after {came} bytes; ask again"),
        }),
    }
}
