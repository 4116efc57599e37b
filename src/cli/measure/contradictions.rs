//! Surveys that say different things of the same ground.

use super::{PICTURE_SIDE, Picture, common, ending, no_format, size_of, write_picture};
use crate::analysis::dissolve;
use crate::base::{Error, Result, limits};
use crate::cli::args::Source;
use crate::cli::export::write_whole;
use crate::cli::ingest::{contradiction, signed};
use crate::cli::output::{Output, message};
use crate::cli::reader::Reader;
use crate::db::{Contradiction, Overlap, Snapshot};
use crate::format::colour_map::Ramp;
use crate::format::geojson::{FeatureWriter, Shape};
use clap::Args;
use serde_json::{Map, json};
use std::path::{Path, PathBuf};

/// Where surveys differ by more than their stated accuracies allow
///
/// Every two surveys that overlap are compared at the centres of the cells of the coarser one, bilinear between valid posts;
/// of more than 4 million cells some are taken evenly. A difference beyond the sum of both accuracies means that one of
/// them is false, or that the ground has changed. A mean far from 0 suggests another vertical datum or unit.
#[derive(Args)]
#[command(
    after_help = "Examples:\n  terraquilt contradictions hills\n  terraquilt contradictions hills where.png --surveys lidar-2020,lidar-2025\n  terraquilt contradictions hills where.geojson"
)]
pub struct Contradictions {
    #[command(flatten)]
    source: Source,
    /// Also write where: .png (blue: the finer survey is lower, red: higher, pale: they agree) or .geojson (polygons)
    out: Option<PathBuf>,
    /// Only these two
    #[arg(long, value_name = "A,B")]
    surveys: Option<String>,
}

/// Pairs drawn into one picture.
const PAIRS_MAX: usize = 64;

impl Contradictions {
    pub fn run(self) -> Result<bool> {
        let r = self.source.open()?;
        let names: Option<Vec<&str>> = self.surveys.as_ref().map(|t| t.split(',').map(str::trim).collect());
        let named = match names.as_deref() {
            None => None,
            Some([a, b]) if a != b => Some([*a, *b]),
            Some(_) => return Err(Error::invalid("--surveys", "name two surveys: --surveys A,B")),
        };
        let found = match (&self.out, &r) {
            (None, _) => r.contradictions(named)?,
            (Some(path), Reader::Disk(_, s)) => drawn(s, named, path)?,
            (Some(path), Reader::Server(there)) => {
                return Err(Error::unsupported(
                    &there.line.connection.server,
                    format!(
                        "{} needs every cell of both surveys, which a server does not send",
                        path.display()
                    ),
                    "leave the file out, or run the command where the database's files are",
                ));
            }
        };
        let mut out = Output::new();
        if self.source.json {
            out.json(&found)?;
            return out.end();
        }
        for c in &found {
            if c.contradicted_cells > 0 {
                out.line(contradiction(c))?;
            } else {
                out.line(format!(
                    "'{}' and '{}' agree within {} m on all of {:.3} km2: mean {} m, std {:.2} m",
                    c.finer,
                    c.coarser,
                    crate::base::round::significant(c.allowed_m, 6),
                    c.overlap_m2 / 1e6,
                    signed(c.mean_m),
                    c.std_m
                ))?;
            }
        }
        if found.is_empty() {
            out.line("no two surveys share ground")?;
        }
        if let Some(p) = self.out.filter(|p| p.exists()) {
            out.line(format!("{}: {}", p.display(), size_of(&p)))?;
        }
        out.end()
    }
}

/// Compares, and writes where surveys differ.
fn drawn(s: &Snapshot, named: Option<[&str; 2]>, path: &Path) -> Result<Vec<Contradiction>> {
    let mut found = Vec::new();
    match ending(path).as_str() {
        "geojson" | "json" => {
            write_whole(path, |p| {
                let mut out = FeatureWriter::new(super::create(p)?, s.crs(), Map::new())?;
                let mut vertices = 0;
                s.contradictions(named, |o| {
                    polygons(s, &o, &mut out, &mut vertices)?;
                    found.push(o.found);
                    Ok(())
                })?;
                out.finish().map(|_| ())
            })?;
        }
        "png" => {
            let mut all = Vec::new();
            s.contradictions(named, |o| {
                if all.len() == PAIRS_MAX {
                    let most = PAIRS_MAX as u64;
                    return Err(Error::limit(
                        "pairs in one picture (name two with --surveys)",
                        most,
                        most + 1,
                    ));
                }
                found.push(o.found.clone());
                all.push(o);
                Ok(())
            })?;
            if all.is_empty() {
                message("note: no two surveys share ground; there is no picture to draw");
            } else {
                picture(&all, path)?;
            }
        }
        _ => return Err(no_format(path, ".png or .geojson")),
    }
    Ok(found)
}

/// Writes the contradicted cells of a pair as polygons.
fn polygons<W: std::io::Write>(
    s: &Snapshot,
    o: &Overlap,
    out: &mut FeatureWriter<W>,
    vertices: &mut u64,
) -> Result<()> {
    let (pieces, piece_of) = dissolve(o.cols, o.rows, |c, r| o.contradicts(c, r));
    // Sum and largest difference of each piece.
    let mut figures = vec![(0.0f64, 0.0f32); pieces.len()];
    for (k, n) in piece_of.iter().enumerate().filter(|(_, n)| **n > 0) {
        let (sum, largest) = &mut figures[*n as usize - 1];
        let d = o.difference[k];
        *sum += f64::from(d);
        if d.abs() > largest.abs() {
            *largest = d;
        }
    }
    let cell_m2 = o.found.overlap_m2 / o.found.cells as f64;
    for (piece, (sum, largest)) in pieces.iter().zip(figures) {
        *vertices += piece.rings.iter().map(|r| r.len() as u64).sum::<u64>();
        if *vertices > limits::LINE_VERTICES_MAX {
            return Err(Error::limit(
                "vertices of polygons (name two surveys with --surveys)",
                limits::LINE_VERTICES_MAX,
                *vertices,
            ));
        }
        let rings: Vec<Vec<[f64; 2]>> =
            piece.rings.iter().map(|r| r.iter().map(|[c, r]| o.corner(*c, *r)).collect()).collect();
        let properties = json!({
            "finer": o.found.finer, "coarser": o.found.coarser, "area_m2": piece.cells as f64 * cell_m2,
            "mean_m": sum / piece.cells as f64, "largest_m": largest, "allowed_m": o.found.allowed_m, "version": s.number(),
        });
        out.feature(Shape::Polygon(&rings), &properties)?;
    }
    Ok(())
}

/// Draws the differences where surveys contradict each other; of several pairs the largest difference.
fn picture(all: &[Overlap], path: &Path) -> Result<()> {
    let corners = all
        .iter()
        .flat_map(|o| [(0, 0), (o.cols, 0), (0, o.rows), (o.cols, o.rows)].map(|(c, r)| o.corner(c, r)));
    let b = corners.fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |b, p| {
        [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])]
    });
    // Square in CRS units: no finer than the cells of the finest pair.
    let finest = all
        .iter()
        .map(|o| {
            let (a, b) = (o.corner(0, 0), o.corner(1, 0));
            (b[0] - a[0]).hypot(b[1] - a[1])
        })
        .fold(f64::INFINITY, f64::min);
    let pixel = finest.max((b[2] - b[0]).max(b[3] - b[1]) / PICTURE_SIDE as f64);
    let [cols, rows] = [0, 1].map(|k| (((b[k + 2] - b[k]) / pixel - 1e-6).ceil().max(1.0)) as usize);
    let mut values = vec![f32::NAN; cols * rows];
    for (k, v) in values.iter_mut().enumerate() {
        let p = [b[0] + ((k % cols) as f64 + 0.5) * pixel, b[3] - ((k / cols) as f64 + 0.5) * pixel];
        for o in all {
            let d = o.at(p);
            let shown = if f64::from(d).abs() > o.found.allowed_m { d } else { 0.0 };
            if !d.is_nan() && (v.is_nan() || shown.abs() > v.abs()) {
                *v = shown;
            }
        }
    }
    let far = common(values.iter().map(|v| v.abs()).filter(|v| *v > 0.0));
    let picture = Picture { ramp: Ramp::Diverging, range: Some([-far, far]), unit: "m", legend: true };
    write_picture(path, [cols, rows], &values, &picture)
}
