//! Messages become our types here, once; behind it our types are trusted.

mod parts;
mod question;

pub use parts::{ground, mask, patch, survey_frame};
pub use question::{area, how, pairs, query, tolerance};
