//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// Databases, servers and clients for these tests.
mod support;

/// Calls by path with raw bytes, HTTP by hand.
mod raw;

/// Tokens, rights, TLS, mutual TLS.
mod security;
/// A server starts, answers and stops.
mod serving;
