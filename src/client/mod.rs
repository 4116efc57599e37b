//! The other side of the wire: asks a server what `proto/terraquilt/v1` says, for the command line and for programs in Rust.
//!
//! - [`Address`]: where the server is and who asks; [`Connection`]: a channel to it, with a client for each service;
//! - [`catalog`]: what is in the database, changes without samples; [`query`]: patches, differences;
//! - [`ingest`]: sends surveys;
//! - [`heights`]: points, lines and rasters; [`watch`]: commits as they happen; [`export`]: files;
//! - [`stream`]: the surface as a stream that goes on where it broke off;
//! - [`view`]: a view that the server keeps in step.

pub mod catalog;
mod connection;
pub mod export;
pub mod heights;
pub mod ingest;
pub mod query;
pub mod stream;
pub mod view;
pub mod watch;

pub use connection::{Address, Bearer, Connection, Wire, failed};
