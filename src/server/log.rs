//! The log, on standard error: for people, or one JSON object a line.
//!
//! Every call is a line with the target `terraquilt::call`: id, method, peer, name of the token, code, milliseconds, bytes. No
//! token is ever in it: only [`tokens`](super::tokens) sees one.

use super::settings::{LogForm, Settings};
use crate::base::{Error, Result};
use tracing_subscriber::EnvFilter;

/// Starts the log of this process.
///
/// # Errors
/// If `log_level` is no level and no list of filters.
pub fn start(settings: &Settings) -> Result<()> {
    // The library that brings catalogs up to date says at each opening that there is nothing to do.
    let filter = EnvFilter::try_new(format!("refinery_core=warn,{}", settings.log_level)).map_err(|e| {
        let what = format!("'{}': {e}; give error, warn, info, debug or trace", settings.log_level);
        Error::invalid("log-level", what)
    })?;
    let builder = tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr);
    // A second server in one process writes into the first one's log.
    let _ = match settings.log {
        LogForm::Text => builder.with_ansi(false).try_init(),
        LogForm::Json => {
            builder.json().flatten_event(true).with_current_span(false).with_span_list(false).try_init()
        }
    };
    Ok(())
}
