//! Uploads in progress: samples as they arrive, in a folder each, until they are committed.
//!
//! - [`Uploads`]: which there are, who is at work on one, and what is to be removed;
//! - [`staging`]: the folder of one; `journal`, `rows`: which rows of it are durable.
//!
//! A row of the catalog of uploads comes before its folder and goes after it, so whatever has no row is a leftover. Everything
//! here blocks: call it where that is allowed.

mod journal;
mod rows;
pub mod staging;

use super::Settings;
use super::model::upload::{self, Said, StagedGrid};
use super::pools::Answer;
use crate::base::bytes::Put;
use crate::base::{Error, Result};
use crate::db::{self, Db, Outcome};
use crate::height::frame::CellRect;
use crate::wire::v1;
use prost::Message;
use staging::Staging;
use std::collections::{HashMap, HashSet};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use tokio::sync::watch;

/// A row whose folder is missing is left alone for so long: another server may be about to make it.
const BEGINNING: Duration = Duration::from_secs(10);
/// The longest time between two looks for what is to be removed.
const LOOK_EVERY: Duration = Duration::from_secs(600);
/// Room that a commit needs beside what it writes.
const ROOM_BYTES: u64 = 4 << 20;

/// How a commit ended; `None` while it is under way.
pub type Ending = watch::Receiver<Option<Answer<v1::CommitReply>>>;

/// What is being done with an operation.
#[derive(Clone)]
enum Work {
    /// Its samples come in, or it is being looked at.
    Taken,
    Committing(Ending),
}

/// Uploads in progress.
pub struct Uploads {
    db: Arc<Db>,
    kept: Duration,
    most: u64,
    most_bytes: u64,
    work: Mutex<HashMap<String, Work>>,
    catalog: Mutex<Option<db::Uploads>>,
    stopped: OnceLock<watch::Receiver<bool>>,
}

/// The right to work on one operation; given back when dropped.
pub struct Claim {
    uploads: Arc<Uploads>,
    operation: String,
}

impl Drop for Claim {
    fn drop(&mut self) {
        self.uploads.work().remove(&self.operation);
    }
}

impl Claim {
    pub fn operation(&self) -> &str {
        &self.operation
    }

    /// Whoever claims the operation from now on is shown how its commit ends.
    pub fn committing(&self, ending: Ending) {
        self.uploads.work().insert(self.operation.clone(), Work::Committing(ending));
    }
}

/// What a claim found.
pub enum Claimed {
    Mine(Claim),
    /// It is being committed already.
    Committing(Ending),
}

/// An upload as it is listed.
pub struct Listed {
    pub operation: String,
    pub name: String,
    pub grids: u64,
    pub rows_received: u64,
    pub rows: u64,
    pub touched_at: i64,
    pub active: bool,
}

/// Seconds since 1970 UTC.
fn now() -> i64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_secs() as i64)
}

/// Name of the folder of an operation: whatever its caller called it, it is a name that every file system takes.
fn folder_name(operation: &str) -> String {
    blake3::hash(operation.as_bytes()).to_hex()[..32].to_string()
}

impl Uploads {
    pub fn new(db: Arc<Db>, settings: &Settings) -> Uploads {
        Uploads {
            db,
            kept: settings.uploads_kept,
            most: settings.uploads_max,
            most_bytes: settings.uploads_bytes_max,
            work: Mutex::default(),
            catalog: Mutex::default(),
            stopped: OnceLock::new(),
        }
    }

    fn work(&self) -> MutexGuard<'_, HashMap<String, Work>> {
        self.work.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn folder(&self, operation: &str) -> PathBuf {
        self.db.uploads_folder().join(folder_name(operation))
    }

    /// The catalog, opened when it is first needed.
    fn catalog<T>(&self, f: impl FnOnce(&mut db::Uploads) -> Result<T>) -> Result<T> {
        let mut slot = self.catalog.lock().unwrap_or_else(PoisonError::into_inner);
        match slot.as_mut() {
            Some(open) => f(open),
            None => f(slot.insert(self.db.uploads()?)),
        }
    }

    /// Takes an operation, so that nobody else works on it.
    ///
    /// # Errors
    /// If somebody does, or too many are being worked on.
    pub fn claim(self: &Arc<Self>, operation: &str) -> Result<Claimed> {
        let mut work = self.work();
        match work.get(operation) {
            Some(Work::Committing(ending)) => return Ok(Claimed::Committing(ending.clone())),
            Some(Work::Taken) => {
                return Err(Error::Busy {
                    what: format!(
                        "upload '{operation}' has a stream already, and has one at a time; try again when that has ended"
                    ),
                });
            }
            None => {}
        }
        if work.len() as u64 >= self.most {
            return Err(Error::Busy {
                what: format!("{} uploads are being received, no more at once; try again later", work.len()),
            });
        }
        work.insert(operation.to_string(), Work::Taken);
        Ok(Claimed::Mine(Claim { uploads: self.clone(), operation: operation.to_string() }))
    }

    /// Compares a header with the one that began its upload; does nothing if there is none.
    pub fn compare(&self, header: &v1::UploadHeader) -> Result<()> {
        let Some(was) = self.began(&header.operation)? else { return Ok(()) };
        match upload::difference(&was, header) {
            None => Ok(()),
            Some(what) => Err(Error::invalid(
                format!("upload '{}'", header.operation),
                format!(
                    "began with another header: {what}; send the same, abandon the upload, or choose another operation"
                ),
            )),
        }
    }

    /// The tile that a grid with a hash became before, of the posts that it covers.
    pub fn delivered(&self, grid: &StagedGrid, at: &CellRect) -> Result<Option<[u8; 16]>> {
        // Where nothing was uploaded yet there is no catalog to ask, and none is made.
        if grid.hash.is_none() || !self.db.uploads_folder().exists() {
            return Ok(None);
        }
        let Some(id) = delivery(grid, grid.hash.as_ref(), at) else { return Ok(None) };
        self.catalog(|c| c.delivered(&id))
    }

    /// Notes which tiles the grids of a committed upload became, where their hashes were told.
    pub fn deliver(&self, said: &Said, hashes: &[Option<[u8; 32]>], outcome: &Outcome) -> Result<()> {
        let infos: Vec<_> = said.grids.iter().map(|g| g.info.clone()).collect();
        let snapshot = self.db.snapshot(Some(outcome.version))?;
        let tiles = self.db.tiles_of(&snapshot, &outcome.survey, &infos)?;
        let mut found = Vec::new();
        for (k, (grid, tile)) in said.grids.iter().zip(tiles).enumerate() {
            let hash = grid.hash.or(hashes.get(k).copied().flatten());
            if let Some((at, key)) = tile
                && let Some(id) = delivery(grid, hash.as_ref(), &at)
            {
                found.push((id, key));
            }
        }
        if found.is_empty() { Ok(()) } else { self.catalog(|c| c.deliver(&found)) }
    }

    /// Opens the folder of an upload, or begins it.
    ///
    /// # Errors
    /// If there are too many uploads; if the disk has too little room for the samples and their commit.
    pub fn open(&self, claim: &Claim, header: &v1::UploadHeader, said: &Said) -> Result<Staging> {
        let operation = claim.operation();
        if self.catalog(|c| c.header(operation))?.is_none() {
            let here = folder_bytes(&self.folder(operation));
            let wanted = staging::room(said).saturating_sub(here);
            // A commit writes segments beside the samples that it reads.
            self.need_room(operation, wanted + said.bytes + said.bytes / 2 + ROOM_BYTES)?;
            let row = db::Upload {
                operation: operation.to_string(),
                bytes: staging::room(said),
                touched_at: now(),
            };
            self.catalog(|c| c.add(&row, &header.encode_to_vec(), self.most, self.most_bytes))?;
        } else {
            self.touch(operation)?;
        }
        Staging::open(&self.folder(operation), said)
    }

    /// Refuses to begin what cannot end, counting what other uploads may still bring.
    fn need_room(&self, operation: &str, wanted: u64) -> Result<()> {
        let Some(free) = self.db.free_bytes()? else { return Ok(()) };
        let others = self.catalog(|c| c.all())?;
        let others = others.iter().filter(|u| u.operation != operation);
        let awaited: u64 =
            others.map(|u| u.bytes.saturating_sub(folder_bytes(&self.folder(&u.operation)))).sum();
        if free < wanted.saturating_add(awaited) {
            let place = self.db.uploads_folder().display().to_string();
            return Err(Error::NoSpace { place, wanted: wanted.saturating_add(awaited), free });
        }
        Ok(())
    }

    /// Notes a sign of life.
    pub fn touch(&self, operation: &str) -> Result<()> {
        self.catalog(|c| c.touch(operation, now()))
    }

    /// Removes an upload and what arrived of it. Returns whether there was one.
    pub fn remove(&self, claim: &Claim) -> Result<bool> {
        remove_folder(&self.folder(claim.operation()))?;
        self.catalog(|c| c.remove(claim.operation()))
    }

    /// Forgets an upload that nobody works on. Returns whether there was one.
    pub fn abandon(self: &Arc<Self>, operation: &str) -> Result<bool> {
        let busy = || {
            let what = "a stream of it is open, or it is being committed";
            Err(Error::unsupported(format!("upload '{operation}'"), what, "end that first"))
        };
        let claim = match self.claim(operation) {
            Ok(Claimed::Mine(claim)) => claim,
            Ok(Claimed::Committing(_)) | Err(Error::Busy { .. }) => return busy(),
            Err(e) => return Err(e),
        };
        // Another server may be receiving it.
        self.alone(operation, || self.remove(&claim))?.map_or_else(busy, Ok)
    }

    /// Does something while no other server can receive an upload; `None` if one does.
    fn alone<T>(&self, operation: &str, f: impl FnOnce() -> Result<T>) -> Result<Option<T>> {
        let folder = self.folder(operation);
        if !folder.exists() {
            return f().map(Some);
        }
        let Some(_held) = staging::lock(&folder)? else { return Ok(None) };
        f().map(Some)
    }

    /// Uploads in progress, by operation.
    pub fn list(&self) -> Result<Vec<Listed>> {
        let all = self.catalog(|c| c.all())?;
        let active: HashSet<String> = self.work().keys().cloned().collect();
        let mut out = Vec::with_capacity(all.len());
        for u in all {
            // It may be gone meanwhile.
            let Some(header) = self.began(&u.operation)? else { continue };
            let mut rows = rows::RowSet::new(header.grids.iter().map(|g| g.rows));
            journal::read(&self.folder(&u.operation).join(staging::RECEIVED), &mut |s| {
                if rows.holds(&s) {
                    rows.add(&s);
                }
            })?;
            out.push(Listed {
                name: named(&header),
                grids: header.grids.len() as u64,
                rows_received: rows.there(),
                rows: header.grids.iter().map(|g| g.rows).sum(),
                touched_at: u.touched_at,
                active: active.contains(&u.operation),
                operation: u.operation,
            });
        }
        Ok(out)
    }

    /// The header that began an upload, if it is in progress.
    fn began(&self, operation: &str) -> Result<Option<v1::UploadHeader>> {
        let Some(bytes) = self.catalog(|c| c.header(operation))? else { return Ok(None) };
        let damaged = |e| {
            let place = format!("header of upload '{operation}'");
            Error::corrupt("uploads/catalog.sqlite", place, format!("{e}; abandon the upload"))
        };
        v1::UploadHeader::decode(&bytes[..]).map(Some).map_err(damaged)
    }

    /// How many uploads are not committed yet.
    pub fn count(&self) -> Result<usize> {
        Ok(self.catalog(|c| c.all())?.len())
    }

    /// Removes uploads that were committed or that nobody touched for too long, rows without a folder, and folders without a
    /// row. Returns how many.
    pub fn sweep(self: &Arc<Self>) -> Result<usize> {
        let root = self.db.uploads_folder();
        if !root.exists() {
            return Ok(0);
        }
        // Folders first: one that is made from here on is not in the list, and one in the list had its row before.
        let folders = folders(&root)?;
        let rows = self.catalog(|c| c.all())?;
        let mut removed = 0;
        for row in &rows {
            if self.is_left(row)?
                && let Ok(Claimed::Mine(claim)) = self.claim(&row.operation)
            {
                let gone = self.alone(&row.operation, || {
                    // It may have gone on before it was claimed.
                    let unchanged = self.catalog(|c| c.all())?.contains(row);
                    if unchanged { self.remove(&claim) } else { Ok(false) }
                })?;
                removed += usize::from(gone == Some(true));
            }
        }
        let orphans = |rows: &[db::Upload]| {
            let named: HashSet<String> = rows.iter().map(|r| folder_name(&r.operation)).collect();
            folders.iter().filter(|n| !named.contains(*n)).cloned().collect::<Vec<_>>()
        };
        for name in orphans(&rows) {
            let folder = root.join(&name);
            if folder.exists()
                && let Some(_held) = staging::lock(&folder)?
                // An abandoned one may have begun again meanwhile.
                && orphans(&self.catalog(|c| c.all())?).contains(&name)
            {
                remove_folder(&folder)?;
                removed += 1;
            }
        }
        Ok(removed)
    }

    /// Whether an upload was committed, or nobody touched it for too long.
    fn is_left(&self, row: &db::Upload) -> Result<bool> {
        let age = now().saturating_sub(row.touched_at).max(0) as u64;
        let begun = self.folder(&row.operation).exists();
        Ok(age > self.kept.as_secs()
            || (!begun && age > BEGINNING.as_secs())
            || self.db.operation(&row.operation)?.is_some())
    }

    /// Waits until the server stops: no more samples are taken then.
    pub async fn stopping(&self) {
        match self.stopped.get().cloned() {
            Some(mut stopped) => {
                let _ = stopped.wait_for(|s| *s).await;
            }
            None => std::future::pending().await,
        }
    }

    /// Sweeps now, and now and then until told to stop.
    pub fn sweep_on(self: &Arc<Self>, mut stopped: watch::Receiver<bool>) {
        let uploads = self.clone();
        let _ = self.stopped.set(stopped.clone());
        tokio::spawn(async move {
            let every = (uploads.kept / 4).clamp(Duration::from_secs(1), LOOK_EVERY);
            while !*stopped.borrow() {
                let swept = uploads.clone();
                match tokio::task::spawn_blocking(move || swept.sweep()).await {
                    Ok(Ok(0)) => {}
                    Ok(Ok(n)) => tracing::info!("removed {n} uploads that ended or were left"),
                    Ok(Err(e)) => tracing::warn!("removing uploads that were left: {e}"),
                    Err(e) => tracing::warn!("removing uploads that were left: {e}"),
                }
                tokio::select! {
                    _ = tokio::time::sleep(every) => {}
                    _ = stopped.changed() => break,
                }
            }
        });
    }
}

/// What a grid is and what its rows hash to, as one hash: equal ones become the same tile.
fn delivery(grid: &StagedGrid, hash: Option<&[u8; 32]>, at: &CellRect) -> Option<[u8; 32]> {
    let mut bytes = Vec::with_capacity(128);
    bytes.put(b"terraquilt delivery 1");
    for v in [at.i0, at.j0, at.i1, at.j1] {
        bytes.put_i64(v);
    }
    bytes.put_u8(grid.info.sample_type as u8);
    bytes.put_u8(u8::from(grid.masked));
    bytes.put_u8(u8::from(grid.info.nodata.is_some()));
    bytes.put_f64(grid.info.nodata.unwrap_or(0.0));
    bytes.put(hash?);
    Some(*blake3::hash(&bytes).as_bytes())
}

/// What a survey will be called, as far as it is said.
fn named(h: &v1::UploadHeader) -> String {
    use v1::upload_header::Target;
    match &h.target {
        Some(Target::Into(s) | Target::Replace(s)) => s.clone(),
        None if !h.name.is_empty() => h.name.clone(),
        None => h.grids.first().map_or_else(String::new, |g| g.name.clone()),
    }
}

/// Folders of uploads.
fn folders(root: &Path) -> Result<Vec<String>> {
    let mut out = Vec::new();
    for entry in std::fs::read_dir(root).map_err(|e| Error::io(root, e))? {
        let entry = entry.map_err(|e| Error::io(root, e))?;
        if let Some(name) = entry.file_name().to_str()
            && name.len() == 32
            && name.bytes().all(|b| b.is_ascii_hexdigit())
            && entry.path().is_dir()
        {
            out.push(name.to_string());
        }
    }
    Ok(out)
}

/// Bytes that a folder takes on the disk.
fn folder_bytes(folder: &Path) -> u64 {
    let Ok(entries) = std::fs::read_dir(folder) else { return 0 };
    entries.filter_map(|e| e.ok()?.metadata().ok()).map(|m| m.blocks() * 512).sum()
}

fn remove_folder(folder: &Path) -> Result<()> {
    match std::fs::remove_dir_all(folder) {
        Ok(()) => folder.parent().map_or(Ok(()), staging::sync_folder),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(Error::io(folder, e)),
    }
}
