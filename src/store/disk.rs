//! The narrow trait behind which segment files live, so that a test can be the disk.
//!
//! Assumed of a real disk: `sync` makes the bytes of a file durable, `sync_names` makes creations, renames and
//! removals durable, a rename is atomic, and nothing else is promised about what survives a power cut.

use crate::base::{Error, Result};
use std::fs::{self, File, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The bytes of a finished file, readable by many threads.
pub type Finished = Arc<dyn AsRef<[u8]> + Send + Sync>;

/// A directory of segment files.
pub trait Disk: Send + Sync {
    /// Creates a file for appending; replaces a leftover of the same name.
    fn create(&self, name: &str) -> Result<Box<dyn Growing>>;
    /// Gives a file its final name. Atomic; durable after [`Disk::sync_names`].
    fn rename(&self, from: &str, to: &str) -> Result<()>;
    fn sync_names(&self) -> Result<()>;
    fn remove(&self, name: &str) -> Result<()>;
    /// Every file and its length in bytes.
    fn names(&self) -> Result<Vec<(String, u64)>>;
    /// The bytes of a finished file.
    ///
    /// # Errors
    /// If the file is missing or its length is not `len`: it is never mapped then.
    fn open(&self, name: &str, len: u64) -> Result<Finished>;
    /// Bytes that can still be written, if the disk knows.
    fn free_bytes(&self) -> Result<Option<u64>>;
    /// How to name the directory in messages.
    fn place(&self) -> String;
}

/// A file that is being written.
pub trait Growing: Send {
    fn append(&mut self, bytes: &[u8]) -> Result<()>;
    /// Reads back what was appended.
    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<()>;
    fn sync(&mut self) -> Result<()>;
}

/// A file that is whole, but not yet durable nor under its final name.
pub struct Unnamed {
    pub(super) file: Box<dyn Growing>,
    pub(super) temporary: String,
    pub(super) name: String,
}

impl Unnamed {
    /// Makes the bytes durable.
    pub fn sync(&mut self) -> Result<()> {
        self.file.sync()
    }

    /// Gives a synced file its final name: durable after [`Disk::sync_names`].
    pub fn name(self, disk: &dyn Disk) -> Result<()> {
        drop(self.file);
        disk.rename(&self.temporary, &self.name)
    }

    /// The whole way of one file.
    pub fn finish(mut self, disk: &dyn Disk) -> Result<()> {
        self.sync()?;
        self.name(disk)?;
        disk.sync_names()
    }
}

/// A directory of the operating system.
pub struct RealDisk {
    root: PathBuf,
}

impl RealDisk {
    pub fn new(root: impl Into<PathBuf>) -> RealDisk {
        RealDisk { root: root.into() }
    }
    fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }
}

impl Disk for RealDisk {
    fn create(&self, name: &str) -> Result<Box<dyn Growing>> {
        let path = self.path(name);
        let file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(true)
            .open(&path)
            .map_err(|e| Error::io(&path, e))?;
        Ok(Box::new(RealGrowing { file, path }))
    }

    fn rename(&self, from: &str, to: &str) -> Result<()> {
        fs::rename(self.path(from), self.path(to)).map_err(|e| Error::io(self.path(to), e))
    }

    fn sync_names(&self) -> Result<()> {
        sync_directory(&self.root)
    }

    fn remove(&self, name: &str) -> Result<()> {
        fs::remove_file(self.path(name)).map_err(|e| Error::io(self.path(name), e))
    }

    fn names(&self) -> Result<Vec<(String, u64)>> {
        let mut out = Vec::new();
        for entry in fs::read_dir(&self.root).map_err(|e| Error::io(&self.root, e))? {
            let entry = entry.map_err(|e| Error::io(&self.root, e))?;
            let meta = entry.metadata().map_err(|e| Error::io(entry.path(), e))?;
            if meta.is_file()
                && let Some(name) = entry.file_name().to_str()
            {
                out.push((name.to_string(), meta.len()));
            }
        }
        out.sort();
        Ok(out)
    }

    fn open(&self, name: &str, len: u64) -> Result<Finished> {
        let path = self.path(name);
        let file = File::open(&path).map_err(|e| {
            if e.kind() == std::io::ErrorKind::NotFound {
                Error::corrupt(
                    path.display(),
                    "file",
                    "named by the catalog but missing; restore it from a backup",
                )
            } else {
                Error::io(&path, e)
            }
        })?;
        let found = file.metadata().map_err(|e| Error::io(&path, e))?.len();
        if found != len {
            return Err(Error::corrupt(
                path.display(),
                "length",
                format!("{found} bytes, the catalog says {len}; restore the file from a backup"),
            ));
        }
        // SAFETY: segment files are immutable once renamed: no process of ours writes to or shortens a
        // finished file, and its length was checked above. Pages are only read through checksums.
        let map = unsafe { memmap2::Mmap::map(&file) }.map_err(|e| Error::io(&path, e))?;
        Ok(Arc::new(map))
    }

    fn free_bytes(&self) -> Result<Option<u64>> {
        match rustix::fs::statvfs(&self.root) {
            Ok(s) => Ok(Some(s.f_bavail.saturating_mul(s.f_frsize))),
            Err(_) => Ok(None),
        }
    }

    fn place(&self) -> String {
        self.root.display().to_string()
    }
}

/// Makes creations, renames and removals in a directory durable.
pub fn sync_directory(path: &Path) -> Result<()> {
    File::open(path).and_then(|f| f.sync_all()).map_err(|e| Error::io(path, e))
}

struct RealGrowing {
    file: File,
    path: PathBuf,
}

impl Growing for RealGrowing {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.file.write_all(bytes).map_err(|e| Error::io(&self.path, e))
    }

    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        use std::os::unix::fs::FileExt;
        self.file.read_exact_at(buffer, offset).map_err(|e| Error::io(&self.path, e))
    }

    fn sync(&mut self) -> Result<()> {
        self.file.sync_all().map_err(|e| Error::io(&self.path, e))
    }
}
