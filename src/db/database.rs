//! A database directory: creating, opening, snapshots, the writer, prune.
//!
//! ```text
//! DB/catalog.sqlite   versions and files          DB/segments/NNNNNNNN.tqs   pages, never changed
//! DB/writer.lock      held by the one writer      DB/readers/V-PID-N         leases of readers
//! ```

use super::view::View;
use crate::base::date::Date;
use crate::base::{Error, Result};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::frame::LatticeUnit;
use crate::store::catalog::{Catalog, Commit, Counters, NamedFile, Sqlite, Version};
use crate::store::disk::{Disk, RealDisk, sync_directory};
use crate::store::lock::{Lease, WriterLock, leased};
use crate::store::segment::{Files, PageRef, SegmentWriter, file_name};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Version of the whole format; a newer one is refused.
pub const FORMAT_VERSION: u32 = 1;

/// How surveys rank where no explicit precedence is given.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Policy {
    /// All rank equally: accuracy decides (the paper's rule).
    Accuracy,
    /// The later survey replaces the earlier.
    Newest,
}

impl Policy {
    pub fn name(self) -> &'static str {
        match self {
            Policy::Accuracy => "accuracy",
            Policy::Newest => "newest",
        }
    }

    pub fn precedence(self, date: Option<Date>, explicit: Option<i64>) -> i64 {
        match (explicit, self) {
            (Some(p), _) => p,
            (None, Policy::Newest) => date.map_or(0, Date::ordinal),
            (None, Policy::Accuracy) => 0,
        }
    }
}

/// What is fixed when a database is created.
#[derive(Clone, Debug)]
pub struct Options {
    pub crs: Crs,
    pub policy: Policy,
}

/// Opens the catalog of a database directory: for writing (`true`) or reading.
pub type CatalogOpener = Arc<dyn Fn(bool) -> Result<Box<dyn Catalog>> + Send + Sync>;

/// A database.
pub struct Db {
    root: PathBuf,
    disk: Arc<dyn Disk>,
    catalog: CatalogOpener,
    crs: Crs,
    policy: Policy,
    unit: LatticeUnit,
}

/// The constants that every database of this format has; a database with others is of another program.
pub(super) fn constants_known() -> BTreeMap<&'static str, String> {
    use crate::height::{lod, surface};
    use crate::store::quadtree;
    [
        ("format_version", FORMAT_VERSION.to_string()),
        ("derivation_version", super::root::DERIVATION_VERSION.to_string()),
        ("world_half_log2", "60".to_string()),
        ("tree_capacity", quadtree::CAPACITY.to_string()),
        ("tree_depth_max", quadtree::DEPTH_MAX.to_string()),
        ("kappa", surface::KAPPA.to_string()),
        ("kernel", lod::KERNEL.to_string()),
        ("margin", lod::MARGIN.to_string()),
        ("patch", "bilinear".to_string()),
        ("weight", "hat, unit volume".to_string()),
        ("sharding", "0".to_string()),
    ]
    .into()
}

/// What an `init` may leave that was cut off.
const LEFTOVERS: [&str; 4] = ["catalog.new", "catalog.new-wal", "catalog.new-shm", "catalog.new-journal"];

fn catalog_path(root: &Path) -> PathBuf {
    root.join("catalog.sqlite")
}

impl Db {
    /// Creates a database in a directory that does not exist or is empty.
    pub fn create(root: &Path, options: &Options) -> Result<Db> {
        if root.is_file() {
            return Err(Error::invalid(root.display(), "is a file; name a new directory for the database"));
        }
        if root.exists() {
            let mut entries = std::fs::read_dir(root).map_err(|e| Error::io(root, e))?;
            if catalog_path(root).exists() {
                return Err(Error::invalid(root.display(), "is a database already"));
            }
            // What an `init` leaves that was cut off is no reason to refuse.
            let ours = |name: &str| name == "segments" || name == "readers" || LEFTOVERS.contains(&name);
            if !entries.all(|e| e.is_ok_and(|e| e.file_name().to_str().is_some_and(ours))) {
                return Err(Error::invalid(root.display(), "is not empty; give a new directory"));
            }
        }
        for d in [root.to_path_buf(), root.join("segments"), root.join("readers")] {
            std::fs::create_dir_all(&d).map_err(|e| Error::io(&d, e))?;
        }
        let unit = LatticeUnit::for_crs(&options.crs);
        let mut constants: BTreeMap<String, String> =
            constants_known().into_iter().map(|(k, v)| (k.to_string(), v)).collect();
        constants.insert("crs".into(), options.crs.code.clone());
        constants.insert("crs_unit".into(), options.crs.unit.to_string());
        constants.insert("policy".into(), options.policy.name().into());
        constants.insert("lattice_unit_log2".into(), unit.exponent.to_string());
        // The catalog appears under its name only when it is complete.
        let temporary = root.join("catalog.new");
        for leftover in LEFTOVERS {
            let _ = std::fs::remove_file(root.join(leftover));
        }
        drop(Sqlite::create(&temporary, &constants)?);
        std::fs::rename(&temporary, catalog_path(root)).map_err(|e| Error::io(catalog_path(root), e))?;
        sync_directory(root)?;
        // The directory's own name has to survive, too.
        if let Some(parent) = root.canonicalize().ok().as_deref().and_then(Path::parent) {
            sync_directory(parent)?;
        }
        Db::open(root)
    }

    /// Opens a database. Costs milliseconds and reads no survey, whatever the size.
    pub fn open(root: &Path) -> Result<Db> {
        let path = catalog_path(root);
        if root.is_file() {
            return Err(Error::invalid(
                root.display(),
                "is a file, not a database; the database's directory comes first",
            ));
        }
        if !path.exists() {
            return Err(Error::missing(
                format!("database {}", root.display()),
                "`terraquilt init DB` makes one",
            ));
        }
        let disk = Arc::new(RealDisk::new(root.join("segments")));
        let opener: CatalogOpener = Arc::new(move |write| {
            Ok(if write { Box::new(Sqlite::open(&path)?) } else { Box::new(Sqlite::open_read_only(&path)?) })
        });
        Db::open_with(root, disk, opener)
    }

    /// Opens a database on another disk or catalog: how tests stop at a write.
    pub fn open_with(root: &Path, disk: Arc<dyn Disk>, catalog: CatalogOpener) -> Result<Db> {
        let constants = catalog(false)?.constants()?;
        let file = catalog_path(root).display().to_string();
        let get = |name: &str| {
            constants
                .get(name)
                .ok_or_else(|| Error::corrupt(&file, format!("constant '{name}'"), "is missing"))
        };
        let format: u32 = get("format_version")?.parse().map_err(|_| {
            Error::corrupt(
                &file,
                "table of constants",
                "format_version is not a number; restore the catalog from a backup",
            )
        })?;
        if format > FORMAT_VERSION {
            return Err(Error::unsupported(
                root.display(),
                format!("database format {format}, this program knows {FORMAT_VERSION}"),
                "use a newer terraquilt",
            ));
        }
        let known = constants_known();
        let fixed = ["kernel", "margin", "patch", "weight", "kappa", "tree_capacity", "tree_depth_max"];
        for name in fixed.into_iter().chain(["sharding", "world_half_log2", "derivation_version"]) {
            let known = &known[name];
            let found = get(name)?;
            if found != known {
                return Err(Error::unsupported(
                    root.display(),
                    format!("constant {name} is '{found}', this program knows '{known}'"),
                    "use a newer terraquilt",
                ));
            }
        }
        let policy = match get("policy")?.as_str() {
            "accuracy" => Policy::Accuracy,
            "newest" => Policy::Newest,
            other => return Err(Error::corrupt(&file, "policy", format!("'{other}'"))),
        };
        let exponent = get("lattice_unit_log2")?.parse().map_err(|_| {
            Error::corrupt(
                &file,
                "table of constants",
                "lattice_unit_log2 is not a number; restore the catalog from a backup",
            )
        })?;
        // As it was looked up when the database was made: opening needs no registry.
        let unit = AxisUnit::parse(get("crs_unit")?).ok_or_else(|| {
            Error::corrupt(
                &file,
                "table of constants",
                "crs_unit is no unit; restore the catalog from a backup",
            )
        })?;
        Ok(Db {
            root: root.to_path_buf(),
            disk,
            catalog,
            crs: Crs { code: get("crs")?.clone(), unit },
            policy,
            unit: LatticeUnit { exponent },
        })
    }

    pub fn path(&self) -> &Path {
        &self.root
    }
    pub fn crs(&self) -> &Crs {
        &self.crs
    }
    pub fn policy(&self) -> Policy {
        self.policy
    }
    pub fn unit(&self) -> LatticeUnit {
        self.unit
    }
    pub fn disk(&self) -> &dyn Disk {
        &*self.disk
    }

    /// Every version, oldest first.
    pub fn versions(&self) -> Result<Vec<Version>> {
        (self.catalog)(false)?.versions()
    }

    /// The version that an operation made.
    pub fn operation(&self, id: &str) -> Result<Option<u64>> {
        (self.catalog)(false)?.operation(id)
    }

    /// A version to read from: the latest, or the one asked for. Never blocked by writers, unmoved by them.
    pub fn snapshot(&self, at: Option<u64>) -> Result<Snapshot> {
        let catalog = (self.catalog)(false)?;
        loop {
            let version = match at {
                None => catalog.latest()?,
                Some(0) => None,
                Some(n) => Some(catalog.version(n)?.ok_or_else(|| {
                    Error::missing(
                        format!("version {n}"),
                        "`terraquilt versions DB` lists those that are kept",
                    )
                })?),
            };
            let Some(version) = version else {
                let view = View::open(Files::new(self.disk.clone(), []), None)?;
                return Ok(Snapshot {
                    view,
                    version: None,
                    unit: self.unit,
                    crs: self.crs.clone(),
                    policy: self.policy,
                    _lease: None,
                });
            };
            let lease = Lease::take(&self.root, version.number)?;
            // Pruned between the look and the lease? Then look again. In this order: a version that is still there
            // had all its files a moment ago.
            let files = catalog.files(version.number)?;
            if catalog.version(version.number)?.is_none() {
                continue;
            }
            let files = Files::new(self.disk.clone(), files.iter().map(|f| (f.number, f.length)));
            let view = View::open(files, Some(version.root))?;
            return Ok(Snapshot {
                view,
                version: Some(version),
                unit: self.unit,
                crs: self.crs.clone(),
                policy: self.policy,
                _lease: Some(Arc::new(lease)),
            });
        }
    }

    pub(super) fn catalog_for_reading(&self) -> Result<Box<dyn Catalog>> {
        (self.catalog)(false)
    }

    /// Takes the writer lock, removes leftovers, and opens the latest version.
    pub(super) fn begin(&self, waiting: &mut dyn FnMut()) -> Result<Writing> {
        let lock = WriterLock::take(&self.root, waiting)?;
        let catalog = (self.catalog)(true)?;
        let version = catalog.latest()?;
        let files = match &version {
            Some(v) => catalog.files(v.number)?,
            None => Vec::new(),
        };
        let view = View::open(
            Files::new(self.disk.clone(), files.iter().map(|f| (f.number, f.length))),
            version.as_ref().map(|v| v.root),
        )?;
        let counters = catalog.counters()?;
        let mut writing = Writing { lock, catalog, view, version, files, counters, swept: 0 };
        writing.swept = writing.sweep(self)?;
        Ok(writing)
    }

    /// Forgets versions and gives their bytes back. Keeps the latest, and every version that a reader holds.
    pub fn prune(
        &self,
        choose: impl Fn(&[u64]) -> Vec<u64>,
        waiting: &mut dyn FnMut(),
    ) -> Result<PruneOutcome> {
        let mut writing = self.begin(waiting)?;
        let all: Vec<u64> = writing.catalog.versions()?.iter().map(|v| v.number).collect();
        let held = leased(&self.root)?;
        let latest = all.last().copied();
        let mut gone = choose(&all);
        gone.retain(|v| all.contains(v) && Some(*v) != latest);
        let kept_for_readers: Vec<u64> = gone.iter().copied().filter(|v| held.contains(v)).collect();
        gone.retain(|v| !held.contains(v));
        if !gone.is_empty() {
            writing.catalog.prune(&gone)?;
        }
        let freed = writing.swept + writing.sweep(self)?;
        Ok(PruneOutcome { pruned: gone, kept_for_readers, bytes_freed: freed })
    }
}

/// What prune did.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PruneOutcome {
    pub pruned: Vec<u64>,
    pub kept_for_readers: Vec<u64>,
    pub bytes_freed: u64,
}

/// One version of a database. Readers of the same version share nothing but files.
pub struct Snapshot {
    pub(super) view: View,
    version: Option<Version>,
    pub(super) unit: LatticeUnit,
    pub(super) crs: Crs,
    pub(super) policy: Policy,
    _lease: Option<Arc<Lease>>,
}

impl Snapshot {
    /// Number of the version; 0 before the first commit.
    pub fn number(&self) -> u64 {
        self.version.as_ref().map_or(0, |v| v.number)
    }
    pub fn version(&self) -> Option<&Version> {
        self.version.as_ref()
    }
    pub fn crs(&self) -> &Crs {
        &self.crs
    }
    pub fn unit(&self) -> LatticeUnit {
        self.unit
    }
    pub fn policy(&self) -> Policy {
        self.policy
    }
    /// The same version seen through other tables.
    pub(super) fn seen_as(&self, view: View) -> Snapshot {
        Snapshot {
            view,
            version: self.version.clone(),
            unit: self.unit,
            crs: self.crs.clone(),
            policy: self.policy,
            _lease: self._lease.clone(),
        }
    }
    /// A survey by name or id prefix.
    pub fn survey(&self, name: &str) -> Result<&super::root::SurveyEntry> {
        super::change::find_survey(&self.view, name)
    }
    /// A survey by number.
    pub fn survey_by_number(&self, n: crate::height::lod::SurveyNumber) -> Result<&super::root::SurveyEntry> {
        self.view.entry(n)
    }
    /// Surveys, by number.
    pub fn entries(&self) -> impl Iterator<Item = &super::root::SurveyEntry> {
        use super::view::Tables;
        self.view.entries().values()
    }
    /// Head of a survey: declaration and tiles.
    pub fn head(&self, n: crate::height::lod::SurveyNumber) -> Result<Arc<super::head::Head>> {
        self.view.head(n).cloned()
    }
}

/// What a commit makes visible.
pub(super) struct Publication<'a> {
    /// Segments that were written for it.
    pub segments: Vec<SegmentWriter>,
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
    #[allow(dead_code, reason = "held for its effect until the commit is over")]
    lock: WriterLock,
    pub catalog: Box<dyn Catalog>,
    pub view: View,
    pub version: Option<Version>,
    files: Vec<NamedFile>,
    pub counters: Counters,
    /// Bytes of leftovers that were removed at the start.
    swept: u64,
}

impl Writing {
    /// The number of the next segment file.
    pub fn next_file(&self) -> u32 {
        self.counters.file + 1
    }

    /// Refuses to start what cannot end.
    pub fn need_space(&self, db: &Db, bytes: u64) -> Result<()> {
        match db.disk.free_bytes()? {
            Some(free) if free < bytes => Err(Error::NoSpace { place: db.disk.place(), wanted: bytes, free }),
            _ => Ok(()),
        }
    }

    /// Removes what a change was writing that did not become a version: on a full disk, the room it took. Only temporary
    /// names: after a commit that failed, whether a finished file is named is for the next writer to find out.
    pub fn discard_temporaries(&self, db: &Db) {
        for (name, _) in db.disk.names().unwrap_or_default() {
            if name.ends_with(".tmp") {
                let _ = db.disk.remove(&name);
            }
        }
    }

    /// Removes files that no version names. Skipped while a reader holds a version that the catalog has forgotten.
    pub fn sweep(&self, db: &Db) -> Result<u64> {
        let kept: Vec<u64> = self.catalog.versions()?.iter().map(|v| v.number).collect();
        if leased(&db.root)?.iter().any(|v| !kept.contains(v)) {
            return Ok(0);
        }
        let named: std::collections::HashSet<String> =
            self.catalog.all_files()?.iter().map(|(n, _)| file_name(*n)).collect();
        let mut freed = 0;
        for (name, len) in db.disk.names()? {
            let ours = name.ends_with(".tqs") || name.ends_with(".tmp");
            if ours && !named.contains(&name) {
                db.disk.remove(&name)?;
                freed += len;
            }
        }
        if freed > 0 {
            db.disk.sync_names()?;
        }
        Ok(freed)
    }

    /// Makes the segments durable, then commits the version that names them.
    pub fn publish(&mut self, db: &Db, p: Publication) -> Result<()> {
        let mut live: HashMap<u32, (u64, u64)> =
            self.files.iter().map(|f| (f.number, (f.length, f.live))).collect();
        let mut last = self.counters.file;
        for segment in p.segments {
            let number = segment.number();
            let pages = segment.len() - crate::store::segment::HEADER_BYTES;
            let length = segment.finish(db.disk())?;
            live.insert(number, (length, pages));
            last = last.max(number);
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
        self.catalog.commit(&Commit { version, files, counters })
    }
}
