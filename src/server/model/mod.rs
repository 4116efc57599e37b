//! Messages become our types here, once; behind it our types are trusted.

pub mod heights;
mod looser;
mod parts;
mod question;
pub mod upload;

pub use looser::looser;
pub use parts::{frames, ground, mask, patch, set_hash, survey_frame};
pub use question::{area, how, manner, pairs, query, tolerance};
