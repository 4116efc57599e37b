//! One error type, sorted by what the reader can do next.

use std::io;
use std::path::{Path, PathBuf};

/// The result of everything in this crate that can fail.
pub type Result<T> = std::result::Result<T, Error>;

/// What went wrong, where, and what to do. Texts are lower case, name the place and carry both values.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file is not what it claims to be. Restore it, or run `terraquilt verify`.
    #[error("{file}: damaged {place}: {reason}")]
    Corrupt { file: String, place: String, reason: String },
    /// Legal, but not read (yet). Convert it first.
    #[error("{file}: {what}; {remedy}")]
    Unsupported { file: String, what: String, remedy: String },
    /// The caller asked for something impossible. Fix the call.
    #[error("{what}: {reason}")]
    Invalid { what: String, reason: String },
    /// A bound in [`limits`](crate::base::limits) was met. Ask for less.
    #[error("{what}: {wanted} wanted, at most {limit} allowed")]
    Limit { what: String, limit: u64, wanted: u64 },
    /// The named thing is not there.
    #[error("{what} not found; {remedy}")]
    Missing { what: String, remedy: String },
    /// Another process holds what is needed. Try again later.
    #[error("{what}")]
    Busy { what: String },
    /// The disk has too little room.
    #[error("{place}: {:.1} MB needed, {:.1} MB free; nothing was changed; make room or use another disk", *wanted as f64 / 1e6, *free as f64 / 1e6)]
    NoSpace { place: String, wanted: u64, free: u64 },
    /// The operating system refused.
    #[error("{path}: {source}{}", advice(source))]
    Io { path: PathBuf, source: io::Error },
    /// The catalog (SQLite) refused.
    #[error(
        "catalog of the database (catalog.sqlite): {0}; make room if the disk is full; if it is damaged, `terraquilt rebuild DB` makes it again from the other files"
    )]
    Catalog(String),
    /// A server answered that it could not, or did not answer.
    #[error("{server}: {message}")]
    Remote { server: String, message: String },
    /// The work was stopped by the caller (Ctrl-C); nothing was changed.
    #[error("stopped; nothing was changed")]
    Stopped,
}

/// What to do about an error of the operating system, where that is plain.
fn advice(e: &io::Error) -> &'static str {
    match e.kind() {
        io::ErrorKind::NotFound => "; check the name",
        io::ErrorKind::PermissionDenied => "; this user may not write there (reading may still work)",
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => "; nothing was changed; make room",
        io::ErrorKind::ReadOnlyFilesystem => "; it can be read but not changed",
        io::ErrorKind::InvalidData => "; it is not a text file",
        _ => "",
    }
}

impl Error {
    pub fn io(path: impl AsRef<Path>, source: io::Error) -> Error {
        Error::Io { path: path.as_ref().to_path_buf(), source }
    }
    pub fn corrupt(file: impl ToString, place: impl ToString, reason: impl ToString) -> Error {
        Error::Corrupt { file: file.to_string(), place: place.to_string(), reason: reason.to_string() }
    }
    pub fn unsupported(file: impl ToString, what: impl ToString, remedy: impl ToString) -> Error {
        Error::Unsupported { file: file.to_string(), what: what.to_string(), remedy: remedy.to_string() }
    }
    pub fn invalid(what: impl ToString, reason: impl ToString) -> Error {
        Error::Invalid { what: what.to_string(), reason: reason.to_string() }
    }
    pub fn limit(what: impl ToString, limit: u64, wanted: u64) -> Error {
        Error::Limit { what: what.to_string(), limit, wanted }
    }
    pub fn missing(what: impl ToString, remedy: impl ToString) -> Error {
        Error::Missing { what: what.to_string(), remedy: remedy.to_string() }
    }
}
