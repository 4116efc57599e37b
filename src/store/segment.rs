//! Segments: files of pages, written once.
//!
//! A page is found by a [`PageRef`] that carries its checksum, so a page that was damaged *or landed in the
//! wrong place* is an error on first touch. Bytes are drawn in `docs/format.md`.

use super::disk::{Disk, Finished, Growing, Unnamed};
use crate::base::bytes::{Put, Reader};
use crate::base::{Error, Result, limits};
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, OnceLock};

/// First bytes of every segment file.
pub const MAGIC: [u8; 8] = *b"TQUILTSG";
/// Version of the bytes of a segment.
pub const SEGMENT_VERSION: u32 = 1;
/// Bytes before the first page.
pub const HEADER_BYTES: u64 = 32;

/// Where a page is, and what its bytes must hash to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct PageRef {
    /// Number of the segment file.
    pub file: u32,
    /// Bytes of the page.
    pub len: u32,
    /// Byte offset in the file.
    pub offset: u64,
    /// CRC-32C of the bytes.
    pub crc: u32,
}

impl PageRef {
    pub const BYTES: usize = 20;

    pub fn put(&self, out: &mut Vec<u8>) {
        out.put_u32(self.file);
        out.put_u32(self.len);
        out.put_u64(self.offset);
        out.put_u32(self.crc);
    }

    pub fn read(r: &mut Reader) -> Result<PageRef> {
        Ok(PageRef { file: r.u32()?, len: r.u32()?, offset: r.u64()?, crc: r.u32()? })
    }

    /// How the page is named in errors.
    pub fn place(&self) -> String {
        format!("page at byte {} ({} bytes)", self.offset, self.len)
    }
}

/// What a segment file is a function of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum SegmentKind {
    /// One survey: samples, levels, patch table.
    Survey = 1,
    /// The set of surveys: tops, kernels, tree, root.
    Derived = 2,
}

/// The final name of a segment file.
pub fn file_name(number: u32) -> String {
    format!("{number:08}.tqs")
}

/// The name of a segment file while it is being written.
pub fn temporary_name(number: u32) -> String {
    format!("{number:08}.tmp")
}

/// CRC-32C (Castagnoli).
pub(super) fn checksum(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
}

fn header(kind: SegmentKind, number: u32) -> Vec<u8> {
    let mut h = Vec::with_capacity(HEADER_BYTES as usize);
    h.put(&MAGIC);
    h.put_u32(SEGMENT_VERSION);
    h.put_u8(kind as u8);
    h.put(&[0; 3]);
    h.put_u32(number);
    h.put(&[0; 8]);
    let crc = checksum(&h);
    h.put_u32(crc);
    h
}

fn check_header(name: &str, bytes: &[u8], number: u32) -> Result<()> {
    let mut r = Reader::new(bytes, name, "segment header");
    let body = r.take(28)?;
    let crc = r.u32()?;
    if body[..8] != MAGIC {
        return Err(r.bad("does not begin with TQUILTSG; restore the file from a backup"));
    }
    let mut f = Reader::new(&body[8..], name, "segment header");
    let version = f.u32()?;
    if version > SEGMENT_VERSION {
        return Err(Error::unsupported(
            name,
            format!("segment format {version}, this program reads up to {SEGMENT_VERSION}"),
            "use a newer terraquilt",
        ));
    }
    if checksum(body) != crc {
        return Err(r.bad(format!("checksum {:#010x}, stored {crc:#010x}", checksum(body))));
    }
    f.take(4)?;
    let found = f.u32()?;
    if found != number {
        return Err(r.bad(format!("file says it is number {found}, the catalog says {number}")));
    }
    Ok(())
}

/// Reads pages by reference.
pub trait Pages: Sync {
    /// The bytes of a page, their checksum verified.
    fn page(&self, at: &PageRef) -> Result<Cow<'_, [u8]>>;
}

/// Bytes of pages that are gathered before they are written: a page has some kilobytes, a call for each costs more than its bytes.
const GATHERED_BYTES: usize = 256 << 10;

/// Writes one segment under a temporary name; [`SegmentWriter::finish`] makes it durable under its own.
pub struct SegmentWriter {
    file: Mutex<Box<dyn Growing>>,
    number: u32,
    /// Bytes of the segment, those not yet written included.
    offset: u64,
    /// The last of them: not yet in the file.
    gathered: Vec<u8>,
}

impl SegmentWriter {
    pub fn create(disk: &dyn Disk, number: u32, kind: SegmentKind) -> Result<SegmentWriter> {
        let mut file = disk.create(&temporary_name(number))?;
        file.append(&header(kind, number))?;
        Ok(SegmentWriter { file: Mutex::new(file), number, offset: HEADER_BYTES, gathered: Vec::new() })
    }

    /// A segment that lives in memory and is never on a disk.
    pub fn in_memory(number: u32, kind: SegmentKind) -> Result<SegmentWriter> {
        let file: Box<dyn Growing> = Box::new(InMemory(header(kind, number)));
        Ok(SegmentWriter { file: Mutex::new(file), number, offset: HEADER_BYTES, gathered: Vec::new() })
    }

    pub fn number(&self) -> u32 {
        self.number
    }

    /// Bytes written so far.
    pub fn len(&self) -> u64 {
        self.offset
    }

    pub fn is_empty(&self) -> bool {
        self.offset == HEADER_BYTES
    }

    /// Appends a page.
    pub fn append(&mut self, page: &[u8]) -> Result<PageRef> {
        if page.len() as u64 > limits::PAGE_BYTES_MAX {
            return Err(Error::limit("bytes of a page", limits::PAGE_BYTES_MAX, page.len() as u64));
        }
        let at =
            PageRef { file: self.number, len: page.len() as u32, offset: self.offset, crc: checksum(page) };
        self.gathered.extend_from_slice(page);
        self.offset += page.len() as u64;
        if self.gathered.len() >= GATHERED_BYTES {
            self.flush()?;
        }
        Ok(at)
    }

    /// Writes what was gathered.
    fn flush(&mut self) -> Result<()> {
        let file = self.file.get_mut().expect("no thread panicked while holding the file");
        file.append(&self.gathered)?;
        self.gathered.clear();
        Ok(())
    }

    /// No page follows.
    pub fn close(mut self) -> Result<Unnamed> {
        self.flush()?;
        Ok(Unnamed {
            file: self.file.into_inner().expect("no thread panicked while holding the file"),
            temporary: temporary_name(self.number),
            name: file_name(self.number),
        })
    }

    /// Makes the file durable under its own name. Returns its length.
    pub fn finish(self, disk: &dyn Disk) -> Result<u64> {
        let length = self.offset;
        self.close()?.finish(disk)?;
        Ok(length)
    }
}

/// The bytes of a file that is on no disk.
struct InMemory(Vec<u8>);

impl Growing for InMemory {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        let from = offset as usize;
        buffer.copy_from_slice(&self.0[from..from + buffer.len()]);
        Ok(())
    }

    fn sync(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Pages for SegmentWriter {
    fn page(&self, at: &PageRef) -> Result<Cow<'_, [u8]>> {
        if at.offset.checked_add(u64::from(at.len)).is_none_or(|end| end > self.offset) {
            return Err(Error::corrupt(file_name(at.file), at.place(), "reaches past what was written"));
        }
        let name = || file_name(at.file);
        let written = self.offset - self.gathered.len() as u64;
        if at.offset < written && at.offset + u64::from(at.len) > written {
            return Err(Error::corrupt(name(), at.place(), "is no page of those that were written"));
        }
        if let Some(from) = at.offset.checked_sub(written) {
            let page = &self.gathered[from as usize..][..at.len as usize];
            verify(name, at, page)?;
            return Ok(Cow::Borrowed(page));
        }
        let mut buffer = vec![0; at.len as usize];
        self.file
            .lock()
            .expect("no thread panicked while holding the file")
            .read_at(at.offset, &mut buffer)?;
        verify(name, at, &buffer)?;
        Ok(Cow::Owned(buffer))
    }
}

fn verify(name: impl Fn() -> String, at: &PageRef, bytes: &[u8]) -> Result<()> {
    let crc = checksum(bytes);
    if crc != at.crc {
        return Err(Error::corrupt(
            name(),
            at.place(),
            format!("checksum {crc:#010x}, stored {:#010x}; restore the file from a backup", at.crc),
        ));
    }
    Ok(())
}

/// The finished files of one version, each opened and its length checked on first touch.
pub struct Files {
    disk: Arc<dyn Disk>,
    /// Number, length as the catalog says, and the bytes once opened.
    files: HashMap<u32, (u64, OnceLock<Finished>)>,
}

impl Files {
    pub fn new(disk: Arc<dyn Disk>, lengths: impl IntoIterator<Item = (u32, u64)>) -> Files {
        Files { disk, files: lengths.into_iter().map(|(n, l)| (n, (l, OnceLock::new()))).collect() }
    }

    /// The same files and what was written beside them, held in memory.
    pub fn with(&self, mut segment: SegmentWriter) -> Result<Files> {
        segment.flush()?;
        let mut bytes = vec![0; segment.offset as usize];
        segment.file.lock().expect("no thread panicked while holding the file").read_at(0, &mut bytes)?;
        let finished: Finished = Arc::new(bytes);
        let mut files = Files::new(self.disk.clone(), self.lengths());
        files.files.insert(segment.number, (segment.offset, OnceLock::from(finished)));
        Ok(files)
    }

    /// Numbers and lengths, ascending.
    pub fn lengths(&self) -> Vec<(u32, u64)> {
        let mut n: Vec<(u32, u64)> = self.files.iter().map(|(n, (l, _))| (*n, *l)).collect();
        n.sort_unstable();
        n
    }

    /// A file as messages name it.
    fn name(&self, number: u32) -> String {
        format!("{}/{}", self.disk.place(), file_name(number))
    }

    /// Checks a file's header. Not done on opening: it would cost a read of its own, and every page has its checksum.
    pub fn check_header(&self, number: u32) -> Result<()> {
        check_header(&self.name(number), self.bytes(number)?, number)
    }

    /// Opens a file, or names why it cannot be.
    pub fn bytes(&self, number: u32) -> Result<&[u8]> {
        let name = self.name(number);
        let Some((len, slot)) = self.files.get(&number) else {
            return Err(Error::corrupt(
                &name,
                "reference",
                "a page is named in a file that this version does not hold",
            ));
        };
        if let Some(open) = slot.get() {
            return Ok((**open).as_ref());
        }
        let open = self.disk.open(&file_name(number), *len)?;
        // Two threads may have opened it at once: either mapping serves.
        Ok((**slot.get_or_init(|| open)).as_ref())
    }
}

impl Pages for Files {
    fn page(&self, at: &PageRef) -> Result<Cow<'_, [u8]>> {
        let bytes = self.bytes(at.file)?;
        let end = at.offset.checked_add(u64::from(at.len)).filter(|e| *e <= bytes.len() as u64);
        let Some(end) = end else {
            return Err(Error::corrupt(
                self.name(at.file),
                at.place(),
                format!("reaches past the end of the file ({} bytes)", bytes.len()),
            ));
        };
        let page = &bytes[at.offset as usize..end as usize];
        verify(|| self.name(at.file), at, page)?;
        Ok(Cow::Borrowed(page))
    }
}

/// Pages of a version and of the segments being written on top of it.
pub struct Layered<'a> {
    pub base: &'a Files,
    pub writing: Vec<&'a SegmentWriter>,
}

impl Pages for Layered<'_> {
    fn page(&self, at: &PageRef) -> Result<Cow<'_, [u8]>> {
        match self.writing.iter().find(|w| w.number == at.file) {
            Some(w) => w.page(at),
            None => self.base.page(at),
        }
    }
}
