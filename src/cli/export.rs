//! `export`: the surface as GLB, GeoTIFF or PNG; a survey's own samples, bit for bit.

use super::args::{Region, Source, ToleranceArgs, numbers};
use super::mesh::{self, Packing};
use super::output::{Meter, Output, bytes, count, message, stop_flag};
use super::reader::Reader;
use super::remote::Remote;
use super::stream::StreamArgs;
use super::tile::{self, TileArgs};
use crate::base::{Error, Result, limits};
use crate::client;
use crate::db::query::Query;
use crate::export::{FileRequest, Form, Going, Place, Written, write_samples, write_surface};
use crate::height::surface::Seams;
use crate::wire::v1;
use clap::Args;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Write the surface of a region to a file: .glb mesh, .tif heights, .png relief, .gtb stream, .ifs fractal tile
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt export hills hills.glb --error 2 --bbox 500000,4100000,502000,4102000\n  terraquilt export hills small.glb --error 2 --quantize\n  terraquilt export hills hills.tif --error 0 --step 10\n  terraquilt export hills hills.png --error 5\n  terraquilt export hills hills.gtb --error 2      # a stream: whole after any byte, errors at posts certified\n  terraquilt export hills hills.ifs --error 2      # a fractal tile: maps, and a residual that keeps the bound\n  terraquilt export hills small.ifs --error 2 --maps 5000      # maps alone: their error is measured\n  terraquilt export hills lidar.tif --survey lidar-2025      # as it was delivered, bit for bit"
)]
#[command(mut_arg("error", |a| a.required_unless_present_any(["eye", "error_raster", "focus", "survey"])))]
pub struct Export {
    /// Directory of the database (or --server ADDR)
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
    /// .tif, .png, .gtb and .ifs: pixel size, or spacing of posts, in units of the CRS, or of --coords (X or X,Y); the posts of
    /// a .gtb or .ifs lie at whole multiples of it. Without it a .tif, .gtb or .ifs is as fine as the finest survey there, its
    /// pixels on the posts of one that lies north-up
    #[arg(long, value_name = "X[,Y]")]
    step: Option<String>,
    #[command(flatten)]
    packing: Packing,
    #[command(flatten)]
    stream: StreamArgs,
    #[command(flatten)]
    fractal: TileArgs,
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
        let reader = source.open()?;
        let ending =
            self.out.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
        self.packing().only_for_glb(&ending)?;
        let tile = self.fractal.choice(self.stream.bound, self.stream.unit);
        if ending == "gtb" && self.survey.is_none() {
            self.fractal.only_for_ifs(&ending)?;
            return self.stream(&reader);
        }
        let is_tile = ending == "ifs" && self.survey.is_none();
        self.stream.only_for_gtb(is_tile)?;
        self.fractal.only_for_ifs(if is_tile { "ifs" } else { &ending })?;
        if let Some(name) = &self.survey {
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
            let s = match &reader {
                Reader::Disk(_, s) => s,
                Reader::Server(r) => {
                    let (survey, tile) = (name.clone(), tile.unwrap_or_default().to_string());
                    let format = wire_format(Form::GeoTiff) as i32;
                    let request = v1::FileRequest { format, survey, tile, ..Default::default() };
                    return self.ask(r, Form::GeoTiff, request);
                }
            };
            let written = write_file(&self.out, |out, going| write_samples(out, s, name, tile, going))?;
            return self.told(written, None);
        }
        let form = Form::of_ending(&ending).ok_or_else(|| {
            Error::unsupported(
                self.out.display(),
                if ending.is_empty() {
                    "has no ending that names a format".to_string()
                } else {
                    format!("ending '.{ending}' is no format that is written")
                },
                "name a .glb, .tif, .png, .gtb or .ifs file",
            )
        })?;
        let ground = reader.ground()?;
        let place = self.region.place(ground)?;
        let query = self.tolerance.inner.query(&place, ground, form.seams())?;
        let s = match &reader {
            Reader::Disk(_, s) => s,
            Reader::Server(r) => {
                return self.ask(r, form, tile::asked(self.request(form, &place, &query)?, &tile));
            }
        };
        let request = FileRequest {
            form,
            place,
            query,
            step: self.step()?,
            packing: self.packing(),
            tile,
            pixels_max: limits::RASTER_POSTS_MAX,
            far_posts_max: limits::FRACTAL_FAR_POSTS_MAX,
        };
        let written = write_file(&self.out, |out, going| write_surface(out, s, &request, going))?;
        self.told(written, Some(&request))
    }

    /// The question as a server takes it.
    fn request(&self, form: Form, place: &Place, query: &Query) -> Result<v1::FileRequest> {
        let asked = Remote::asked(query)?;
        let [step_x, step_y] = self.step()?.unwrap_or_default();
        let coords = place.coords.as_ref().and(self.region.coords.coords.clone()).unwrap_or_default();
        let mut region = asked.region;
        // A box is given in the caller's coordinates; a polygon has come to the database's.
        let boxed = place.mask.is_none() && self.region.bbox.is_some();
        if let (true, Some([xmin, ymin, xmax, ymax])) = (boxed, place.bounds) {
            let b = v1::Box { xmin, ymin, xmax, ymax };
            region = Some(v1::Region { kind: Some(v1::region::Kind::Box(b)) });
        }
        Ok(v1::FileRequest {
            format: wire_format(form) as i32,
            region,
            tolerance: asked.tolerance,
            blend: asked.blend,
            seams: asked.seams,
            step_x,
            step_y,
            quantize: self.packing.quantize,
            meshopt: self.packing.meshopt,
            region_in_database_crs: place.mask.is_some(),
            coords,
            ..Default::default()
        })
    }

    /// Has a server write the file.
    fn ask(&self, r: &Remote, form: Form, request: v1::FileRequest) -> Result<bool> {
        let request = v1::FileRequest { at: r.version, ..request };
        let mut said = None;
        write_whole(&self.out, |p| {
            let mut out = BufWriter::new(File::create(p).map_err(|e| Error::io(p, e))?);
            let asked = client::export::file(&r.line.connection, request, &mut out);
            said = Some(r.line.wait(asked)?);
            out.flush().map_err(|e| Error::io(p, e))
        })?;
        let Some(end) = said else { return Ok(true) };
        end.notes.iter().for_each(|n| message(&format!("note: {n}")));
        let written: Written = r.line.read(end.json.as_bytes())?;
        self.print(&written, form, end.bytes)
    }

    /// The surface as a stream.
    fn stream(&self, reader: &Reader) -> Result<bool> {
        let ground = reader.ground()?;
        let place = self.region.place(ground)?;
        let query = self.tolerance.inner.query(&place, ground, Seams::Off)?;
        match reader {
            Reader::Disk(_, s) => self.stream.on_disk(
                s,
                (&self.out, self.json),
                self.stream.request(place, query, self.step()?)?,
            ),
            Reader::Server(r) => {
                let asked = self.request(Form::GeoTiff, &place, &query)?;
                let known = place.coords.map_or(Vec::new(), |c| c.notes);
                self.stream.on_server(r, (&self.out, self.json), (asked, known), self.at)
            }
        }
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
        let size = std::fs::metadata(&self.out).map_or(0, |m| m.len());
        self.print(&written, request.map_or(Form::GeoTiff, |r| r.form), size)
    }

    fn print(&self, written: &Written, form: Form, size: u64) -> Result<bool> {
        let mut out = Output::new();
        if self.json {
            out.json(&Told { out: &self.out, written })?;
            return out.end();
        }
        let text = match written {
            Written::Mesh(m) => mesh::text(m),
            Written::Tile(t) => tile::text(t),
            Written::Samples { posts, .. } => format!("{} posts as delivered", count(*posts)),
            Written::Raster { cols, rows, error_m, .. } => match form {
                Form::Png => format!("{cols} x {rows} pixels, coloured by patch size"),
                _ => format!("{cols} x {rows} posts, error {error_m:.3} m"),
            },
        };
        out.line(format!("{}: {text}, {}", self.out.display(), bytes(size)))?;
        out.end()
    }
}

/// What is said of a file as JSON.
#[derive(Serialize)]
struct Told<'a, T> {
    out: &'a Path,
    #[serde(flatten)]
    written: &'a T,
}

fn wire_format(form: Form) -> v1::file_request::Format {
    match form {
        Form::Glb => v1::file_request::Format::Glb,
        Form::GeoTiff => v1::file_request::Format::Geotiff,
        Form::Png => v1::file_request::Format::Png,
        Form::Ifs => v1::file_request::Format::Ifs,
    }
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
