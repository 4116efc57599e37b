//! The folder of one upload: samples as they arrive, at the place where they belong, and which of them are durable.

use super::journal::{ENTRY_BYTES, Journal};
use super::rows::{RowSet, joined};
use crate::base::{Error, Result};
use crate::format;
use crate::height::source::{HeightSource, Samples, SourceInfo, Window};
use crate::server::model::upload::{Said, StagedGrid};
use crate::wire::v1::{RowSpan, SampleBlock, sample_block::Packing};
use crate::wire::{self, MESSAGE_BYTES};
use flate2::read::ZlibDecoder;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read};
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};

/// File of the rows of all grids.
const SAMPLES: &str = "samples";
/// File that names the rows that are durable.
pub const RECEIVED: &str = "received";

/// What arrived of an upload. The one who has it is the only one who writes there: it holds a lock.
pub struct Staging {
    folder: PathBuf,
    samples: File,
    journal: Journal,
    grids: Vec<StagedGrid>,
    rows: RowSet,
    /// Rows that were written and are not durable yet.
    fresh: Vec<RowSpan>,
    fresh_bytes: u64,
}

/// Room that an upload may take: its rows, and an entry for each.
pub fn room(said: &Said) -> u64 {
    said.bytes + said.rows * ENTRY_BYTES + 4096
}

/// A lock on a folder of an upload, held as long as the file is; `None` if another process has it.
pub fn lock(folder: &Path) -> Result<Option<File>> {
    let path = folder.join(SAMPLES);
    let samples = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(&path);
    let samples = samples.map_err(|e| Error::io(&path, e))?;
    match samples.try_lock() {
        Ok(()) => {
            // Whoever held it may have removed it.
            let held = samples.metadata().map_err(|e| Error::io(&path, e))?.ino();
            let there = std::fs::metadata(&path).is_ok_and(|m| m.ino() == held);
            Ok(there.then_some(samples))
        }
        Err(TryLockError::WouldBlock) => Ok(None),
        Err(TryLockError::Error(e)) => Err(Error::io(&path, e)),
    }
}

/// Makes creations and removals in a folder durable.
pub fn sync_folder(path: &Path) -> Result<()> {
    File::open(path).and_then(|f| f.sync_all()).map_err(|e| Error::io(path, e))
}

impl Staging {
    /// Opens the folder of an upload, or begins it.
    ///
    /// # Errors
    /// If another process receives it; if it is damaged.
    pub fn open(folder: &Path, said: &Said) -> Result<Staging> {
        std::fs::create_dir_all(folder).map_err(|e| Error::io(folder, e))?;
        let path = folder.join(SAMPLES);
        let samples = lock(folder)?.ok_or_else(|| Error::Busy {
            what: format!("upload '{}': another server receives it; try again later", said.operation),
        })?;
        let io = |e| Error::io(&path, e);
        let length = samples.metadata().map_err(io)?.len();
        let mut rows = RowSet::new(said.grids.iter().map(|g| g.info.rows));
        let mut unknown = None;
        let journal = Journal::open(&folder.join(RECEIVED), &mut |span| {
            if rows.holds(&span) {
                rows.add(&span);
            } else {
                unknown = Some(span);
            }
        })?;
        if let Some(s) = unknown {
            return Err(Error::corrupt(
                folder.join(RECEIVED).display(),
                format!("entry of grid {}, rows {} to {}", s.grid, s.row, s.row.saturating_add(s.rows)),
                "its header has no such rows; abandon the upload and send it again",
            ));
        }
        if length != said.bytes {
            if rows.there() > 0 {
                let reason = format!(
                    "{length} bytes, its rows are {}; abandon the upload and send it again",
                    said.bytes
                );
                return Err(Error::corrupt(path.display(), "length", reason));
            }
            samples.set_len(said.bytes).and_then(|()| samples.sync_all()).map_err(io)?;
        }
        // Also of a folder that was there: who made it may have been killed before it was durable.
        for above in folder.ancestors().take(3) {
            sync_folder(above)?;
        }
        let (fresh, fresh_bytes) = (Vec::new(), 0);
        Ok(Staging {
            folder: folder.to_path_buf(),
            samples,
            journal,
            grids: said.grids.clone(),
            rows,
            fresh,
            fresh_bytes,
        })
    }

    /// Which rows are there.
    pub fn rows(&self) -> &RowSet {
        &self.rows
    }

    /// Bytes that were written and are not durable yet.
    pub fn fresh_bytes(&self) -> u64 {
        self.fresh_bytes
    }

    /// Writes rows; those that are there already are left as they are.
    pub fn write(&mut self, block: &Block) -> Result<()> {
        let Some(grid) = self.grids.get(block.span.grid as usize) else {
            return Err(Error::invalid("block", format!("there is no grid {}", block.span.grid)));
        };
        for s in self.rows.absent(&block.span) {
            let from = ((s.row - block.span.row) * grid.row_bytes) as usize;
            let bytes = &block.rows[from..from + (s.rows * grid.row_bytes) as usize];
            self.samples.write_all_at(bytes, grid.at + s.row * grid.row_bytes).map_err(|e| {
                match e.kind() {
                    ErrorKind::StorageFull | ErrorKind::QuotaExceeded => Error::NoSpace {
                        place: self.folder.display().to_string(),
                        wanted: bytes.len() as u64,
                        free: 0,
                    },
                    _ => Error::io(self.folder.join(SAMPLES), e),
                }
            })?;
            self.rows.add(&s);
            self.fresh_bytes += bytes.len() as u64;
            self.fresh.push(s);
        }
        Ok(())
    }

    /// Makes durable what was written. Returns the rows.
    pub fn sync(&mut self) -> Result<Vec<RowSpan>> {
        if self.fresh.is_empty() {
            return Ok(Vec::new());
        }
        // Tried once: after a failure a second sync may succeed though the bytes are lost.
        let spans = joined(std::mem::take(&mut self.fresh));
        self.fresh_bytes = 0;
        self.samples.sync_data().map_err(|e| Error::io(self.folder.join(SAMPLES), e))?;
        self.journal.add(&spans)?;
        Ok(spans)
    }

    /// Refuses an upload with rows missing.
    pub fn complete(&self) -> Result<()> {
        if self.rows.is_complete() {
            return Ok(());
        }
        let named = |s: RowSpan| {
            let last = s.row + s.rows - 1;
            format!("'{}' rows {} to {last}", self.grids[s.grid as usize].info.file, s.row)
        };
        let mut missing: Vec<String> = self.rows.spans(false, 6).into_iter().map(named).collect();
        if missing.len() == 6 {
            missing[5] = "and more".into();
        }
        let all: u64 = self.grids.iter().map(|g| g.info.rows).sum();
        Err(Error::unsupported(
            "finish",
            format!("{} of {all} rows are here, missing are {}", self.rows.there(), missing.join(", ")),
            "call again with the same header and send them",
        ))
    }

    /// Compares the rows of each grid with the hash that was told of them. Reads what has one.
    ///
    /// # Errors
    /// If one differs: then all rows are forgotten, so that they can be sent again.
    pub fn check_hashes(&mut self, told: &[Option<[u8; 32]>]) -> Result<()> {
        for (k, grid) in self.grids.iter().enumerate() {
            for wanted in [grid.hash, told.get(k).copied().flatten()].into_iter().flatten() {
                let found = self.hash(grid)?;
                if found.as_bytes() != &wanted {
                    self.journal.clear()?;
                    self.rows = RowSet::new(self.grids.iter().map(|g| g.info.rows));
                    return Err(Error::invalid(
                        format!("hash of grid '{}'", grid.info.file),
                        format!(
                            "the rows that arrived hash to {}, {} was told; all rows were forgotten: call again and send them anew",
                            found.to_hex(),
                            blake3::Hash::from_bytes(wanted).to_hex()
                        ),
                    ));
                }
            }
        }
        Ok(())
    }

    fn hash(&self, grid: &StagedGrid) -> Result<blake3::Hash> {
        let (mut hasher, end) = (blake3::Hasher::new(), grid.at + grid.row_bytes * grid.info.rows);
        let mut chunk = vec![0; MESSAGE_BYTES];
        let mut at = grid.at;
        while at < end {
            let n = (end - at).min(chunk.len() as u64) as usize;
            let read = self.samples.read_exact_at(&mut chunk[..n], at);
            read.map_err(|e| Error::io(self.folder.join(SAMPLES), e))?;
            hasher.update(&chunk[..n]);
            at += n as u64;
        }
        Ok(hasher.finalize())
    }

    /// The grids, to be read.
    pub fn sources(&self) -> Result<Vec<Box<dyn HeightSource>>> {
        let path = self.folder.join(SAMPLES);
        self.grids
            .iter()
            .map(|g| {
                let samples = format::open_rows(&path, g.info.clone(), g.at, g.row_bytes)?;
                if !g.masked {
                    return Ok(samples);
                }
                let file = self.samples.try_clone().map_err(|e| Error::io(&path, e))?;
                let source = Masked { samples, file, path: path.clone(), grid: g.clone() };
                Ok(Box::new(source) as Box<dyn HeightSource>)
            })
            .collect()
    }
}

/// A grid whose rows have masks behind them.
struct Masked {
    samples: Box<dyn HeightSource>,
    file: File,
    path: PathBuf,
    grid: StagedGrid,
}

impl HeightSource for Masked {
    fn info(&self) -> &SourceInfo {
        self.samples.info()
    }

    fn set_nodata(&mut self, value: f64) {
        self.samples.set_nodata(value);
    }

    fn read(&mut self, w: Window) -> Result<Samples> {
        let mut found = self.samples.read(w)?;
        let g = &self.grid;
        let mask_bytes = g.info.cols.div_ceil(8);
        let mut bits = vec![0; mask_bytes as usize];
        for (r, valid) in found.valid.chunks_exact_mut(w.cols.max(1)).enumerate() {
            let row = w.row + r as u64;
            let at = g.at + row * g.row_bytes + (g.row_bytes - mask_bytes);
            self.file.read_exact_at(&mut bits, at).map_err(|e| Error::io(&self.path, e))?;
            for (k, v) in valid.iter_mut().enumerate() {
                let col = w.col as usize + k;
                *v &= bits[col / 8] >> (col % 8) & 1;
            }
        }
        Ok(found)
    }
}

/// A source that says what it is and has no samples: a change that is only held against the database is made of it.
pub struct Described(pub SourceInfo);

impl HeightSource for Described {
    fn info(&self) -> &SourceInfo {
        &self.0
    }

    fn set_nodata(&mut self, value: f64) {
        self.0.nodata = Some(value);
    }

    fn read(&mut self, _: Window) -> Result<Samples> {
        Err(Error::invalid(&self.0.file, "its samples have not arrived"))
    }
}

/// Rows of a grid, checked and unpacked.
pub struct Block {
    pub span: RowSpan,
    rows: Vec<u8>,
}

/// Checks a block and unpacks it. Never allocates more than the rows that it names have, and those have a limit.
///
/// # Errors
/// If its checksum, its length or its rows are wrong.
pub fn unpack(block: &SampleBlock, grids: &[StagedGrid]) -> Result<Block> {
    let span = RowSpan { grid: block.grid, row: block.row, rows: u64::from(block.rows) };
    let Some(grid) = grids.get(block.grid as usize) else {
        return Err(Error::invalid(
            "block.grid",
            format!("{}; the header describes {}, counted from 0", block.grid, grids.len()),
        ));
    };
    let place = || format!("block of '{}', {} rows from row {}", grid.info.file, block.rows, block.row);
    let all = grid.info.rows;
    if block.rows == 0 || block.row.checked_add(span.rows).is_none_or(|end| end > all) {
        let reason = format!("the grid has rows 0 to {}; send one row at least, and none beyond", all - 1);
        return Err(Error::invalid(place(), reason));
    }
    let wanted = span.rows * grid.row_bytes;
    if wanted > MESSAGE_BYTES as u64 && span.rows > 1 {
        return Err(Error::limit(format!("bytes of a {}", place()), MESSAGE_BYTES as u64, wanted));
    }
    let found = wire::crc32(&block.samples);
    if found != block.crc32 {
        return Err(Error::invalid(
            place(),
            format!(
                "its samples have the checksum {found:#010x}, {:#010x} was told; call again and send it once more",
                block.crc32
            ),
        ));
    }
    let packing = Packing::try_from(block.packing).map_err(|_| {
        Error::invalid(place(), format!("packing {} is none that this server knows", block.packing))
    })?;
    let rows = match packing {
        Packing::None => block.samples.to_vec(),
        Packing::Zlib => {
            let mut out = Vec::with_capacity(wanted as usize);
            // One byte more than there may be tells that there is too much.
            let read = ZlibDecoder::new(&block.samples[..]).take(wanted + 1).read_to_end(&mut out);
            read.map_err(|e| Error::invalid(place(), format!("its zlib stream is damaged: {e}")))?;
            out
        }
    };
    if rows.len() as u64 != wanted {
        let more = if rows.len() as u64 > wanted { " or more" } else { "" };
        return Err(Error::invalid(
            place(),
            format!("{}{more} bytes of samples, {wanted} are needed ({} a row)", rows.len(), grid.row_bytes),
        ));
    }
    Ok(Block { span, rows })
}
