//! One file: the surface of a region as a mesh, heights or a picture; a survey's own samples.

use super::fractal::{self, TileRequest, TileTold};
use super::mesh::{MeshFound, Packing, write_mesh};
use super::place::{Place, whereabouts};
use super::raster::Raster;
use super::{Going, go_on};
use crate::base::{Error, Result};
use crate::db::query::{Query, Tolerance};
use crate::db::{self, Delivered, Snapshot};
use crate::format::geotiff::{GeoTiffSpec, GeoTiffWriter};
use crate::format::relief::{Relief, write_relief};
use crate::height::crs::Crs;
use crate::height::source::{Affine, SampleType};
use crate::height::surface::Seams;
use serde::{Deserialize, Serialize};
use std::io::{Seek, Write};

/// How a file that is written is called in errors.
const OUT: &str = "the file to write";
/// Pixels along the longer side of a picture.
const PICTURE_SIDE: usize = 1600;

/// What is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// A mesh: binary glTF 2.0.
    Glb,
    /// Heights, float32.
    GeoTiff,
    /// A shaded relief, coloured by patch size.
    Png,
    /// A fractal tile of heights.
    Ifs,
}

impl Form {
    /// What an ending names.
    pub fn of_ending(ending: &str) -> Option<Form> {
        match ending {
            "glb" => Some(Form::Glb),
            "tif" | "tiff" => Some(Form::GeoTiff),
            "png" => Some(Form::Png),
            "ifs" => Some(Form::Ifs),
            _ => None,
        }
    }

    pub fn ending(self) -> &'static str {
        match self {
            Form::Glb => "glb",
            Form::GeoTiff => "tif",
            Form::Png => "png",
            Form::Ifs => "ifs",
        }
    }

    /// What is done where surveys disagree, unless it is said: what is looked at is bent, what is measured is not.
    pub fn seams(self) -> Seams {
        if matches!(self, Form::GeoTiff | Form::Ifs) { Seams::Off } else { Seams::All }
    }
}

/// A file of the surface.
pub struct FileRequest {
    pub form: Form,
    pub place: Place,
    pub query: Query,
    /// Pixel sizes, spacing of posts; `None`: as fine as the finest survey for GeoTIFF and tiles, 1600 pixels along the longer side for
    /// PNG.
    pub step: Option<[f64; 2]>,
    pub packing: Packing,
    pub tile: fractal::Choice,
    /// Pixels or posts that it may have.
    pub pixels_max: u64,
    /// Posts that a tile may have whose ranges meet domains far away.
    pub far_posts_max: u64,
}

/// What there is to say of a file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Written {
    Mesh(MeshFound),
    // Before what has fewer members: the first that fits is read.
    Tile(Box<TileTold>),
    Raster { cols: usize, rows: usize, error_m: f64, seams: String },
    Samples { posts: u64, masked_posts: u64 },
}

impl Written {
    /// What a person should know; `tolerance`: what was asked of the surface.
    pub fn notes(&self, tolerance: Option<&Tolerance>) -> Vec<String> {
        let mut out = Vec::new();
        match self {
            Written::Mesh(m) => {
                if let Some(Tolerance::Constant(asked)) = tolerance
                    && m.error_m > *asked
                {
                    out.push(format!(
                        "the surface alone has {:.3} m there ({}); with the mesh's {:.3} m that is more than the {asked} m asked",
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
                    out.push(format!(
                        "somewhere the surveys are less accurate than was asked{bent}: surface and mesh need {used:.2} times \
                         the tolerance there"
                    ));
                }
            }
            Written::Tile(t) => out = t.notes(tolerance),
            Written::Samples { masked_posts, .. } if *masked_posts > 0 => out.push(format!(
                "{masked_posts} posts were void by a mask in the delivered file; their samples are written as they were, the \
                 mask is not, so another program will take them for heights"
            )),
            _ => {}
        }
        out
    }
}

/// Writes the surface of a region.
///
/// # Errors
/// If nothing lies there; above the limits of meshes and rasters; [`Error::Stopped`] when told not to go on.
pub fn write_surface(
    out: &mut (impl Write + Seek),
    s: &Snapshot,
    r: &FileRequest,
    going: Going,
) -> Result<Written> {
    r.packing.only_for_glb(r.form.ending())?;
    r.tile.only_for_ifs(r.form.ending())?;
    if r.form == Form::Ifs {
        return ifs(out, s, r, going);
    }
    if s.select(&r.query)?.records.is_empty() {
        let reason = format!("holds no data; {}", whereabouts(s.crs(), s.bounds(), r.place.coords.as_ref()));
        return Err(Error::invalid("region", reason));
    }
    if r.form == Form::Glb {
        return Ok(Written::Mesh(write_mesh(out, s, &r.query, r.packing, going)?));
    }
    let raster = match (r.form, r.step) {
        (Form::GeoTiff, None) => Raster::as_fine_as_posts(s, &r.place)?,
        (_, step) => Raster::new(s, &r.place, step, PICTURE_SIDE)?,
    };
    let (cols, rows) = (raster.cols, raster.rows);
    let pixels = cols as u64 * rows as u64;
    if pixels > r.pixels_max {
        let what = "pixels (give a smaller --bbox or a larger --step)";
        return Err(Error::limit(what, r.pixels_max, pixels));
    }
    let error_m = match r.form {
        Form::GeoTiff => tif(out, s, &r.query, &raster, going)?,
        _ => png(out, s, &r.query, &raster, going)?,
    };
    Ok(Written::Raster { cols, rows, error_m, seams: r.query.how.seams.name().into() })
}

/// Writes a fractal tile.
fn ifs(out: &mut impl Write, s: &Snapshot, r: &FileRequest, going: Going) -> Result<Written> {
    let request = TileRequest {
        place: &r.place,
        query: &r.query,
        step: r.step,
        choice: &r.tile,
        posts_max: r.pixels_max,
        far_posts_max: r.far_posts_max,
    };
    let (bytes, told) = fractal::tile(s, &request, going)?;
    out.write_all(&bytes).map_err(|e| Error::io(OUT, e))?;
    Ok(Written::Tile(Box::new(told)))
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

fn tif(
    out: &mut (impl Write + Seek),
    s: &Snapshot,
    query: &Query,
    raster: &Raster,
    going: Going,
) -> Result<f64> {
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
    let mut any = false;
    let mut tiff = GeoTiffWriter::new(out, OUT.into(), spec)?;
    let error = raster.heights(s, query, going, |row, _, z| {
        let data: Vec<u8> = z.iter().flat_map(|v| v.to_le_bytes()).collect();
        any |= z.iter().any(|v| !v.is_nan());
        tiff.write_rows(row as u64, &data)
    })?;
    if !any {
        return Err(no_data());
    }
    tiff.finish().map(|_| error)
}

/// Writes a shaded relief coloured by patch size.
fn png(out: &mut dyn Write, s: &Snapshot, query: &Query, raster: &Raster, going: Going) -> Result<f64> {
    let mut z = Vec::with_capacity(raster.cols * raster.rows);
    let error = raster.heights(s, query, going, |_, _, band| {
        z.extend_from_slice(band);
        Ok(())
    })?;
    if z.iter().all(|v| v.is_nan()) {
        return Err(no_data());
    }
    let class = raster.patch_sizes(s, query, going)?;
    let relief = Relief {
        cols: raster.cols,
        rows: raster.rows,
        z: &z,
        cell_m: raster.cell_m(s),
        class: Some(&class),
        class_range: Some(class_range(&class)),
    };
    write_relief(out, &relief)?;
    Ok(error)
}

/// Writes a survey's tile as it was delivered, bit for bit, as GeoTIFF. `tile`: by file name or key, if there are several.
pub fn write_samples(
    out: &mut (impl Write + Seek),
    s: &Snapshot,
    name: &str,
    tile: Option<&str>,
    going: Going,
) -> Result<Written> {
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
    let mut tiff = GeoTiffWriter::new(out, OUT.into(), spec)?;
    let rows = raw.rows();
    raw.bands(|first, _, samples, valid| {
        go_on(going, "samples", first as f64 / rows as f64)?;
        for (v, sample) in valid.iter().zip(samples.chunks_exact(sample_type.bytes())) {
            let value = sample_type.value(sample);
            let says_so = !value.is_finite()
                || raw.tile.nodata.is_some_and(|n| n == value || (n as f32) as f64 == value);
            masked += u64::from(*v == 0 && !says_so);
        }
        tiff.write_rows(first as u64, samples)
    })?;
    tiff.finish()?;
    Ok(Written::Samples { posts: (raw.cols() * rows) as u64, masked_posts: masked })
}
