//! Sends surveys: rows in checksummed blocks, and after a broken connection only what had not arrived.

use super::Connection;
use crate::base::{Error, Result};
use crate::height::source::{SampleType, SourceInfo};
use crate::wire::{MESSAGE_BYTES, crc32, v1};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use std::error::Error as _;
use std::io::Write;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Code, Status};

/// Rows of the grids of an upload, wherever they lie. They are asked for in any order, and again where a connection broke.
pub trait Rows: Send + 'static {
    /// Appends rows `[row, row + rows)` of a grid as `SampleBlock.samples` of the wire wants them before they are packed:
    /// little-endian samples, row by row, each row with its mask behind it if the grid is `masked`.
    fn read(&mut self, grid: usize, row: u64, rows: u64, out: &mut Vec<u8>) -> Result<()>;

    /// Rows of a grid that are cheap to read together.
    fn batch(&self, _grid: usize) -> u64 {
        u64::MAX
    }
}

/// What a file says of itself, as a grid of an upload: its samples, whose voids their values mark, in its own units.
///
/// # Errors
/// If the file has no georeference.
pub fn grid_of(info: &SourceInfo) -> Result<v1::Grid> {
    let at = info.affine.ok_or_else(|| {
        Error::invalid(&info.file, "has no georeference; say where it lies with gdal_translate -a_ullr")
    })?;
    let name = Path::new(&info.file).file_name().map(|n| n.to_string_lossy().into_owned());
    let sample_type = match info.sample_type {
        SampleType::U8 => v1::SampleType::Uint8,
        SampleType::I8 => v1::SampleType::Int8,
        SampleType::U16 => v1::SampleType::Uint16,
        SampleType::I16 => v1::SampleType::Int16,
        SampleType::U32 => v1::SampleType::Uint32,
        SampleType::I32 => v1::SampleType::Int32,
        SampleType::F32 => v1::SampleType::Float32,
        SampleType::F64 => v1::SampleType::Float64,
    };
    Ok(v1::Grid {
        name: name.unwrap_or_else(|| info.file.clone()),
        cols: info.cols,
        rows: info.rows,
        sample_type: sample_type as i32,
        x: at.origin[0],
        y: at.origin[1],
        col_dx: at.col_step[0],
        col_dy: at.col_step[1],
        row_dx: at.row_step[0],
        row_dy: at.row_step[1],
        nodata: info.nodata,
        scale: info.scale,
        offset: info.offset,
        ..Default::default()
    })
}

/// Grids that lie in memory: all rows of each, one behind the other.
pub struct InMemory {
    pub grids: Vec<Vec<u8>>,
    /// Bytes of a row of each grid (`Grid::row_bytes`).
    pub row_bytes: Vec<usize>,
}

impl Rows for InMemory {
    fn read(&mut self, grid: usize, row: u64, rows: u64, out: &mut Vec<u8>) -> Result<()> {
        let found = self.grids.get(grid).zip(self.row_bytes.get(grid)).and_then(|(bytes, n)| {
            let (from, to) = (row as usize * n, (row + rows) as usize * n);
            bytes.get(from..to)
        });
        let found = found.ok_or_else(|| {
            Error::invalid(format!("grid {grid}"), format!("has no rows {row} to {}", row + rows))
        })?;
        out.extend_from_slice(found);
        Ok(())
    }
}

/// Reads all rows once and puts their hashes into the header: then a repeat of what the server has sends nothing.
pub fn hash(header: &mut v1::UploadHeader, rows: &mut impl Rows) -> Result<()> {
    for (k, grid) in header.grids.iter_mut().enumerate() {
        let row_bytes = row_bytes(grid)?;
        let (mut hasher, mut at, mut bytes) = (blake3::Hasher::new(), 0, Vec::new());
        while at < grid.rows {
            let n = batch(rows, k, row_bytes).min(grid.rows - at);
            bytes.clear();
            rows.read(k, at, n, &mut bytes)?;
            hasher.update(&bytes);
            at += n;
        }
        grid.hash = hasher.finalize().as_bytes().to_vec().into();
    }
    Ok(())
}

/// Rows of a grid that go into one block.
fn batch(rows: &dyn Rows, grid: usize, row_bytes: u64) -> u64 {
    (MESSAGE_BYTES as u64 / row_bytes.max(1)).max(1).min(rows.batch(grid).max(1))
}

fn row_bytes(g: &v1::Grid) -> Result<u64> {
    g.row_bytes().ok_or_else(|| {
        Error::invalid(format!("grid '{}'", g.name), "its sample type or size is none that can be sent")
    })
}

/// How an upload is sent.
#[derive(Clone, Copy, Debug)]
pub struct Sending {
    /// Blocks are packed where that makes them smaller.
    pub packed: bool,
    /// How often in a row it is tried again without anything having arrived.
    pub tries: u32,
    /// The wait before trying again; it doubles up to `wait_max`.
    pub wait: Duration,
    pub wait_max: Duration,
}

impl Default for Sending {
    fn default() -> Sending {
        Sending {
            packed: true,
            tries: 10,
            wait: Duration::from_millis(200),
            wait_max: Duration::from_secs(10),
        }
    }
}

/// Blocks that are made ahead of the connection.
const AHEAD: usize = 2;

/// Why an attempt ended.
enum Ended {
    /// Trying again may help.
    Broken(Status),
    Refused(Status),
    /// The rows could not be read.
    Unreadable(Error),
}

impl From<Status> for Ended {
    fn from(status: Status) -> Ended {
        // Errors of the connection have a cause; what a server says has none.
        if status.code() == Code::Unavailable || status.source().is_some() {
            Ended::Broken(status)
        } else {
            Ended::Refused(status)
        }
    }
}

/// Sends an upload and waits for its commit. Tries again after a broken connection and sends only what had not arrived.
/// `told` sees every reply.
///
/// # Errors
/// What the server refuses, in its words; rows that cannot be read; a server that cannot be reached for `sending.tries` times
/// in a row.
pub async fn upload(
    connection: &Connection,
    header: v1::UploadHeader,
    rows: impl Rows,
    sending: &Sending,
    told: &mut (dyn FnMut(&v1::UploadReply) + Send),
) -> Result<v1::CommitReply> {
    let rows: Shared = Arc::new(Mutex::new(rows));
    let (mut failures, mut wait) = (0, sending.wait);
    loop {
        let mut arrived = false;
        let mut seen = |r: &v1::UploadReply, first: bool| {
            arrived |= !first && !r.received.is_empty();
            told(r);
        };
        match attempt(connection, &header, &rows, sending.packed, &mut seen).await {
            Ok(commit) => return Ok(commit),
            Err(Ended::Unreadable(e)) => return Err(e),
            Err(Ended::Refused(status)) => return Err(connection.failed(status)),
            Err(Ended::Broken(status)) => {
                if arrived {
                    (failures, wait) = (0, sending.wait);
                }
                failures += 1;
                if failures > sending.tries {
                    return Err(connection.failed(status));
                }
                tokio::time::sleep(wait).await;
                wait = (wait * 2).min(sending.wait_max);
            }
        }
    }
}

type Shared = Arc<Mutex<dyn Rows>>;

async fn attempt(
    connection: &Connection,
    header: &v1::UploadHeader,
    rows: &Shared,
    packed: bool,
    told: &mut (dyn FnMut(&v1::UploadReply, bool) + Send),
) -> std::result::Result<v1::CommitReply, Ended> {
    let gone = || Ended::Broken(Status::unavailable("the server ended the stream before the commit"));
    let (send, requests) = mpsc::channel(AHEAD);
    // The channel has room for it.
    let _ = send.try_send(request(v1::upload_request::Kind::Header(header.clone())));
    let mut replies = connection.ingest().upload(ReceiverStream::new(requests)).await?.into_inner();
    let first = replies.message().await?.ok_or_else(gone)?;
    told(&first, true);
    if let Some(commit) = first.commit {
        return Ok(commit);
    }
    let uploading = first.state == v1::operation_status::State::Uploading as i32;
    let missing = if uploading { missing(header, &first.received) } else { Vec::new() };
    let feeder = async {
        if uploading {
            feed(header, rows, &missing, packed, &send).await?;
            let finish = v1::UploadFinish::default();
            let _ = send.send(request(v1::upload_request::Kind::Finish(finish))).await;
        }
        // The sending side stays open until the answer is there.
        std::future::pending::<Result<v1::CommitReply>>().await
    };
    let reader = async {
        loop {
            let reply = replies.message().await?.ok_or_else(gone)?;
            told(&reply, false);
            if let Some(commit) = reply.commit {
                return Ok::<_, Ended>(commit);
            }
        }
    };
    tokio::select! {
        biased;
        commit = reader => commit,
        unreadable = feeder => unreadable.map_err(Ended::Unreadable),
    }
}

fn request(kind: v1::upload_request::Kind) -> v1::UploadRequest {
    v1::UploadRequest { kind: Some(kind) }
}

/// Rows that have not arrived.
fn missing(header: &v1::UploadHeader, received: &[v1::RowSpan]) -> Vec<v1::RowSpan> {
    let mut out = Vec::new();
    for (grid, g) in (0u32..).zip(&header.grids) {
        let mut there: Vec<&v1::RowSpan> = received.iter().filter(|s| s.grid == grid).collect();
        there.sort_unstable_by_key(|s| s.row);
        let mut next = 0;
        for s in there {
            if s.row > next {
                out.push(v1::RowSpan { grid, row: next, rows: s.row - next });
            }
            next = next.max(s.row.saturating_add(s.rows));
        }
        if next < g.rows {
            out.push(v1::RowSpan { grid, row: next, rows: g.rows - next });
        }
    }
    out
}

/// Sends spans of rows in blocks. Ends early, without an error, if nobody takes them any more.
async fn feed(
    header: &v1::UploadHeader,
    rows: &Shared,
    spans: &[v1::RowSpan],
    packed: bool,
    send: &mpsc::Sender<v1::UploadRequest>,
) -> Result<()> {
    for span in spans {
        let Some(g) = header.grids.get(span.grid as usize) else { continue };
        let row_bytes = row_bytes(g)?;
        let mut at = span.row;
        while at < span.row + span.rows {
            let (rows, s) = (rows.clone(), *span);
            let left = span.row + span.rows - at;
            let made = tokio::task::spawn_blocking(move || {
                let mut rows = rows.lock().unwrap_or_else(PoisonError::into_inner);
                let n = batch(&*rows, s.grid as usize, row_bytes).min(left);
                block(&mut *rows, s.grid, at, n, n * row_bytes, packed)
            });
            let made = made.await.map_err(|e| Error::invalid("reading rows", e))??;
            at += u64::from(made.rows);
            if send.send(request(v1::upload_request::Kind::Block(made))).await.is_err() {
                return Ok(());
            }
        }
    }
    Ok(())
}

/// One block; `bytes`: what it must have unpacked.
fn block(
    source: &mut dyn Rows,
    grid: u32,
    row: u64,
    rows: u64,
    bytes: u64,
    packed: bool,
) -> Result<v1::SampleBlock> {
    use v1::sample_block::Packing;
    let mut samples = Vec::with_capacity(bytes as usize);
    source.read(grid as usize, row, rows, &mut samples)?;
    if samples.len() as u64 != bytes {
        let reason = format!("{} bytes of samples, rows {row} to {} have {bytes}", samples.len(), row + rows);
        return Err(Error::invalid(format!("grid {grid}"), reason));
    }
    let mut packing = Packing::None;
    if packed {
        let mut zlib = ZlibEncoder::new(Vec::with_capacity(samples.len() / 2), Compression::fast());
        let small = zlib.write_all(&samples).and_then(|()| zlib.finish());
        let small = small.map_err(|e| Error::invalid(format!("packing grid {grid}"), e))?;
        if small.len() < samples.len() {
            (samples, packing) = (small, Packing::Zlib);
        }
    }
    Ok(v1::SampleBlock {
        grid,
        row,
        rows: rows as u32,
        packing: packing as i32,
        crc32: crc32(&samples),
        samples: samples.into(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_missing_is_what_no_span_names() {
        let grid = |rows| v1::Grid { rows, ..Default::default() };
        let header = v1::UploadHeader { grids: vec![grid(10), grid(3), grid(4)], ..Default::default() };
        let span = |grid, row, rows| v1::RowSpan { grid, row, rows };
        assert_eq!(missing(&header, &[]), [span(0, 0, 10), span(1, 0, 3), span(2, 0, 4)]);
        let received =
            [span(0, 6, 2), span(0, 0, 2), span(0, 1, 3), span(1, 0, 3), span(2, 1, 9), span(7, 0, 1)];
        assert_eq!(missing(&header, &received), [span(0, 4, 2), span(0, 8, 2), span(2, 0, 1)]);
    }
}
