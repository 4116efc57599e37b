//! Commands that look at a database's health: info, fingerprint, verify.

use super::args::Source;
use super::output::{Output, bytes, count};
use crate::base::Result;
use clap::Args;
use serde_json::json;

/// Sizes, counts, overlap, format version
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt info hills")]
pub struct InfoCommand {
    #[command(flatten)]
    source: Source,
}

impl InfoCommand {
    pub fn run(self) -> Result<bool> {
        let i = self.source.open()?.info()?;
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
        let r = self.source.open()?;
        let f = r.fingerprint()?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&json!({"fingerprint": f, "version": r.version()}))?;
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
        let reader = self.source.open()?;
        let r = reader.verify()?;
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
            out.line(format!("version {}: {verdict}; {counted}", reader.version()))?;
        }
        out.end()?;
        Ok(r.ok)
    }
}
