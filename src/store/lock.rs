//! Who may write, and what readers still hold.
//!
//! One process holds the writer lock at a time. A reader leaves a *lease*: a file named after its version, under a
//! shared lock for as long as the reader lives. Only the holder of the writer lock removes anything: stale leases
//! (nobody holds their lock) and files that no version names, and the latter only while no lease stands for a
//! version that the catalog has already forgotten.

use crate::base::{Error, Result};
use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// The exclusive right to write; given back when dropped, or when the process dies.
pub struct WriterLock {
    _file: File,
}

impl WriterLock {
    /// Takes the lock, or calls `waiting` once and waits for it.
    pub fn take(directory: &Path, waiting: &mut dyn FnMut()) -> Result<WriterLock> {
        let path = directory.join("writer.lock");
        let file = OpenOptions::new()
            .create(true)
            .truncate(false)
            .write(true)
            .open(&path)
            .map_err(|e| Error::io(&path, e))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                waiting();
                file.lock().map_err(|e| Error::io(&path, e))?;
            }
            Err(TryLockError::Error(e)) => return Err(Error::io(&path, e)),
        }
        Ok(WriterLock { _file: file })
    }
}

/// A reader's claim on a version. On a medium that cannot be written there is nothing to claim against.
pub struct Lease {
    path: Option<PathBuf>,
    _file: Option<File>,
}

static NEXT: AtomicU64 = AtomicU64::new(0);

impl Lease {
    pub fn take(directory: &Path, version: u64) -> Result<Lease> {
        loop {
            let unique = NEXT.fetch_add(1, Ordering::Relaxed);
            // Process numbers repeat across containers that share a disk; the clock tells them apart.
            let now = std::time::SystemTime::now()
                .duration_since(std::time::UNIX_EPOCH)
                .map_or(0, |d| d.as_nanos());
            let path =
                directory.join("readers").join(format!("{version}-{}-{now}-{unique}", std::process::id()));
            let Ok(file) = OpenOptions::new().create(true).truncate(false).write(true).open(&path) else {
                // A reader without write permission reads unprotected: after prune it may find a file gone, never
                // a wrong height.
                return Ok(Lease { path: None, _file: None });
            };
            file.lock_shared().map_err(|e| Error::io(&path, e))?;
            // A writer may have taken the file for stale between its creation and the lock.
            if path.exists() {
                return Ok(Lease { path: Some(path), _file: Some(file) });
            }
        }
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        // A reader removes its own lease only: nothing but bookkeeping.
        if let Some(path) = &self.path {
            let _ = fs::remove_file(path);
        }
    }
}

/// Versions that readers hold now. Removes stale leases; call it under the writer lock.
pub fn leased(directory: &Path) -> Result<Vec<u64>> {
    let readers = directory.join("readers");
    let mut held = Vec::new();
    let entries = match fs::read_dir(&readers) {
        Ok(e) => e,
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => return Ok(held),
        Err(e) => return Err(Error::io(&readers, e)),
    };
    for entry in entries {
        let entry = entry.map_err(|e| Error::io(&readers, e))?;
        let name = entry.file_name();
        let Some(version) = name.to_str().and_then(|n| n.split('-').next()).and_then(|v| v.parse().ok())
        else {
            continue;
        };
        let file = match File::open(entry.path()) {
            Ok(file) => file,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => continue,
            // Another user's lease that we may not open: it may be alive.
            Err(_) => {
                held.push(version);
                continue;
            }
        };
        match file.try_lock() {
            Ok(()) => {
                let _ = fs::remove_file(entry.path());
            }
            Err(_) => held.push(version),
        }
    }
    held.sort_unstable();
    held.dedup();
    Ok(held)
}
