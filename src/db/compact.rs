//! Compaction: what is still read of mostly dead files moves to new ones. And copies: one version, its pages only.

use super::backup::{BackupOutcome, Destination};
use super::change::Progress;
use super::database::{Db, IDENTITY, new_identity};
use super::relocate::Relocation;
use super::settling::SettlingSegment;
use super::view::View;
use super::writing::{Publication, Writing};
use crate::base::{Error, Result};
use crate::store::catalog::{Contents, NamedFile};
use crate::store::segment::{Files, HEADER_BYTES};
use serde::Serialize;
use std::collections::HashSet;
use std::path::Path;

/// What a compaction did.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CompactOutcome {
    /// The version that the database has now.
    pub version: u64,
    /// False if no file was dead enough.
    pub changed: bool,
    /// Files that the new version no longer reads.
    pub files_left: usize,
    pub pages_moved: u64,
    pub bytes_written: u64,
    /// Length of the files left: what comes back when the versions that read them are pruned.
    pub bytes_to_prune: u64,
    pub seconds: f64,
}

impl Db {
    /// Rewrites files of which at least the share `dead` (0 to 1) is not read by the latest version, as a commit that
    /// changes no content: same fingerprint, same ids. With 0, everything goes to two new files if any byte is dead.
    pub fn compact(
        &self,
        dead: f64,
        progress: &Progress,
        waiting: &mut dyn FnMut(),
    ) -> Result<CompactOutcome> {
        let started = std::time::Instant::now();
        if !(0.0..=1.0).contains(&dead) {
            return Err(Error::invalid("--dead", format!("{dead} is no share; give a number from 0 to 1")));
        }
        let mut writing = self.begin(waiting)?;
        let done = writing.compact(self, dead, progress);
        if !done.as_ref().is_ok_and(|o| o.changed) {
            writing.discard_temporaries(self);
        }
        let mut outcome = done?;
        outcome.seconds = started.elapsed().as_secs_f64();
        Ok(outcome)
    }

    /// Writes one version (the latest, or `at`) into a new directory as a database of its own: its pages and no others, in
    /// two segments. It keeps the number of the version, and nothing of the history before it.
    pub fn copy(&self, to: &Path, at: Option<u64>, progress: &Progress) -> Result<BackupOutcome> {
        let started = std::time::Instant::now();
        let destination = Destination::take(self, to)?;
        destination.refuse_any()?;
        let catalog = self.catalog_for_reading()?;
        let claim = self.claim(&*catalog, at)?;
        let mut counters = catalog.counters()?;
        let mut out = BackupOutcome::default();
        let mut versions = Vec::new();
        counters.file = 0;
        if let Some(c) = &claim {
            let live: u64 = c.files.iter().map(|f| f.live).sum();
            destination.need_space(live + live / 50)?;
            let files = Files::new(self.shared_disk(), c.files.iter().map(|f| (f.number, f.length)));
            let view = View::open(files, Some(c.version.root))?;
            let move_all = |_: u32| true;
            let all = Relocation::new(&view, &move_all, (&*destination.disk, 1), (progress, live))?;
            let (root, segments, moved) = all.run(c.version.root)?;
            out.pages_checked = moved.len() as u64;
            let mut files = Vec::new();
            for segment in segments {
                let (number, live) = (segment.number(), segment.len() - HEADER_BYTES);
                let length = segment.finish(&*destination.disk)?;
                files.push(NamedFile { number, length, live });
                out.bytes_copied += length;
                counters.file = number;
            }
            (out.files, out.files_copied) = (files.len(), files.len());
            out.versions = vec![c.version.number];
            let mut version = c.version.clone();
            version.root = root;
            versions.push((version, files));
        }
        let newest = out.versions.first().copied().unwrap_or(0);
        let mut operations = catalog.operations()?;
        operations.retain(|(_, v)| *v <= newest);
        let mut constants = catalog.constants()?;
        constants.insert(IDENTITY.into(), new_identity());
        destination.finish(&Contents { constants, versions, operations, counters, backup: None })?;
        out.seconds = started.elapsed().as_secs_f64();
        Ok(out)
    }
}

impl Writing {
    fn compact(&mut self, db: &Db, dead: f64, progress: &Progress) -> Result<CompactOutcome> {
        // Bytes of a file that the version does not read, as a share of its pages.
        let share = |f: &NamedFile| 1.0 - f.live as f64 / f.length.saturating_sub(HEADER_BYTES).max(1) as f64;
        let any = self.files.iter().any(|f| share(f) > 0.0);
        let sparse = |f: &&NamedFile| share(f) >= dead && any;
        let chosen: Vec<NamedFile> = self.files.iter().filter(sparse).copied().collect();
        let mut outcome = CompactOutcome { version: self.counters.version, ..CompactOutcome::default() };
        let (Some(version), false) = (&self.version, chosen.is_empty()) else { return Ok(outcome) };
        let live: u64 = chosen.iter().map(|f| f.live).sum();
        self.need_space(db, live + live / 8 + (4 << 20))?;
        let numbers: HashSet<u32> = chosen.iter().map(|f| f.number).collect();
        let moves = |file: u32| numbers.contains(&file);
        let to = (db.disk(), self.next_file());
        let (root, segments, gone) =
            Relocation::new(&self.view, &moves, to, (progress, live))?.run(version.root)?;
        outcome.pages_moved = gone.len() as u64;
        outcome.bytes_written = segments.iter().map(|s| s.len()).sum();
        outcome.files_left = chosen.len();
        outcome.bytes_to_prune = chosen.iter().map(|f| f.length).sum();
        progress.step("committing", 0.0)?;
        let action = format!("compact {} file{}", chosen.len(), if chosen.len() == 1 { "" } else { "s" });
        let segments = segments.into_iter().map(SettlingSegment::start).collect::<Result<_>>()?;
        outcome.version =
            self.publish(db, Publication { segments, root, dead: gone, survey: 0, action, operation: None })?;
        outcome.changed = true;
        Ok(outcome)
    }
}
