//! A database directory: creating, opening, snapshots.
//!
//! ```text
//! DB/catalog.sqlite   versions and files          DB/segments/NNNNNNNN.tqs   pages, never changed
//! DB/writer.lock      held by the one writer      DB/readers/V-PID-N         leases of readers
//! ```

use super::awaiting::AWAITING;
use super::caches::Caches;
use super::view::View;
use super::writer::{Writer, WriterHome};
use crate::base::date::Date;
use crate::base::{Error, Result};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::frame::LatticeUnit;
use crate::height::lod::SurveyNumber;
use crate::height::patch::Kind;
use crate::store::catalog::{Catalog, Contents, Counters, NamedFile, Sqlite, Version};
use crate::store::disk::{Disk, RealDisk, sync_directory};
use crate::store::lock::Lease;
use crate::store::segment::Files;
use std::collections::BTreeMap;
use std::ops::RangeBounds;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The oldest and the newest version of the whole format that this program opens. New databases are of the newest.
pub const FORMAT_OLDEST: u32 = 1;
pub const FORMAT_NEWEST: u32 = 3;

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
    /// What lies between vertices.
    pub patch: Kind,
}

/// Opens the catalog of a database directory: for writing (`true`) or reading.
pub type CatalogOpener = Arc<dyn Fn(bool) -> Result<Box<dyn Catalog>> + Send + Sync>;

/// A database.
pub struct Db {
    root: PathBuf,
    disk: Arc<dyn Disk>,
    catalog: CatalogOpener,
    format: u32,
    crs: Crs,
    policy: Policy,
    kind: Kind,
    unit: LatticeUnit,
    caches: Arc<Caches>,
    /// The catalog as the last commit left it.
    writer: WriterHome,
}

/// The constants that every database of this format and kind of patches has; a database with others is of another
/// program.
pub(super) fn constants(kind: Kind) -> BTreeMap<&'static str, String> {
    use crate::height::{lod, surface};
    use crate::store::quadtree;
    [
        ("format_version", FORMAT_NEWEST.to_string()),
        ("derivation_version", super::root::DERIVATION_VERSION.to_string()),
        ("world_half_log2", "60".to_string()),
        ("tree_capacity", quadtree::CAPACITY.to_string()),
        ("tree_depth_max", quadtree::DEPTH_MAX.to_string()),
        ("kappa", surface::KAPPA.to_string()),
        ("kernel", lod::KERNEL.to_string()),
        ("margin", lod::MARGIN.to_string()),
        ("patch", kind.name().to_string()),
        ("weight", kind.weight_name().to_string()),
        ("sharding", "0".to_string()),
    ]
    .into()
}

/// What an `init` may leave that was cut off.
const LEFTOVERS: [&str; 4] = ["catalog.new", "catalog.new-wal", "catalog.new-shm", "catalog.new-journal"];

/// The constant that tells databases apart: random, kept by backups, absent in those of earlier programs.
pub(super) const IDENTITY: &str = "identity";

/// 32 random hexadecimal digits.
pub(super) fn new_identity() -> String {
    use std::hash::{BuildHasher, Hasher, RandomState};
    // Each state is seeded by the operating system.
    let random = || RandomState::new().build_hasher().finish();
    let mut h = blake3::Hasher::new();
    for v in [random(), random(), u64::from(std::process::id())] {
        h.update(&v.to_le_bytes());
    }
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    h.update(&now.map_or(0, |d| d.as_nanos()).to_le_bytes());
    h.finalize().to_hex()[..32].to_string()
}

/// Stands in a directory while a backup or copy into it is not finished.
pub(super) const UNFINISHED: &str = "backup.unfinished";

pub(super) fn catalog_path(root: &Path) -> PathBuf {
    root.join("catalog.sqlite")
}

/// Whether there are finished segments in a directory.
fn holds_segments(root: &Path) -> Result<bool> {
    let segments = root.join("segments");
    Ok(segments.is_dir() && RealDisk::new(&segments).names()?.iter().any(|(name, _)| name.ends_with(".tqs")))
}

/// Puts a catalog with these contents into a directory that has none: it appears under its name when it is complete.
pub(super) fn place_catalog(root: &Path, contents: &Contents) -> Result<()> {
    let temporary = root.join("catalog.new");
    for leftover in LEFTOVERS {
        let _ = std::fs::remove_file(root.join(leftover));
    }
    Sqlite::create(&temporary)?.fill(contents)?;
    std::fs::rename(&temporary, catalog_path(root)).map_err(|e| Error::io(catalog_path(root), e))?;
    sync_directory(root)?;
    // The directory's own name has to survive, too.
    match root.canonicalize().ok().as_deref().and_then(Path::parent) {
        Some(parent) => sync_directory(parent),
        None => Ok(()),
    }
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
            if holds_segments(root)? {
                return Err(Error::invalid(
                    root.display(),
                    "holds segments of a database whose catalog is gone; `terraquilt rebuild DB` makes it again",
                ));
            }
            // What an `init` leaves that was cut off is no reason to refuse.
            let ours = |name: &str| {
                ["segments", "readers", "writer.lock", AWAITING].contains(&name) || LEFTOVERS.contains(&name)
            };
            if !entries.all(|e| e.is_ok_and(|e| e.file_name().to_str().is_some_and(ours))) {
                return Err(Error::invalid(root.display(), "is not empty; give a new directory"));
            }
        }
        for d in [root.to_path_buf(), root.join("segments"), root.join("readers")] {
            std::fs::create_dir_all(&d).map_err(|e| Error::io(&d, e))?;
        }
        let unit = LatticeUnit::for_crs(&options.crs);
        let mut constants: BTreeMap<String, String> =
            constants(options.patch).into_iter().map(|(k, v)| (k.to_string(), v)).collect();
        constants.insert(IDENTITY.into(), new_identity());
        constants.insert("crs".into(), options.crs.code.clone());
        constants.insert("crs_unit".into(), options.crs.unit.to_string());
        constants.insert("policy".into(), options.policy.name().into());
        constants.insert("lattice_unit_log2".into(), unit.exponent.to_string());
        let counters = Counters { file: 0, survey: 0, version: 0 };
        let (versions, operations) = (Vec::new(), Vec::new());
        let contents = Contents { constants, versions, operations, counters, backup: None };
        place_catalog(root, &contents)?;
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
            if root.join(AWAITING).exists() {
                return Err(Error::missing(
                    format!("a coordinate system in {}", root.display()),
                    "it is chosen when the first survey comes; run `terraquilt ingest` first (before `terraquilt serve`, too)",
                ));
            }
            if root.join(UNFINISHED).exists() {
                return Err(Error::missing(
                    format!("catalog of {}", root.display()),
                    "it is a backup that was cut off; run `terraquilt backup` again",
                ));
            }
            if root.is_dir() && holds_segments(root)? {
                return Err(Error::missing(
                    format!("catalog of {}", root.display()),
                    "restore catalog.sqlite, or run `terraquilt rebuild DB` to make it again from the other files",
                ));
            }
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
        if !(FORMAT_OLDEST..=FORMAT_NEWEST).contains(&format) {
            return Err(Error::unsupported(
                root.display(),
                format!("database format {format}, this program knows {FORMAT_OLDEST} to {FORMAT_NEWEST}"),
                "use a newer terraquilt",
            ));
        }
        let kind = Kind::parse(get("patch")?).ok_or_else(|| {
            let known = Kind::ALL.map(|k| format!("'{}'", k.name())).join(" and ");
            Error::unsupported(
                root.display(),
                format!("constant patch is '{}', this program knows {known}", constants["patch"]),
                "use a newer terraquilt",
            )
        })?;
        let known = self::constants(kind);
        let fixed = ["kernel", "margin", "weight", "kappa", "tree_capacity", "tree_depth_max"];
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
            format,
            crs: Crs { code: get("crs")?.clone(), unit },
            policy,
            kind,
            unit: LatticeUnit { exponent },
            caches: Caches::new(),
            writer: WriterHome::default(),
        })
    }

    pub fn path(&self) -> &Path {
        &self.root
    }
    /// Version of the format that the database was made with.
    pub fn format(&self) -> u32 {
        self.format
    }
    pub fn crs(&self) -> &Crs {
        &self.crs
    }
    pub fn policy(&self) -> Policy {
        self.policy
    }
    /// What lies between vertices.
    pub fn kind(&self) -> Kind {
        self.kind
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

    /// Number of the newest version; 0 before the first commit.
    pub fn newest(&self) -> Result<u64> {
        Ok((self.catalog)(false)?.latest()?.map_or(0, |v| v.number))
    }

    /// The version that an operation made.
    pub fn operation(&self, id: &str) -> Result<Option<u64>> {
        (self.catalog)(false)?.operation(id)
    }

    /// A version to read from: the latest, or the one asked for. Never blocked by writers, unmoved by them.
    pub fn snapshot(&self, at: Option<u64>) -> Result<Snapshot> {
        let claim = self.claim(&*self.catalog_for_reading()?, at)?;
        let files = claim.iter().flat_map(|c| &c.files).map(|f| (f.number, f.length));
        let files = Files::new(self.disk.clone(), files);
        self.caches.tidy();
        let view = View::sharing(files, claim.as_ref().map(|c| c.version.root), self.caches.clone())?;
        let (version, lease) = claim.map(|c| (c.version, c.lease)).unzip();
        Ok(Snapshot {
            view,
            version,
            unit: self.unit,
            crs: self.crs.clone(),
            policy: self.policy,
            kind: self.kind,
            _lease: lease.map(Arc::new),
        })
    }

    /// Leaves a lease for the latest version, or the one asked for; `None` for version 0.
    pub(super) fn claim(&self, catalog: &dyn Catalog, at: Option<u64>) -> Result<Option<Claim>> {
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
            let Some(version) = version else { return Ok(None) };
            let lease = Lease::take(&self.root, version.number)?;
            // Pruned between the look and the lease? Then look again. In this order: a version that is still there
            // had all its files a moment ago.
            let files = catalog.files(version.number)?;
            if catalog.version(version.number)?.is_some() {
                return Ok(Some(Claim { version, files, lease }));
            }
        }
    }

    pub(super) fn catalog_for_reading(&self) -> Result<Box<dyn Catalog>> {
        (self.catalog)(false)
    }
    /// Only under the writer lock.
    pub(super) fn catalog_for_writing(&self) -> Result<Writer> {
        self.writer.take(&|| (self.catalog)(true))
    }
    pub(super) fn caches(&self) -> Arc<Caches> {
        self.caches.clone()
    }
    pub(super) fn shared_disk(&self) -> Arc<dyn Disk> {
        self.disk.clone()
    }
}

/// A version that nobody prunes while this lives.
pub(super) struct Claim {
    pub version: Version,
    pub files: Vec<NamedFile>,
    lease: Lease,
}

/// One version of a database. Readers of the same version share nothing but files.
pub struct Snapshot {
    pub(super) view: View,
    version: Option<Version>,
    pub(super) unit: LatticeUnit,
    pub(super) crs: Crs,
    pub(super) policy: Policy,
    kind: Kind,
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
    /// What lies between vertices.
    pub fn kind(&self) -> Kind {
        self.kind
    }
    /// The same version seen through other tables.
    pub(super) fn seen_as(&self, view: View) -> Snapshot {
        Snapshot {
            view,
            version: self.version.clone(),
            unit: self.unit,
            crs: self.crs.clone(),
            policy: self.policy,
            kind: self.kind,
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
    /// Surveys whose numbers are in a range, by number.
    pub fn entries_in(
        &self,
        range: impl RangeBounds<SurveyNumber>,
    ) -> impl Iterator<Item = &super::root::SurveyEntry> {
        use super::view::Tables;
        self.view.entries().range(range).map(|(_, e)| e)
    }
    /// Head of a survey: declaration and tiles.
    pub fn head(&self, n: crate::height::lod::SurveyNumber) -> Result<Arc<super::head::Head>> {
        self.view.head(n).cloned()
    }
}
