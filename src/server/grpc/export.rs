//! `Export`: files, made in the pool of work, sent as the client reads.
//!
//! A file is written under no name (unlinked as soon as it is made), so nothing is left of it however the call ends.

use super::outgoing::{Outgoing, Stream, stream};
use crate::base::{Error, Result};
use crate::db::Snapshot;
use crate::export::{write_samples, write_surface};
use crate::server::model::export::{File as Wanted, file};
use crate::server::status::status;
use crate::server::{Answer, State};
use crate::wire::v1;
use crate::wire::v1::export_server::Export;
use std::fs::File;
use std::io::{BufWriter, Seek, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use tokio::io::AsyncReadExt;
use tokio::sync::Semaphore;
use tonic::{Request, Response, Status};

/// Bytes of a piece.
const CHUNK: usize = 256 << 10;
/// Files that are waited for, made or sent at once.
const FILES_MAX: usize = 16;
/// Files that are made at once, as far as there are cores to leave one.
const MADE_AT_ONCE: usize = 2;

/// The service.
pub struct ExportService {
    state: Arc<State>,
    files: Arc<Semaphore>,
    making: Arc<Semaphore>,
}

impl ExportService {
    pub fn new(state: Arc<State>) -> ExportService {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let making = MADE_AT_ONCE.min(cores.saturating_sub(1)).max(1);
        let semaphore = |n| Arc::new(Semaphore::new(n));
        ExportService { state, files: semaphore(FILES_MAX), making: semaphore(making) }
    }
}

/// Tells the work that nobody waits for it any more.
struct Wanting(Arc<AtomicBool>);

impl Drop for Wanting {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// A file that is complete, and what there is to say of it.
struct Made {
    file: File,
    bytes: u64,
    json: String,
    notes: Vec<String>,
}

#[tonic::async_trait]
impl Export for ExportService {
    type FileStream = Stream<v1::FileChunk>;

    async fn file(&self, request: Request<v1::FileRequest>) -> Answer<Response<Self::FileStream>> {
        let r = request.into_inner();
        let Ok(one) = self.files.clone().try_acquire_owned() else {
            return Err(Status::resource_exhausted(format!(
                "{FILES_MAX} files are being made and sent already, no more at once; ask again later"
            )));
        };
        let (state, making) = (self.state.clone(), self.making.clone());
        let live = state.live.clone();
        let most = state.settings.points_max;
        let (snapshot, wanted) = state
            .pools
            .work(move || {
                let s = live.snapshot(r.at)?;
                let wanted = file(&r, &s, most)?;
                Ok((s, wanted))
            })
            .await?;
        Ok(stream(|out| async move {
            let _one = one;
            let stop = Arc::new(AtomicBool::new(false));
            let _wanting = Wanting(stop.clone());
            let turn = making.acquire_owned().await.map_err(|e| Status::internal(e.to_string()))?;
            let version = snapshot.number();
            let made = state
                .pools
                .work(move || {
                    let _turn = turn;
                    make(&snapshot, &wanted, &stop)
                })
                .await?;
            send(made, version, &out).await
        }))
    }
}

fn make(s: &Snapshot, wanted: &Wanted, stop: &AtomicBool) -> Result<Made> {
    let io = |e| Error::io(std::env::temp_dir(), e);
    let mut out = BufWriter::new(tempfile::tempfile().map_err(io)?);
    let going = |_: &str, _: f64| !stop.load(Ordering::Relaxed);
    let (written, tolerance) = match wanted {
        Wanted::Surface(r) => (write_surface(&mut out, s, r, &going)?, Some(&r.query.tolerance)),
        Wanted::Samples { survey, tile } => {
            (write_samples(&mut out, s, survey, tile.as_deref(), &going)?, None)
        }
    };
    out.flush().map_err(io)?;
    let mut file = out.into_inner().map_err(|e| io(e.into_error()))?;
    let bytes = file.metadata().map_err(io)?.len();
    file.rewind().map_err(io)?;
    let json = serde_json::to_string(&written).map_err(|e| Error::invalid("JSON of the file", e))?;
    let notes = match wanted {
        Wanted::Surface(r) => r.place.coords.iter().flat_map(|c| c.notes.clone()).collect(),
        Wanted::Samples { .. } => Vec::new(),
    };
    let notes = [notes, written.notes(tolerance)].concat();
    Ok(Made { file, bytes, json, notes })
}

async fn send(made: Made, version: u64, out: &Outgoing<v1::FileChunk>) -> Answer<()> {
    let mut file = tokio::fs::File::from_std(made.file);
    let mut left = made.bytes;
    while left > 0 {
        out.room().await?;
        let mut data = vec![0; CHUNK.min(left as usize)];
        file.read_exact(&mut data).await.map_err(|e| status(Error::io(std::env::temp_dir(), e)))?;
        left -= data.len() as u64;
        out.send(v1::FileChunk { version, data: data.into(), ..Default::default() }).await?;
    }
    let (json, bytes, notes) = (made.json, made.bytes, made.notes);
    out.send(v1::FileChunk { version, data: Default::default(), json, bytes, notes }).await
}
