//! Over a region: statistics, contours.

use super::{ending, metered, no_format, size_of, step};
use crate::analysis::{self, Grid, Levels, Terrain};
use crate::base::Result;
use crate::cli::args::{Region, Source, ToleranceArgs};
use crate::cli::export::write_whole;
use crate::cli::output::{Output, count};
use crate::format::geojson::{FeatureWriter, Shape};
use crate::height::surface::Seams;
use clap::Args;
use serde_json::{Map, json};
use std::path::PathBuf;

/// Lowest, highest and mean height of a region, its area, and how much of it has data
///
/// Points are asked at the centres and corners of cells. Without --step these are the cells of the finest survey there: over
/// one upright survey at --error 0 in a bilinear database, min, max, mean and area are then exactly those of the surface. A
/// bicubic surface may be a little higher or lower between these points, and its mean differ a little: with a smaller --step
/// they come closer.
#[derive(Args)]
#[command(
    name = "statistics",
    after_help = "Example:\n  terraquilt statistics hills --error 0 --bbox 500000,4100000,501000,4101000"
)]
pub struct StatisticsCommand {
    #[command(flatten)]
    source: Source,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// Size of the cells in CRS units; default: the cells of the finest survey there
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
}

impl StatisticsCommand {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let s = r.ground()?;
        let query = self.tolerance.query(&self.region.place(s)?, s, Seams::Off)?;
        let terrain = Terrain::new(s, &query)?;
        let grid = Grid::new(&[&terrain], &query.area, step(self.step.as_deref())?, None)?;
        let f = metered("heights", |going| analysis::statistics(&terrain, &grid, going))?;
        let mut out = Output::new();
        if self.source.json {
            out.json(&f)?;
            return out.end();
        }
        let at = |p: [f64; 2]| format!("at {}, {}", p[0], p[1]);
        out.line(format!("lowest   {:.3} m {}", f.min_m, at(f.min_at)))?;
        out.line(format!("highest  {:.3} m {}", f.max_m, at(f.max_at)))?;
        out.line(format!("mean     {:.3} m, standard deviation {:.3} m", f.mean_m, f.std_m))?;
        out.line(format!("error    {:.3} m at most", f.error_m))?;
        out.line(format!(
            "area     {:.6} km2, {:.2} % of it without data, {:.2} % without a promised error",
            f.area_m2 / 1e6,
            f.share_without_data * 100.0,
            f.share_uncertified * 100.0
        ))?;
        out.line(format!("cells    {} of {} x {}", count(f.cells), f.step[0], f.step[1]))?;
        out.end()
    }
}

/// Draw contour lines of the surface as GeoJSON
///
/// Lines cross the sides of a grid where the surface does, and are straight between. Without --step the corners of the grid
/// are the posts of the finest survey there. Lines end at holes and at the edge of the region; high ground is on their left.
/// Each has "elevation", "error_m" (vertical, of the surface beside it) and "closed".
#[derive(Args)]
#[command(
    name = "contours",
    after_help = "Example:\n  terraquilt contours hills hills.geojson --error 0 --interval 10\n  terraquilt contours hills coarse.geojson --error 5 --interval 50 --base 12.5 --step 20"
)]
pub struct ContoursCommand {
    #[command(flatten)]
    source: Source,
    /// File to write
    #[arg(value_name = "OUT.geojson")]
    out: PathBuf,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// Metres of height between two lines
    #[arg(long, value_name = "M")]
    interval: f64,
    /// A height that has a line
    #[arg(long, value_name = "M", default_value_t = 0.0, allow_hyphen_values = true)]
    base: f64,
    /// Size of the cells in CRS units; default: the cells of the finest survey there
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
}

impl ContoursCommand {
    pub fn run(self) -> Result<bool> {
        if !["geojson", "json"].contains(&ending(&self.out).as_str()) {
            return Err(no_format(&self.out, ".geojson"));
        }
        let r = self.source.open()?;
        let s = r.ground()?;
        let place = self.region.place(s)?;
        let query = self.tolerance.query(&place, s, Seams::Off)?;
        let terrain = Terrain::new(s, &query)?;
        let grid = Grid::new(&[&terrain], &query.area, step(self.step.as_deref())?, None)?;
        let levels = Levels { interval: self.interval, base: self.base };
        let found = metered("heights", |going| analysis::contours(&terrain, &grid, levels, going))?;
        let mut extras = Map::new();
        extras.insert("version".into(), json!(r.version()));
        extras.insert("error_m".into(), json!(found.error_m));
        extras.insert("step".into(), json!(grid.step));
        write_whole(&self.out, |p| {
            let crs = place.coords.as_ref().map_or(s.crs(), |c| &c.crs);
            let mut out = FeatureWriter::new(super::create(p)?, crs, extras)?;
            for l in &found.lines {
                let points: Vec<[f64; 2]> = match &place.coords {
                    None => l.points.clone(),
                    Some(c) => l.points.iter().filter_map(|p| c.outward(*p)).collect(),
                };
                let properties = json!({"elevation": l.elevation, "error_m": l.error_m, "closed": l.closed});
                out.feature(Shape::Line(&points), &properties)?;
            }
            out.finish().map(|_| ())
        })?;
        let vertices: u64 = found.lines.iter().map(|l| l.points.len() as u64).sum();
        let mut out = Output::new();
        if self.source.json {
            out.json(&json!({
                "out": self.out, "lines": found.lines.len(), "vertices": vertices, "z": found.z, "error_m": found.error_m,
                "step": grid.step,
            }))?;
            return out.end();
        }
        out.line(format!(
            "{}: {} lines, {} vertices, heights {:.3} .. {:.3} m, error {:.3} m, {}",
            self.out.display(),
            count(found.lines.len() as u64),
            count(vertices),
            found.z[0],
            found.z[1],
            found.error_m,
            size_of(&self.out)
        ))?;
        out.end()
    }
}
