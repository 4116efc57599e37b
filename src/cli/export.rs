//! `export`: the surface as GLB, GeoTIFF or PNG; a survey's own samples, bit for bit.

use super::args::{Region, Source, ToleranceArgs, numbers};
use super::mesh::{Packing, packed_glb};
use super::output::{Meter, Output, bytes, count, message};
use super::place::{Place, whereabouts};
use super::reader::Reader;
use super::shading::Raster;
use crate::base::{Error, Result};
use crate::db::Delivered;
use crate::db::query::Query;
use crate::db::{self, Snapshot};
use crate::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use crate::format::relief::{Relief, write_relief};
use crate::height::crs::Crs;
use crate::height::source::{Affine, SampleType};
use crate::height::surface::Seams;
use clap::Args;
use serde_json::json;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

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

/// Pixels along the longer side of a picture.
const PICTURE_SIDE: usize = 1600;

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
            self.packing.only_for_glb(&ending)?;
            if ending != "tif" && ending != "tiff" {
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
            let (posts, masked) = survey(&s, name, self.tile.as_deref(), &self.out)?;
            if masked > 0 {
                message(&format!(
                    "note: {} posts were void by a mask in the delivered file; their samples are written as they were, the \
                     mask is not, so another program will take them for heights",
                    count(masked)
                ));
            }
            return self.told(
                &json!({"out": self.out, "posts": posts, "masked_posts": masked}),
                &format!("{} posts as delivered", count(posts)),
            );
        }
        let place = self.region.place(&*s)?;
        self.packing.only_for_glb(&ending)?;
        let looked_at = ending == "glb" || ending == "png";
        let seams = if looked_at { Seams::All } else { Seams::Off };
        let query = self.tolerance.inner.query(&place, &*s, seams)?;
        if s.select(&query)?.records.is_empty() {
            let reason =
                format!("holds no data; {}", whereabouts(s.crs(), s.bounds(), place.coords.as_ref()));
            return Err(Error::invalid("region", reason));
        }
        self.write(&s, &place, &query, &ending)
    }

    fn write(&self, s: &Snapshot, place: &Place, query: &Query, ending: &str) -> Result<bool> {
        match ending {
            "glb" => {
                let m = packed_glb(s, query, &self.out, self.packing)?;
                let text = m.text();
                if let crate::db::query::Tolerance::Constant(asked) = query.tolerance
                    && m.error_m > asked
                {
                    message(&format!(
                        "note: the surface alone has {:.3} m there ({}); with the mesh's {:.3} m that is more than the {asked} m asked",
                        m.surface_error_m,
                        if m.correction_m > 0.0 {
                            "the accuracy of its surveys, and what is bent where they disagree: --seams off keeps them apart"
                        } else {
                            "the accuracy of its surveys"
                        },
                        m.mesh_error_m
                    ));
                }
                if let Some(used) = m.tolerance_used.filter(|u| *u > 1.0) {
                    let bent = if m.correction_m > 0.0 {
                        ", or are bent where they disagree (--seams off keeps them apart)"
                    } else {
                        ""
                    };
                    message(&format!(
                        "note: somewhere the surveys are less accurate than was asked{bent}: surface and mesh need {used:.2} times \
                         the tolerance there"
                    ));
                }
                self.told(&m, &text)
            }
            "tif" | "tiff" => {
                let raster = match self.step()? {
                    None => Raster::as_fine_as_posts(s, place)?,
                    step => Raster::new(s, place, step, PICTURE_SIDE)?,
                };
                let error = tif(s, query, &raster, &self.out)?;
                self.told(
                    &json!({"out": self.out, "cols": raster.cols, "rows": raster.rows, "error_m": error, "seams": query.how.seams.name()}),
                    &format!("{} x {} posts, error {error:.3} m", raster.cols, raster.rows),
                )
            }
            "png" => {
                let raster = Raster::new(s, place, self.step()?, PICTURE_SIDE)?;
                let error = png(s, query, &raster, &self.out)?;
                self.told(
                    &json!({"out": self.out, "cols": raster.cols, "rows": raster.rows, "error_m": error, "seams": query.how.seams.name()}),
                    &format!("{} x {} pixels, coloured by patch size", raster.cols, raster.rows),
                )
            }
            other => Err(Error::unsupported(
                self.out.display(),
                if other.is_empty() {
                    "has no ending that names a format".to_string()
                } else {
                    format!("ending '.{other}' is no format that is written")
                },
                "name a .glb, .tif or .png file",
            )),
        }
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

    fn told(&self, value: &impl serde::Serialize, text: &str) -> Result<bool> {
        let mut out = Output::new();
        if self.json {
            out.json(value)?;
        } else {
            let size = std::fs::metadata(&self.out).map_or(0, |m| m.len());
            out.line(format!("{}: {text}, {}", self.out.display(), bytes(size)))?;
        }
        out.end()
    }
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

pub(super) fn create(path: &Path) -> Result<BufWriter<File>> {
    Ok(BufWriter::new(File::create(path).map_err(|e| Error::io(path, e))?))
}

/// The patch sizes drawn red and blue (log2 of metres): those in the picture, at least four octaves apart, so that sizes
/// that hardly differ are not drawn as if they did.
fn class_range(class: &[f32]) -> [f32; 2] {
    let found = class.iter().filter(|c| !c.is_nan());
    let (lo, hi) = found.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), c| (a.min(*c), b.max(*c)));
    if !lo.is_finite() {
        return [0.0, 4.0];
    }
    let (middle, half) = ((lo + hi) / 2.0, ((hi - lo) / 2.0).max(2.0));
    [middle - half, middle + half]
}

fn no_data() -> Error {
    Error::invalid("region", "holds no data; `terraquilt surveys` shows where the surveys are")
}

fn tif(s: &Snapshot, query: &Query, raster: &Raster, path: &Path) -> Result<f64> {
    let [sx, sy] = raster.step();
    let spec = GeoTiffSpec {
        cols: raster.cols as u64,
        rows: raster.rows as u64,
        sample_type: SampleType::F32,
        affine: Some(Affine { origin: raster.center(0, 0), col_step: [sx, 0.0], row_step: [0.0, -sy] }),
        crs: Some(raster.crs(s).clone()),
        nodata: Some("nan".into()),
        scale: 1.0,
        offset: 0.0,
        vertical_datum: db::vertical_datum(s)?,
    };
    let mut error = 0.0;
    let meter = Meter::new();
    write_whole(path, |p| {
        let mut out = GeoTiffWriter::create(p, spec)?;
        let mut any = false;
        error = raster.heights(s, query, |row, _, z| {
            meter.report("heights", row as f64 / raster.rows as f64);
            let data: Vec<u8> = z.iter().flat_map(|v| v.to_le_bytes()).collect();
            any |= z.iter().any(|v| !v.is_nan());
            out.write_rows(row as u64, &data)
        })?;
        if !any {
            return Err(no_data());
        }
        out.finish().map(|_| ())
    })?;
    meter.clear();
    Ok(error)
}

/// Writes a shaded relief coloured by patch size.
pub fn png(s: &Snapshot, query: &Query, raster: &Raster, path: &Path) -> Result<f64> {
    let mut z = Vec::with_capacity(raster.cols * raster.rows);
    let meter = Meter::new();
    let error = raster.heights(s, query, |row, _, band| {
        meter.report("heights", row as f64 / raster.rows as f64);
        z.extend_from_slice(band);
        Ok(())
    })?;
    if z.iter().all(|v| v.is_nan()) {
        return Err(no_data());
    }
    let class = raster.patch_sizes(s, query)?;
    let range = class_range(&class);
    meter.clear();
    write_whole(path, |p| {
        let mut out = create(p)?;
        let relief = Relief {
            cols: raster.cols,
            rows: raster.rows,
            z: &z,
            cell_m: raster.cell_m(s),
            class: Some(&class),
            class_range: Some(range),
        };
        write_relief(&mut out, &relief)?;
        out.flush().map_err(|e| Error::io(p, e))
    })?;
    Ok(error)
}

/// A survey's tile, as it was delivered. Returns its posts, and how many were void only by a mask.
fn survey(s: &Snapshot, name: &str, tile: Option<&str>, path: &Path) -> Result<(u64, u64)> {
    let entry = s.survey(name)?;
    let head = s.head(entry.number)?;
    let index = match tile {
        Some(t) => head
            .tiles
            .iter()
            .position(|x| x.file == t || (t.len() >= 4 && x.id().starts_with(t)))
            .ok_or_else(|| {
                Error::missing(format!("tile '{t}' of survey '{name}'"), "see `terraquilt tiles`")
            })?,
        None if head.tiles.len() == 1 => 0,
        None => {
            return Err(Error::invalid(
                "--tile",
                format!(
                    "survey '{name}' has {} tiles; say which with --tile (see `terraquilt tiles`)",
                    head.tiles.len()
                ),
            ));
        }
    };
    let raw = db::read_tile(s, entry.number, index)?;
    let nodata = raw.tile.nodata.map(|v| if v.is_nan() { "nan".to_string() } else { format!("{v}") });
    let Delivered { sample_type, scale, offset } = raw.declaration.delivered();
    let spec = GeoTiffSpec {
        cols: raw.cols() as u64,
        rows: raw.rows() as u64,
        sample_type,
        affine: Some(raw.tile.affine),
        crs: Some(Crs::parse(raw.declaration.delivered_crs())?),
        nodata,
        scale,
        offset,
        vertical_datum: raw.declaration.vertical_datum.clone(),
    };
    let mut masked = 0;
    write_whole(path, |p| {
        let mut out = GeoTiffWriter::create(p, spec)?;
        raw.bands(|first, _, samples, valid| {
            for (v, sample) in valid.iter().zip(samples.chunks_exact(sample_type.bytes())) {
                let value = sample_type.value(sample);
                let says_so = !value.is_finite()
                    || raw.tile.nodata.is_some_and(|n| n == value || (n as f32) as f64 == value);
                masked += u64::from(*v == 0 && !says_so);
            }
            out.write_rows(first as u64, samples)
        })?;
        out.finish().map(|_| ())
    })?;
    Ok(((raw.cols() * raw.rows()) as u64, masked))
}
