//! The log, on standard error: for people, or one JSON object a line.
//!
//! Every call is a line with the target `terraquilt::call`: id, method, peer, name of the token, code, milliseconds, bytes. No
//! token is ever in it: only [`tokens`](super::tokens) sees one.

use super::settings::{LogForm, Settings};
use crate::base::{Error, Result};
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::LevelFilter;

/// Starts the log of this process.
///
/// # Errors
/// If `log_level` is no level and no list of filters.
pub fn start(settings: &Settings) -> Result<()> {
    let level = &settings.log_level;
    let refused = |e: &dyn std::fmt::Display| {
        Error::invalid("log-level", format!("'{level}': {e}; give error, warn, info, debug or trace"))
    };
    // A word alone would be taken for the name of a part of the program, and nothing logged.
    if !level.contains('=') && level.parse::<LevelFilter>().is_err() {
        return Err(refused(&"is no level"));
    }
    // The library below the catalog tells of every time that it finds nothing to do.
    let filter = EnvFilter::try_new(format!("refinery_core=warn,{level}")).map_err(|e| refused(&e))?;
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
