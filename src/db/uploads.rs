//! Uploads in progress: where their folders are, and the catalog that knows them. What is in the folders is the server's.
//!
//! ```text
//! DB/uploads/catalog.sqlite   uploads in progress          DB/uploads/HEX/...   what arrived of one
//! ```
//! Commits, prune, backups and copies neither read nor remove them.

use super::change::{Change, Ingest};
use super::database::{Db, Snapshot};
use crate::base::{Error, Result};
pub use crate::store::catalog::{Upload, Uploads};
use std::path::PathBuf;

impl Db {
    /// The folder of uploads in progress. It may be missing.
    pub fn uploads_folder(&self) -> PathBuf {
        self.path().join("uploads")
    }

    /// The catalog of uploads in progress; made if there is none.
    pub fn uploads(&self) -> Result<Uploads> {
        let folder = self.uploads_folder();
        std::fs::create_dir_all(&folder).map_err(|e| Error::io(&folder, e))?;
        Uploads::open(&folder.join("catalog.sqlite"))
    }

    /// Bytes that the disk of the database can still take, if it knows.
    pub fn free_bytes(&self) -> Result<Option<u64>> {
        self.disk().free_bytes()
    }

    /// Holds an ingest or a replacement against a version, without reading a sample: what can be refused already, is. Returns
    /// the notes that the commit would begin with.
    pub fn foresee(&self, snapshot: &Snapshot, change: &Change) -> Result<Vec<String>> {
        let (ingest, into): (&Ingest, Option<&str>) = match change {
            Change::Ingest(i) => (i, i.into.as_deref()),
            Change::Replace { survey, ingest } => (ingest, Some(survey)),
            _ => return Ok(Vec::new()),
        };
        super::arrive::foresee(self, &snapshot.view, ingest, into).map(|f| f.warnings)
    }
}
