//! Surveys in files that the server can see, below the one directory that it was started with.

use super::arrival::{Told, blocking, done, follow, known, settle};
use crate::base::{Error, Result, limits};
use crate::format;
use crate::height::source::HeightSource;
use crate::server::model::upload;
use crate::server::operations;
use crate::server::pools::Answer;
use crate::server::state::State;
use crate::server::status::{short, status};
use crate::server::uploads::Claimed;
use crate::wire::v1;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;
use tonic::{Code, Status};

/// Ingests files as one survey.
pub async fn files(state: &Arc<State>, request: v1::FilesRequest, told: &Told) -> Answer<()> {
    let Some(root) = state.settings.ingest_from.clone() else {
        return Err(Status::failed_precondition(
            "this server takes no files that lie beside it; `terraquilt serve --ingest-from DIR` allows those below DIR",
        ));
    };
    let header = request.header.unwrap_or_default();
    let operation = upload::operation(&header.operation).map_err(status)?;
    if let Some(commit) = known(state, &operation).await? {
        return done(told, &operation, commit).await;
    }
    let said = upload::said_of_files(&header).map_err(status)?;
    let count = request.paths.len() as u64;
    if count == 0 {
        return Err(Status::invalid_argument("paths: none is given; name files below the directory"));
    }
    if count > limits::FILES_MAX {
        return Err(status(Error::limit("paths", limits::FILES_MAX, count)));
    }
    let paths = request.paths;
    let found = blocking(move || Ok(paths.iter().map(|p| inside(&root, p)).collect::<Answer<Vec<_>>>()));
    let paths = found.await??;
    let (uploads, id) = (state.uploads.clone(), operation.clone());
    let claim = match blocking(move || uploads.claim(&id)).await? {
        Claimed::Mine(claim) => claim,
        Claimed::Committing(ending) => return follow(state, &operation, ending, told).await,
    };
    let ending = settle(claim, |claim| {
        let (state, id) = (state.clone(), operation.clone());
        async move {
            let (live, s, nodata) = (state.live.clone(), said.clone(), request.nodata);
            let opened = state.pools.work(move || {
                let sources = paths.iter().map(|p| open(p, nodata)).collect::<Result<_>>()?;
                let change = s.change(sources);
                live.look()?;
                live.db().foresee(&live.newest(), &change, &|_, _| Ok(None))?;
                Ok(change)
            });
            let change = opened.await?;
            let outcome = operations::commit(&state, id.clone(), said.dry_run, move || Ok(change)).await?;
            drop(claim);
            Ok(operations::reply(&outcome, &id))
        }
    });
    follow(state, &operation, ending, told).await
}

fn open(path: &Path, nodata: Option<f64>) -> Result<Box<dyn HeightSource>> {
    let mut source = format::open(path)?;
    if let Some(v) = nodata {
        source.set_nodata(v);
    }
    Ok(source)
}

/// The file that a path names, if it lies below the directory, symbolic links followed.
fn inside(root: &Path, path: &str) -> Answer<PathBuf> {
    let outside = || {
        Status::new(
            Code::PermissionDenied,
            short(format!("file '{path}' is not below the directory that this server may take files from")),
        )
    };
    // Before the disk is asked: what is outside is not told, not even whether it exists.
    let plain = |c: Component| matches!(c, Component::Normal(_) | Component::CurDir);
    if path.is_empty() || path.contains('\0') || !Path::new(path).components().all(plain) {
        return Err(outside());
    }
    let root = root.canonicalize().map_err(|e| status(Error::io(root, e)))?;
    let missing = || status(Error::missing(format!("file '{path}'"), "check the name"));
    let found = root.join(path).canonicalize().map_err(|_| missing())?;
    if !found.starts_with(&root) {
        return Err(outside());
    }
    Ok(found)
}
