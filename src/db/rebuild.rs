//! A lost catalog, made again from the version records beside the segments.

use super::database::{Db, catalog_path, place_catalog};
use super::root::Root;
use crate::base::{Error, Result};
use crate::store::catalog::{Catalog, Contents, Counters, NamedFile, Sqlite};
use crate::store::disk::{Disk, RealDisk, sync_directory};
use crate::store::lock::{WriterLock, leased};
use crate::store::record::{VersionRecord, version_of_name};
use crate::store::segment::{Files, Pages, file_name};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use std::sync::Arc;

/// What a rebuild found.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RebuildOutcome {
    /// Versions that the catalog holds now, ascending.
    pub versions: Vec<u64>,
    pub files: usize,
    /// Files that were set aside under another name, and the damaged catalog.
    pub set_aside: Vec<String>,
    /// Versions that could not be had, and why.
    pub notes: Vec<String>,
}

/// Makes the catalog of a database again. Nothing is deleted: a damaged catalog is kept as `catalog.damaged`, damaged
/// records and segments that no version names get another name.
///
/// # Errors
/// If the catalog is well; if somebody reads or writes; if there is no record to go by.
pub fn rebuild(root: &Path, waiting: &mut dyn FnMut()) -> Result<RebuildOutcome> {
    let segments = root.join("segments");
    if !segments.is_dir() {
        return Err(Error::missing(
            format!("directory {}", segments.display()),
            "name the directory of a database",
        ));
    }
    rebuild_on(root, Arc::new(RealDisk::new(segments)), waiting)
}

/// The same on another disk: how tests stop at a write.
pub fn rebuild_on(root: &Path, disk: Arc<dyn Disk>, waiting: &mut dyn FnMut()) -> Result<RebuildOutcome> {
    let _lock = WriterLock::take(root, waiting)?;
    match healthy(root) {
        Ok(n) => {
            return Err(Error::invalid(
                root.display(),
                format!("its catalog is well (versions: {n}); there is nothing to rebuild"),
            ));
        }
        // It is not damaged, but of a newer program.
        Err(e @ Error::Unsupported { .. }) => return Err(e),
        Err(_) => {}
    }
    if let Some(v) = leased(root)?.first() {
        return Err(Error::Busy {
            what: format!(
                "{}: somebody is reading version {v}; end the readers, then rebuild",
                root.display()
            ),
        });
    }
    let mut out = RebuildOutcome::default();
    let names = disk.names()?;
    let found = read_records(&disk, &names, &mut out)?;
    let Some(newest) = found.last() else {
        return Err(Error::missing(
            format!("version records (segments/*.tqv) of {}", root.display()),
            "without the catalog they alone say which versions there are, where their root pages lie, and the CRS, \
             lattice unit and policy; programs before they existed wrote none. Restore catalog.sqlite from a backup",
        ));
    };
    let counters = counters(newest, &names);
    let contents = Contents {
        constants: newest.constants.clone(),
        operations: found.iter().map(|r| (r.version.operation.clone(), r.version.number)).collect(),
        versions: found.iter().map(|r| (r.version.clone(), r.files.clone())).collect(),
        counters,
        backup: None,
    };
    // What no version names would be swept by the next writer. It may be all that is left of something: it stays.
    let kept: BTreeSet<String> = found.iter().flat_map(|r| &r.files).map(|f| file_name(f.number)).collect();
    let known: BTreeSet<u64> = found.iter().map(|r| r.version.number).collect();
    let mut renamed = false;
    for (name, _) in &names {
        let aside = match version_of_name(name) {
            Some(version) => !known.contains(&version),
            None => name.ends_with(".tqs") && !kept.contains(name),
        };
        if aside {
            let to = format!("{name}.aside");
            disk.rename(name, &to)?;
            out.set_aside.push(format!("segments/{to}"));
            renamed = true;
        }
    }
    if renamed {
        disk.sync_names()?;
    }
    out.set_aside.extend(set_catalog_aside(root)?);
    fs::create_dir_all(root.join("readers")).map_err(|e| Error::io(root, e))?;
    place_catalog(root, &contents)?;
    out.versions = known.into_iter().collect();
    out.files = kept.len();
    Ok(out)
}

/// How many versions a catalog holds that can be used.
fn healthy(root: &Path) -> Result<usize> {
    let path = catalog_path(root);
    if !path.exists() {
        return Err(Error::missing(path.display(), "it is lost"));
    }
    Db::open(root)?;
    let catalog = Sqlite::open_read_only(&path)?;
    if let Some(p) = catalog.check()?.first() {
        return Err(Error::Catalog(p.clone()));
    }
    catalog.counters()?;
    let versions = catalog.versions()?;
    for v in &versions {
        if catalog.files(v.number)?.is_empty() {
            return Err(Error::corrupt(path.display(), format!("version {}", v.number), "names no file"));
        }
    }
    Ok(versions.len())
}

/// Records that are whole and whose files are all there, ascending by version.
fn read_records(
    disk: &Arc<dyn Disk>,
    names: &[(String, u64)],
    out: &mut RebuildOutcome,
) -> Result<Vec<VersionRecord>> {
    let lengths: BTreeMap<&str, u64> = names.iter().map(|(n, l)| (n.as_str(), *l)).collect();
    let mut found: BTreeMap<u64, VersionRecord> = BTreeMap::new();
    for (name, length) in names {
        let Some(number) = version_of_name(name) else { continue };
        let record = match VersionRecord::read(&**disk, name, *length) {
            Ok(r) if r.version.number == number => r,
            Ok(r) => {
                out.notes.push(format!("{name}: holds version {}, not this one", r.version.number));
                continue;
            }
            Err(e @ Error::Unsupported { .. }) => return Err(e),
            Err(e) => {
                out.notes.push(format!("version {number}: {e}"));
                continue;
            }
        };
        let wrong = |f: &&NamedFile| lengths.get(file_name(f.number).as_str()) != Some(&f.length);
        if let Some(f) = record.files.iter().find(wrong) {
            let is = match lengths.get(file_name(f.number).as_str()) {
                Some(l) => format!("has {l} bytes, not {}", f.length),
                None => "is not there".into(),
            };
            out.notes.push(format!("version {number}: {} {is}", file_name(f.number)));
            continue;
        }
        let files = Files::new(disk.clone(), record.files.iter().map(|f| (f.number, f.length)));
        let at = record.version.root;
        if let Err(e) = files.page(&at).and_then(|b| Root::decode(&b, &file_name(at.file))) {
            out.notes.push(format!("version {number}: {e}"));
            continue;
        }
        found.insert(number, record);
    }
    // One database has one set of constants. Records of another got here by mistake.
    if let Some(newest) = found.values().next_back().map(|r| r.constants.clone()) {
        found.retain(|number, r| {
            let same = r.constants == newest;
            if !same {
                out.notes.push(format!("version {number}: its record has the constants of another database"));
            }
            same
        });
    }
    Ok(found.into_values().collect())
}

/// Numbers given out, as far as anything in the directory tells: none is given twice.
fn counters(newest: &VersionRecord, names: &[(String, u64)]) -> Counters {
    let mut c = newest.counters;
    for (name, _) in names {
        let stem = name.split('.').next().unwrap_or_default();
        if name.contains(".tqv") {
            c.version = c.version.max(stem.parse().unwrap_or(0));
        } else if let Ok(file) = stem.parse() {
            c.file = c.file.max(file);
        }
    }
    c
}

/// Gives a damaged catalog and its log other names: a log that is left would be taken for the new catalog's.
fn set_catalog_aside(root: &Path) -> Result<Vec<String>> {
    let mut out = Vec::new();
    let free = (0..)
        .map(|n| if n == 0 { "catalog.damaged".to_string() } else { format!("catalog.damaged-{n}") })
        .find(|name| !root.join(name).exists() && !root.join(format!("{name}-wal")).exists())
        .expect("there are more numbers than files");
    for end in ["", "-wal", "-shm"] {
        let from = root.join(format!("catalog.sqlite{end}"));
        if from.exists() {
            let to = format!("{free}{end}");
            fs::rename(&from, root.join(&to)).map_err(|e| Error::io(&from, e))?;
            out.push(to);
        }
    }
    sync_directory(root)?;
    Ok(out)
}
