//! Along a line: profile, sight.

use crate::analysis::{self, End, Ground, SightOptions, Terrain, Verdict, line_length_m};
use crate::base::{Error, Result};
use crate::cli::args::{CoordsArg, Source, ToleranceArgs, numbers};
use crate::cli::output::Output;
use crate::cli::place::Coords;
use crate::db::query::{Area, Query};
use crate::format::geojson::read_line;
use crate::height::surface::Seams;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// Heights along a line
///
/// Prints CSV: distance_m,x,y,z,error_m. No z: no data there. A z without error_m: the rim of a survey, where no error is
/// promised. The vertices of the line are among the points.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt profile hills --error 0 --line 500000,4100000 501000,4100500 502000,4100000\n  terraquilt profile hills --error 1 --line-file road.geojson --step 5 > road.csv"
)]
pub struct Profile {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    #[command(flatten)]
    coords: CoordsArg,
    /// Vertices of the line; it is straight between them in the database's CRS
    #[arg(
        long,
        value_name = "X,Y",
        num_args = 2..,
        required_unless_present = "line_file",
        conflicts_with = "line_file"
    )]
    line: Vec<String>,
    /// A GeoJSON file with one LineString, in the same coordinates
    #[arg(long, value_name = "FILE.geojson")]
    line_file: Option<PathBuf>,
    /// Metres between points, at most; default: the step of the finest survey there
    #[arg(long, value_name = "M")]
    step: Option<f64>,
}

/// The surface that is asked at points of its own: a region has no part in it.
fn terrain<'a>(s: &'a dyn Ground, tolerance: &ToleranceArgs, coords: Option<&Coords>) -> Result<Terrain<'a>> {
    let how = tolerance.how(Seams::Off);
    Terrain::new(s, &Query { area: Area::Everything, tolerance: tolerance.get(s, coords)?, how })
}

/// A point as it was given, in the database's CRS.
fn inside(coords: Option<&Coords>, what: &str, p: [f64; 2]) -> Result<[f64; 2]> {
    coords.map_or(Ok(p), |c| c.inside(what, p))
}

/// A point of the answer, in the coordinates that were asked for.
fn outside(coords: Option<&Coords>, p: [f64; 2]) -> [f64; 2] {
    coords.and_then(|c| c.outward(p)).unwrap_or(p)
}

impl Profile {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let s = r.ground()?;
        let line = match &self.line_file {
            Some(f) => read_line(f)?,
            None => self.line.iter().map(|t| numbers("--line", t)).collect::<Result<Vec<[f64; 2]>>>()?,
        };
        let coords = self.coords.get(s)?;
        let coords = coords.as_ref();
        let line = line.into_iter().map(|p| inside(coords, "--line", p)).collect::<Result<Vec<_>>>()?;
        let mut found = analysis::profile(&terrain(s, &self.tolerance, coords)?, &line, self.step)?;
        for p in &mut found {
            [p.x, p.y] = outside(coords, [p.x, p.y]);
        }
        let mut out = Output::new();
        if self.source.json {
            out.json(&json!({"length_m": line_length_m(&found), "points": found}))?;
            return out.end();
        }
        out.line("distance_m,x,y,z,error_m")?;
        for p in &found {
            out.line(format!("{},{},{},{},{}", p.distance_m, p.x, p.y, text(p.z), text(p.error_m)))?;
        }
        out.end()
    }
}

fn text(v: Option<f64>) -> String {
    v.map_or(String::new(), |v| v.to_string())
}

/// Whether one point sees another: visible, hidden, or undecided within the error
#[derive(Args)]
#[command(
    name = "sight",
    after_help = "Examples:\n  terraquilt sight hills --error 0 --from 500000,4100000,1.7 --to 503000,4102000,10\n  terraquilt sight hills --error 1 --from 500000,4100000,30 --to 540000,4102000,30 --curvature\n\nVisible: the ground is lower than the line by more than the error at every point. Hidden: somewhere it is higher by more\nthan the error. The error is that of the surface at the point and, where an end is given above ground, below the ends."
)]
pub struct SightCommand {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    #[command(flatten)]
    coords: CoordsArg,
    /// One end; H: metres above the ground, 1.7 if left out
    #[arg(long, value_name = "X,Y[,H]", allow_hyphen_values = true)]
    from: String,
    /// The other end
    #[arg(long, value_name = "X,Y[,H]", allow_hyphen_values = true)]
    to: String,
    /// H is a height of the database, not above ground
    #[arg(long)]
    absolute: bool,
    /// Metres between the points looked at; default: half the step of the finest survey there
    #[arg(long, value_name = "M")]
    step: Option<f64>,
    /// Reckon with the curvature of the Earth, and with refraction
    #[arg(long)]
    curvature: bool,
    /// Coefficient of refraction (0.13: by day, after Gauss)
    #[arg(
        long,
        value_name = "K",
        default_value_t = 0.13,
        requires = "curvature",
        allow_hyphen_values = true
    )]
    refraction: f64,
    /// Print the clearance at every point as CSV
    #[arg(long)]
    along: bool,
}

impl SightCommand {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let s = r.ground()?;
        let coords = self.coords.get(s)?;
        let coords = coords.as_ref();
        let (from, to) = (self.end("--from", &self.from, coords)?, self.end("--to", &self.to, coords)?);
        let options =
            SightOptions { step_m: self.step, refraction: self.curvature.then_some(self.refraction) };
        let mut found = analysis::sight(&terrain(s, &self.tolerance, coords)?, from, to, options)?;
        for r in found.rays.iter_mut().chain(&mut found.closest).chain(&mut found.obstruction) {
            [r.x, r.y] = outside(coords, [r.x, r.y]);
        }
        let mut out = Output::new();
        if self.source.json {
            out.json(&found)?;
            return out.end();
        }
        if self.along {
            out.line("distance_m,x,y,z,clearance_m,error_m")?;
            for r in &found.rays {
                let (z, c, e) = (text(r.z), text(r.clearance_m), text(r.error_m));
                out.line(format!("{},{},{},{z},{c},{e}", r.distance_m, r.x, r.y))?;
            }
            return out.end();
        }
        let word = |v: Verdict| match v {
            Verdict::Visible => "visible",
            Verdict::Hidden => "hidden",
            Verdict::Undecided => "undecided",
        };
        let verdict = match found.verdict {
            Verdict::Undecided => {
                format!("undecided within the error (on the surface itself: {})", word(found.on_surface))
            }
            v => word(v).to_string(),
        };
        out.line(format!(
            "{verdict}: {:.1} m from height {:.2} to {:.2} m",
            found.distance_m, found.from_z, found.to_z
        ))?;
        if let Some(r) = &found.closest {
            let error = r.error_m.map_or("not promised".into(), |e| format!("{e:.2} m"));
            out.line(format!(
                "  least clearance {:.2} m (error {error}) at {:.1} m, {:.3}, {:.3}",
                r.clearance_m.unwrap_or(f64::NAN),
                r.distance_m,
                r.x,
                r.y
            ))?;
        }
        if let Some(r) = &found.obstruction {
            out.line(format!(
                "  first obstruction at {:.1} m, {:.3}, {:.3}: ground at {:.2} m",
                r.distance_m,
                r.x,
                r.y,
                r.z.unwrap_or(f64::NAN)
            ))?;
        }
        if found.without_data + found.uncertified > 0 {
            out.line(format!(
                "  {} points on the way have no data, {} no promised error",
                found.without_data, found.uncertified
            ))?;
        }
        out.end()
    }

    fn end(&self, name: &str, t: &str, coords: Option<&Coords>) -> Result<End> {
        let (at, height) = match t.matches(',').count() {
            1 if self.absolute => {
                return Err(Error::invalid(name, format!("'{t}': --absolute needs X,Y,HEIGHT")));
            }
            1 => (numbers::<2>(name, t)?, 1.7),
            _ => {
                let [x, y, h] = numbers(name, t)?;
                ([x, y], h)
            }
        };
        Ok(End { at: inside(coords, name, at)?, height, absolute: self.absolute })
    }
}
