//! The database on disk: boxes and bytes, never heights.
//!
//! - [`disk`]: the narrow trait behind which files live, and the real one;
//! - [`segment`]: files of checksummed pages, written once, named by the catalog, then mapped;
//! - [`catalog`]: SQLite; a commit is one transaction, made after everything it names is synced;
//! - [`record`]: what the catalog says of a version, once more, in a file: a lost catalog can be made again;
//! - [`lock`]: the exclusive writer lock and the leases of readers;
//! - [`table`]: pages of the patch table (what a survey is) and of the top table (what the set makes of it);
//! - [`quadtree`]: the multiple-storage quadtree.
//!
//! A commit is visible when its catalog row is, and not before: files named by a row are complete and
//! synced; a row is never changed; whatever no row names may be removed by the holder of the writer lock.

pub mod catalog;
pub mod disk;
pub mod lock;
pub mod quadtree;
pub mod record;
pub mod segment;
pub mod table;
