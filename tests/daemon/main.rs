//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// Databases, servers and clients for these tests.
mod support;

/// Calls by path with raw bytes, HTTP by hand.
mod raw;

/// Noise, slowness, too many, too large; deadlines, shedding, stopping.
mod guarded;
/// Pages, numbers, log, gRPC-web, the commands `serve` and `token`.
mod pages;
/// Tokens, rights, TLS, mutual TLS.
mod security;
/// A server starts, answers and stops.
mod serving;
