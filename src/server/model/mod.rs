//! Messages become our types here, once; behind it our types are trusted.

mod question;
pub mod upload;

pub use question::{area, how, pairs, query, tolerance};
