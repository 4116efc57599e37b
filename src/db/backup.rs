//! Backups: a consistent second directory of a database, made while others read and write.

use super::change::Progress;
use super::database::{Claim, Db, IDENTITY, UNFINISHED, catalog_path, place_catalog};
use super::pages;
use super::view::View;
use crate::base::{Error, Result};
use crate::store::catalog::{Catalog, Contents, Sqlite};
use crate::store::disk::{Disk, RealDisk, sync_directory};
use crate::store::lock::WriterLock;
use crate::store::segment::{Files, PageRef, file_name};
use serde::Serialize;
use std::collections::{BTreeMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// What a backup or a copy did.
#[derive(Clone, Debug, Default, Serialize)]
pub struct BackupOutcome {
    /// Versions that the other directory holds now, ascending.
    pub versions: Vec<u64>,
    /// Segment files that it holds now.
    pub files: usize,
    pub files_copied: usize,
    /// Files that were there already, and are whole.
    pub files_kept: usize,
    /// Files that were there already and damaged: copied anew.
    pub files_mended: Vec<String>,
    pub bytes_copied: u64,
    /// Pages whose checksums were compared.
    pub pages_checked: u64,
    pub seconds: f64,
}

/// Bytes that are written at once.
const CHUNK: usize = 4 << 20;

impl Db {
    /// Makes `to` a second database with the same versions (`at`: with this one only), or brings an earlier backup up to
    /// date: only files that it does not hold are copied. Takes a lease on every version; writers go on meanwhile.
    ///
    /// # Errors
    /// If a page that one of the versions reads is damaged; if `to` holds anything but an earlier backup of this database.
    /// What `to` held before is then still there.
    pub fn backup(&self, to: &Path, at: Option<u64>, progress: &Progress) -> Result<BackupOutcome> {
        let started = std::time::Instant::now();
        let destination = Destination::take(self, to)?;
        let catalog = self.catalog_for_reading()?;
        let claims = self.claims(&*catalog, at)?;
        let contents = contents(&*catalog, &claims)?;
        destination.refuse_another(&*catalog, &contents)?;

        // Every page of every version, by file.
        let mut seen: HashSet<PageRef> = HashSet::new();
        for (n, c) in claims.iter().enumerate() {
            progress.step("looking", n as f64 / claims.len() as f64)?;
            let files = Files::new(self.shared_disk(), c.files.iter().map(|f| (f.number, f.length)));
            let view = View::open(files, Some(c.version.root))?;
            pages::gather(&view, c.version.root, &mut seen)?;
        }
        let mut by_file: BTreeMap<u32, Vec<PageRef>> = BTreeMap::new();
        for page in seen {
            by_file.entry(page.file).or_default().push(page);
        }
        let lengths: BTreeMap<u32, u64> =
            claims.iter().flat_map(|c| &c.files).map(|f| (f.number, f.length)).collect();

        let mut out = BackupOutcome {
            versions: claims.iter().map(|c| c.version.number).collect(),
            files: lengths.len(),
            ..BackupOutcome::default()
        };
        let there: BTreeMap<String, u64> = destination.disk.names()?.into_iter().collect();
        let absent = |n: u32, length: u64| there.get(&file_name(n)) != Some(&length);
        let wanted: u64 = lengths.iter().filter(|(n, l)| absent(**n, **l)).map(|(_, l)| l).sum();
        destination.need_space(wanted)?;
        let source = Files::new(self.shared_disk(), lengths.iter().map(|(n, l)| (*n, *l)));
        let kept = Files::new(destination.disk.clone(), lengths.iter().map(|(n, l)| (*n, *l)));
        let (total, mut done) = (lengths.values().sum::<u64>().max(1), 0);
        for (number, length) in &lengths {
            let mut all = by_file.remove(number).unwrap_or_default();
            all.sort_unstable_by_key(|p| p.offset);
            out.pages_checked += all.len() as u64;
            let whole = || kept.check_header(*number).and_then(|()| pages::check(&kept, &all));
            if !absent(*number, *length) && whole().is_ok() {
                out.files_kept += 1;
            } else {
                if there.contains_key(&file_name(*number)) {
                    out.files_mended.push(file_name(*number));
                }
                copy_file(&source, *number, &all, &*destination.disk, &|bytes| {
                    progress.step("copying", (done + bytes) as f64 / total as f64)
                })?;
                out.files_copied += 1;
                out.bytes_copied += length;
            }
            done += length;
            progress.step("copying", done as f64 / total as f64)?;
        }
        destination.disk.sync_names()?;
        destination.finish(&contents)?;
        out.seconds = started.elapsed().as_secs_f64();
        Ok(out)
    }

    /// Leases on the versions to back up: all that are kept, or one.
    fn claims(&self, catalog: &dyn Catalog, at: Option<u64>) -> Result<Vec<Claim>> {
        if at.is_some() {
            return Ok(self.claim(catalog, at)?.into_iter().collect());
        }
        let mut out = Vec::new();
        for v in catalog.versions()? {
            match self.claim(catalog, Some(v.number)) {
                Ok(c) => out.extend(c),
                // Pruned since the list was read.
                Err(Error::Missing { .. }) => {}
                Err(e) => return Err(e),
            }
        }
        // The versions that were listed may all have gone while another came.
        if out.is_empty() {
            out.extend(self.claim(catalog, None)?);
        }
        Ok(out)
    }
}

/// What the catalog says of these versions. Counters may be ahead of them: numbers are skipped then, never used twice.
fn contents(catalog: &dyn Catalog, claims: &[Claim]) -> Result<Contents> {
    let newest = claims.last().map_or(0, |c| c.version.number);
    let mut operations = catalog.operations()?;
    operations.retain(|(_, version)| *version <= newest);
    Ok(Contents {
        constants: catalog.constants()?,
        versions: claims.iter().map(|c| (c.version.clone(), c.files.clone())).collect(),
        operations,
        counters: catalog.counters()?,
        backup: Some(newest),
    })
}

/// Copies a segment file, comparing the checksum of every page on the way.
fn copy_file(
    source: &Files,
    number: u32,
    pages: &[PageRef],
    to: &dyn Disk,
    told: &dyn Fn(u64) -> Result<()>,
) -> Result<()> {
    use crate::store::segment::{Pages, temporary_name};
    source.check_header(number)?;
    let bytes = source.bytes(number)?;
    let mut file = to.create(&temporary_name(number))?;
    let (mut at, mut next) = (0, pages.iter().peekable());
    while at < bytes.len() {
        let end = (at + CHUNK).min(bytes.len());
        // Pages that begin in this chunk are compared before it is written.
        while let Some(page) = next.next_if(|p| (p.offset as usize) < end) {
            source.page(page)?;
        }
        file.append(&bytes[at..end])?;
        at = end;
        told(at as u64)?;
    }
    if let Some(page) = next.next() {
        // A page past the end: reading it says so.
        source.page(page)?;
    }
    file.sync()?;
    drop(file);
    to.rename(&temporary_name(number), &file_name(number))
}

/// The directory that a backup or a copy goes to, under its writer lock.
pub(super) struct Destination {
    root: PathBuf,
    pub disk: Arc<dyn Disk>,
    lock: WriterLock,
    /// It held a database when it was taken.
    existed: bool,
}

impl Destination {
    /// Takes a directory that is new, empty, a database, or what a backup left that was cut off.
    pub fn take(db: &Db, root: &Path) -> Result<Destination> {
        let place = root.display();
        if root.is_file() {
            return Err(Error::invalid(place, "is a file; name a directory for the backup"));
        }
        let existed = catalog_path(root).exists();
        if root.exists() && !existed && !root.join(UNFINISHED).exists() {
            let mut entries = fs::read_dir(root).map_err(|e| Error::io(root, e))?;
            if entries.next().is_some() {
                return Err(Error::invalid(
                    place,
                    "is neither empty nor an earlier backup; give a new directory",
                ));
            }
        }
        fs::create_dir_all(root).map_err(|e| Error::io(root, e))?;
        let full = |p: &Path| p.canonicalize().map_err(|e| Error::io(p, e));
        if full(root)?.starts_with(full(db.path())?) {
            if !existed {
                let _ = fs::remove_dir(root);
            }
            return Err(Error::invalid(
                place,
                format!(
                    "is the database {} itself, or inside of it; give another directory",
                    db.path().display()
                ),
            ));
        }
        if !existed {
            let mark = root.join(UNFINISHED);
            fs::write(&mark, "").map_err(|e| Error::io(&mark, e))?;
        }
        for d in [root.join("segments"), root.join("readers")] {
            fs::create_dir_all(&d).map_err(|e| Error::io(&d, e))?;
        }
        sync_directory(root)?;
        let lock = WriterLock::take(root, &mut || ())?;
        let disk = Arc::new(RealDisk::new(root.join("segments")));
        Ok(Destination { root: root.to_path_buf(), disk, lock, existed })
    }

    pub fn need_space(&self, wanted: u64) -> Result<()> {
        match self.disk.free_bytes()? {
            Some(free) if free < wanted => Err(Error::NoSpace { place: self.disk.place(), wanted, free }),
            _ => Ok(()),
        }
    }

    /// Refuses a directory with a database.
    pub fn refuse_any(&self) -> Result<()> {
        if self.existed {
            return Err(Error::invalid(
                self.root.display(),
                "holds a database already; give a new directory",
            ));
        }
        Ok(())
    }

    /// Refuses a database that is no earlier backup of this one: it must be marked as a backup and not have been changed
    /// since; constants and every version that both know must be equal.
    fn refuse_another(&self, ours: &dyn Catalog, contents: &Contents) -> Result<()> {
        if !self.existed {
            return Ok(());
        }
        let other = |reason: String| {
            let what = format!("{reason}; it is no earlier backup of this database, give a new directory");
            Err(Error::invalid(self.root.display(), what))
        };
        let theirs = Sqlite::open_read_only(&catalog_path(&self.root))?;
        let (a, b) = (&contents.constants, theirs.constants()?);
        if let Some((name, _)) = a.iter().chain(&b).find(|(name, _)| a.get(*name) != b.get(*name)) {
            return other(format!("its constant '{name}' is another"));
        }
        let (versions, newest) = (theirs.versions()?, contents.counters.version);
        let last = versions.last().map_or(0, |v| v.number);
        if last > newest {
            return other(format!("holds version {last}, this one ends with {newest}"));
        }
        match theirs.backup()? {
            Some(made_at) if made_at == last => {}
            Some(made_at) => {
                return other(format!("was a backup up to version {made_at} and holds version {last} now"));
            }
            None => return other("is a database, and was not made by `terraquilt backup`".into()),
        }
        let mut shared = versions.is_empty() || a.contains_key(IDENTITY);
        for v in &versions {
            if let Some(w) = ours.version(v.number)? {
                if w != *v {
                    return other(format!("its version {} is another", v.number));
                }
                shared = true;
            }
        }
        if !shared {
            return other("shares no version with it".into());
        }
        Ok(())
    }

    /// Makes the catalog say this, durably, and removes what it does not name.
    pub fn finish(self, contents: &Contents) -> Result<()> {
        if self.existed {
            Sqlite::open(&catalog_path(&self.root))?.fill(contents)?;
        } else {
            place_catalog(&self.root, contents)?;
            let mark = self.root.join(UNFINISHED);
            fs::remove_file(&mark).map_err(|e| Error::io(&mark, e))?;
            sync_directory(&self.root)?;
        }
        drop(self.lock);
        // As any writer does when it begins: leftovers go, and every version gets its record.
        Db::open(&self.root)?.begin(&mut || ()).map(|_| ())
    }
}
