//! Arguments that several commands share: database, version, region, tolerance.

use super::output::message;
use super::place::{place_of_file, told};
use super::reader::Reader;
use super::tolerance::read_raster;
use crate::analysis::Ground;
use crate::base::{Error, Result};
use crate::db::query::{Query, Tolerance};
use crate::export::{Coords, Place};
use crate::height::lod::cut::{Camera, Foci, Focus};
use crate::height::surface::{Blend, How, Seams};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::sync::Arc;

/// The database and which version of it to read.
#[derive(Args)]
pub struct Source {
    /// Directory of the database (or --server ADDR)
    pub db: PathBuf,
    /// Read this version instead of the latest
    #[arg(long, value_name = "VERSION")]
    pub at: Option<u64>,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

impl Source {
    pub fn open(&self) -> Result<Reader> {
        Reader::open(&self.db, self.at)
    }
}

/// Where.
#[derive(Args)]
pub struct Region {
    /// Only this box; without it, everything
    #[arg(long, value_name = "XMIN,YMIN,XMAX,YMAX", allow_hyphen_values = true)]
    pub bbox: Option<String>,
    /// Only the inside of the polygons of this file
    #[arg(long, value_name = "FILE.geojson", conflicts_with = "bbox")]
    pub polygon: Option<PathBuf>,
    #[command(flatten)]
    pub coords: CoordsArg,
}

/// Whose coordinates.
#[derive(Args)]
pub struct CoordsArg {
    /// Coordinates are in this CRS (EPSG:4326: longitude, latitude); without it, in the database's
    #[arg(long, value_name = "EPSG:n")]
    pub coords: Option<String>,
}

impl CoordsArg {
    pub fn get(&self, s: &dyn Ground) -> Result<Option<Coords>> {
        Ok(told(Coords::of(self.coords.as_deref(), s.crs())?))
    }
}

impl Region {
    pub fn place(&self, s: &dyn Ground) -> Result<Place> {
        let coords = self.coords.get(s)?;
        if let Some(path) = &self.polygon {
            return place_of_file(path, coords, s.crs(), s.bounds());
        }
        let Some(text) = &self.bbox else { return Ok(Place::everywhere(coords, s.bounds())) };
        let b: [f64; 4] = numbers("--bbox", text)?;
        if b[0] >= b[2] || b[1] >= b[3] {
            return Err(Error::invalid(
                "--bbox",
                format!("'{text}' is empty; give xmin,ymin,xmax,ymax with min below max"),
            ));
        }
        Place::of_box(b, coords)
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
        conflicts_with_all = ["eye", "error_raster", "focus"],
        required_unless_present_any = ["eye", "error_raster", "focus"],
        allow_hyphen_values = true
    )]
    pub error: Option<f64>,
    /// A grid of errors in metres, in the database's CRS; beyond its border the nearest value holds
    #[arg(long, value_name = "FILE.tif", conflicts_with_all = ["eye", "focus"])]
    pub error_raster: Option<PathBuf>,
    /// ERROR metres within RADIUS metres of a point, GROWTH metres more for each metre beyond; may be repeated, the least
    /// holds
    #[arg(long, value_name = "X,Y,RADIUS,ERROR,GROWTH", conflicts_with = "eye", allow_hyphen_values = true)]
    pub focus: Vec<String>,
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

    /// `coords`: what points are given in, if not in the database's CRS.
    pub fn get(&self, s: &dyn Ground, coords: Option<&Coords>) -> Result<Tolerance> {
        let inside = |what: &str, p: [f64; 2]| coords.map_or(Ok(p), |c| c.inside(what, p));
        if let Some(e) = self.error {
            if e.is_nan() || e < 0.0 {
                return Err(Error::invalid("--error", format!("{e} is no error; give metres, 0 or more")));
            }
            return Ok(Tolerance::Constant(e));
        }
        if let Some(path) = &self.error_raster {
            return Ok(Tolerance::Raster(Arc::new(read_raster(path, s.crs())?)));
        }
        if !self.focus.is_empty() {
            let one = |text: &String| {
                let [x, y, radius, error, growth] = numbers("--focus", text)?;
                Ok(Focus { center: inside("--focus", [x, y])?, radius, error, growth })
            };
            return Ok(Tolerance::Foci(Foci::new(self.focus.iter().map(one).collect::<Result<_>>()?)?));
        }
        let (Some(eye), Some(look)) = (&self.eye, &self.look_at) else {
            return Err(Error::invalid(
                "tolerance",
                "give --error M, --error-raster FILE.tif, --focus, or --eye and --look-at",
            ));
        };
        let point = |what: &str, text: &str| {
            let [x, y, z] = numbers(what, text)?;
            let [x, y] = inside(what, [x, y])?;
            Ok::<_, Error>([x, y, z])
        };
        let bad = || Error::invalid("--viewport", format!("'{}' is not WIDTHxHEIGHT", self.viewport));
        let (w, h) = self.viewport.split_once(['x', 'X']).ok_or_else(bad)?;
        let viewport = [w.parse().map_err(|_| bad())?, h.parse().map_err(|_| bad())?];
        let camera = Camera::new(
            point("--eye", eye)?,
            point("--look-at", look)?,
            self.fov,
            viewport,
            self.pixels,
            self.far,
        )?;
        Ok(Tolerance::Camera(camera))
    }

    /// The question at a place.
    pub fn query(&self, place: &Place, s: &dyn Ground, seams: Seams) -> Result<Query> {
        let tolerance = self.get(s, place.coords.as_ref())?;
        if let (Tolerance::Raster(r), Some(b)) = (&tolerance, place.area.bounds().or_else(|| s.bounds()))
            && [[b[0], b[1]], [b[2], b[1]], [b[2], b[3]], [b[0], b[3]]].iter().any(|p| !r.covers(*p))
        {
            message(
                "note: --error-raster covers only a part of the region; beyond it the nearest of its values holds",
            );
        }
        Ok(Query { area: place.area.clone(), tolerance, how: self.how(seams) })
    }
}

/// Numbers between commas.
pub fn listed(what: &str, text: &str) -> Result<Vec<f64>> {
    let found: Vec<f64> = text
        .split(',')
        .map(|t| t.trim().parse::<f64>())
        .collect::<std::result::Result<_, _>>()
        .map_err(|_| Error::invalid(what, format!("'{text}' is not numbers between commas")))?;
    match found.iter().any(|v| !v.is_finite()) {
        true => Err(Error::invalid(what, format!("'{text}' holds a number that is not finite"))),
        false => Ok(found),
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
