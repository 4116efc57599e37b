//! Between two states of the ground: volume, difference.

use super::{PICTURE_SIDE, Picture, ending, metered, no_format, size_of, step, write_raster};
use crate::analysis::{self, Grid, Terrain, Volumes};
use crate::base::{Error, Result};
use crate::cli::args::{Region, ToleranceArgs};
use crate::cli::output::Output;
use crate::cli::reader::Reader;
use crate::db::query::Query;
use crate::format::colour_map::Ramp;
use crate::height::surface::Seams;
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Which two states of the ground are compared.
#[derive(Args)]
struct Between {
    /// The ground before, as this version has it
    #[arg(long, value_name = "VERSION", required_unless_present = "from_surveys")]
    from: Option<u64>,
    /// The ground after, as this version has it; default: the latest
    #[arg(long, value_name = "VERSION")]
    to: Option<u64>,
    /// Before: as if only these surveys (names between commas) were in the database
    #[arg(long, value_name = "S,S...")]
    from_surveys: Option<String>,
    /// After: as if only these surveys were in the database
    #[arg(long, value_name = "S,S...")]
    to_surveys: Option<String>,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// Size of the cells in CRS units; default: the cells of the finest survey there
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
    /// Metres beyond which errors are taken for independent, for the standard deviation; default: the coarsest step of
    /// the surveys
    #[arg(long, value_name = "M")]
    independent_beyond: Option<f64>,
}

impl Between {
    /// The two states.
    fn states(&self, db: &Path) -> Result<[Reader; 2]> {
        if self.from_surveys.is_none() && self.to_surveys.is_none() && self.from == self.to {
            return Err(Error::invalid(
                "--from",
                "both states are the same version; name another one with --to",
            ));
        }
        let newest = Reader::open(db, None)?;
        Ok([
            state(&newest, self.from, self.from_surveys.as_deref())?,
            state(&newest, self.to, self.to_surveys.as_deref())?,
        ])
    }

    /// Compares, and hands over each row of differences.
    fn compare(
        &self,
        states: &[Reader; 2],
        query: &Query,
        side_max: Option<usize>,
        rows: impl FnOnce(
            &Grid,
            &mut dyn FnMut(&mut dyn FnMut(usize, &[f32]) -> Result<()>) -> Result<()>,
        ) -> Result<()>,
    ) -> Result<Volumes> {
        let (from, to) =
            (Terrain::new(states[0].ground()?, query)?, Terrain::new(states[1].ground()?, query)?);
        let grid = Grid::new(&[&from, &to], &query.area, step(self.step.as_deref())?, side_max)?;
        let mut found = None;
        rows(&grid, &mut |f| {
            let done = metered("heights", |going| {
                analysis::volumes(&from, &to, &grid, self.independent_beyond, going, f)
            })?;
            found = Some(done);
            Ok(())
        })?;
        found.ok_or_else(|| Error::invalid("region", "nothing was compared"))
    }
}

/// A version, or some of its surveys.
fn state(newest: &Reader, version: Option<u64>, surveys: Option<&str>) -> Result<Reader> {
    let s = newest.at(version)?;
    let Some(names) = surveys else { return Ok(s) };
    let names: Vec<String> =
        names.split(',').map(str::trim).filter(|n| !n.is_empty()).map(str::to_string).collect();
    s.only(&names)
}

/// Cut and fill between two versions, or two sets of surveys, with their uncertainty
///
/// Without --step the cells are those of the finest survey there. The worst case holds if no height is wrong by more than
/// its error_m (the accuracies stated for the surveys, and the tolerance), in whatever direction. The standard deviation
/// assumes errors spread evenly within that and independent from place to place: a common shift is not in it.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt volume pit --from 3 --error 0                    # what changed since version 3\n  terraquilt volume pit --from-surveys flight-06 --to-surveys flight-07 --error 0\n  terraquilt volume pit --from-surveys flight-06 --to-surveys flight-07 --error 0 --bbox 500000,4100000,501000,4101000 --json"
)]
pub struct Volume {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    #[command(flatten)]
    between: Between,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Volume {
    pub fn run(self) -> Result<bool> {
        let states = self.between.states(&self.db)?;
        let after = states[1].ground()?;
        let place = self.between.region.place(after)?;
        let query = self.between.tolerance.query(&place, after, Seams::Off)?;
        let c = self.between.compare(&states, &query, None, |_, go| go(&mut |_, _| Ok(())))?;
        let mut out = Output::new();
        if self.json {
            out.json(&c)?;
            return out.end();
        }
        let m3 = |v: f64| format!("{v:.0} m3");
        let between = |r: [f64; 2]| format!("between {:.0} and {:.0} m3 in the worst case", r[0], r[1]);
        out.line(format!("fill  {} ({})", m3(c.fill_m3), between(c.fill_range_m3)))?;
        out.line(format!("cut   {} ({})", m3(c.cut_m3), between(c.cut_range_m3)))?;
        out.line(format!("net   {:+.0} m3, within {} in the worst case", c.net_m3, m3(c.net_bound_m3)))?;
        out.line(format!(
            "      standard deviation {} if errors are independent beyond {} m",
            m3(c.net_std_m3),
            crate::base::round::significant(c.independent_beyond_m, 4)
        ))?;
        out.line(format!(
            "area  {:.6} km2 compared, {:.2} % of it changed beyond the error; mean {:+.3} m, from {:+.2} to {:+.2} m",
            c.area_m2 / 1e6,
            c.changed_m2 / c.area_m2 * 100.0,
            c.mean_m,
            c.lowest_m,
            c.highest_m
        ))?;
        out.line(format!(
            "      left out: {:.6} km2 without data in both, {:.6} km2 without a promised error",
            c.without_data_m2 / 1e6,
            c.uncertified_m2 / 1e6
        ))?;
        out.end()
    }
}

/// A raster of what changed between two versions, or two sets of surveys: after minus before
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt difference pit change.png --from 3 --error 0\n  terraquilt difference pit change.tif --from-surveys flight-06 --to-surveys flight-07 --error 0"
)]
pub struct Difference {
    /// Directory of the database (or --server ADDR)
    db: PathBuf,
    /// File to write: .tif (float32 metres, NaN = no data) or .png (blue: lower, red: higher)
    out: PathBuf,
    #[command(flatten)]
    between: Between,
    /// .png: metres at the ends of the colours; default: what all but one in 200 pixels stay below
    #[arg(long, value_name = "M")]
    range: Option<f32>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

impl Difference {
    pub fn run(self) -> Result<bool> {
        let png = match ending(&self.out).as_str() {
            "png" => true,
            "tif" | "tiff" => false,
            _ => return Err(no_format(&self.out, ".tif or .png")),
        };
        let range = match self.range {
            Some(r) if !(r.is_finite() && r > 0.0) => {
                return Err(Error::invalid("--range", format!("{r} m; it must be positive")));
            }
            r => r.map(|r| [-r, r]),
        };
        let states = self.between.states(&self.db)?;
        let after = states[1].ground()?;
        let place = self.between.region.place(after)?;
        super::stays(&place, after);
        let query = self.between.tolerance.query(&place, after, Seams::Off)?;
        let picture = Picture { ramp: Ramp::Diverging, range, unit: "m", legend: true };
        let mut size = [0; 2];
        let c = self.between.compare(&states, &query, png.then_some(PICTURE_SIDE), |grid, go| {
            size = [grid.cols, grid.rows];
            write_raster(&self.out, grid, after.crs(), &picture, |f| go(f))
        })?;
        let mut out = Output::new();
        if self.json {
            out.json(&json!({
                "out": self.out, "cols": size[0], "rows": size[1], "step": c.step, "mean_m": c.mean_m, "lowest_m": c.lowest_m,
                "highest_m": c.highest_m, "error_m": c.error_m,
            }))?;
            return out.end();
        }
        out.line(format!(
            "{}: {} x {} pixels, mean {:+.3} m, from {:+.2} to {:+.2} m, errors together {:.3} m at most, {}",
            self.out.display(),
            size[0],
            size[1],
            c.mean_m,
            c.lowest_m,
            c.highest_m,
            c.error_m,
            size_of(&self.out)
        ))?;
        out.end()
    }
}
