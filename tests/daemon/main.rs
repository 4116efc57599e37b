//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// What the command line says to the same question.
mod by_hand;
/// Calls of the ingest service, message by message.
mod calls;
/// Databases, servers and clients for these tests.
mod support;
/// Surveys as uploads.
mod survey;

/// Any bytes and any valid message as a request: a status or an answer, never a panic.
mod requests;

/// Surveys arrive.
mod arrivals;
/// Commits as they happen, and where.
mod commits;
/// Files from a server are those of the command line, byte for byte.
mod exports;
/// A database of Mount St. Helens.
mod hills;
/// What clients see while surveys arrive is what the database holds.
mod history;
/// The server is killed while surveys arrive.
mod killed;
/// What of an upload is refused.
mod refused;
/// The surface as a stream: whole, from where the client is, refining what it holds.
mod streams;
/// Fractal tiles of the surface.
mod tiles;

/// Points, lines and rasters from a server are those of the database, bit for bit.
mod heights;
/// Calls by path with raw bytes, HTTP by hand.
mod raw;

/// Noise, slowness, too many, too large; deadlines, shedding, stopping.
mod guarded;
/// Pages, numbers, log, gRPC-web, the commands `serve` and `token`.
mod pages;
/// Tokens, rights, TLS, mutual TLS.
mod security;
/// Sources in memory, random worlds: shared with the other binary.
#[allow(dead_code)]
#[path = "../support/mod.rs"]
mod worlds;

/// What is in the database, asked over the wire.
mod catalog;
/// The command line with `--server`.
mod remote;
/// A server starts, answers and stops.
mod serving;

/// Answers, budgets and differences of Query.
mod queries;

/// Vertices and masks as they travel.
mod payload;

/// Corrections of seams as they travel.
mod bent;

/// Views: sets that stay in step.
mod views;
