//! Who may ask for what.
//!
//! - [`TokenFile`]: the tokens that were made, hashed, in a file beside the database;
//! - [`Tokens`]: the same as a running server knows them, followed while the file changes;
//! - [`rights`]: the right that each method needs;
//! - `command`: `terraquilt token add|list|revoke`.
//!
//! A token is `tq_` and 32 random bytes in hexadecimal. Only its BLAKE3 hash is kept: 256 random bits need no slow hash, and a
//! look-up by hash tells an attacker nothing by its timing. Where no file of tokens is, nobody was ever given a token, and
//! everyone who reaches the server (on loopback) may do everything. A file without tokens refuses everyone.

pub mod command;
mod file;
mod known;
pub mod rights;

pub use file::{Right, Token, TokenFile};
pub use known::{Caller, Tokens};
