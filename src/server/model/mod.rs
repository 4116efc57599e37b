//! Messages become our types here, once; behind it our types are trusted.

mod catalog;
pub mod export;
pub mod heights;
mod looser;
mod page;
mod parts;
mod question;
pub mod stream;
pub mod upload;

pub use catalog::{json, survey, tile};
pub use looser::looser;
pub use page::Page;
pub use parts::{correction, frames, ground, mask, patch, survey_frame};
pub use question::{area, how, manner, pairs, query, tolerance};
