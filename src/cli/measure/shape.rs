//! The ground's shape as a raster: slope, aspect, hillshade.

use super::{
    PICTURE_SIDE, Picture, common, ending, metered, no_format, size_of, step, write_picture, write_raster,
};
use crate::analysis::{Grid, Shape, Spot, Sun, Terrain};
use crate::base::{Error, Result};
use crate::cli::args::{Region, Source, ToleranceArgs};
use crate::cli::output::Output;
use crate::format::colour_map::Ramp;
use crate::height::surface::Seams;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;

/// What the three commands share.
#[derive(Args)]
struct Drawn {
    #[command(flatten)]
    source: Source,
    /// File to write: .tif (float32, NaN = no data) or .png
    out: PathBuf,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: ToleranceArgs,
    /// Size of the pixels in CRS units; default: the cells of the finest survey there (.png: 1600 at most along a side)
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
}

/// How steep the ground is
///
/// From the gradient of the surface at the centre of each pixel, not from differences between pixels.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt slope hills slope.tif --error 0\n  terraquilt slope hills slope.png --error 0 --percent"
)]
pub struct Slope {
    #[command(flatten)]
    drawn: Drawn,
    /// Rise over run in percent, not degrees
    #[arg(long)]
    percent: bool,
}

/// Where slopes face: degrees clockwise from north, -1 where level
///
/// From the gradient of the surface at the centre of each pixel.
#[derive(Args)]
#[command(after_help = "Example:\n  terraquilt aspect hills aspect.tif --error 0")]
pub struct Aspect {
    #[command(flatten)]
    drawn: Drawn,
}

/// Light and shade: 0 (in the shade) to 255 (facing the sun)
///
/// From the gradient of the surface at the centre of each pixel. Shadows that hills cast are not drawn.
#[derive(Args)]
#[command(
    after_help = "Example:\n  terraquilt hillshade hills shade.png --error 0 --azimuth 315 --altitude 45"
)]
pub struct Hillshade {
    #[command(flatten)]
    drawn: Drawn,
    /// Where the sun is, degrees clockwise from north
    #[arg(long, value_name = "DEG", default_value_t = 315.0, allow_hyphen_values = true)]
    azimuth: f64,
    /// How high the sun is above the horizon, degrees
    #[arg(long, value_name = "DEG", default_value_t = 45.0, allow_hyphen_values = true)]
    altitude: f64,
    /// Heights are multiplied by this
    #[arg(long, value_name = "N", default_value_t = 1.0)]
    exaggeration: f64,
}

impl Slope {
    pub fn run(self) -> Result<bool> {
        self.drawn.run(if self.percent { Shape::SlopePercent } else { Shape::SlopeDegrees })
    }
}

impl Aspect {
    pub fn run(self) -> Result<bool> {
        self.drawn.run(Shape::Aspect)
    }
}

impl Hillshade {
    pub fn run(self) -> Result<bool> {
        if !(0.0..=90.0).contains(&self.altitude) || !self.azimuth.is_finite() {
            return Err(Error::invalid(
                "--altitude",
                format!(
                    "sun at {} degrees, {} high; it stands between 0 and 90",
                    self.azimuth, self.altitude
                ),
            ));
        }
        if !(self.exaggeration.is_finite() && self.exaggeration > 0.0) {
            return Err(Error::invalid(
                "--exaggeration",
                format!("{}; it must be positive", self.exaggeration),
            ));
        }
        self.drawn.run(Shape::Hillshade(Sun {
            azimuth_deg: self.azimuth,
            altitude_deg: self.altitude,
            exaggeration: self.exaggeration,
        }))
    }
}

impl Drawn {
    fn run(self, shape: Shape) -> Result<bool> {
        let png = match ending(&self.out).as_str() {
            "png" => true,
            "tif" | "tiff" => false,
            _ => return Err(no_format(&self.out, ".tif or .png")),
        };
        let r = self.source.open()?;
        let s = r.ground()?;
        let place = self.region.place(s)?;
        super::stays(&place, s);
        let query = self.tolerance.query(&place, s, Seams::Off)?;
        let terrain = Terrain::new(s, &query)?;
        let side = png.then_some(PICTURE_SIDE);
        let grid = Grid::new(&[&terrain], &query.area, step(self.step.as_deref())?, side)?;
        let mut error: f64 = 0.0;
        let mut any = false;
        // Of the slopes as they are: the range of colours is known only after all of them.
        let mut picture_values = Vec::new();
        let mut each = |f: &mut dyn FnMut(usize, &[f32]) -> Result<()>| {
            metered("slopes", |going| {
                grid.ask(&terrain, Spot::Slopes, going, |row, found| {
                    let k = grid.cell_m(row);
                    let values: Vec<f32> = found
                        .iter()
                        .map(|e| {
                            let Some(e) = e else { return f32::NAN };
                            any = true;
                            if e.certified {
                                error = error.max(e.error_m);
                            }
                            // Metres per CRS unit, over metres per CRS unit along the ground.
                            let g = [0, 1].map(|c| e.gradient[c] * grid.step[c] / k[c]);
                            shape.of(g) as f32
                        })
                        .collect();
                    f(row, &values)
                })
            })?;
            if any {
                Ok(())
            } else {
                Err(Error::invalid(
                    "region",
                    "holds no data; `terraquilt surveys` shows where the surveys are",
                ))
            }
        };
        if png {
            each(&mut |_, row| {
                // Level ground faces nowhere: left transparent.
                let level = |v: &f32| if shape == Shape::Aspect && *v < 0.0 { f32::NAN } else { *v };
                picture_values.extend(row.iter().map(level));
                Ok(())
            })?;
            let (ramp, range, unit) = match shape {
                Shape::SlopeDegrees => (Ramp::Heat, [0.0, common(picture_values.iter().copied())], "deg"),
                Shape::SlopePercent => (Ramp::Heat, [0.0, common(picture_values.iter().copied())], "%"),
                Shape::Aspect => (Ramp::Circle, [0.0, 360.0], "deg"),
                Shape::Hillshade(_) => (Ramp::Grey, [0.0, 255.0], ""),
            };
            let legend = !matches!(shape, Shape::Hillshade(_));
            let picture = Picture { ramp, range: Some(range), unit, legend };
            write_picture(&self.out, [grid.cols, grid.rows], &picture_values, &picture)?;
        } else {
            let picture = Picture { ramp: Ramp::Grey, range: None, unit: "", legend: false };
            write_raster(&self.out, &grid, s.crs(), &picture, each)?;
        }
        let mut out = Output::new();
        if self.source.json {
            out.json(&json!({
                "out": self.out, "cols": grid.cols, "rows": grid.rows, "step": grid.step, "shape": shape, "error_m": error,
            }))?;
            return out.end();
        }
        out.line(format!(
            "{}: {} x {} pixels of {} x {}, heights within {error:.3} m, {}",
            self.out.display(),
            grid.cols,
            grid.rows,
            grid.step[0],
            grid.step[1],
            size_of(&self.out)
        ))?;
        out.end()
    }
}
