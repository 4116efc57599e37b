//! Ground floor: what every room may use and that uses none of them.
//!
//! [`Error`] says what went wrong and what to do about it; [`limits`] holds the largest sizes that
//! are accepted from outside; [`bytes`] reads and writes little-endian fields without panicking;
//! [`lattice`] is exact integer geometry; [`round`] rounds errors upwards.

pub mod bytes;
pub mod date;
mod error;
pub mod lattice;
pub mod limits;
pub mod polygon;
pub mod round;

pub use error::{Error, Result};
