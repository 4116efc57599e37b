//! The writer's side of a database: the lock, what a dead writer left, and making a version visible.

use super::database::Db;
use super::settling::{Settling, SettlingSegment, name_all};
use super::view::View;
use super::writer::Writer;
use crate::base::{Error, Result};
use crate::store::catalog::{Commit, Counters, NamedFile, Version};
use crate::store::lock::{WriterLock, leased};
use crate::store::record::{VersionRecord, record_name, version_of_name};
use crate::store::segment::{Files, PageRef, file_name};
use std::collections::{BTreeSet, HashMap, HashSet};

/// What a commit makes visible.
pub(super) struct Publication<'a> {
    /// Segments that were written for it.
    pub segments: Vec<SettlingSegment>,
    pub root: PageRef,
    /// Pages of the version before that this one does not read.
    pub dead: Vec<PageRef>,
    /// Number of the survey that changed; 0 if none did.
    pub survey: u32,
    pub action: String,
    pub operation: Option<&'a str>,
}

/// The writer's side of one commit.
pub(super) struct Writing {
    /// Goes back to the database before the lock is given up.
    pub catalog: Writer,
    #[allow(dead_code, reason = "held for its effect until the commit is over")]
    lock: WriterLock,
    pub view: View,
    pub version: Option<Version>,
    /// Files of the version, ascending.
    pub files: Vec<NamedFile>,
    pub counters: Counters,
    /// Bytes of leftovers that were removed at the start.
    pub swept: u64,
}

impl Db {
    /// Takes the writer lock, removes leftovers, writes records that are missing, and opens the latest version.
    pub(super) fn begin(&self, waiting: &mut dyn FnMut()) -> Result<Writing> {
        let lock = WriterLock::take(self.path(), waiting)?;
        let catalog = self.catalog_for_writing()?;
        let version = catalog.latest()?;
        let files = match &version {
            Some(v) => catalog.files(v.number)?,
            None => Vec::new(),
        };
        self.caches().tidy();
        // With the caches of the database: a commit reads what was asked for a moment ago, and what it reads will be.
        let view = View::sharing(
            Files::new(self.shared_disk(), files.iter().map(|f| (f.number, f.length))),
            version.as_ref().map(|v| v.root),
            self.caches(),
        )?;
        let counters = catalog.counters()?;
        let mut writing = Writing { lock, catalog, view, version, files, counters, swept: 0 };
        writing.swept = writing.sweep(self)?;
        writing.complete_records(self)?;
        Ok(writing)
    }
}

impl Writing {
    /// The number of the next segment file.
    pub fn next_file(&self) -> u32 {
        self.counters.file + 1
    }

    /// Refuses to start what cannot end.
    pub fn need_space(&self, db: &Db, bytes: u64) -> Result<()> {
        match db.disk().free_bytes()? {
            Some(free) if free < bytes => {
                Err(Error::NoSpace { place: db.disk().place(), wanted: bytes, free })
            }
            _ => Ok(()),
        }
    }

    /// Removes what a change was writing that did not become a version: on a full disk, the room it took. Only temporary
    /// names: after a commit that failed, whether a finished file is named is for the next writer to find out.
    pub fn discard_temporaries(&self, db: &Db) {
        for (name, _) in db.disk().names().unwrap_or_default() {
            if name.ends_with(".tmp") {
                let _ = db.disk().remove(&name);
            }
        }
    }

    /// Removes records of versions that the catalog does not hold, and files that no version names. Files stay while a
    /// reader holds a version that the catalog has forgotten. Returns the bytes that came back.
    pub fn sweep(&self, db: &Db) -> Result<u64> {
        let kept: HashSet<u64> = self.catalog.versions()?.iter().map(|v| v.number).collect();
        let held = leased(db.path())?.iter().any(|v| !kept.contains(v));
        let named: HashSet<String> = self.catalog.all_files()?.iter().map(|(n, _)| file_name(*n)).collect();
        let (mut freed, mut removed) = (0, false);
        for (name, len) in db.disk().names()? {
            let goes = match version_of_name(&name) {
                Some(version) => !kept.contains(&version),
                None => !held && (name.ends_with(".tqs") || name.ends_with(".tmp")) && !named.contains(&name),
            };
            if goes {
                db.disk().remove(&name)?;
                (freed, removed) = (freed + len, true);
            }
        }
        if removed {
            db.disk().sync_names()?;
        }
        Ok(freed)
    }

    /// Writes the records of versions that have none: an earlier program made them, or they were restored.
    fn complete_records(&self, db: &Db) -> Result<()> {
        let there: BTreeSet<String> = db.disk().names()?.into_iter().map(|(name, _)| name).collect();
        for version in self.catalog.versions()? {
            if there.contains(&record_name(version.number)) {
                continue;
            }
            let files = self.catalog.files(version.number)?;
            self.record(version, files, self.counters)?.write(db.disk())?.finish(db.disk())?;
        }
        Ok(())
    }

    fn record(&self, version: Version, files: Vec<NamedFile>, counters: Counters) -> Result<VersionRecord> {
        Ok(VersionRecord { version, files, counters, constants: self.catalog.constants()? })
    }

    /// Makes the segments and the record of the version durable, then commits the version that names them. Returns its
    /// number.
    pub fn publish(&mut self, db: &Db, p: Publication) -> Result<u64> {
        let mut live: HashMap<u32, (u64, u64)> =
            self.files.iter().map(|f| (f.number, (f.length, f.live))).collect();
        let mut last = self.counters.file;
        let mut settling = Vec::new();
        for SettlingSegment { number, length, file } in p.segments {
            live.insert(number, (length, length - crate::store::segment::HEADER_BYTES));
            last = last.max(number);
            settling.push(file);
        }
        for page in p.dead {
            if let Some((_, bytes)) = live.get_mut(&page.file) {
                *bytes = bytes.saturating_sub(u64::from(page.len));
            }
        }
        let number = self.counters.version + 1;
        let mut files: Vec<NamedFile> = live
            .into_iter()
            .filter(|(_, (_, bytes))| *bytes > 0)
            .map(|(number, (length, live))| NamedFile { number, length, live })
            .collect();
        files.sort_unstable_by_key(|f| f.number);
        let made_at = std::time::SystemTime::now()
            .duration_since(std::time::UNIX_EPOCH)
            .map_or(0, |d| d.as_secs() as i64);
        let operation = p.operation.map_or_else(|| format!("commit-{number}"), str::to_string);
        let counters = Counters { file: last, survey: self.counters.survey.max(p.survey), version: number };
        let version = Version { number, operation, made_at, action: p.action, root: p.root };
        // The record is named last: what it names has its name then, unless the power goes before the names are durable.
        let record = self.record(version.clone(), files.clone(), counters)?.write(db.disk())?;
        settling.push(Settling::start(record)?);
        name_all(settling, db.disk())?;
        self.catalog.commit(&Commit { version, files, counters })?;
        Ok(number)
    }
}
