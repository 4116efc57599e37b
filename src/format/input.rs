//! A survey file's bytes, read at any place: in a file, or in memory.

use super::sidecar::Beside;
use crate::base::{Error, Result};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::Arc;

/// One file and what lies beside it.
pub struct Input {
    /// The file, as the user named it; used in errors.
    pub file: String,
    pub beside: Beside,
    span_bytes: u64,
    bytes: Bytes,
}

enum Bytes {
    Disk(File),
    Memory(Vec<u8>),
}

impl Input {
    /// Opens a file; nothing is read.
    ///
    /// # Errors
    /// If there is no such file, or it is no regular file.
    pub fn open(path: &Path) -> Result<Input> {
        let file = path.display().to_string();
        let meta = std::fs::metadata(path).map_err(|e| match e.kind() {
            ErrorKind::NotFound => Error::missing(format!("file {file}"), "check the name"),
            _ => Error::io(path, e),
        })?;
        if meta.is_dir() {
            return Err(Error::unsupported(
                file,
                "a directory, not a survey file",
                "name the files inside it",
            ));
        }
        if !meta.is_file() {
            // A pipe would block for ever.
            return Err(Error::unsupported(file, "not a regular file", "copy it into one"));
        }
        let disk = File::open(path).map_err(|e| Error::io(path, e))?;
        let span_bytes = disk.metadata().map_err(|e| Error::io(path, e))?.len();
        Ok(Input { file, beside: Beside::Folder(path.to_path_buf()), span_bytes, bytes: Bytes::Disk(disk) })
    }

    /// A file in memory; `name` plays the part of the file name.
    pub fn memory(name: &str, bytes: Vec<u8>, beside: Beside) -> Input {
        Input { file: name.to_string(), beside, span_bytes: bytes.len() as u64, bytes: Bytes::Memory(bytes) }
    }

    pub fn span_bytes(&self) -> u64 {
        self.span_bytes
    }

    /// Fills `out` with the bytes from `at`.
    pub fn read_exact_at(&self, at: u64, out: &mut [u8]) -> io::Result<()> {
        match &self.bytes {
            Bytes::Disk(file) => file.read_exact_at(out, at),
            Bytes::Memory(bytes) => {
                let found = usize::try_from(at).ok().and_then(|at| bytes.get(at..at.checked_add(out.len())?));
                out.copy_from_slice(found.ok_or(ErrorKind::UnexpectedEof)?);
                Ok(())
            }
        }
    }

    /// Fills `out` with the bytes from `at`; `place` names them in the error.
    pub fn fill(&self, at: u64, out: &mut [u8], place: &str) -> Result<()> {
        self.read_exact_at(at, out).map_err(|e| match e.kind() {
            ErrorKind::UnexpectedEof => {
                let (n, all) = (out.len(), self.span_bytes);
                Error::corrupt(&self.file, place, format!("{n} bytes from byte {at}, but the file has {all}"))
            }
            _ => Error::io(&self.file, e),
        })
    }

    /// The first bytes: `most` of them, or what there is.
    pub fn head(&self, most: usize) -> Result<Vec<u8>> {
        let mut head = vec![0; most.min(usize::try_from(self.span_bytes).unwrap_or(most))];
        self.fill(0, &mut head, "header")?;
        Ok(head)
    }

    /// The bytes from `at` on, in order.
    pub fn reader(self: &Arc<Self>, at: u64) -> InputReader {
        InputReader { input: self.clone(), at }
    }
}

/// Reads an [`Input`] in order.
pub struct InputReader {
    input: Arc<Input>,
    at: u64,
}

impl Read for InputReader {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let n = match &self.input.bytes {
            Bytes::Disk(file) => file.read_at(out, self.at)?,
            Bytes::Memory(bytes) => {
                let rest = usize::try_from(self.at).ok().and_then(|at| bytes.get(at..)).unwrap_or(&[]);
                let n = rest.len().min(out.len());
                out[..n].copy_from_slice(&rest[..n]);
                n
            }
        };
        self.at += n as u64;
        Ok(n)
    }
}

impl Seek for InputReader {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let at = match to {
            SeekFrom::Start(at) => Some(at),
            SeekFrom::Current(by) => self.at.checked_add_signed(by),
            SeekFrom::End(by) => self.input.span_bytes.checked_add_signed(by),
        };
        self.at = at.ok_or(ErrorKind::InvalidInput)?;
        Ok(self.at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_past_the_end_are_damage_with_both_numbers() {
        let input = Arc::new(Input::memory("a.flt", vec![1, 2, 3, 4], Beside::Nothing));
        let mut two = [0; 2];
        input.fill(2, &mut two, "row 0").unwrap();
        assert_eq!(two, [3, 4]);
        for at in [3, 4, u64::MAX] {
            let e = input.fill(at, &mut two, "row 0").unwrap_err().to_string();
            assert!(e.contains("a.flt") && e.contains("row 0") && e.contains("has 4"), "{e}");
        }
        assert_eq!(input.head(9).unwrap(), [1, 2, 3, 4]);
        let mut reader = input.reader(1);
        let mut rest = Vec::new();
        reader.read_to_end(&mut rest).unwrap();
        assert_eq!(rest, [2, 3, 4]);
        assert_eq!(reader.seek(SeekFrom::End(-1)).unwrap(), 3);
        assert!(reader.seek(SeekFrom::Current(-9)).is_err());
    }
}
