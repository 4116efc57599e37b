//! What a server is started with.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// What a server is started with.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Directory of the database.
    pub db: PathBuf,
    /// Where to listen; port 0: any free one.
    pub listen: SocketAddr,
    /// Files below this directory may be ingested by name; `None`: none may.
    pub ingest_from: Option<PathBuf>,
    /// How long what arrived of an upload is kept after its connection broke.
    pub uploads_kept: Duration,
    /// How long an upload may send nothing before its stream is ended.
    pub upload_idle: Duration,
    /// Uploads that may be in progress at once.
    pub uploads_max: u64,
    /// Bytes that their samples may take on the disk.
    pub uploads_bytes_max: u64,
    /// How long the session of a view is kept after its stream ended.
    pub sessions_kept: Duration,
    /// Sessions that may be held at once.
    pub sessions_max: usize,
    /// Patches that one answer may have.
    pub patches_max: u64,
    /// Points of one call for heights.
    pub points_max: u64,
}

impl Settings {
    /// The defaults for a database.
    pub fn new(db: impl Into<PathBuf>) -> Settings {
        Settings {
            db: db.into(),
            listen: SocketAddr::from(([127, 0, 0, 1], 50051)),
            ingest_from: None,
            uploads_kept: Duration::from_secs(24 * 3600),
            upload_idle: Duration::from_secs(60),
            uploads_max: 64,
            uploads_bytes_max: 256 << 30,
            sessions_kept: Duration::from_secs(300),
            sessions_max: 1000,
            patches_max: 1_000_000,
            points_max: 400_000_000,
        }
    }
}
