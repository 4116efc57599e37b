//! `export` of .gtb: the surface as a progressive stream, from a directory or a server.

use super::args::listed;
use super::coded::at_most;
use super::export::write_whole;
use super::output::{Meter, Output, bytes, count, message, stop_flag};
use super::remote::Remote;
use crate::base::{Error, Result, limits};
use crate::client::stream::Terrain;
use crate::db::Snapshot;
use crate::db::query::Query;
use crate::export::{Choice, Place, StreamRequest, Told, stream, version_of};
use crate::format::picture::Picture;
use crate::wire::v1;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;
use terraquilt_codecs::gtb::{Header, Profile};

/// How the heights of a .gtb are coded.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ProfileKind {
    Cubic,
    Adaptive,
}

/// What a .gtb is made with.
#[derive(Args)]
pub struct StreamArgs {
    /// .gtb: cubic: fast; adaptive: smaller, slower on both sides. Default: cubic
    #[arg(long, value_enum)]
    profile: Option<ProfileKind>,
    /// .gtb: bounds of layers in metres, coarse to fine; the last is the codec's bound. Where they do not refine each other
    /// (2E + 1 must divide, in units) the nearest that do are taken
    #[arg(long, value_name = "A,B,C", conflicts_with = "bound")]
    layers: Option<String>,
    /// .gtb and .ifs: the codec's bound in metres; the surface gets the rest of --error. Without it the surface is asked for half
    /// of --error, and the codec takes what is left; with other tolerances it takes the least error of the surface there
    #[arg(long, value_name = "M")]
    pub bound: Option<f64>,
    /// .gtb and .ifs: metres of a unit. Without it a power of ten, a tenth of the codec's bound at most, and a millimetre at least
    #[arg(long, value_name = "U")]
    pub unit: Option<f64>,
    /// .gtb of a directory: a picture of the ground (GeoTIFF or PNG) that travels along as texture
    #[arg(long, value_name = "FILE")]
    image: Option<PathBuf>,
    /// .gtb from a server: go on with OUT, the beginning of the same stream, of the version that it names
    #[arg(long)]
    resume: bool,
}

/// What is said of a stream as JSON.
#[derive(Serialize)]
struct Said<'a> {
    out: &'a Path,
    #[serde(flatten)]
    told: &'a Told,
}

/// Where it is written, and whether JSON is printed.
type To<'a> = (&'a PathBuf, bool);

impl StreamArgs {
    /// # Errors
    /// If one of them is given for a file of another kind; bound and unit are a fractal tile's (`is_tile`) too.
    pub fn only_for_gtb(&self, is_tile: bool) -> Result<()> {
        let given = [
            ("--profile", self.profile.is_some(), ".gtb"),
            ("--layers", self.layers.is_some(), ".gtb"),
            ("--bound", self.bound.is_some() && !is_tile, ".gtb and .ifs"),
            ("--unit", self.unit.is_some() && !is_tile, ".gtb and .ifs"),
            ("--image", self.image.is_some(), ".gtb"),
            ("--resume", self.resume, ".gtb"),
        ];
        match given.iter().find(|(_, given, _)| *given) {
            Some((name, _, kinds)) => {
                Err(Error::invalid(name, format!("is for {kinds} files; name such a file, or leave it out")))
            }
            None => Ok(()),
        }
    }

    fn choice(&self) -> Result<Choice> {
        let layers = self.layers.as_deref().map_or(Ok(Vec::new()), |t| listed("--layers", t))?;
        Ok(Choice { bound: self.bound, layers, unit: self.unit })
    }

    /// The request to a database in a directory.
    pub fn request(&self, place: Place, query: Query, step: Option<[f64; 2]>) -> Result<StreamRequest> {
        let profile = match self.profile {
            Some(ProfileKind::Adaptive) => Profile::Adaptive,
            _ => Profile::Cubic,
        };
        Ok(StreamRequest {
            place,
            query,
            step,
            profile,
            choice: self.choice()?,
            side_max: limits::LATTICE_SIDE_MAX,
        })
    }

    /// Writes a stream of a database in a directory, with a bar; Ctrl-C stops it.
    pub fn on_disk(&self, s: &Snapshot, to: To, request: StreamRequest) -> Result<bool> {
        if self.resume {
            let reason = "is for streams from a server; of a directory it is made as a whole";
            return Err(Error::invalid("--resume", reason));
        }
        let mut picture = self.image.as_deref().map(Picture::open).transpose()?;
        let (meter, stop) = (Meter::new(), stop_flag());
        let made = stream(s, &request, None, picture.as_mut(), &|stage, share| {
            meter.report(stage, share);
            !stop.load(Ordering::Relaxed)
        });
        meter.clear();
        let made = made?;
        write_whole(to.0, |p| std::fs::write(p, &made.bytes).map_err(|e| Error::io(p, e)))?;
        print(to, &made.told, &made.notes)
    }

    /// Fetches a stream. What came is kept if it breaks off: it is a surface, and can be gone on with. `known`: what
    /// the person was told already; `at`: the version that was named.
    pub fn on_server(
        &self,
        r: &Remote,
        to: To,
        (asked, known): (v1::FileRequest, Vec<String>),
        at: Option<u64>,
    ) -> Result<bool> {
        if self.image.is_some() {
            let reason =
                "goes with a database in a directory: a server has no pictures, and its stream is made there";
            return Err(Error::invalid("--image", reason));
        }
        let choice = self.choice()?;
        let begun = if self.resume { begun(to.0)? } else { Vec::new() };
        let named =
            Header::read(&begun).ok().and_then(|(h, _)| version_of(&h.place)).filter(|_| at.is_none());
        let request = v1::SurfaceRequest {
            region: asked.region,
            tolerance: asked.tolerance,
            blend: asked.blend,
            seams: asked.seams,
            at: named.unwrap_or(r.version),
            step_x: asked.step_x,
            step_y: asked.step_y,
            profile: match self.profile {
                Some(ProfileKind::Adaptive) => v1::surface_request::Profile::Adaptive,
                _ => v1::surface_request::Profile::Cubic,
            } as i32,
            bound_m: choice.bound,
            layers_m: choice.layers,
            unit_m: choice.unit.unwrap_or(0.0),
            coords: asked.coords,
            region_in_database_crs: asked.region_in_database_crs,
            ..Default::default()
        };
        let here = begun.len();
        let mut terrain = Terrain::begun(request, begun);
        let meter = Meter::new();
        let fetched = r.line.wait(terrain.fetch(&r.line.connection, None, |t| {
            let whole = t.head.as_ref().map_or(1, |h| h.bytes.max(1));
            meter.report("stream", t.bytes.len() as f64 / whole as f64);
            Ok(())
        }));
        meter.clear();
        if let Err(e) = fetched {
            self.keep(&terrain, here, to.0)?;
            return Err(e);
        }
        write_whole(to.0, |p| std::fs::write(p, &terrain.bytes).map_err(|e| Error::io(p, e)))?;
        let mut head = terrain.head.unwrap_or_default();
        head.notes.retain(|n| !known.contains(n));
        if here > 0 && head.from > 0 {
            message(&format!("note: {} bytes were there, {} were fetched", here, head.bytes - head.from));
        }
        print(to, &r.line.read(head.json.as_bytes())?, &head.notes)
    }

    /// Keeps what came of a stream that broke off, unless a file lies there that is no beginning of it.
    fn keep(&self, terrain: &Terrain, here: usize, out: &Path) -> Result<()> {
        let came = terrain.bytes.len();
        if came <= here || !terrain.is_begun() || (out.exists() && !self.resume) {
            return Ok(());
        }
        write_whole(out, |p| std::fs::write(p, &terrain.bytes).map_err(|e| Error::io(p, e)))?;
        let whole = terrain.head.as_ref().map_or(0, |h| h.bytes);
        message(&format!(
            "note: {} holds the first {came} of {whole} bytes, a whole surface, less exact; the same command with --resume goes on",
            out.display()
        ));
        Ok(())
    }
}

/// The beginning of a stream; empty if there is no such file.
fn begun(path: &Path) -> Result<Vec<u8>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(bytes),
        Err(e) if e.kind() == std::io::ErrorKind::NotFound => Ok(Vec::new()),
        Err(e) => Err(Error::io(path, e)),
    }
}

fn print((out, json): To, told: &Told, notes: &[String]) -> Result<bool> {
    notes.iter().for_each(|n| message(&format!("note: {n}")));
    let mut o = Output::new();
    if json {
        o.json(&Said { out, told })?;
        return o.end();
    }
    o.line(format!(
        "{}: {} x {} posts on {}, error at posts {} m (surface {:.3}, rounding {}, codec {:.3}), {:.2} bits a post, {}",
        out.display(),
        count(told.cols as u64),
        count(told.rows as u64),
        told.posts,
        at_most(told.error_m),
        told.surface_error_m,
        told.rounding_m,
        told.codec_error_m,
        told.bits_per_sample,
        bytes(told.bytes)
    ))?;
    o.end()
}
