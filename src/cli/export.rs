//! `export`: the surface as GLB, GeoTIFF or PNG; a survey's own samples, bit for bit.

use super::args::{Region, Source, ToleranceArgs, numbers};
use super::mesh::{self, Packing};
use super::output::{Meter, Output, bytes, count, message, stop_flag};
use super::reader::Reader;
use crate::base::{Error, Result, limits};
use crate::export::{FileRequest, Form, Going, Written, write_samples, write_surface};
use clap::Args;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Write the surface of a region to a file: .glb mesh, .tif heights, .png relief
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt export hills hills.glb --error 2 --bbox 500000,4100000,502000,4102000\n  terraquilt export hills small.glb --error 2 --quantize\n  terraquilt export hills hills.tif --error 0 --step 10\n  terraquilt export hills hills.png --error 5\n  terraquilt export hills lidar.tif --survey lidar-2025      # as it was delivered, bit for bit"
)]
#[command(mut_arg("error", |a| a.required_unless_present_any(["eye", "error_raster", "focus", "survey"])))]
pub struct Export {
    /// Directory of the database
    db: PathBuf,
    /// File to write; its ending says the format
    out: PathBuf,
    /// Read this version instead of the latest
    #[arg(long, value_name = "VERSION")]
    at: Option<u64>,
    #[command(flatten)]
    region: Region,
    #[command(flatten)]
    tolerance: OptionalTolerance,
    /// A survey's own samples instead of the surface
    #[arg(long, value_name = "SURVEY")]
    survey: Option<String>,
    /// With --survey: this tile, by file name or key
    #[arg(long, value_name = "T", requires = "survey")]
    tile: Option<String>,
    /// .tif and .png: pixel size in units of the CRS, or of --coords (X or X,Y); without it a .tif is as fine as the finest
    /// survey there, its pixels on the posts of one that lies north-up
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
    #[command(flatten)]
    packing: Packing,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

/// Like [`ToleranceArgs`], but not needed with --survey.
#[derive(Args)]
struct OptionalTolerance {
    #[command(flatten)]
    inner: ToleranceArgs,
}

impl Export {
    pub fn run(self) -> Result<bool> {
        let source = Source { db: self.db.clone(), at: self.at, json: self.json };
        let Reader::Disk(_, s) = source.open()? else {
            return Err(Error::unsupported(
                "export",
                "a server writes no file yet",
                "run it where the database's files are",
            ));
        };
        let ending =
            self.out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        if let Some(name) = &self.survey {
            self.packing().only_for_glb(&ending)?;
            if Form::of_ending(&ending) != Some(Form::GeoTiff) {
                return Err(Error::invalid(
                    "--survey",
                    "a survey's samples are written as .tif; name such a file",
                ));
            }
            let t = &self.tolerance.inner;
            let asked =
                t.error.is_some() || t.eye.is_some() || t.error_raster.is_some() || !t.focus.is_empty();
            let region = self.region.bbox.is_some() || self.region.polygon.is_some();
            if asked || region || self.region.coords.coords.is_some() || self.step.is_some() {
                message(
                    "note: with --survey the samples are written as delivered; tolerance, region, --coords and --step are not used",
                );
            }
            let tile = self.tile.as_deref();
            let written = write_file(&self.out, |out, going| write_samples(out, &s, name, tile, going))?;
            return self.told(written, None);
        }
        let place = self.region.place(&*s)?;
        self.packing().only_for_glb(&ending)?;
        let form = Form::of_ending(&ending).ok_or_else(|| {
            Error::unsupported(
                self.out.display(),
                if ending.is_empty() {
                    "has no ending that names a format".to_string()
                } else {
                    format!("ending '.{ending}' is no format that is written")
                },
                "name a .glb, .tif or .png file",
            )
        })?;
        let query = self.tolerance.inner.query(&place, &*s, form.seams())?;
        let request = FileRequest {
            form,
            place,
            query,
            step: self.step()?,
            packing: self.packing(),
            pixels_max: limits::RASTER_POSTS_MAX,
        };
        let written = write_file(&self.out, |out, going| write_surface(out, &s, &request, going))?;
        self.told(written, Some(&request))
    }

    fn packing(&self) -> crate::export::Packing {
        crate::export::Packing { quantize: self.packing.quantize, meshopt: self.packing.meshopt }
    }

    fn step(&self) -> Result<Option<[f64; 2]>> {
        let Some(text) = &self.step else { return Ok(None) };
        let found = if text.contains(',') {
            numbers("--step", text)?
        } else {
            let [x] = numbers("--step", text)?;
            [x, x]
        };
        if found.iter().any(|v| *v <= 0.0) {
            return Err(Error::invalid("--step", format!("{found:?}; it must be positive")));
        }
        Ok(Some(found))
    }

    fn told(&self, written: Written, request: Option<&FileRequest>) -> Result<bool> {
        written
            .notes(request.map(|r| &r.query.tolerance))
            .iter()
            .for_each(|n| message(&format!("note: {n}")));
        let mut out = Output::new();
        if self.json {
            out.json(&Told { out: &self.out, written: &written })?;
            return out.end();
        }
        let size = std::fs::metadata(&self.out).map_or(0, |m| m.len());
        let text = match &written {
            Written::Mesh(m) => mesh::text(m),
            Written::Samples { posts, .. } => format!("{} posts as delivered", count(*posts)),
            Written::Raster { cols, rows, error_m, .. } => match request.map(|r| r.form) {
                Some(Form::Png) => format!("{cols} x {rows} pixels, coloured by patch size"),
                _ => format!("{cols} x {rows} posts, error {error_m:.3} m"),
            },
        };
        out.line(format!("{}: {text}, {}", self.out.display(), bytes(size)))?;
        out.end()
    }
}

/// What is said of a file as JSON.
#[derive(serde::Serialize)]
struct Told<'a> {
    out: &'a Path,
    #[serde(flatten)]
    written: &'a Written,
}

/// Writes a file as a whole, with a bar; Ctrl-C stops it.
pub fn write_file(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>, Going) -> Result<Written>,
) -> Result<Written> {
    let (meter, stop) = (Meter::new(), stop_flag());
    let mut written = None;
    let done = write_whole(path, |p| {
        let mut out = BufWriter::new(File::create(p).map_err(|e| Error::io(p, e))?);
        written = Some(write(&mut out, &|stage, share| {
            meter.report(stage, share);
            !stop.load(Ordering::Relaxed)
        })?);
        out.flush().map_err(|e| Error::io(p, e))
    });
    meter.clear();
    done?;
    written.ok_or_else(|| Error::invalid(path.display(), "was not written"))
}

/// Writes a file under a temporary name beside it and renames it: never half a file.
pub fn write_whole(path: &Path, write: impl FnOnce(&Path) -> Result<()>) -> Result<()> {
    let name = path.file_name().ok_or_else(|| Error::invalid(path.display(), "names no file"))?;
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|f| !f.is_dir()) {
        return Err(Error::missing(
            format!("folder {}", folder.display()),
            "make it first, or name another file",
        ));
    }
    let temporary = path.with_file_name(format!(".{}.{}.part", name.to_string_lossy(), std::process::id()));
    let done =
        write(&temporary).and_then(|()| std::fs::rename(&temporary, path).map_err(|e| Error::io(path, e)));
    if done.is_err() {
        let _ = std::fs::remove_file(&temporary);
    }
    done
}
