//! Commands that look after a database: info, fingerprint, verify, prune.

use super::args::Source;
use super::output::{Meter, Output, bytes, count, message, stop_flag};
use crate::base::{Error, Result};
use crate::db::{self, Db, Progress};
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// Sizes, counts, overlap, format version
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt info hills")]
pub struct InfoCommand {
    #[command(flatten)]
    source: Source,
}

impl InfoCommand {
    pub fn run(self) -> Result<bool> {
        let (db, s) = self.source.open()?;
        let i = db::info(&db, &s)?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&i)?;
            return out.end();
        }
        let unit =
            if i.crs == "EPSG:4326" || i.lattice_unit < 1e-12 { "degrees" } else { "units of the CRS" };
        for (what, value) in [
            ("database", i.path.clone()),
            ("format", format!("{}, derivation {}", i.format_version, i.derivation_version)),
            ("crs", format!("{}, lattice unit {:e} {unit}", i.crs, i.lattice_unit)),
            ("policy", i.policy.to_string()),
            ("version", i.version.to_string()),
            ("surveys", format!("{}, {} tiles, {} valid posts", i.surveys, i.tiles, count(i.valid_posts))),
            (
                "patches",
                format!("{}, {} live, {} dormant", count(i.patches), count(i.live), count(i.dormant)),
            ),
            (
                "tree",
                format!(
                    "{} nodes, depth {}, {:.2} nodes a live patch",
                    count(i.tree_nodes),
                    i.tree_depth,
                    i.nodes_per_patch
                ),
            ),
            (
                "overlap",
                format!("{:.2} on average, {} at most (tolerance 0, sampled)", i.overlap_mean, i.overlap_max),
            ),
            (
                "disk",
                format!(
                    "{} with all versions; this one reads {} in {} files, {:.3} bytes a post",
                    bytes(i.bytes_all_versions),
                    bytes(i.bytes_live),
                    i.files,
                    i.bytes_per_post
                ),
            ),
        ] {
            out.line(format!("{what:10} {value}"))?;
        }
        out.end()
    }
}

/// One hash of the logical content: equal for the same surveys, whatever the order they came in
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt fingerprint hills")]
pub struct Fingerprint {
    #[command(flatten)]
    source: Source,
}

impl Fingerprint {
    pub fn run(self) -> Result<bool> {
        let (_, s) = self.source.open()?;
        let f = db::fingerprint(&s)?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&json!({"fingerprint": f, "version": s.number()}))?;
        } else {
            out.line(f)?;
        }
        out.end()
    }
}

/// Check everything that can be checked; exit 1 and a list if anything is wrong
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt verify hills\nReads every byte and computes everything again: takes about as long as the ingests did."
)]
pub struct Verify {
    #[command(flatten)]
    source: Source,
}

impl Verify {
    pub fn run(self) -> Result<bool> {
        let (db, s) = self.source.open()?;
        let meter = Meter::new();
        let stop = stop_flag();
        let report = |stage: &str, share: f64| meter.report(stage, share);
        let r = db::verify(&db, &s, &Progress { report: &report, stop: &stop });
        meter.clear();
        let r = r?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&r)?;
        } else {
            let counts: Vec<String> = r.checked.iter().map(|(k, v)| format!("{} {k}", count(*v))).collect();
            for p in &r.problems {
                out.line(format!("{}: {}", p.place, p.what))?;
            }
            let verdict = if r.ok { "all is well" } else { "NOT well" };
            let counted = if counts.is_empty() { "nothing is in it".to_string() } else { counts.join(", ") };
            out.line(format!("version {}: {verdict}; {counted}", s.number()))?;
        }
        out.end()?;
        Ok(r.ok)
    }
}

/// Forget older versions and give their bytes back
#[derive(Args)]
#[command(after_help = "Examples:\n  terraquilt prune hills --keep 1\n  terraquilt prune hills --before 12")]
pub struct Prune {
    /// Directory of the database
    db: PathBuf,
    /// Keep the newest N versions
    #[arg(long, value_name = "N", required_unless_present = "before", conflicts_with = "before")]
    keep: Option<u64>,
    /// Forget versions before this one
    #[arg(long, value_name = "VERSION")]
    before: Option<u64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Prune {
    pub fn run(self) -> Result<bool> {
        if self.keep == Some(0) {
            return Err(Error::invalid(
                "--keep",
                "0 versions; the latest one always stays, so give at least 1",
            ));
        }
        let db = Db::open(&self.db)?;
        let (keep, before) = (self.keep, self.before);
        let choose = |all: &[u64]| -> Vec<u64> {
            match (keep, before) {
                (Some(k), _) => all[..all.len().saturating_sub(k as usize)].to_vec(),
                (None, Some(b)) => all.iter().copied().filter(|v| *v < b).collect(),
                (None, None) => Vec::new(),
            }
        };
        let o =
            db.prune(choose, &mut || message("another process is writing to this database; waiting for it"))?;
        let mut out = Output::new();
        if self.json {
            out.json(&o)?;
            return out.end();
        }
        out.line(format!(
            "forgot {} version{}, gave back {}",
            o.pruned.len(),
            if o.pruned.len() == 1 { "" } else { "s" },
            bytes(o.bytes_freed)
        ))?;
        if !o.kept_for_readers.is_empty() {
            out.line(format!(
                "kept versions {:?}: somebody is reading them; prune again later",
                o.kept_for_readers
            ))?;
        }
        out.end()
    }
}
