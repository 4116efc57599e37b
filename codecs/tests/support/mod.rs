//! Grids for tests: seeded terrain, and real ones of the repository's fixtures.
pub mod grids;
pub mod random;
pub mod reduced;
pub mod spectrum;
pub mod streams;

use std::path::{Path, PathBuf};

/// A file of the shared data, or `None` (with a message) where they are absent.
pub fn shared(path: &str) -> Option<PathBuf> {
    let full = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data").join(path);
    if full.exists() {
        return Some(full);
    }
    assert!(std::env::var_os("TERRAQUILT_REQUIRE_SHARED").is_none(), "{} is absent", full.display());
    println!("shared data absent: skipped ({path})");
    None
}
