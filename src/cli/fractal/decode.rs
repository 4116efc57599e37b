//! `fractal decode`: a fractal tile as GeoTIFF, PNG or GLB, at any zoom.

use super::super::export::write_whole;
use super::super::output::{Output, bytes, count, message};
use super::{Codec, bytes_of, error_of, errors_in, metered, notes};
use crate::base::{Error, Result};
use crate::export::Going;
use crate::export::fractal::{Detail, Opened, Progress, Shown, Worth, Zoom, kind_name, passes, plane};
use crate::export::grid::{MeshRequest, MeshTold, RasterTold};
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use terraquilt_codecs::fractal::Kind;

/// Write what a fractal tile shows, at any zoom: .tif heights, .png picture or relief, .glb terrain
///
/// Up to zoom 1 samples are those of the tile, or means of them, and their error is stated. Above it everything between samples is synthetic; the file
/// says so, and its error is unknown.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt fractal decode crater.ifs crater.tif\n  terraquilt fractal decode crater.ifs small.png --zoom 0.25\n  terraquilt fractal decode crater.ifs closer.tif --zoom 4                  # with made-up detail as rough as the ground\n  terraquilt fractal decode crater.ifs closer.tif --zoom 4 --detail none    # smooth\n  terraquilt fractal decode photo.ifs photo.png --milliseconds 5            # as far as it comes\n\nA file that is cut is decoded as far as it goes: what is missing is flat. Takes some 16 bytes of memory a sample, and four times that with detail."
)]
pub struct Decode {
    /// Fractal tile; `-`: standard input
    file: PathBuf,
    /// File to write; its ending says the format
    out: PathBuf,
    /// Samples of the result for one of the tile, along each axis
    #[arg(long, value_name = "Z", default_value_t = 1.0)]
    zoom: f64,
    /// Above zoom 1: what is between samples
    #[arg(long, value_enum, default_value_t = DetailName::Controlled)]
    detail: DetailName,
    /// Stop after so many passes, the result as it is then
    #[arg(long, value_name = "N", conflicts_with = "milliseconds")]
    passes: Option<u64>,
    /// Stop after so much time, the result as it is then
    #[arg(long, value_name = "T")]
    milliseconds: Option<u64>,
    /// Terrain as .glb: fewer triangles, at most this far from the surface; adds to its error
    #[arg(long, value_name = "M")]
    mesh_error: Option<f64>,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum DetailName {
    /// Smooth, with the texture of the maps as strong as the tile's own roughness leads to expect
    Controlled,
    /// The maps as they are: blocky, and too rough on terrain
    Plain,
    /// Smooth, nothing made up
    None,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Form {
    Tif,
    Png,
    Glb,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Written {
    Mesh(MeshTold),
    Raster(RasterTold),
}

#[derive(Serialize)]
struct Told<'a> {
    out: &'a Path,
    kind: &'static str,
    zoom: f64,
    synthetic: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    detail: Option<&'static str>,
    #[serde(flatten)]
    worth: &'a Worth,
    bytes_used: u64,
    maps: u64,
    /// Whether no pass is missing.
    finished: bool,
    #[serde(skip_serializing_if = "Option::is_none")]
    passes: Option<usize>,
    /// Mean change by the last pass, in units of the tile.
    #[serde(skip_serializing_if = "Option::is_none")]
    change: Option<f64>,
    #[serde(flatten)]
    written: &'a Written,
    seconds: f64,
}

impl Decode {
    pub fn run(self) -> Result<bool> {
        let started = Instant::now();
        let zoom = Zoom::new(self.zoom)?;
        let form = self.form()?;
        let (name, found) = bytes_of(&self.file, Codec::Fractal, None)?;
        let o = metered(|_| Opened::read(&name, &found))?;
        self.check(&o, form, zoom)?;
        notes(&o.notes);
        let mut written = None;
        let (worth, progress) = metered(|going| {
            let (shown, progress) = self.shown(&o, zoom, going)?;
            write_whole(&self.out, |path| {
                let mut out = BufWriter::new(File::create(path).map_err(|e| Error::io(path, e))?);
                written = Some(self.write(&mut out, form, &shown, going)?);
                out.flush().map_err(|e| Error::io(path, e))
            })?;
            Ok((shown.worth, progress))
        })?;
        let Some(written) = written else {
            return Err(Error::invalid(self.out.display(), "was not written"));
        };
        self.tell(&o, zoom, &worth, progress, &written, started)
    }

    fn form(&self) -> Result<Form> {
        let ending =
            self.out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        let form = match ending.as_str() {
            "tif" | "tiff" => Form::Tif,
            "png" => Form::Png,
            "glb" => Form::Glb,
            other => {
                let found = match other {
                    "" => "has no ending that names a format".to_string(),
                    _ => format!("ending '.{other}' is no format that is written"),
                };
                return Err(Error::unsupported(self.out.display(), found, "name a .tif, .png or .glb file"));
            }
        };
        if let Some(e) = self.mesh_error {
            if form != Form::Glb {
                return Err(Error::invalid(
                    "--mesh-error",
                    format!("is for .glb, the file to write ends in '.{ending}'"),
                ));
            }
            if !(e.is_finite() && e >= 0.0) {
                return Err(Error::invalid(
                    "--mesh-error",
                    format!("{e}; an error is a number of at least 0"),
                ));
            }
        }
        Ok(form)
    }

    /// Refuses what does not go together.
    fn check(&self, o: &Opened, form: Form, zoom: Zoom) -> Result<()> {
        let picture = matches!(o.kind(), Kind::Grey | Kind::Colour);
        if picture && form != Form::Png {
            return Err(Error::unsupported(
                self.out.display(),
                "the tile holds a picture, which is written as .png",
                "name a .png file",
            ));
        }
        if o.kind() == Kind::Volume {
            return Err(Error::unsupported(
                self.file.display(),
                "the tile holds a solid, which this build does not draw",
                "ask it point by point: terraquilt fractal point",
            ));
        }
        let option = if self.passes.is_some() { "--passes" } else { "--milliseconds" };
        if (self.passes.is_some() || self.milliseconds.is_some()) && zoom.get() != 1.0 {
            return Err(Error::invalid(option, format!("is for zoom 1, --zoom {} was asked", zoom.get())));
        }
        if self.passes == Some(0) {
            return Err(Error::invalid("--passes", "0; at least 1 is needed"));
        }
        Ok(())
    }

    fn detail(&self) -> Detail {
        match self.detail {
            DetailName::Controlled => Detail::Controlled,
            DetailName::Plain => Detail::Plain,
            DetailName::None => Detail::None,
        }
    }

    fn shown<'a>(&self, o: &'a Opened, zoom: Zoom, going: Going) -> Result<(Shown<'a>, Option<Progress>)> {
        let limited = self.passes.is_some() || self.milliseconds.is_some();
        let detail = self.detail();
        if limited {
            let most = self.passes.map(|n| usize::try_from(n).unwrap_or(usize::MAX));
            let end = self.milliseconds.map(|t| Instant::now() + Duration::from_millis(t.min(1 << 40)));
            let mut in_time = || end.is_none_or(|end| Instant::now() < end);
            let (planes, p) = passes(o, most, &mut in_time, going)?;
            let worth = if p.finished { o.worth.clone() } else { o.worth.unknown() };
            return Ok((Shown { opened: o, planes, zoom, detail, worth }, Some(p)));
        }
        let planes =
            (0..o.tile.planes.len()).map(|k| plane(o, k, zoom, detail, going)).collect::<Result<_>>()?;
        let worth = if zoom.is_synthetic() { o.worth.unknown() } else { o.worth.clone() };
        Ok((Shown { opened: o, planes, zoom, detail, worth }, None))
    }

    fn write(&self, out: &mut BufWriter<File>, form: Form, shown: &Shown, going: Going) -> Result<Written> {
        let picture = matches!(shown.opened.kind(), Kind::Grey | Kind::Colour);
        Ok(match form {
            Form::Png if picture => Written::Raster(shown.write_picture(out)?),
            Form::Png => Written::Raster(shown.write_relief(out, going)?),
            Form::Tif => Written::Raster(shown.write_tif(out, going)?),
            Form::Glb => {
                let request = MeshRequest { strips: false, error: self.mesh_error.unwrap_or(0.0) };
                Written::Mesh(shown.write_terrain(out, request, going)?)
            }
        })
    }

    fn tell(
        &self,
        o: &Opened,
        zoom: Zoom,
        worth: &Worth,
        progress: Option<Progress>,
        written: &Written,
        started: Instant,
    ) -> Result<bool> {
        let added = match written {
            Written::Mesh(m) => m.mesh_error,
            Written::Raster(r) => r.rounding,
        };
        let worth = Worth { error_max: worth.error_max.map(|e| e + added), ..worth.clone() };
        if zoom.is_synthetic() {
            let what = match self.detail() {
                Detail::None => {
                    "between samples there is nothing measured; they are joined smoothly, the error there is unknown"
                }
                _ => {
                    "detail below the sample distance is synthetic: made up, not measured; its error is unknown"
                }
            };
            message(&format!("note: {what}"));
        }
        if let Some(p) = progress.filter(|p| !p.finished) {
            let change = p
                .change
                .map_or(String::new(), |c| format!(", the last changed samples by {c:.3} on average"));
            message(&format!("note: stopped after {} passes{change}; the error is unknown", p.passes));
        }
        let mut out = Output::new();
        if self.json {
            out.json(&Told {
                out: &self.out,
                kind: kind_name(o.kind()),
                zoom: zoom.get(),
                synthetic: zoom.is_synthetic(),
                detail: zoom.is_synthetic().then(|| self.detail().name()),
                worth: &worth,
                bytes_used: o.tile.bytes,
                maps: o.tile.maps() as u64,
                finished: progress.is_none_or(|p| p.finished),
                passes: progress.map(|p| p.passes),
                change: progress.and_then(|p| p.change),
                written,
                seconds: started.elapsed().as_secs_f64(),
            })?;
            return out.end();
        }
        let text = match written {
            Written::Mesh(m) if m.triangles == 0 => {
                "no triangle: fewer than three posts have data".to_string()
            }
            Written::Mesh(m) => format!("{} triangles, {} vertices", count(m.triangles), count(m.vertices)),
            Written::Raster(r) => format!("{} x {}, {}", r.cols, r.rows, r.samples),
        };
        let size = std::fs::metadata(&self.out).map_or(0, |m| m.len());
        out.line(format!(
            "{}: {text}, {}, {}",
            self.out.display(),
            error_of(&worth, &errors_in(o)),
            bytes(size)
        ))?;
        out.end()
    }
}
