//! The daemon, over real connections on loopback. A binary of its own: it needs a runtime, and links in a fraction of the
//! time of the other.

/// Databases, servers and clients for these tests.
mod support;

/// Sources in memory, random worlds: shared with the other binary.
#[allow(dead_code)]
#[path = "../support/mod.rs"]
mod worlds;

/// A server starts, answers and stops.
mod serving;

/// Answers, budgets and differences of Query.
mod queries;

/// Vertices and masks as they travel.
mod payload;

/// Views: sets that stay in step.
mod views;
