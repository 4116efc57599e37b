//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// Calls of the ingest service, message by message.
mod calls;
/// Databases, servers and clients for these tests.
mod support;
/// Surveys as uploads.
mod survey;

/// Surveys arrive.
mod arrivals;
/// The server is killed while surveys arrive.
mod killed;
/// What of an upload is refused.
mod refused;
/// A server starts, answers and stops.
mod serving;
