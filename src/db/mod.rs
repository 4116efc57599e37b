//! The junction: surveys in, versions out, questions answered. The only room that sees the whole middle floor.
//!
//! - [`Db`]: a database directory; [`Snapshot`]: one version of it, never blocked by writers;
//! - [`Change`]: what a commit does (ingest, replace, remove, set); [`prune`](Db::prune) gives bytes back;
//! - [`query`]: patches of a region within a tolerance, differences, heights;
//! - [`Db::backup`], [`Db::copy`], [`Db::compact`], [`rebuild`]: care of the data;
//! - [`contributions`], [`Snapshot::provenance`]: what each survey gives;
//! - [`verify`]: everything that can be checked; [`fingerprint`]: one hash of the logical content.

mod alone;
mod area;
mod arrive;
mod asked;
mod awaiting;
mod backup;
mod build;
mod caches;
mod change;
mod check;
mod commit;
mod compact;
mod contradictions;
mod corrections;
mod database;
mod declare;
mod errors;
mod export;
mod finest;
mod fingerprint;
mod footprint;
mod found;
mod head;
mod heights;
mod kept;
mod leave;
mod levels;
mod listing;
mod masks;
mod pages;
mod payload;
mod provenance;
mod prune;
pub mod query;
mod reader;
mod rebuild;
mod redundant;
mod relief;
mod relocate;
mod resample;
mod root;
mod seams;
mod selection;
mod settling;
mod sheets;
mod subset;
mod tile;
mod triangles;
mod update;
mod uploads;
mod view;
mod walls;
mod writer;
mod writing;

pub use awaiting::Awaiting;
pub use backup::BackupOutcome;
pub use change::{Change, Ingest, Outcome, Progress};
pub use check::{Problem, Report, verify};
pub use compact::CompactOutcome;
pub use contradictions::{Contradiction, Overlap};
pub use corrections::CorrectionPart;
pub use database::{Db, Options, Policy, Snapshot};
pub use export::{OwnPosts, RawTile, own_posts, read_tile};
pub use fingerprint::fingerprint;
pub use footprint::Footprint;
pub use head::{Declaration, Delivered, Head, Resampled, Tile};
pub use listing::{
    BoxRow, BoxWalk, DeliveredRow, Info, NodeRow, SurveyRow, TileRow, TreeNode, TreeWalk, boxes, info,
    more_boxes, survey_row, surveys, tiles, tree, vertical_datum,
};
pub use masks::MaskPart;
pub use provenance::{Provenance, Share};
pub use prune::PruneOutcome;
pub use rebuild::{RebuildOutcome, rebuild, rebuild_on};
pub use redundant::{Contribution, contributions};
pub use resample::Resampling;
pub use root::SurveyEntry;
pub use triangles::{RegionMesh, WALL_STEPS, metres_per_unit, triangulate_region};
pub use uploads::{Upload, Uploads};
