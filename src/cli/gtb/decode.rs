//! `gtb decode`: a GTB file, or the beginning of one, as GeoTIFF, GLB or PNG.

use super::super::coded::{ending, no_format};
use super::super::export::write_whole;
use super::super::output::{Output, bytes, count, message};
use super::{Codec, at_most, bytes_of, metered, notes, short, unit_of};
use crate::base::{Error, Result};
use crate::export::Going;
use crate::export::gtb::{
    MeshRequest, MeshTold, Prefix, RasterTold, Reached, Until, read_prefix, write_mesh, write_picture,
    write_tif,
};
use clap::Args;
use serde::Serialize;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Write what a GTB file shows, or the beginning of one: .tif heights, .glb mesh, .png relief
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt gtb decode crater.gtb crater.tif\n  terraquilt gtb decode crater.gtb small.glb --bytes 20000\n  terraquilt gtb decode crater.gtb crater.png --error 5\n  head -c 5000 crater.gtb | terraquilt gtb decode - crater.png\n\nA file that is cut, or still growing, gives a whole surface without cracks from whatever is there; what it is worth is said\non stderr. Takes some 40 bytes of memory a post, and more for a picture and a mesh."
)]
pub struct Decode {
    /// GTB file; `-`: standard input
    file: PathBuf,
    /// File to write; its ending says the format
    out: PathBuf,
    /// Stop after so many bytes of the file
    #[arg(long, value_name = "N", conflicts_with = "error")]
    bytes: Option<u64>,
    /// Stop where no height is wrong by more than this, in the file's own units
    #[arg(long, value_name = "M")]
    error: Option<f64>,
    /// .glb: one strip instead of single triangles
    #[arg(long)]
    strips: bool,
    /// .glb: fewer triangles, at most this far from the surface; adds to its error
    #[arg(long, value_name = "M")]
    mesh_error: Option<f64>,
    /// Seed of the texture where it is made up
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

enum Form {
    Tif,
    Glb,
    Png,
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
    #[serde(flatten)]
    reached: &'a Reached,
    #[serde(flatten)]
    written: &'a Written,
    seconds: f64,
}

impl Decode {
    pub fn run(self) -> Result<bool> {
        let started = Instant::now();
        let form = self.form()?;
        let (name, found) = bytes_of(&self.file, Codec::Gtb, self.bytes)?;
        let until = match (self.bytes, self.error) {
            (Some(n), _) => Until::Bytes(n),
            (_, Some(e)) => Until::Error(e),
            _ => Until::End,
        };
        let mut written = None;
        let prefix = metered(|going| {
            let p =
                read_prefix(&name, &found, until, None, self.seed, &mut |share| going("decoding", share))?;
            write_whole(&self.out, |path| {
                let mut out = BufWriter::new(File::create(path).map_err(|e| Error::io(path, e))?);
                written = Some(self.write(&mut out, &form, &p, going)?);
                out.flush().map_err(|e| Error::io(path, e))
            })?;
            Ok(p)
        })?;
        let Some(written) = written else {
            return Err(Error::invalid(self.out.display(), "was not written"));
        };
        notes(&prefix.notes);
        self.tell(prefix, &written, started)
    }

    fn form(&self) -> Result<Form> {
        let ending = ending(&self.out);
        let form = match ending.as_str() {
            "tif" | "tiff" => Form::Tif,
            "glb" => Form::Glb,
            "png" => Form::Png,
            _ => return Err(no_format(&self.out, "name a .glb, .tif or .png file")),
        };
        if !matches!(form, Form::Glb) && (self.strips || self.mesh_error.is_some()) {
            let option = if self.strips { "--strips" } else { "--mesh-error" };
            return Err(Error::invalid(
                option,
                format!("is for .glb, the file to write ends in '.{ending}'"),
            ));
        }
        for (option, e) in [("--error", self.error), ("--mesh-error", self.mesh_error)] {
            if let Some(e) = e.filter(|e| !(e.is_finite() && *e >= 0.0)) {
                return Err(Error::invalid(option, format!("{e}; an error is a number of at least 0")));
            }
        }
        Ok(form)
    }

    fn write(&self, out: &mut BufWriter<File>, form: &Form, p: &Prefix, going: Going) -> Result<Written> {
        Ok(match form {
            Form::Tif => Written::Raster(write_tif(out, p, going)?),
            Form::Png => Written::Raster(write_picture(out, p, going)?),
            Form::Glb => {
                let request = MeshRequest { strips: self.strips, error: self.mesh_error.unwrap_or(0.0) };
                Written::Mesh(write_mesh(out, p, request, going)?)
            }
        })
    }

    fn tell(&self, p: Prefix, written: &Written, started: Instant) -> Result<bool> {
        let added = match written {
            Written::Mesh(m) => m.mesh_error,
            Written::Raster(r) => r.rounding,
        };
        let reached = Reached { error_bound: p.reached.error_bound + added, ..p.reached.clone() };
        let unit = unit_of(&p.header.place.vertical);
        let state = match (reached.complete, reached.damaged_at) {
            (true, _) => "complete".to_string(),
            (_, Some(at)) => {
                format!("not complete: the block at byte {at} of the body is damaged, fetch it again")
            }
            _ if self.error.is_some_and(|e| p.reached.error_bound <= e) => {
                "stopped at the error asked".to_string()
            }
            _ => "not complete: more bytes show more".to_string(),
        };
        message(&format!(
            "{} read: every {} post known, error at most {}{unit}; {state}",
            bytes(reached.bytes_used),
            ordinal(reached.spacing),
            at_most(reached.error_bound),
        ));
        if let Some(asked) = self.error.filter(|e| p.reached.error_bound > *e) {
            message(&format!(
                "note: what is there gives {}{unit}, {} was asked",
                at_most(p.reached.error_bound),
                short(asked)
            ));
        }
        let mut out = Output::new();
        if self.json {
            let seconds = started.elapsed().as_secs_f64();
            out.json(&Told { out: &self.out, reached: &reached, written, seconds })?;
            return out.end();
        }
        let text = match written {
            Written::Mesh(m) if m.triangles == 0 => {
                "no triangle: fewer than three posts have data".to_string()
            }
            Written::Mesh(m) => {
                let strip = m.strip_length.map_or(String::new(), |n| format!(" in a strip of {}", count(n)));
                format!("{} triangles{strip}, {} vertices", count(m.triangles), count(m.vertices))
            }
            Written::Raster(r) => format!("{} x {}, {}", r.cols, r.rows, r.samples),
        };
        let size = std::fs::metadata(&self.out).map_or(0, |m| m.len());
        out.line(format!(
            "{}: {text}, error {}{unit}, {}",
            self.out.display(),
            at_most(reached.error_bound),
            bytes(size)
        ))?;
        out.end()
    }
}

/// `single`, `2nd`, `4th`: posts along rows and columns.
fn ordinal(spacing: u64) -> String {
    match spacing {
        1 => "single".to_string(),
        2 => "2nd".to_string(),
        n => format!("{n}th"),
    }
}
