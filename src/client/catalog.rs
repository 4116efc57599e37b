//! What is in a database, from a server. Lists come whole, and all of one version; long answers line by line.

use super::Connection;
use crate::base::{Error, Result};
use crate::wire::v1;
use tonic::{Response, Status, Streaming};

type Call<T> = std::result::Result<Response<T>, Status>;

impl Connection {
    /// What a call answered.
    fn answer<T>(&self, call: Call<T>) -> Result<T> {
        call.map(Response::into_inner).map_err(|s| self.failed(s))
    }
}

/// Facts of a version (0: the newest); with `sizes` also its counts, which take a walk over the tree.
pub async fn info(c: &Connection, at: u64, sizes: bool) -> Result<v1::InfoReply> {
    c.answer(c.catalog().info(v1::InfoRequest { at, sizes }).await)
}

/// All surveys of a version, or only their frames.
pub async fn surveys(c: &Connection, at: u64, frames_only: bool) -> Result<v1::ListSurveysReply> {
    let mut all = v1::ListSurveysReply::default();
    let mut catalog = c.catalog();
    loop {
        let page_token = std::mem::take(&mut all.next_page_token);
        let request =
            v1::ListSurveysRequest { at, frames_only, page_token: page_token.clone(), ..Default::default() };
        let page = c.answer(catalog.list_surveys(request).await)?;
        all.version = page.version;
        all.surveys.extend(page.surveys);
        all.frames.extend(page.frames);
        if ends(c, &page.next_page_token, &page_token)? {
            return Ok(all);
        }
        all.next_page_token = page.next_page_token;
    }
}

/// A survey by its name, or the beginning of its id.
pub async fn survey(c: &Connection, at: u64, survey: &str) -> Result<v1::GetSurveyReply> {
    let request = v1::GetSurveyRequest { at, survey: survey.to_string() };
    c.answer(c.catalog().get_survey(request).await)
}

/// All tiles of a survey.
pub async fn tiles(c: &Connection, at: u64, survey: &str) -> Result<v1::ListTilesReply> {
    let mut all = v1::ListTilesReply::default();
    let mut catalog = c.catalog();
    loop {
        let page_token = std::mem::take(&mut all.next_page_token);
        let request = v1::ListTilesRequest {
            at,
            survey: survey.to_string(),
            page_token: page_token.clone(),
            ..Default::default()
        };
        let page = c.answer(catalog.list_tiles(request).await)?;
        all.version = page.version;
        all.tiles.extend(page.tiles);
        if ends(c, &page.next_page_token, &page_token)? {
            return Ok(all);
        }
        all.next_page_token = page.next_page_token;
    }
}

/// All versions that are kept.
pub async fn versions(c: &Connection) -> Result<v1::ListVersionsReply> {
    let mut all = v1::ListVersionsReply::default();
    let mut catalog = c.catalog();
    loop {
        let page_token = std::mem::take(&mut all.next_page_token);
        let request = v1::ListVersionsRequest { page_token: page_token.clone(), ..Default::default() };
        let page = c.answer(catalog.list_versions(request).await)?;
        all.version = page.version;
        all.versions.extend(page.versions);
        if ends(c, &page.next_page_token, &page_token)? {
            return Ok(all);
        }
        all.next_page_token = page.next_page_token;
    }
}

/// Whether a page was the last one.
fn ends(c: &Connection, next: &str, token: &str) -> Result<bool> {
    if !next.is_empty() && next == token {
        return Err(Error::Remote { server: c.server.clone(), message: "sends one page for ever".into() });
    }
    Ok(next.is_empty())
}

/// The fingerprint of a version.
pub async fn fingerprint(c: &Connection, at: u64) -> Result<v1::FingerprintReply> {
    c.answer(c.catalog().fingerprint(v1::FingerprintRequest { at }).await)
}

/// Every patch, as lines of JSON.
pub async fn boxes(c: &Connection, at: u64, each: impl FnMut(&[u8]) -> Result<()>) -> Result<u64> {
    let stream = c.answer(c.catalog().boxes(v1::BoxesRequest { at }).await)?;
    lines(c, stream, each).await
}

/// A report, as lines of JSON.
pub async fn report(
    c: &Connection,
    request: v1::ReportRequest,
    each: impl FnMut(&[u8]) -> Result<()>,
) -> Result<u64> {
    let stream = c.answer(c.catalog().report(request).await)?;
    lines(c, stream, each).await
}

/// Hands over whole lines, each with its line feed. Returns the version.
async fn lines(
    c: &Connection,
    mut stream: Streaming<v1::JsonLines>,
    mut each: impl FnMut(&[u8]) -> Result<()>,
) -> Result<u64> {
    let mut version = 0;
    while let Some(message) = stream.message().await.map_err(|s| c.failed(s))? {
        version = message.version;
        message.lines.split_inclusive(|b| *b == b'\n').try_for_each(&mut each)?;
    }
    Ok(version)
}

/// Checks a version; `told` hears what is being checked and the share of it that is. Returns the last message.
pub async fn verify(c: &Connection, at: u64, told: impl Fn(&str, f64)) -> Result<v1::VerifyReply> {
    let mut stream = c.answer(c.catalog().verify(v1::VerifyRequest { at }).await)?;
    while let Some(reply) = stream.message().await.map_err(|s| c.failed(s))? {
        if reply.done {
            return Ok(reply);
        }
        told(&reply.stage, reply.share);
    }
    let message = "ended the check without a result; ask again".to_string();
    Err(Error::Remote { server: c.server.clone(), message })
}

/// Takes surveys, or a tile of one, out.
pub async fn remove(c: &Connection, request: v1::RemoveRequest) -> Result<v1::CommitReply> {
    c.answer(c.catalog().remove(request).await)
}

/// Changes a survey's date or precedence.
pub async fn set(c: &Connection, request: v1::SetRequest) -> Result<v1::CommitReply> {
    c.answer(c.catalog().set(request).await)
}

/// Forgets versions.
pub async fn prune(c: &Connection, what: v1::prune_request::What) -> Result<v1::PruneReply> {
    c.answer(c.catalog().prune(v1::PruneRequest { what: Some(what) }).await)
}

/// Where an operation stands.
pub async fn operation(c: &Connection, operation: &str) -> Result<v1::OperationStatus> {
    let request = v1::GetOperationRequest { operation: operation.to_string() };
    c.answer(c.catalog().get_operation(request).await)
}
