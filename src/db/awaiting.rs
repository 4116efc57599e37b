//! A database whose coordinate system is chosen by its first survey.
//!
//! Until then the directory holds nothing but a text file with what was fixed when it was made.

use super::database::{Db, Options, Policy};
use crate::base::{Error, Result};
use crate::height::crs::{AxisUnit, Crs, automatic, lonlat_bounds};
use crate::height::patch::Kind;
use crate::height::source::SourceInfo;
use crate::store::disk::sync_directory;
use std::path::{Path, PathBuf};

/// Name of the text file.
pub(super) const AWAITING: &str = "awaiting-first-survey.txt";
/// Bytes of that file that are read.
const BYTES_MAX: u64 = 4096;
/// Projected systems that stretch lengths so much that nobody wants them unasked: web and world Mercator.
const STRETCHED: [&str; 2] = ["EPSG:3857", "EPSG:3395"];

/// A directory that waits for its first survey.
#[derive(Clone, Debug, PartialEq)]
pub struct Awaiting {
    root: PathBuf,
    pub policy: Policy,
    pub patch: Kind,
}

impl Awaiting {
    /// Makes a directory that does not exist or is empty.
    pub fn create(root: &Path, policy: Policy, patch: Kind) -> Result<Awaiting> {
        if root.is_file() {
            return Err(Error::invalid(root.display(), "is a file; name a new directory for the database"));
        }
        if root.exists() && std::fs::read_dir(root).map_err(|e| Error::io(root, e))?.next().is_some() {
            return Err(Error::invalid(root.display(), "is not empty; give a new directory"));
        }
        std::fs::create_dir_all(root).map_err(|e| Error::io(root, e))?;
        put(root, policy, patch)?;
        Ok(Awaiting { root: root.to_path_buf(), policy, patch })
    }

    /// What waits in a directory; `None` if that is something else.
    pub fn read(root: &Path) -> Result<Option<Awaiting>> {
        let file = root.join(AWAITING);
        let Ok(meta) = std::fs::metadata(&file) else { return Ok(None) };
        if super::database::catalog_path(root).exists() {
            return Ok(None);
        }
        let bad = |what: &str| {
            Error::corrupt(
                file.display(),
                "text",
                format!("{what}; make the database anew with `terraquilt init`"),
            )
        };
        if meta.len() > BYTES_MAX {
            return Err(bad("is too long"));
        }
        let text = std::fs::read_to_string(&file).map_err(|e| Error::io(&file, e))?;
        let value = |name: &str| text.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(' '));
        let policy = match value("policy") {
            Some("accuracy") => Policy::Accuracy,
            Some("newest") => Policy::Newest,
            _ => return Err(bad("names no policy")),
        };
        let patch = match value("patch") {
            Some(t) if t == Kind::Bilinear.name() => Kind::Bilinear,
            Some(t) if t == Kind::Bicubic.name() => Kind::Bicubic,
            _ => return Err(bad("names no kind of patches")),
        };
        Ok(Some(Awaiting { root: root.to_path_buf(), policy, patch }))
    }

    /// The system for files: their own, if they are all in one that is projected (so that nothing has to be resampled);
    /// else the UTM zone or polar system of the area that they cover.
    ///
    /// # Errors
    /// If a file has no georeference or says no system, or the area is too wide for one.
    pub fn choose(&self, files: &[&SourceInfo], said: Option<&Crs>) -> Result<Crs> {
        let mut systems = Vec::with_capacity(files.len());
        for info in files {
            systems.push(said.or(info.crs.as_ref()).ok_or_else(|| {
                Error::invalid(
                    &info.file,
                    format!(
                        "does not say its coordinate system, and the database takes its own from the first survey; give --crs{}",
                        info.notes.iter().map(|n| format!("; {n}")).collect::<String>()
                    ),
                )
            })?);
        }
        let first = systems.first().ok_or_else(|| Error::invalid("ingest", "no file was given"))?;
        let one = systems.iter().all(|c| c.same_as(first));
        if one && first.unit != AxisUnit::Degree && !STRETCHED.contains(&first.code.as_str()) {
            return Ok((*first).clone());
        }
        let mut all: Option<[f64; 4]> = None;
        for (info, crs) in files.iter().zip(&systems) {
            let a = info.affine.ok_or_else(|| Error::invalid(&info.file, "has no georeference"))?;
            let (n, m) = (info.cols.saturating_sub(1) as f64, info.rows.saturating_sub(1) as f64);
            let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
            for (c, r) in [(0.0, 0.0), (n, 0.0), (0.0, m), (n, m)] {
                let p = [0, 1].map(|k| a.origin[k] + c * a.col_step[k] + r * a.row_step[k]);
                b = [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])];
            }
            let mut b = lonlat_bounds(crs, b)?;
            if let Some(w) = all {
                // Side by side with what came before, also across the antimeridian.
                let turn = (((w[0] + w[2]) - (b[0] + b[2])) / 720.0).round() * 360.0;
                (b[0], b[2]) = (b[0] + turn, b[2] + turn);
                b = [b[0].min(w[0]), b[1].min(w[1]), b[2].max(w[2]), b[3].max(w[3])];
            }
            all = Some(b);
        }
        automatic(all.expect("there is a first file"))
    }

    /// Makes the database, in a system.
    pub fn settle(self, crs: Crs) -> Result<Db> {
        let db = Db::create(&self.root, &Options { crs, policy: self.policy, patch: self.patch })?;
        let file = self.root.join(AWAITING);
        std::fs::remove_file(&file).map_err(|e| Error::io(&file, e))?;
        Ok(db)
    }

    /// Waits again, if the first survey did not come: a system that it chose would bind the next one.
    pub fn wait_again(db: &Db) -> Result<()> {
        let writing = db.begin(&mut || ())?;
        if writing.counters.version > 0 {
            return Ok(());
        }
        let root = db.path();
        put(root, db.policy(), db.kind())?;
        for name in ["catalog.sqlite", "catalog.sqlite-wal", "catalog.sqlite-shm"] {
            let _ = std::fs::remove_file(root.join(name));
        }
        sync_directory(root)
    }
}

fn put(root: &Path, policy: Policy, patch: Kind) -> Result<()> {
    let file = root.join(AWAITING);
    let text = format!("policy {}\npatch {}\n", policy.name(), patch.name());
    std::fs::write(&file, text).map_err(|e| Error::io(&file, e))?;
    sync_directory(root)
}
