//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// Databases, servers and clients for these tests.
mod support;
/// Surveys as uploads.
mod survey;

/// Commits as they happen, and where.
mod commits;
/// Files from a server are those of the command line, byte for byte.
mod exports;
/// A database of Mount St. Helens.
mod hills;

/// Points, lines and rasters from a server are those of the database, bit for bit.
mod heights;

/// Surveys arrive.
mod arrivals;
/// What is in the database, asked over the wire.
mod catalog;
/// The server is killed while surveys arrive.
mod killed;
/// The command line with `--server`.
mod remote;
/// A server starts, answers and stops.
mod serving;
