//! Messages become our types here, once; behind it our types are trusted.

mod catalog;
mod page;
mod question;

pub use catalog::{commit_reply, frame, ground, json, survey, tile};
pub use page::Page;
pub use question::{area, how, pairs, query, tolerance};
