//! The catalog: versions, the files they name, and the constants of the database.
//!
//! A commit is one transaction, made after every file it names is synced. The trait is narrow so that a test can
//! stop at it; [`sqlite`] is the implementation. [`uploads`]: what is coming in and no commit yet, in a file of its own.

mod sqlite;
mod uploads;

pub use sqlite::Sqlite;
pub use uploads::{Upload, Uploads};

use super::segment::PageRef;
use crate::base::Result;
use std::collections::BTreeMap;

/// One commit.
#[derive(Clone, Debug, PartialEq)]
pub struct Version {
    pub number: u64,
    pub operation: String,
    /// Seconds since 1970 UTC.
    pub made_at: i64,
    pub action: String,
    pub root: PageRef,
}

/// A file as a version names it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NamedFile {
    pub number: u32,
    /// Length in bytes.
    pub length: u64,
    /// Bytes of it that the version reads.
    pub live: u64,
}

/// Numbers given out so far.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counters {
    pub file: u32,
    pub survey: u32,
    pub version: u64,
}

/// What a commit adds.
#[derive(Clone, Debug)]
pub struct Commit {
    pub version: Version,
    pub files: Vec<NamedFile>,
    pub counters: Counters,
}

/// Everything that a catalog holds.
#[derive(Clone, Debug)]
pub struct Contents {
    pub constants: BTreeMap<String, String>,
    /// Versions, ascending, each with the files that it reads.
    pub versions: Vec<(Version, Vec<NamedFile>)>,
    /// Ids of operations and the versions that they made.
    pub operations: Vec<(String, u64)>,
    pub counters: Counters,
    /// The newest version when this was made as a backup; `None` for any other database.
    pub backup: Option<u64>,
}

pub trait Catalog: Send {
    fn constants(&self) -> Result<BTreeMap<String, String>>;
    fn counters(&self) -> Result<Counters>;
    /// The newest version, if there is any.
    fn latest(&self) -> Result<Option<Version>>;
    fn version(&self, number: u64) -> Result<Option<Version>>;
    /// Every version, ascending.
    fn versions(&self) -> Result<Vec<Version>>;
    /// The version that an operation made, even if it was pruned since.
    fn operation(&self, id: &str) -> Result<Option<u64>>;
    /// Every operation and the version that it made, ascending by version.
    fn operations(&self) -> Result<Vec<(String, u64)>>;
    /// The files of a version, ascending.
    fn files(&self, version: u64) -> Result<Vec<NamedFile>>;
    /// Every file that some version names: number and length, ascending.
    fn all_files(&self) -> Result<Vec<(u32, u64)>>;
    /// Adds a version. One transaction, durable when it returns.
    fn commit(&mut self, commit: &Commit) -> Result<()>;
    /// Forgets versions, and files that only they name. One transaction.
    fn prune(&mut self, versions: &[u64]) -> Result<()>;
    /// Whether this is still the catalog that is found in its place: not moved away, not replaced.
    ///
    /// # Errors
    /// If a newer program has changed its schema.
    fn is_current(&self) -> Result<bool>;
    /// Checks the catalog's own structure.
    fn check(&self) -> Result<Vec<String>>;
}
