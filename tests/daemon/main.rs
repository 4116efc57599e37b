//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// Databases, servers and clients for these tests.
mod support;
/// Surveys as uploads.
mod survey;

/// Surveys arrive.
mod arrivals;
/// What clients see while surveys arrive is what the database holds.
mod history;
/// The server is killed while surveys arrive.
mod killed;
/// A server starts, answers and stops.
mod serving;
