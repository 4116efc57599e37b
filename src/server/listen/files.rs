//! File handles: each connection needs one.

use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

/// Handles that stay for the database, the log and what else the process opens.
const OTHERS: u64 = 512;

/// Raises the process's soft limit of open files to the hard one, and returns how many connections that allows of those wanted.
pub fn connections(wanted: usize) -> usize {
    let limit = getrlimit(Resource::Nofile);
    let raised = Rlimit { current: limit.maximum, maximum: limit.maximum };
    // A system that refuses leaves the limit as it was, and the bound follows it.
    let _ = setrlimit(Resource::Nofile, raised);
    let Some(files) = getrlimit(Resource::Nofile).current else { return wanted };
    let room = usize::try_from(files.saturating_sub(OTHERS).max(files / 2)).unwrap_or(usize::MAX);
    if room < wanted {
        tracing::warn!(
            "{files} open files are allowed: no more than {room} connections, of the {wanted} wanted"
        );
    }
    wanted.min(room)
}
