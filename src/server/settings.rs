//! What a server is started with.

use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// What a server is started with. `configuration` names each as a flag, a variable and a key of a file.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Directory of the database.
    pub db: PathBuf,
    /// Where to listen; port 0: any free one.
    pub listen: SocketAddr,
    /// Certificates (PEM) of the server, its own first, and their key; `None`: it speaks plainly.
    pub tls: Option<TlsFiles>,
    /// Where the tokens are; `None`: `tokens.json` in the database.
    pub tokens: Option<PathBuf>,
    /// Listen beyond loopback though no token was made: whoever reaches the port may do everything.
    pub insecure_open: bool,
    /// Origins whose pages may ask (gRPC-web from another origin); `*`: any.
    pub allow_origin: Vec<String>,
    /// Connections that may be open at once; further ones are closed as they come.
    pub connections_max: usize,
    /// Calls that one HTTP/2 connection may have under way.
    pub connection_calls_max: u32,
    /// Calls that end by themselves and may be under way at once.
    pub calls_max: usize,
    /// Calls that last as long as the client likes (views, watches, uploads) and may be under way at once.
    pub streams_max: usize,
    /// How long an answer of one message may take where the caller states no time.
    pub deadline: Duration,
    /// Within this time come the TLS handshake, the first bytes and the head of a request.
    pub greet_within: Duration,
    /// A connection without a call on which nothing moved for this long is closed.
    pub idle: Duration,
    /// A connection whose client takes nothing of an answer for this long is closed.
    pub stall: Duration,
    /// How often a quiet HTTP/2 connection is asked whether it is alive.
    pub keepalive: Duration,
    /// How long calls may go on once the server was told to stop.
    pub grace: Duration,
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
    /// Posts along a side of a stream of the surface: some 50 bytes of memory a post of the square while it is made.
    pub gtb_side_max: u64,
    /// Bytes of streams of the surface that are kept, so that who goes on with one need not wait.
    pub gtb_cache_bytes: u64,
    /// How the log is written.
    pub log: LogForm,
    /// What is logged: `error`, `warn`, `info`, `debug`, `trace`, or filters such as `info,terraquilt=debug`.
    pub log_level: String,
}

/// Files (PEM) with which a server speaks TLS.
#[derive(Clone, Debug, Default)]
pub struct TlsFiles {
    pub certificates: PathBuf,
    pub key: PathBuf,
    /// Certificates that sign those of clients; given: who has none is refused.
    pub client_ca: Option<PathBuf>,
}

/// How the log is written: for people, or one JSON object a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LogForm {
    Text,
    Json,
}

impl Settings {
    /// The defaults for a database.
    pub fn new(db: impl Into<PathBuf>) -> Settings {
        Settings {
            db: db.into(),
            listen: SocketAddr::from(([127, 0, 0, 1], 50051)),
            tls: None,
            tokens: None,
            insecure_open: false,
            allow_origin: Vec::new(),
            connections_max: 16_384,
            connection_calls_max: 256,
            calls_max: 256,
            streams_max: 2048,
            deadline: Duration::from_secs(300),
            greet_within: Duration::from_secs(20),
            idle: Duration::from_secs(300),
            stall: Duration::from_secs(300),
            keepalive: Duration::from_secs(30),
            grace: Duration::from_secs(20),
            ingest_from: None,
            uploads_kept: Duration::from_secs(24 * 3600),
            upload_idle: Duration::from_secs(60),
            uploads_max: 64,
            uploads_bytes_max: 256 << 30,
            sessions_kept: Duration::from_secs(300),
            sessions_max: 1000,
            patches_max: 1_000_000,
            points_max: 400_000_000,
            gtb_side_max: 2049,
            gtb_cache_bytes: 64 << 20,
            log: LogForm::Text,
            log_level: "info".into(),
        }
    }

    /// Where the tokens are.
    pub fn tokens_file(&self) -> PathBuf {
        self.tokens.clone().unwrap_or_else(|| self.db.join("tokens.json"))
    }
}
