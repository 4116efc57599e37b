//! `gtb encode`: a grid file, and perhaps a picture, as GTB.

use super::super::export::write_whole;
use super::super::output::{Output, bytes, count, message};
use super::{Codec, at_most, metered, named, notes, unit_of};
use crate::base::{Error, Result};
use crate::export::gtb::{Grid, Request, SentTold, send};
use crate::format::{self, picture::Picture};
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use terraquilt_codecs::gtb;

/// Write a grid file as GTB: what can be shown after any byte, and is exact (or within --bound) after the last
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt gtb encode crater.tif crater.gtb                       # bit for bit\n  terraquilt gtb encode crater.tif crater.gtb --bound 0.5            # within half a metre\n  terraquilt gtb encode crater.tif crater.gtb --layers 13,4,1,0      # coarse bounds first, everywhere\n  terraquilt gtb encode lidar.tif lidar.gtb --unit 0.001 --profile adaptive\n  terraquilt gtb encode dem.tif dem.gtb --image satellite.tif        # with its texture\n  terraquilt gtb encode dem.tif dem.gtb --profile sparse --posts 1   # one post in a hundred\n\nRead is every grid that `ingest` reads (GeoTIFF, HGT, DTED, Esri ASCII, ENVI, USGS DEM, greyscale PNG, and these zipped), up\nto 8193 posts a side; cut larger ones into tiles. Takes some 60 bytes of memory a post of the square of 2^n + 1 posts that\nholds the grid, and more for a picture."
)]
pub struct Encode {
    /// Grid file
    file: PathBuf,
    /// File to write
    out: PathBuf,
    /// No height is farther from the file's than this, in the file's own units: metres, counts of a picture [default: 0]
    #[arg(long, value_name = "E", conflicts_with = "layers")]
    bound: Option<f64>,
    /// Heights are integers of this unit [default: that of the file's integers; else the coarsest of 1, 0.1, 0.01 that loses
    /// nothing, else 0.01]
    #[arg(long, value_name = "U")]
    unit: Option<f64>,
    /// How heights are coded
    #[arg(long, value_enum, default_value_t = ProfileName::Cubic)]
    profile: ProfileName,
    /// Bounds of several layers, coarse to fine, in the units of --bound: first all within the first, then all within the next
    #[arg(long, value_name = "E,E,...", value_delimiter = ',')]
    layers: Vec<f64>,
    /// With --profile sparse: send this part of the posts, in percent, by the surplus rule, in place of what --bound needs
    #[arg(long, value_name = "PERCENT", conflicts_with_all = ["bound", "layers"])]
    posts: Option<f64>,
    /// A picture of the same ground (GeoTIFF or PNG, 8 bits, RGB or RGBA) that travels along as texture
    #[arg(long, value_name = "RGB")]
    image: Option<PathBuf>,
    /// With --image: cells of the texture along a side of the square, a power of two [default: about as fine as the picture,
    /// 2048 at most]
    #[arg(long, value_name = "N", requires = "image")]
    image_cells: Option<u64>,
    /// This sample value means: no data
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    nodata: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum ProfileName {
    /// Every post, fast: integers alone
    Cubic,
    /// Every post, some percent smaller, slower
    Adaptive,
    /// A part of the posts: the scheme as it was published
    Sparse,
}

#[derive(Serialize)]
struct Told<'a> {
    out: &'a Path,
    #[serde(flatten)]
    told: &'a SentTold,
    seconds: f64,
}

impl Encode {
    pub fn run(self) -> Result<bool> {
        let started = Instant::now();
        named(&self.out, Codec::Gtb)?;
        let profile = match self.profile {
            ProfileName::Cubic => gtb::Profile::Cubic,
            ProfileName::Adaptive => gtb::Profile::Adaptive,
            ProfileName::Sparse => gtb::Profile::Sparse,
        };
        let share = self.share()?;
        let cells_n = self.cells_n()?;
        let mut source = format::open(&self.file)?;
        if let Some(v) = self.nodata {
            source.set_nodata(v);
        }
        notes(&source.info().notes);
        let mut picture = self.image.as_deref().map(Picture::open).transpose()?;
        let bounds = match (&self.layers[..], self.bound) {
            ([], bound) => vec![bound.unwrap_or(0.0)],
            (layers, _) => layers.to_vec(),
        };
        let sent = metered(|going| {
            let grid = Grid::read(source.as_mut(), going)?;
            notes(&grid.notes);
            let request =
                Request { profile, unit: self.unit, bounds, share, picture: picture.as_mut(), cells_n };
            let sent = send(&grid, request, going)?;
            write_whole(&self.out, |p| std::fs::write(p, &sent.encoded.bytes).map_err(|e| Error::io(p, e)))?;
            Ok(sent)
        })?;
        notes(&sent.notes);
        let t = &sent.told;
        if self.unit.is_none() {
            message(&format!("note: heights are integers of {} (--unit takes another)", t.unit));
        }
        let mut out = Output::new();
        if self.json {
            out.json(&Told { out: &self.out, told: t, seconds: started.elapsed().as_secs_f64() })?;
            return out.end();
        }
        let place = gtb::Header::read(&sent.encoded.bytes).map(|(h, _)| h.place).unwrap_or_default();
        let texture = t.texture_side.map_or(String::new(), |n| format!(", texture of {n} x {n} cells"));
        let part = t.posts_sent.map_or(String::new(), |n| format!(", {} of them sent", count(n)));
        out.line(format!(
            "{}: {} posts{part} in {}, {:.3} bits a post, error {}{}{texture}",
            self.out.display(),
            count(t.samples),
            bytes(t.bytes),
            t.bits_per_sample,
            at_most(t.error_max),
            unit_of(&place.vertical),
        ))?;
        out.end()
    }

    fn share(&self) -> Result<Option<f64>> {
        let Some(percent) = self.posts else { return Ok(None) };
        if !matches!(self.profile, ProfileName::Sparse) {
            return Err(Error::invalid("--posts", "goes with --profile sparse; the others send every post"));
        }
        if !(0.0..=100.0).contains(&percent) {
            return Err(Error::invalid("--posts", format!("{percent}; a part is between 0 and 100 percent")));
        }
        Ok(Some(percent / 100.0))
    }

    fn cells_n(&self) -> Result<Option<u32>> {
        let Some(n) = self.image_cells else { return Ok(None) };
        if !n.is_power_of_two() || n > 8192 {
            return Err(Error::invalid("--image-cells", format!("{n}; a power of two up to 8192 is needed")));
        }
        Ok(Some(n.trailing_zeros()))
    }
}
