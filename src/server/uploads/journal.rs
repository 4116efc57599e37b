//! The file `received` of an upload: which rows are durable. Bytes are drawn in `docs/format.md`.

use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result};
use crate::wire::v1::RowSpan;
use std::fs::{File, OpenOptions};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// First bytes of the file.
const MAGIC: [u8; 8] = *b"TQUILTUP";
const VERSION: u32 = 1;
const HEADER_BYTES: u64 = 16;
/// Bytes of one entry.
pub const ENTRY_BYTES: u64 = 24;

/// Which rows are durable: entries are added behind the last one, after the samples that they name were synced.
pub struct Journal {
    file: File,
    path: PathBuf,
}

impl Journal {
    /// Opens the file, or begins it. Calls `each` with every span of rows that it names, in order of arrival. What a writer left
    /// half written at the end is cut off.
    ///
    /// # Errors
    /// If the file is of something else, or of a newer program.
    pub fn open(path: &Path, each: &mut dyn FnMut(RowSpan)) -> Result<Journal> {
        let io = |e| Error::io(path, e);
        let mut file =
            OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path).map_err(io)?;
        let length = file.metadata().map_err(io)?.len();
        let trim = |file: &mut File, whole: u64| -> Result<()> {
            // A power cut may leave any bytes behind what was synced.
            if whole != length {
                file.set_len(whole).map_err(io)?;
                file.sync_all().map_err(io)?;
            }
            file.seek(SeekFrom::End(0)).map_err(io).map(|_| ())
        };
        if length < HEADER_BYTES {
            trim(&mut file, 0)?;
            file.write_all(&header()).and_then(|()| file.sync_all()).map_err(io)?;
            return Ok(Journal { file, path: path.to_path_buf() });
        }
        let whole = entries(&file, length, path, each)?;
        trim(&mut file, whole)?;
        Ok(Journal { file, path: path.to_path_buf() })
    }

    /// Adds spans, durably.
    pub fn add(&mut self, spans: &[RowSpan]) -> Result<()> {
        let mut bytes = Vec::with_capacity(spans.len() * ENTRY_BYTES as usize);
        for s in spans {
            encode(s, &mut bytes);
        }
        let done = self.file.write_all(&bytes).and_then(|()| self.file.sync_data());
        done.map_err(|e| Error::io(&self.path, e))
    }

    /// Forgets every span, durably.
    pub fn clear(&mut self) -> Result<()> {
        let done = self.file.set_len(HEADER_BYTES).and_then(|()| self.file.seek(SeekFrom::End(0)));
        done.and_then(|_| self.file.sync_all()).map_err(|e| Error::io(&self.path, e))
    }
}

/// Calls with every span that the file at a path names; with none if there is no such file or it has just been begun.
pub fn read(path: &Path, each: &mut dyn FnMut(RowSpan)) -> Result<()> {
    let file = match File::open(path) {
        Ok(file) => file,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(()),
        Err(e) => return Err(Error::io(path, e)),
    };
    let length = file.metadata().map_err(|e| Error::io(path, e))?.len();
    if length >= HEADER_BYTES {
        entries(&file, length, path, each)?;
    }
    Ok(())
}

/// Reads header and entries. Returns the bytes that are whole.
fn entries(file: &File, length: u64, path: &Path, each: &mut dyn FnMut(RowSpan)) -> Result<u64> {
    let mut reader = std::io::BufReader::new(file);
    let mut read = |into: &mut [u8]| reader.read_exact(into).map_err(|e| Error::io(path, e));
    let mut first = [0; HEADER_BYTES as usize];
    read(&mut first)?;
    check_header(&first, path)?;
    let mut whole = HEADER_BYTES;
    let mut entry = [0; ENTRY_BYTES as usize];
    while whole + ENTRY_BYTES <= length {
        read(&mut entry)?;
        let Some(span) = decode(&entry) else { break };
        each(span);
        whole += ENTRY_BYTES;
    }
    Ok(whole)
}

fn header() -> Vec<u8> {
    let mut h = Vec::with_capacity(HEADER_BYTES as usize);
    h.put(&MAGIC);
    h.put_u32(VERSION);
    let crc = crc32c::crc32c(&h);
    h.put_u32(crc);
    h
}

fn check_header(bytes: &[u8], path: &Path) -> Result<()> {
    if bytes[..8] == MAGIC && bytes[8..12] != VERSION.to_le_bytes() {
        let found = Reader::new(&bytes[8..], "received", "header").u32()?;
        return Err(Error::unsupported(
            path.display(),
            format!("upload of format {found}, this program knows {VERSION}"),
            "abandon the upload, or use a newer terraquilt",
        ));
    }
    if bytes != header() {
        return Err(Error::corrupt(
            path.display(),
            "header",
            "does not begin as such a file does; abandon the upload and send it again",
        ));
    }
    Ok(())
}

fn encode(s: &RowSpan, out: &mut Vec<u8>) {
    let at = out.len();
    out.put_u32(s.grid);
    out.put_u64(s.row);
    out.put_u64(s.rows);
    let crc = crc32c::crc32c(&out[at..]);
    out.put_u32(crc);
}

fn decode(bytes: &[u8]) -> Option<RowSpan> {
    let mut r = Reader::new(bytes, "received", "entry");
    let span = RowSpan { grid: r.u32().ok()?, row: r.u64().ok()?, rows: r.u64().ok()? };
    (r.u32().ok()? == crc32c::crc32c(&bytes[..20])).then_some(span)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_added_is_read_and_what_was_cut_off_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("received");
        let span = |k: u64| RowSpan { grid: k as u32, row: k * 10, rows: k + 1 };
        let read = || {
            let mut found = Vec::new();
            Journal::open(&path, &mut |s| found.push(s)).map(|j| (j, found))
        };
        let (mut j, found) = read().unwrap();
        assert!(found.is_empty());
        j.add(&[span(0), span(1)]).unwrap();
        j.add(&[span(2)]).unwrap();
        drop(j);
        assert_eq!(read().unwrap().1, [span(0), span(1), span(2)]);
        let bytes = std::fs::read(&path).unwrap();
        for cut in 0..bytes.len() {
            std::fs::write(&path, &bytes[..cut]).unwrap();
            let (mut j, found) = read().unwrap();
            assert_eq!(found.len(), cut.saturating_sub(16) / 24, "cut at {cut}");
            // It goes on behind what is whole.
            j.add(&[span(9)]).unwrap();
            drop(j);
            assert_eq!(read().unwrap().1.last(), Some(&span(9)));
        }
        for k in 16..bytes.len() {
            let mut bytes = bytes.clone();
            bytes[k] ^= 4;
            std::fs::write(&path, &bytes).unwrap();
            assert_eq!(read().unwrap().1.len(), (k - 16) / 24, "byte {k}");
        }
        for k in 0..16 {
            let mut bytes = bytes.clone();
            bytes[k] ^= 4;
            std::fs::write(&path, &bytes).unwrap();
            let e = read().map(|_| ()).unwrap_err().to_string();
            assert!(e.contains("received") && e.contains("abandon"), "{e}");
        }
        std::fs::write(&path, &bytes).unwrap();
        let (mut j, _) = read().unwrap();
        j.clear().unwrap();
        j.add(&[span(5)]).unwrap();
        assert_eq!(read().unwrap().1, [span(5)]);
    }
}
