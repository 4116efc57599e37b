//! `fractal encode`: a DEM, a picture or a mesh as a fractal tile.

use super::super::args::numbers;
use super::super::export::write_whole;
use super::super::output::{Output, bytes, count, message};
use super::{Codec, at_most, metered, named, notes};
use crate::base::{Error, Result, limits};
use crate::export::fractal::{
    NEAR, Request, SentTold, Taken, VOXELS, search_of, send_heights, send_picture, send_solid,
};
use crate::export::grid::Grid;
use crate::format::picture::Picture;
use crate::format::{self, solid::read_solid};
use clap::{ArgGroup, Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;
use terraquilt_codecs::fractal::ifs::SIDE_MAX;
use terraquilt_codecs::fractal::{Options, Partition, Search};

/// Write a DEM, a picture or a mesh as a fractal tile: maps of the grid to itself
///
/// The grid is cut into squares, small ones where it is rough (ranges). A map says how each is a turned, mirrored, fainter copy of a square of twice its side
/// elsewhere in the grid (its domain). More maps: a better copy, a larger file.
///
/// How far to go is said by --maps, --const, --tolerance or --slope; --bound adds, for heights, what keeps every sample within E, and chooses the maps for the
/// smallest file if nothing else does.
#[derive(Args)]
#[command(
    group = ArgGroup::new("far").args(["maps", "const_side", "tolerance", "slope", "bound"]).multiple(true).required(true),
    after_help = "Examples:\n  terraquilt fractal encode crater.tif crater.ifs --bound 0.5       # no post farther off than half a metre\n  terraquilt fractal encode crater.tif crater.ifs --bound 0         # exact, to the unit\n  terraquilt fractal encode photo.png photo.ifs --maps 5000         # the best 5000 maps\n  terraquilt fractal encode photo.png photo.ifs --slope 20          # as many bits as pay\n  terraquilt fractal encode dem8bit.png dem.ifs --as heights --const 2\n  terraquilt fractal encode dem.tif dem.ifs --maps 9000 --interest 560000,5115000,561000,5116000,50\n  terraquilt fractal encode bunny.ply bunny.ifs --maps 5000 --voxels 128\n\nRead is every grid that `ingest` reads; GeoTIFF and PNG of 8 bits as pictures; PLY, GLB and glTF as meshes. Up to 16 million samples (a million if all domains are searched); some 200 bytes of memory a sample."
)]
pub struct Encode {
    /// DEM, picture or mesh
    file: PathBuf,
    /// File to write
    out: PathBuf,
    /// What the file is taken for [default: PNG of 8 bits: picture; PLY, GLB, glTF: mesh; all else: heights]
    #[arg(long = "as", value_enum, value_name = "KIND")]
    taken: Option<TakenName>,
    /// So many maps, where errors are greatest
    #[arg(long, value_name = "N", conflicts_with_all = ["const_side", "tolerance", "slope"])]
    maps: Option<u64>,
    /// All ranges of this side, a power of two up to 32; 1: every sample its own, 2: one map for four
    #[arg(long = "const", value_name = "R", conflicts_with_all = ["tolerance", "slope"])]
    const_side: Option<u64>,
    /// Ranges are split until the root mean square error of each is at most this, in the file's own units
    #[arg(long, value_name = "RMS", conflicts_with = "slope", allow_negative_numbers = true)]
    tolerance: Option<f64>,
    /// Best quality for the bits: a bit must take at least so much from the sum of squared errors, in squares of the file's own units
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    slope: Option<f64>,
    /// Heights: no post is farther from the file's than this, in the file's own units; 0 is exact to the unit
    #[arg(long, value_name = "E", allow_negative_numbers = true)]
    bound: Option<f64>,
    /// Which domains a range meets: all; those of like classes; those near it [default: all of up to 262144 samples, near ones of more]
    #[arg(long, value_enum, value_name = "KIND")]
    search: Option<SearchName>,
    /// Domains along an axis that count as near, 2 to 64 [default: 16 in the plane, 4 in space]
    #[arg(long, value_name = "W")]
    near: Option<u64>,
    /// Heights are integers of this unit [default: that of the file's integers; else the coarsest of 1, 0.1, 0.01 that loses
    /// nothing, else 0.01; finer where --bound needs it]
    #[arg(long, value_name = "U")]
    unit: Option<f64>,
    /// Side of the largest ranges, a power of two up to 32 [default: as large as the tile allows]
    #[arg(long, value_name = "R")]
    range_max: Option<u64>,
    /// Side of the smallest ranges, a power of two [default: 2, 1 in space]
    #[arg(long, value_name = "R")]
    range_min: Option<u64>,
    /// Distance of neighbouring domains, an even number
    #[arg(long, value_name = "N", default_value_t = 4)]
    jump: u64,
    /// Ways to turn and mirror a domain: 1 or 8 in the plane; 1, 16, 24 or 48 in space [default: 8, 1 in space]
    #[arg(long, value_name = "N")]
    isometries: Option<u64>,
    /// Step in which means are stored, in the file's own units
    #[arg(long, value_name = "STEP", allow_negative_numbers = true)]
    step: Option<f64>,
    /// Bits in which the contrast of a map is stored, 2 to 8 [default: 5, with --const 7]
    #[arg(long, value_name = "BITS", value_parser = clap::value_parser!(u32).range(2..=8))]
    scale_bits: Option<u32>,
    /// Colours: the two colour planes are so many times smaller along each axis: 1, 2 or 4
    #[arg(long, value_name = "N", default_value_t = 2)]
    chroma: u64,
    /// Errors within this box count WEIGHT times, at least 1; in the file's coordinates (pixels of a picture, downwards). May be repeated, the
    /// greatest holds
    #[arg(long, value_name = "XMIN,YMIN,XMAX,YMAX,WEIGHT", allow_hyphen_values = true)]
    interest: Vec<String>,
    /// Meshes: voxels along the longest side, 8 to 512 [default: 64]
    #[arg(long, value_name = "N")]
    voxels: Option<u64>,
    /// Heights: this sample value means no data
    #[arg(long, value_name = "V", allow_hyphen_values = true)]
    nodata: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum TakenName {
    Heights,
    Picture,
    Mesh,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum SearchName {
    Exact,
    Classes,
    Near,
}

#[derive(Serialize)]
struct Told<'a> {
    out: &'a Path,
    #[serde(flatten)]
    told: &'a SentTold,
    seconds: f64,
}

/// As the codec counts; what is too large is refused there.
fn size(v: u64) -> usize {
    usize::try_from(v).unwrap_or(usize::MAX)
}

impl Encode {
    pub fn run(self) -> Result<bool> {
        let started = Instant::now();
        named(&self.out, Codec::Fractal)?;
        let request = self.request()?;
        let by_file = Taken::of(&self.file)?;
        let taken = match self.taken {
            None => by_file,
            Some(TakenName::Heights) => Taken::Heights,
            Some(TakenName::Picture) => Taken::Picture,
            Some(TakenName::Mesh) => Taken::Mesh,
        };
        if self.voxels.is_some() && taken != Taken::Mesh {
            return Err(Error::invalid(
                "--voxels",
                format!("is for meshes; this file is taken for {}", taken.name()),
            ));
        }
        if self.taken.is_none() && taken == Taken::Picture {
            message("note: taken as a picture (8 bits a sample, no place); --as heights for a DEM");
        }
        let sent = metered(|going| {
            let sent = match taken {
                Taken::Heights => {
                    let mut source = format::open(&self.file)?;
                    if let Some(v) = self.nodata {
                        source.set_nodata(v);
                    }
                    notes(&source.info().notes);
                    let (side, most) = (SIDE_MAX as u64, limits::FRACTAL_POSTS_MAX);
                    let grid = Grid::read_within(source.as_mut(), side, most, going)?;
                    notes(&grid.notes);
                    send_heights(&grid, &request, going)?
                }
                Taken::Picture => {
                    self.only_heights("every pixel of a picture counts")?;
                    let mut picture = Picture::open(&self.file)?;
                    notes(&picture.info().notes);
                    send_picture(&mut picture, &request, going)?
                }
                Taken::Mesh => {
                    self.only_heights("every triangle of a mesh counts")?;
                    going("reading", 0.0);
                    let mesh = read_solid(&self.file)?;
                    let voxels = self.voxels.map_or(VOXELS, size);
                    send_solid(&mesh, &self.file.display().to_string(), voxels, &request, going)?
                }
            };
            write_whole(&self.out, |p| std::fs::write(p, &sent.bytes).map_err(|e| Error::io(p, e)))?;
            Ok(sent)
        })?;
        notes(&sent.notes);
        self.tell(&sent.told, started)
    }

    /// Refuses what says which samples are none.
    fn only_heights(&self, why: &str) -> Result<()> {
        match self.nodata {
            Some(_) => Err(Error::invalid("--nodata", format!("is for heights; {why}"))),
            None => Ok(()),
        }
    }

    fn request(&self) -> Result<Request> {
        for (option, v) in [
            ("--tolerance", self.tolerance),
            ("--slope", self.slope),
            ("--bound", self.bound),
            ("--step", self.step),
        ] {
            if let Some(v) = v.filter(|v| !(v.is_finite() && *v >= 0.0)) {
                return Err(Error::invalid(option, format!("{v}; a number of at least 0 is needed")));
            }
        }
        let partition = match (self.maps, self.const_side, self.tolerance, self.slope) {
            (Some(n), ..) => Some(Partition::Maps(size(n))),
            (_, Some(r), ..) => Some(Partition::Const(size(r))),
            (_, _, Some(t), _) => Some(Partition::Tolerance(t)),
            (.., Some(s)) => Some(Partition::Slope(s)),
            _ => None,
        };
        let search = match (self.search, self.near) {
            (Some(SearchName::Exact), _) => search_of("exact"),
            (Some(SearchName::Classes), _) => search_of("classes"),
            (Some(SearchName::Near), w) => Some(Search::Near(w.map_or(NEAR, size))),
            (None, _) => None,
        };
        let interest = self
            .interest
            .iter()
            .map(|text| {
                let b: [f64; 5] = numbers("--interest", text)?;
                if b[0] > b[2] || b[1] > b[3] || b[4] < 1.0 {
                    return Err(Error::invalid(
                        "--interest",
                        format!("'{text}'; give xmin,ymin,xmax,ymax with min below max, and a weight of at least 1"),
                    ));
                }
                Ok(b)
            })
            .collect::<Result<Vec<_>>>()?;
        let options = Options {
            partition,
            range_max: self.range_max.map(size),
            range_min: self.range_min.map(size),
            jump: size(self.jump),
            isometries: self.isometries.map(size),
            near: self.near.map(size),
            step: self.step,
            scale_bits: self.scale_bits,
            chroma: size(self.chroma),
            ..Options::default()
        };
        Ok(Request { options, search, bound: self.bound, unit: self.unit, interest })
    }

    fn tell(&self, t: &SentTold, started: Instant) -> Result<bool> {
        if let (None, Some(unit)) = (self.unit, t.unit) {
            message(&format!("note: heights are integers of {unit} (--unit takes another)"));
        }
        let mut out = Output::new();
        if self.json {
            out.json(&Told { out: &self.out, told: t, seconds: started.elapsed().as_secs_f64() })?;
            return out.end();
        }
        let size: Vec<String> = t.size.iter().map(usize::to_string).collect();
        let psnr = t.psnr_db.map_or("every unit the same".into(), |p| format!("{p:.2} dB"));
        let error = match t.error_bound {
            Some(b) => {
                format!("error at most {}, guaranteed ({} measured)", at_most(b), at_most(t.error_max))
            }
            None if t.voxel.is_some() => {
                format!("error at most {} eighths of a voxel, as measured", at_most(t.error_max))
            }
            None if t.kind != "heights" => {
                format!("error at most {} grey levels, as measured", at_most(t.error_max))
            }
            None => format!("error at most {}, as measured", at_most(t.error_max)),
        };
        out.line(format!(
            "{}: {} of {} in {}, {:.3} bits a sample, {} maps, {psnr}, {error}",
            self.out.display(),
            t.kind,
            size.join(" x "),
            bytes(t.bytes),
            t.bits_per_sample,
            count(t.maps),
        ))?;
        out.end()
    }
}
