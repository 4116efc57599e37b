//! Messages become our types here, once; behind it our types are trusted.

pub mod heights;
mod question;

pub use question::{area, how, pairs, query, tolerance};
