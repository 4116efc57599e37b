//! `fractal decode`: a fractal tile as GeoTIFF, PNG, GLB or PLY, at any zoom.

use super::super::args::numbers;
use super::super::coded::{ending, no_format};
use super::super::export::write_whole;
use super::super::output::{Output, bytes, count, message};
use super::{Codec, bytes_of, error_of, errors_in, metered, notes};
use crate::base::{Error, Result};
use crate::export::Going;
use crate::export::fractal::{
    Detail, Opened, Progress, Shown, Solid, SolidTold, Worth, Zoom, gpu_built, kind_name, passes, plane,
    plane_on_gpu,
};
use crate::export::grid::{MeshRequest, MeshTold, RasterTold};
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use terraquilt_codecs::fractal::Kind;

/// Write what a fractal tile shows, at any zoom: .tif heights, .png picture or relief, .glb terrain or solid, .ply solid
///
/// Up to zoom 1 samples are those of the tile, or means of them, and their error is stated. Above it everything between samples is synthetic; the file
/// says so, and its error is unknown.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt fractal decode crater.ifs crater.tif\n  terraquilt fractal decode crater.ifs small.png --zoom 0.25\n  terraquilt fractal decode crater.ifs closer.tif --zoom 4                  # with made-up detail as rough as the ground\n  terraquilt fractal decode crater.ifs closer.tif --zoom 4 --detail none    # smooth\n  terraquilt fractal decode photo.ifs photo.png --milliseconds 5            # as far as it comes\n  terraquilt fractal decode bunny.ifs ear.glb --zoom 4 --window -0.09,0.14,-0.02,-0.06,0.19,0.02\n\nA file that is cut is decoded as far as it goes: what is missing is flat. Takes some 16 bytes of memory a sample, and four times that with detail."
)]
pub struct Decode {
    /// Fractal tile; `-`: standard input
    file: PathBuf,
    /// File to write; its ending says the format
    out: PathBuf,
    /// Samples of the result for one of the tile, along each axis: any number above 0, 0.25 or 2.5, too; last ones with their middle
    /// beyond the tile are left out
    #[arg(long, value_name = "Z", default_value_t = 1.0, allow_negative_numbers = true)]
    zoom: f64,
    /// Above zoom 1: what is between samples [default: controlled, at its best for tiles with a bound; plain of solids, and with --gpu]
    #[arg(long, value_enum)]
    detail: Option<DetailName>,
    /// Solids: only this box, in the coordinates of the mesh; closed where it cuts
    #[arg(long, value_name = "X0,Y0,Z0,X1,Y1,Z1", allow_hyphen_values = true)]
    window: Option<String>,
    /// Heights and pictures, zoom 1 and above: on the GPU, within 1e-4 of the range (needs a build with gpu)
    #[arg(long, conflicts_with_all = ["passes", "milliseconds"])]
    gpu: bool,
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
    Ply,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Written {
    Solid(SolidTold),
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
        let window = self.window.as_deref().map(|text| {
            let w: [f64; 6] = numbers("--window", text)?;
            Ok::<_, Error>([[w[0], w[1], w[2]], [w[3], w[4], w[5]]])
        });
        let window = window.transpose()?;
        let mut written = None;
        let (worth, progress) = metered(|going| {
            if o.kind() == Kind::Volume {
                let solid = Solid::of(&o, zoom, window, going)?;
                write_whole(&self.out, |path| {
                    let mut out = BufWriter::new(File::create(path).map_err(|e| Error::io(path, e))?);
                    match form {
                        Form::Ply => solid.write_ply(&mut out)?,
                        _ => solid.write_glb(&mut out)?,
                    }
                    out.flush().map_err(|e| Error::io(path, e))
                })?;
                let worth = if zoom.is_synthetic() { o.worth.unknown() } else { o.worth.clone() };
                written = Some(Written::Solid(solid.told));
                return Ok((worth, None));
            }
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
        let ending = ending(&self.out);
        let form = match ending.as_str() {
            "tif" | "tiff" => Form::Tif,
            "png" => Form::Png,
            "glb" => Form::Glb,
            "ply" => Form::Ply,
            _ => return Err(no_format(&self.out, "name a .tif, .png, .glb or .ply file")),
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
        let (what, forms, name): (_, &[Form], _) = match o.kind() {
            Kind::Heights => ("heights", &[Form::Tif, Form::Png, Form::Glb], "a .tif, .png or .glb file"),
            Kind::Grey | Kind::Colour => ("a picture", &[Form::Png], "a .png file"),
            Kind::Volume => ("a solid", &[Form::Glb, Form::Ply], "a .glb or .ply file"),
        };
        if !forms.contains(&form) {
            let found = format!("no such file is made of {what}, which the tile holds");
            return Err(Error::unsupported(self.out.display(), found, format!("name {name}")));
        }
        let solid = o.kind() == Kind::Volume;
        let option = if self.passes.is_some() { "--passes" } else { "--milliseconds" };
        let limited = self.passes.is_some() || self.milliseconds.is_some();
        let given = [
            (self.window.is_some() && !solid, "--window", "solids"),
            (self.gpu && solid, "--gpu", "heights and pictures"),
            (limited && solid, option, "heights and pictures"),
            (self.mesh_error.is_some() && solid, "--mesh-error", "heights"),
        ];
        if let Some((_, option, kinds)) = given.iter().find(|(wrong, ..)| *wrong) {
            return Err(Error::invalid(option, format!("is for {kinds}, the tile holds {what}")));
        }
        if limited && zoom.get() != 1.0 {
            return Err(Error::invalid(option, format!("is for zoom 1, --zoom {} was asked", zoom.get())));
        }
        if self.passes == Some(0) {
            return Err(Error::invalid("--passes", "0; at least 1 is needed"));
        }
        if self.gpu {
            gpu_built()?;
            if zoom.get() < 1.0 {
                return Err(Error::invalid("--gpu", "decodes at zoom 1 and above; leave it out below"));
            }
        }
        if (self.gpu || solid) && self.detail.is_some_and(|d| d != DetailName::Plain) {
            let who = if solid { "solids are" } else { "a GPU is" };
            return Err(Error::invalid("--detail", format!("{who} asked for what the maps say; take plain")));
        }
        Ok(())
    }

    fn detail(&self, kind: Kind) -> Detail {
        match self.detail {
            None if self.gpu || kind == Kind::Volume => Detail::Plain,
            None | Some(DetailName::Controlled) => Detail::Controlled,
            Some(DetailName::Plain) => Detail::Plain,
            Some(DetailName::None) => Detail::None,
        }
    }

    fn shown<'a>(&self, o: &'a Opened, zoom: Zoom, going: Going) -> Result<(Shown<'a>, Option<Progress>)> {
        let limited = self.passes.is_some() || self.milliseconds.is_some();
        let detail = self.detail(o.kind());
        if limited {
            let most = self.passes.map(|n| usize::try_from(n).unwrap_or(usize::MAX));
            let end = self.milliseconds.map(|t| Instant::now() + Duration::from_millis(t.min(1 << 40)));
            let mut in_time = || end.is_none_or(|end| Instant::now() < end);
            let (planes, p) = passes(o, most, &mut in_time, going)?;
            let worth = if p.finished { o.worth.clone() } else { o.worth.unknown() };
            return Ok((Shown { opened: o, planes, zoom, detail, worth, stopped: !p.finished }, Some(p)));
        }
        let one = |k| match self.gpu {
            true => plane_on_gpu(o, k, zoom),
            false => plane(o, k, zoom, detail, going),
        };
        let planes = (0..o.tile.planes.len()).map(one).collect::<Result<_>>()?;
        // A GPU's last digits are its own.
        let worth = if zoom.is_synthetic() || self.gpu { o.worth.unknown() } else { o.worth.clone() };
        Ok((Shown { opened: o, planes, zoom, detail, worth, stopped: false }, None))
    }

    fn write(&self, out: &mut BufWriter<File>, form: Form, shown: &Shown, going: Going) -> Result<Written> {
        let picture = matches!(shown.opened.kind(), Kind::Grey | Kind::Colour);
        Ok(match form {
            Form::Png if picture => Written::Raster(shown.write_picture(out)?),
            Form::Png => Written::Raster(shown.write_relief(out, going)?),
            Form::Tif => Written::Raster(shown.write_tif(out, going)?),
            Form::Glb | Form::Ply => {
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
            Written::Solid(_) => 0.0,
            Written::Mesh(m) => m.mesh_error,
            Written::Raster(r) => r.rounding,
        };
        let worth = Worth { error_max: worth.error_max.map(|e| e + added), ..worth.clone() };
        if zoom.is_synthetic() {
            let what = match self.detail(o.kind()) {
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
            let passes = if p.passes == 1 { "a pass".to_string() } else { format!("{} passes", p.passes) };
            message(&format!("note: stopped after {passes}{change}; the error is unknown"));
        }
        let mut out = Output::new();
        if self.json {
            out.json(&Told {
                out: &self.out,
                kind: kind_name(o.kind()),
                zoom: zoom.get(),
                synthetic: zoom.is_synthetic(),
                detail: zoom.is_synthetic().then(|| self.detail(o.kind()).name()),
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
            Written::Solid(s) if s.triangles == 0 => "no triangle: nothing of the solid is there".to_string(),
            Written::Solid(s) => {
                format!("{} triangles, {} vertices", count(s.triangles), count(s.vertices))
            }
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
