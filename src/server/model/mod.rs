//! Messages become our types here, once; behind it our types are trusted.

mod catalog;
mod page;
mod parts;
mod question;

pub use catalog::{commit_reply, json, survey, tile};
pub use page::Page;
pub use parts::{ground, mask, patch, survey_frame};
pub use question::{area, how, pairs, query, tolerance};
