//! The junction: surveys in, versions out, questions answered. The only room that sees the whole middle floor.
//!
//! - [`Db`]: a database directory; [`Snapshot`]: one version of it, never blocked by writers;
//! - [`Change`]: what a commit does (ingest, replace, remove, set); [`prune`](Db::prune) gives bytes back;
//! - [`query`]: patches of a region within a tolerance, differences, heights;
//! - [`verify`]: everything that can be checked; [`fingerprint`]: one hash of the logical content.

mod area;
mod arrive;
mod build;
mod change;
mod check;
mod commit;
mod database;
mod export;
mod fingerprint;
mod head;
mod leave;
mod listing;
pub mod query;
mod reader;
mod root;
mod tile;
mod triangles;
mod update;
mod view;

pub use change::{Change, Ingest, Outcome, Progress};
pub use check::{Report, verify};
pub use database::{Db, Options, Policy, PruneOutcome, Snapshot};
pub use export::{RawTile, read_tile};
pub use fingerprint::fingerprint;
pub use head::{Declaration, Head, Tile};
pub use listing::{BoxRow, Info, SurveyRow, TreeNode, boxes, info, surveys, tree};
pub use root::SurveyEntry;
pub use triangles::{RegionMesh, metres_per_unit, triangulate_region};
