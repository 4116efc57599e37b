//! Commands that change a database: init, ingest, replace, set, remove.

use super::args::numbers;
use super::line::{Line, operation, server};
use super::output::{Meter, Output, count, message, stop_flag};
use super::send::{Call, send};
use crate::base::date::Date;
use crate::base::{Error, Result};
use crate::client::catalog;
use crate::db::{self, Awaiting, Change, Db, Options, Outcome, Policy, Progress};
use crate::format;
use crate::height::crs::geoid::Geoid;
use crate::height::crs::vertical::VerticalDatum;
use crate::height::crs::{Crs, DatumChoice};
use crate::height::lifted::{Lift, Lifted};
use crate::height::patch::Kind;
use crate::height::source::HeightSource;
use crate::wire::v1;
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::sync::Arc;

#[derive(Clone, Copy, ValueEnum)]
enum PolicyName {
    /// All surveys rank equally; the more accurate one is shown
    Accuracy,
    /// The later survey replaces the earlier
    Newest,
}

#[derive(Clone, Copy, ValueEnum)]
enum PatchKind {
    /// Continuous; fastest
    Bilinear,
    /// Cubic splines: slopes and curvature are continuous, too
    Bicubic,
}

/// Make a new, empty database
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt init pit --crs EPSG:32610 --policy newest\n  terraquilt init dunes --crs EPSG:32611 --patch bicubic"
)]
pub struct Init {
    /// Directory to make
    db: PathBuf,
    /// Coordinate system of the database; surveys in others are resampled [default: that of the first survey, or, if it is
    /// in degrees, its UTM zone]
    #[arg(long, value_name = "EPSG:n|ESRI:n|PROJ|WKT", allow_hyphen_values = true)]
    crs: Option<String>,
    /// Who wins where surveys overlap
    #[arg(long, value_enum, default_value = "accuracy")]
    policy: PolicyName,
    /// Kind of patches: what lies between posts
    #[arg(long, value_enum, default_value = "bilinear")]
    patch: PatchKind,
}

impl Init {
    pub fn run(self) -> Result<bool> {
        let policy = match self.policy {
            PolicyName::Accuracy => Policy::Accuracy,
            PolicyName::Newest => Policy::Newest,
        };
        let patch = match self.patch {
            PatchKind::Bilinear => Kind::Bilinear,
            PatchKind::Bicubic => Kind::Bicubic,
        };
        let path = self.db.display();
        let system = match self.crs {
            Some(crs) => {
                let db = Db::create(&self.db, &Options { crs: Crs::parse(&crs)?, policy, patch })?;
                format!("in {}", db.crs().code)
            }
            None => {
                Awaiting::create(&self.db, policy, patch)?;
                "in the coordinate system that suits its first survey".into()
            }
        };
        message(&format!(
            "made {path} {system}, policy {}, {} patches; next: terraquilt ingest {path} FILE --accuracy METRES",
            policy.name(),
            patch.name(),
        ));
        Ok(true)
    }
}

#[derive(Clone, Copy, ValueEnum)]
enum VerticalUnit {
    /// Metres
    M,
    /// International feet, 0.3048 m
    Ft,
    /// US survey feet, 1200/3937 m
    UsFt,
}

impl VerticalUnit {
    fn metres(self) -> f64 {
        match self {
            VerticalUnit::M => 1.0,
            VerticalUnit::Ft => 0.3048,
            VerticalUnit::UsFt => 1200.0 / 3937.0,
        }
    }
}

/// What is said of files as they arrive.
#[derive(Args)]
struct Said {
    /// Vertical accuracy of the heights, metres; known products bring their own
    #[arg(long, value_name = "M", allow_hyphen_values = true)]
    accuracy: Option<f64>,
    /// Day of the survey
    #[arg(long, value_name = "YYYY-MM-DD")]
    date: Option<String>,
    /// Rank; a higher one replaces lower ones and wins over the policy
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    precedence: Option<i64>,
    /// The files are in this coordinate system, whatever they say; they are resampled if it is not the database's
    #[arg(long, value_name = "EPSG:n|ESRI:n|PROJ|WKT", allow_hyphen_values = true)]
    crs: Option<String>,
    /// The way from an old datum (NAD27, Pulkovo ...): dx,dy,dz[,rx,ry,rz,s] to WGS 84 (metres, arc seconds, ppm; position
    /// vector), or `ballpark` (none: off by up to hundreds of metres)
    #[arg(long, value_name = "SHIFT", allow_hyphen_values = true)]
    datum_shift: Option<String>,
    /// Spacing of the survey's own posts where the files are resampled, CRS units [default: that of the files]
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
    /// This sample value means: no data
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    nodata: Option<f64>,
    /// Unit of the heights in the files [default: as they say, else metres]
    #[arg(long, value_enum)]
    vertical_unit: Option<VerticalUnit>,
    /// What heights count from: a code (EPSG:5703) or a name [default: as the files say]
    #[arg(long, value_name = "DATUM", conflicts_with = "geoid")]
    vertical_datum: Option<String>,
    /// A geoid grid (.gtx or GeoTIFF): heights above the geoid become heights above the ellipsoid
    #[arg(long, value_name = "FILE")]
    geoid: Option<PathBuf>,
    /// With --geoid the other way: heights above the ellipsoid become heights above the geoid, whose datum is named
    #[arg(long, value_name = "DATUM", requires = "geoid")]
    onto: Option<String>,
    /// Declare the lattice that the posts lie on (file headers may be rounded)
    #[arg(long, value_name = "STEPX,STEPY,PHASEX,PHASEY", allow_hyphen_values = true)]
    lattice: Option<String>,
    /// Say what would happen, change nothing
    #[arg(long)]
    dry_run: bool,
    /// Name of this call: repeating it does nothing twice
    #[arg(long, value_name = "ID")]
    operation: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Said {
    fn request(&self, files: &[PathBuf]) -> Result<db::Ingest> {
        let lift = match &self.geoid {
            None => None,
            Some(file) => {
                let way = match &self.onto {
                    None => Lift::ToEllipsoid,
                    Some(datum) => Lift::ToGeoid(VerticalDatum::parse(datum)?),
                };
                Some((Arc::new(format::geoid::open(file)?), way))
            }
        };
        let vertical_datum = self.vertical_datum.as_deref().map(VerticalDatum::parse).transpose()?;
        let mut sources = Vec::with_capacity(files.len());
        for f in files {
            let mut s = format::open(f)?;
            if let Some(v) = self.nodata {
                s.set_nodata(v);
            }
            sources.push(match &lift {
                None => s,
                Some((geoid, lift)) => self.lifted(s, geoid.clone(), lift)?,
            });
        }
        let step = match self.step.as_deref() {
            None => None,
            Some(t) if t.contains(',') => Some(numbers("--step", t)?),
            Some(t) => numbers("--step", t).map(|[s]: [f64; 1]| Some([s, s]))?,
        };
        Ok(db::Ingest {
            sources,
            name: None,
            into: None,
            accuracy_m: self.accuracy,
            date: self.date.as_deref().map(Date::parse).transpose()?,
            precedence: self.precedence,
            vertical_unit_m: self.vertical_unit.map(VerticalUnit::metres).filter(|_| lift.is_none()),
            vertical_datum: vertical_datum.map(|d| d.as_str().to_string()),
            crs: self.crs()?,
            datum: self.datum_shift.as_deref().map_or(Ok(DatumChoice::None), DatumChoice::parse)?,
            step,
            lattice: self.lattice.as_deref().map(|l| numbers("--lattice", l)).transpose()?,
        })
    }

    fn crs(&self) -> Result<Option<Crs>> {
        self.crs.as_deref().map(Crs::parse).transpose()
    }

    /// A file whose heights are moved by a geoid grid.
    fn lifted(
        &self,
        source: Box<dyn HeightSource>,
        geoid: Arc<Geoid>,
        lift: &Lift,
    ) -> Result<Box<dyn HeightSource>> {
        let info = source.info();
        let crs = self.crs()?.or_else(|| info.crs.clone()).ok_or_else(|| {
            Error::invalid(&info.file, "does not say its coordinate system; say it with --crs")
        })?;
        let unit_m = self.vertical_unit.map(VerticalUnit::metres).or(info.vertical_unit_m).unwrap_or(1.0);
        Ok(Box::new(Lifted::new(source, &crs, unit_m, geoid, lift)?))
    }

    /// Brings the files to a server.
    fn send(&self, server: &str, request: db::Ingest, replace: Option<&str>) -> Result<bool> {
        let line = Line::open(server)?;
        let call = Call {
            replace,
            datum_shift: self.datum_shift.as_deref(),
            operation: operation(self.operation.as_deref(), "ingest")?,
            dry_run: self.dry_run,
        };
        tell(&send(&line, request, call)?, self.json, self.dry_run)
    }

    fn carry_out(&self, db: &Db, change: Change) -> Result<bool> {
        let outcome = carry_out(db, change, self.operation.as_deref(), self.dry_run)?;
        tell(&outcome, self.json, self.dry_run)
    }
}

/// Commits a change with a bar on the terminal.
pub fn carry_out(db: &Db, change: Change, operation: Option<&str>, dry_run: bool) -> Result<Outcome> {
    let meter = Meter::new();
    let stop = stop_flag();
    let report = |stage: &str, share: f64| meter.report(stage, share);
    let progress = Progress { report: &report, stop: &stop };
    let mut waiting = || message("another process is writing to this database; waiting for it");
    let outcome = db.change(change, operation, dry_run, &progress, &mut waiting);
    meter.clear();
    outcome
}

/// Two digits after the point and a sign; 0 has none of its own.
pub fn signed(v: f64) -> String {
    format!("{:+.2}", (v * 100.0).round() / 100.0 + 0.0)
}

/// One line about two surveys that contradict each other.
pub fn contradiction(c: &db::Contradiction) -> String {
    let hint = c.hint.as_ref().map_or(String::new(), |h| format!("; {h}"));
    format!(
        "'{}' and '{}' contradict each other on {:.1} % of {:.3} km2 (more than {} m apart): mean {} m, std {:.2} m, largest {:+.2} m at {}, {}{hint}",
        c.finer,
        c.coarser,
        c.share * 100.0,
        c.overlap_m2 / 1e6,
        crate::base::round::significant(c.allowed_m, 6),
        signed(c.mean_m),
        c.std_m,
        c.largest_m,
        crate::base::round::significant(c.largest_at[0], 9),
        crate::base::round::significant(c.largest_at[1], 9),
    )
}

fn tell(o: &Outcome, json: bool, dry_run: bool) -> Result<bool> {
    for w in &o.warnings {
        message(&format!("note: {w}"));
    }
    let mut out = Output::new();
    if json {
        out.json(o)?;
        return out.end();
    }
    if !o.changed && !dry_run {
        out.line(format!("unchanged, version {}", o.version))?;
        return out.end();
    }
    let verb = if dry_run { "would make" } else { "made" };
    let version = o.version + u64::from(dry_run);
    out.line(format!(
        "{verb} version {version}: '{}', {} posts ({} void), {} patches ({} live, {} dormant), {:.2} s",
        o.survey,
        count(o.posts),
        count(o.voids),
        count(o.patches),
        count(o.live),
        count(o.dormant),
        o.seconds
    ))?;
    if let Some(r) = &o.resampling {
        out.line(format!(
            "  resampled: {} delivered samples differ from the surface by {:.3} m on average, 99 % by at most {:.3} m, at most {:.3} m",
            count(r.posts),
            r.mean_m,
            r.p99_m,
            r.max_m
        ))?;
    }
    for (name, cells) in &o.flipped_cells {
        out.line(format!("  shows or hides {} cells of '{name}'", count(*cells)))?;
    }
    for c in &o.contradictions {
        out.line(format!("  {}", contradiction(c)))?;
    }
    out.end()
}

/// Bring one survey into the database: its files are its tiles
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt ingest pit flight-07.tif --accuracy 0.1 --date 2026-03-07\n  terraquilt ingest hills n47/*.tif --name lidar-2025 --accuracy 0.2\n  terraquilt ingest hills late-tile.tif --into lidar-2025"
)]
pub struct IngestFiles {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    /// GeoTIFF, HGT, DTED, Esri ASCII or float, ENVI, USGS DEM or grey PNG files, zipped or not
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Name of the survey; default: that of the first file
    #[arg(long, value_name = "S", conflicts_with = "into")]
    name: Option<String>,
    /// The files are further tiles of this survey
    #[arg(long, value_name = "SURVEY")]
    into: Option<String>,
    #[command(flatten)]
    said: Said,
}

impl IngestFiles {
    pub fn run(self) -> Result<bool> {
        let mut request = self.said.request(&self.files)?;
        if let Some(server) = server(&self.db) {
            (request.name, request.into) = (self.name, self.into);
            return self.said.send(server, request, None);
        }
        let awaited = Awaiting::read(&self.db)?;
        let first = awaited.is_some();
        let db = match awaited {
            None => Db::open(&self.db)?,
            Some(awaiting) => {
                let files: Vec<_> = request.sources.iter().map(|s| s.info()).collect();
                let crs = awaiting.choose(&files, request.crs.as_ref())?;
                if self.said.dry_run {
                    message(&format!("the database would be made in {}; nothing was changed", crs.code));
                    return Ok(true);
                }
                message(&format!("the first survey puts the database in {}", crs.code));
                awaiting.settle(crs)?
            }
        };
        request.name = self.name.clone();
        request.into = self.into.clone();
        let done = self.said.carry_out(&db, Change::Ingest(request));
        if first && done.is_err() {
            Awaiting::wait_again(&db)?;
        }
        done
    }
}

/// Deliver tiles of a survey again: those wholly inside the new files leave, in the same commit
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt replace hills lidar-2025 corrected/*.tif")]
pub struct Replace {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    /// Survey whose tiles are delivered again
    survey: String,
    /// GeoTIFF, HGT, DTED, Esri ASCII or float, ENVI, USGS DEM or grey PNG files, zipped or not
    #[arg(required = true)]
    files: Vec<PathBuf>,
    #[command(flatten)]
    said: Said,
}

impl Replace {
    pub fn run(self) -> Result<bool> {
        if let Some(server) = server(&self.db) {
            return self.said.send(server, self.said.request(&self.files)?, Some(&self.survey));
        }
        let db = Db::open(&self.db)?;
        let ingest = self.said.request(&self.files)?;
        self.said.carry_out(&db, Change::Replace { survey: self.survey.clone(), ingest })
    }
}

/// Change a survey's date or precedence
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt set pit flight-07 --date 2026-03-08")]
pub struct Set {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    survey: String,
    /// Day of the survey
    #[arg(long, value_name = "YYYY-MM-DD", required_unless_present = "precedence")]
    date: Option<String>,
    /// Rank; a higher one replaces lower ones and wins over the policy
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    precedence: Option<i64>,
    /// Name of this call: repeating it does nothing twice
    #[arg(long, value_name = "ID")]
    operation: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Set {
    pub fn run(self) -> Result<bool> {
        let date = self.date.as_deref().map(Date::parse).transpose()?;
        let o = match server(&self.db) {
            Some(server) => {
                let line = Line::open(server)?;
                let operation = operation(self.operation.as_deref(), "set")?;
                let request = v1::SetRequest {
                    survey: self.survey,
                    date: date.map(|d| d.to_string()),
                    precedence: self.precedence,
                    operation: operation.clone(),
                };
                let done = line.commit(&operation, catalog::set(&line.connection, request))?;
                line.read(done.json.as_bytes())?
            }
            None => {
                let change = Change::Set { survey: self.survey, date, precedence: self.precedence };
                carry_out(&Db::open(&self.db)?, change, self.operation.as_deref(), false)?
            }
        };
        tell(&o, self.json, false)
    }
}

/// Take surveys (or one tile) out: the terrain as if they had never come
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt remove pit flight-06\nThe bytes stay for --at until `terraquilt prune`."
)]
pub struct Remove {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    #[arg(required = true)]
    surveys: Vec<String>,
    /// Only this tile, by file name or key (see `terraquilt tiles`)
    #[arg(long, value_name = "T")]
    tile: Option<String>,
    /// Name of this call: repeating it does nothing twice
    #[arg(long, value_name = "ID")]
    operation: Option<String>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Remove {
    pub fn run(self) -> Result<bool> {
        let o = match server(&self.db) {
            Some(server) => {
                let line = Line::open(server)?;
                let operation = operation(self.operation.as_deref(), "remove")?;
                let request = v1::RemoveRequest {
                    surveys: self.surveys,
                    tile: self.tile.clone().unwrap_or_default(),
                    operation: operation.clone(),
                };
                let done = line.commit(&operation, catalog::remove(&line.connection, request))?;
                line.read::<Outcome>(done.json.as_bytes())?
            }
            None => {
                let change = Change::Remove { surveys: self.surveys, tile: self.tile.clone() };
                carry_out(&Db::open(&self.db)?, change, self.operation.as_deref(), false)?
            }
        };
        if self.json {
            return tell(&o, true, false);
        }
        let mut out = Output::new();
        let what = self.tile.map_or(String::new(), |t| format!("tile '{t}' of "));
        out.line(format!("made version {}: removed {what}'{}', {:.2} s", o.version, o.survey, o.seconds))?;
        for (name, cells) in &o.flipped_cells {
            out.line(format!("  shows {} cells of '{name}' again", count(*cells)))?;
        }
        out.end()
    }
}
