//! Commands that look after the files of a database: backup, copy, prune, compact, rebuild.

use super::line::{Line, server};
use super::output::{Meter, Output, bytes, count, message, stop_flag};
use crate::base::{Error, Result};
use crate::client::catalog;
use crate::db::{self, BackupOutcome, Db, Progress, PruneOutcome};
use crate::wire::v1::prune_request::What;
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

/// What is said when another process holds the writer lock.
fn waiting() {
    message("another process is writing to this database; waiting for it");
}

/// Does work with a bar that Ctrl-C stops.
fn with_progress<T>(work: impl FnOnce(&Progress) -> Result<T>) -> Result<T> {
    let (meter, stop) = (Meter::new(), stop_flag());
    let report = |stage: &str, share: f64| meter.report(stage, share);
    let done = work(&Progress { report: &report, stop: &stop });
    meter.clear();
    done
}

/// Prints an outcome: as JSON, or as these lines.
fn tell(json: bool, outcome: &impl Serialize, lines: Vec<String>) -> Result<bool> {
    let mut out = Output::new();
    if json {
        out.json(outcome)?;
    } else {
        for l in lines {
            out.line(l)?;
        }
    }
    out.end()
}

fn counted(n: usize, what: &str) -> String {
    format!("{} {what}{}", count(n as u64), if n == 1 { "" } else { "s" })
}

/// Make a second directory with the same versions, or bring one up to date, while others read and write
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt backup hills /mnt/other/hills\n  terraquilt backup hills /mnt/other/hills --at 12\nRun again, it copies only files that are missing there. The backup is a database: to restore is to open it, or to\ncopy its directory back. Every page is compared with its checksum; damage is an error that names file and place.\nVersions that were pruned here leave the backup, too; so do all others with --at."
)]
pub struct Backup {
    /// Directory of the database
    db: PathBuf,
    /// Directory of the backup: new, or an earlier backup of this database
    dest: PathBuf,
    /// Only this version instead of all that are kept
    #[arg(long, value_name = "VERSION")]
    at: Option<u64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Backup {
    pub fn run(self) -> Result<bool> {
        let db = Db::open(&self.db)?;
        let o = with_progress(|p| db.backup(&self.dest, self.at, p))?;
        let mut lines = vec![format!(
            "{} in {}: {} copied ({}), {} there already; {} pages are as their checksums say",
            counted(o.versions.len(), "version"),
            self.dest.display(),
            counted(o.files_copied, "file"),
            bytes(o.bytes_copied),
            count(o.files_kept as u64),
            count(o.pages_checked),
        )];
        if !o.files_mended.is_empty() {
            lines.push(format!("damaged in the backup, and copied anew: {}", o.files_mended.join(", ")));
        }
        tell(self.json, &o, lines)
    }
}

/// Write one version into a new directory, compactly: only the pages that it reads, no history
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt copy hills hills-2025\nThe copy has the same fingerprint and is a database of its own. A backup keeps files and history as they are and can\nbe brought up to date; a copy is written anew each time and is as small as can be."
)]
pub struct Copy {
    /// Directory of the database
    db: PathBuf,
    /// Directory of the copy: a new one
    dest: PathBuf,
    /// This version instead of the latest
    #[arg(long, value_name = "VERSION")]
    at: Option<u64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Copy {
    pub fn run(self) -> Result<bool> {
        let db = Db::open(&self.db)?;
        let o: BackupOutcome = with_progress(|p| db.copy(&self.dest, self.at, p))?;
        let version = o.versions.first().copied().unwrap_or(0);
        let line = format!(
            "version {version} in {}: {} pages, {}",
            self.dest.display(),
            count(o.pages_checked),
            bytes(o.bytes_copied)
        );
        tell(self.json, &o, vec![line])
    }
}

/// Move what is still read of mostly dead files to new ones, so that prune can give their bytes back
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt compact hills && terraquilt prune hills --keep 1\nA commit that changes no content: same fingerprint. Readers go on; older versions keep their files until they are\npruned, so the disk needs room for what moves."
)]
pub struct Compact {
    /// Directory of the database
    db: PathBuf,
    /// Rewrite files of which at least this share is not read; 0: every file with a dead byte
    #[arg(long, value_name = "SHARE", default_value_t = 0.5)]
    dead: f64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Compact {
    pub fn run(self) -> Result<bool> {
        let db = Db::open(&self.db)?;
        let o = with_progress(|p| db.compact(self.dead, p, &mut waiting))?;
        let line = if o.changed {
            format!(
                "version {}: {} pages moved out of {}, {} written; `terraquilt prune` gives {} back",
                o.version,
                count(o.pages_moved),
                counted(o.files_left, "file"),
                bytes(o.bytes_written),
                bytes(o.bytes_to_prune)
            )
        } else {
            format!("nothing to do: no file is dead by a share of {} or more (see --dead)", self.dead)
        };
        tell(self.json, &o, vec![line])
    }
}

/// Make a lost or damaged catalog again from the other files of the database
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt rebuild hills && terraquilt verify hills\nReads the version records in segments/ (docs/format.md). Deletes nothing: a damaged catalog is kept as catalog.damaged,\nfiles that no version names get the ending .aside. A catalog that is well is left alone."
)]
pub struct Rebuild {
    /// Directory of the database
    db: PathBuf,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Rebuild {
    pub fn run(self) -> Result<bool> {
        let o = db::rebuild(&self.db, &mut waiting)?;
        let latest = o.versions.last().copied().unwrap_or(0);
        let mut lines = vec![format!(
            "the catalog is there again: {}, the latest is {latest}, {}; `terraquilt verify` checks what they hold",
            counted(o.versions.len(), "version"),
            counted(o.files, "file")
        )];
        lines.extend(o.notes.iter().map(|n| format!("not taken: {n}")));
        lines.extend(o.set_aside.iter().map(|n| format!("set aside: {n}")));
        tell(self.json, &o, lines)
    }
}

/// Forget older versions and give their bytes back
#[derive(Args)]
#[command(after_help = "Examples:\n  terraquilt prune hills --keep 1\n  terraquilt prune hills --before 12")]
pub struct Prune {
    /// Directory of the database (or --server ADDR)
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
        let o: PruneOutcome = match server(&self.db) {
            Some(server) => {
                let what = match (self.keep, self.before) {
                    (Some(k), _) => What::Keep(k),
                    (None, b) => What::Before(b.unwrap_or(0)),
                };
                let line = Line::open(server)?;
                let done = line.wait(catalog::prune(&line.connection, what))?;
                line.read(done.json.as_bytes())?
            }
            None => {
                let (keep, before) = (self.keep, self.before);
                let choose = |all: &[u64]| -> Vec<u64> {
                    match (keep, before) {
                        (Some(k), _) => all[..all.len().saturating_sub(k as usize)].to_vec(),
                        (None, Some(b)) => all.iter().copied().filter(|v| *v < b).collect(),
                        (None, None) => Vec::new(),
                    }
                };
                Db::open(&self.db)?.prune(choose, &mut waiting)?
            }
        };
        let mut lines = vec![format!(
            "forgot {}, gave back {}",
            counted(o.pruned.len(), "version"),
            bytes(o.bytes_freed)
        )];
        if !o.kept_for_readers.is_empty() {
            lines.push(format!(
                "kept versions {:?}: somebody is reading them; prune again later",
                o.kept_for_readers
            ));
        }
        tell(self.json, &o, lines)
    }
}
