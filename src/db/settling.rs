//! Finished files on their way to the disk. Waiting for a disk takes no core, so each file is synced by a thread of its own:
//! that of the survey while the commit is still derived, the others side by side.

use crate::base::{Error, Result};
use crate::store::disk::{Disk, Unnamed};
use crate::store::segment::SegmentWriter;
use std::thread::JoinHandle;

/// A whole file whose bytes are becoming durable. Dropped, it waits for the disk and keeps its temporary name.
pub(super) struct Settling(Option<JoinHandle<Result<Unnamed>>>);

impl Settling {
    pub fn start(mut file: Unnamed) -> Result<Settling> {
        let sync = move || file.sync().map(|()| file);
        let thread = std::thread::Builder::new().name("sync".into()).spawn(sync);
        Ok(Settling(Some(thread.map_err(|e| Error::io("a thread to sync a file", e))?)))
    }

    /// Waits until the bytes are durable.
    fn wait(mut self) -> Result<Unnamed> {
        let thread = self.0.take().expect("a file is waited for once");
        thread.join().expect("syncing does not panic")
    }
}

impl Drop for Settling {
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            let _ = thread.join();
        }
    }
}

/// A finished segment.
pub(super) struct SettlingSegment {
    pub number: u32,
    pub length: u64,
    pub file: Settling,
}

impl SettlingSegment {
    pub fn start(segment: SegmentWriter) -> Result<SettlingSegment> {
        let (number, length) = (segment.number(), segment.len());
        Ok(SettlingSegment { number, length, file: Settling::start(segment.close()?)? })
    }
}

/// Waits until all bytes are durable, then gives the files their names, in this order, and makes those durable.
pub(super) fn name_all(files: Vec<Settling>, disk: &dyn Disk) -> Result<()> {
    let whole: Vec<Unnamed> = files.into_iter().map(Settling::wait).collect::<Result<_>>()?;
    whole.into_iter().try_for_each(|f| f.name(disk))?;
    disk.sync_names()
}
