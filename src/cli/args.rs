//! Arguments that several commands share: database, version, region, tolerance.

use crate::base::{Error, Result};
use crate::db::query::{Area, Query, Tolerance};
use crate::db::{Db, Snapshot};
use crate::height::lod::cut::Camera;
use crate::height::surface::{Blend, How, Seams};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// The database and which version of it to read.
#[derive(Args)]
pub struct Source {
    /// Directory of the database
    pub db: PathBuf,
    /// Read this version instead of the latest
    #[arg(long, value_name = "VERSION")]
    pub at: Option<u64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

impl Source {
    pub fn open(&self) -> Result<(Db, Snapshot)> {
        let db = Db::open(&self.db)?;
        let snapshot = db.snapshot(self.at)?;
        Ok((db, snapshot))
    }
}

/// Where.
#[derive(Args)]
pub struct Region {
    /// Only this box, in the database's CRS; without it, everything
    #[arg(long, value_name = "XMIN,YMIN,XMAX,YMAX", allow_hyphen_values = true)]
    pub bbox: Option<String>,
}

impl Region {
    pub fn get(&self) -> Result<Area> {
        let Some(text) = &self.bbox else { return Ok(Area::Everything) };
        let b: [f64; 4] = numbers("--bbox", text)?;
        if b[0] >= b[2] || b[1] >= b[3] {
            return Err(Error::invalid(
                "--bbox",
                format!("'{text}' is empty; give xmin,ymin,xmax,ymax with min below max"),
            ));
        }
        Ok(Area::Box(b))
    }
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SurfaceKind {
    Exact,
    Plain,
}

/// What is done where surveys disagree.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum SeamsKind {
    Off,
    All,
    Consistent,
}

/// How much error is allowed.
#[derive(Args)]
pub struct ToleranceArgs {
    /// The same error everywhere, metres
    #[arg(
        long,
        value_name = "M",
        conflicts_with = "eye",
        required_unless_present = "eye",
        allow_hyphen_values = true
    )]
    pub error: Option<f64>,
    /// Camera: where the eye is (x, y in the CRS, z in metres)
    #[arg(long, value_name = "X,Y,Z", requires = "look_at", allow_hyphen_values = true)]
    pub eye: Option<String>,
    /// Camera: the point it looks at
    #[arg(long, value_name = "X,Y,Z", requires = "eye", allow_hyphen_values = true)]
    pub look_at: Option<String>,
    /// Camera: vertical field of view, degrees
    #[arg(long, value_name = "DEG", default_value_t = 45.0, requires = "eye")]
    pub fov: f64,
    /// Camera: size of the picture
    #[arg(long, value_name = "WxH", default_value = "1920x1080", requires = "eye")]
    pub viewport: String,
    /// Camera: allowed displacement on the screen
    #[arg(long, value_name = "PIXELS", default_value_t = 1.0, requires = "eye")]
    pub pixels: f64,
    /// Camera: how far it sees, metres
    #[arg(long, value_name = "M", requires = "eye")]
    pub far: Option<f64>,
    /// exact: error certified everywhere; plain: the paper's blend
    #[arg(long, value_enum, default_value = "exact")]
    pub surface: SurfaceKind,
    /// Where surveys disagree: off: as delivered; all: the lower survey is bent towards the better one along its border;
    /// consistent: by no more than both accuracies. Default: all for .glb and .png, else off
    #[arg(long, value_enum)]
    pub seams: Option<SeamsKind>,
}

impl ToleranceArgs {
    /// `seams`: what is done where nothing was said.
    pub fn how(&self, seams: Seams) -> How {
        let blend = match self.surface {
            SurfaceKind::Exact => Blend::Exact,
            SurfaceKind::Plain => Blend::Plain,
        };
        let seams = match self.seams {
            None => seams,
            Some(SeamsKind::Off) => Seams::Off,
            Some(SeamsKind::All) => Seams::All,
            Some(SeamsKind::Consistent) => Seams::Consistent,
        };
        How { blend, seams }
    }

    pub fn get(&self) -> Result<Tolerance> {
        if let Some(e) = self.error {
            if e.is_nan() || e < 0.0 {
                return Err(Error::invalid("--error", format!("{e} is no error; give metres, 0 or more")));
            }
            return Ok(Tolerance::Constant(e));
        }
        let (Some(eye), Some(look)) = (&self.eye, &self.look_at) else {
            return Err(Error::invalid("tolerance", "give --error M, or --eye and --look-at"));
        };
        let bad = || Error::invalid("--viewport", format!("'{}' is not WIDTHxHEIGHT", self.viewport));
        let (w, h) = self.viewport.split_once(['x', 'X']).ok_or_else(bad)?;
        let viewport = [w.parse().map_err(|_| bad())?, h.parse().map_err(|_| bad())?];
        let camera = Camera::new(
            numbers("--eye", eye)?,
            numbers("--look-at", look)?,
            self.fov,
            viewport,
            self.pixels,
            self.far,
        )?;
        Ok(Tolerance::Camera(camera))
    }

    pub fn query(&self, region: &Region, seams: Seams) -> Result<Query> {
        Ok(Query { area: region.get()?, tolerance: self.get()?, how: self.how(seams) })
    }
}

/// N numbers between commas.
pub fn numbers<const N: usize>(what: &str, text: &str) -> Result<[f64; N]> {
    let found: Vec<f64> = text
        .split(',')
        .map(|t| t.trim().parse::<f64>())
        .collect::<std::result::Result<_, _>>()
        .map_err(|_| Error::invalid(what, format!("'{text}' is not {N} numbers between commas")))?;
    if found.iter().any(|v| !v.is_finite()) {
        return Err(Error::invalid(what, format!("'{text}' holds a number that is not finite")));
    }
    let n = found.len();
    found.try_into().map_err(|_| {
        Error::invalid(what, format!("'{text}': {N} numbers between commas are needed, {n} found"))
    })
}
