//! A source whose heights are moved from the geoid to the ellipsoid, or back, sample by sample.

use super::crs::geoid::Geoid;
use super::crs::vertical::VerticalDatum;
use super::crs::{Crs, DatumChoice, Transform, lonlat_bounds};
use super::source::{Affine, HeightSource, SampleType, Samples, SourceInfo, Window};
use crate::base::{Error, Result};
use std::sync::Arc;

/// Which way heights are moved.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Lift {
    /// Heights over the geoid become heights over the ellipsoid: the undulation is added.
    ToEllipsoid,
    /// Heights over the ellipsoid become heights over the geoid, whose name is given.
    ToGeoid(VerticalDatum),
}

/// A [`HeightSource`] in metres, 32-bit floats (64-bit where the file has 32-bit integers or 64-bit floats).
///
/// A sample becomes `(sample * scale + offset) * unit + undulation` (minus the undulation on the way to the geoid).
/// Voids stay voids. The place of a post is its longitude and latitude, interpolated between exact
/// positions at every 16th column and row of the file (so windows do not matter), or exact near a pole. That is
/// off by some 10 m for posts 1 km apart at 60 degrees of latitude, by the square of the spacing less for finer
/// ones; geoids slope by a centimetre a hundred metres at most.
/// Longitudes on the file's own datum are taken for those of the grid: 200 m move it by some millimetres.
pub struct Lifted {
    source: Box<dyn HeightSource>,
    geoid: Arc<Geoid>,
    way: Transform,
    affine: Affine,
    sign: f64,
    unit_m: f64,
    info: SourceInfo,
}

/// Posts between two exact positions.
const NET: u64 = 16;

impl Lifted {
    /// `crs`: of the file's positions; `unit_m`: metres of one unit of its heights. The result counts from the
    /// ellipsoid or the named datum, which is compared between surveys; name and digest of the grid stand in its
    /// notes.
    ///
    /// # Errors
    /// If the file says that its heights count from elsewhere than the way begins (one that says nothing is taken
    /// as the user means it, with a note), if it has no georeference, or the grid does not cover it: with both rectangles.
    pub fn new(
        source: Box<dyn HeightSource>,
        crs: &Crs,
        unit_m: f64,
        geoid: Arc<Geoid>,
        lift: &Lift,
    ) -> Result<Lifted> {
        let mut info = source.info().clone();
        info.notes.extend(start_of(&info, lift)?);
        let affine = info.affine.ok_or_else(|| {
            Error::invalid(&info.file, "without a georeference its heights cannot be moved to another datum")
        })?;
        let way = Transform::new(crs, &Crs::from_epsg(4326)?, &DatumChoice::Ballpark)?;
        let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(c, r)| {
            position(
                affine,
                (info.cols.saturating_sub(1) * c) as f64,
                (info.rows.saturating_sub(1) * r) as f64,
            )
        });
        let extreme =
            |k: usize, f: fn(f64, f64) -> f64| corners.iter().map(|p| p[k]).reduce(f).unwrap_or(0.0);
        let bounds = lonlat_bounds(
            crs,
            [extreme(0, f64::min), extreme(1, f64::min), extreme(0, f64::max), extreme(1, f64::max)],
        )?;
        if !geoid.covers(bounds) {
            let words =
                |[w, s, e, n]: [f64; 4]| format!("longitude {w:.4} to {e:.4}, latitude {s:.4} to {n:.4}");
            return Err(Error::invalid(
                &info.file,
                format!(
                    "the file reaches over {}, the geoid grid {} only over {}; give a grid that covers the file",
                    words(bounds),
                    geoid.name(),
                    words(geoid.bounds())
                ),
            ));
        }
        let (sign, datum, way_words) = match lift {
            Lift::ToEllipsoid => (1.0, VerticalDatum::ellipsoid(), "geoid to ellipsoid"),
            Lift::ToGeoid(datum) => (-1.0, datum.clone(), "ellipsoid to geoid"),
        };
        info.notes.push(format!(
            "heights moved from {way_words} by the grid {} (blake3 {})",
            geoid.name(),
            geoid.digest()
        ));
        info.sample_type = match info.sample_type {
            SampleType::F64 | SampleType::I32 | SampleType::U32 => SampleType::F64,
            _ => SampleType::F32,
        };
        (info.scale, info.offset) = (1.0, 0.0);
        info.nodata = Some(f64::NAN);
        info.vertical_datum = Some(datum.as_str().to_string());
        info.vertical_unit_m = Some(1.0);
        Ok(Lifted { source, geoid, way, affine, sign, unit_m, info })
    }

    /// Longitude and latitude of a post, exactly.
    fn place(&self, col: u64, row: u64) -> Result<[f64; 2]> {
        let p = position(self.affine, col as f64, row as f64);
        self.way.forward(p).ok_or_else(|| {
            Error::invalid(
                &self.info.file,
                format!(
                    "post (column {col}, row {row}) at ({}, {}) has no longitude and latitude",
                    p[0], p[1]
                ),
            )
        })
    }

    /// Exact places at the corners of a mesh of the net, longitudes next to each other; None if they turn too
    /// much for interpolation (near a pole).
    fn net_cell(&self, col: u64, row: u64) -> Result<Option<[[f64; 2]; 4]>> {
        let at = |c: u64, r: u64| self.way.forward(position(self.affine, c as f64, r as f64));
        let corners = [at(col, row), at(col + NET, row), at(col, row + NET), at(col + NET, row + NET)];
        // A corner beyond the file may lie outside the projection.
        let [Some(a), Some(b), Some(c), Some(d)] = corners else { return Ok(None) };
        let near = |p: [f64; 2]| [p[0] - 360.0 * ((p[0] - a[0]) / 360.0).round(), p[1]];
        let cell = [a, near(b), near(c), near(d)];
        let steady = cell.iter().all(|p| (p[0] - a[0]).abs() < 20.0 && p[1].abs() < 88.0);
        Ok(steady.then_some(cell))
    }

    fn undulations(&self, w: Window) -> Result<Vec<Option<f64>>> {
        let mut out = vec![None; w.cols * w.rows];
        let (end_col, end_row) = (w.col + w.cols as u64, w.row + w.rows as u64);
        for net_row in (w.row / NET * NET..end_row).step_by(NET as usize) {
            for net_col in (w.col / NET * NET..end_col).step_by(NET as usize) {
                let cell = self.net_cell(net_col, net_row)?;
                for row in net_row.max(w.row)..(net_row + NET).min(end_row) {
                    for col in net_col.max(w.col)..(net_col + NET).min(end_col) {
                        let [lon, lat] = match &cell {
                            Some(cell) => {
                                between(cell, (col - net_col) as f64 / 16.0, (row - net_row) as f64 / 16.0)
                            }
                            None => self.place(col, row)?,
                        };
                        out[(row - w.row) as usize * w.cols + (col - w.col) as usize] =
                            self.geoid.undulation(lon, lat);
                    }
                }
            }
        }
        Ok(out)
    }
}

/// Checks that the heights begin where the way does; a note if the file does not say where.
fn start_of(info: &SourceInfo, lift: &Lift) -> Result<Option<String>> {
    let said = info.vertical_datum.as_deref();
    let (begins, words, remedy) = match lift {
        Lift::ToEllipsoid => (said != Some("ellipsoid"), "a geoid", "leave --geoid out"),
        Lift::ToGeoid(_) => (
            said.is_none_or(|d| d == "ellipsoid"),
            "the ellipsoid",
            "leave --geoid and --onto out; or take it to the ellipsoid first, by the grid of its own geoid",
        ),
    };
    match said {
        None => Ok(Some(format!(
            "the file does not say what its heights count from; with --geoid they are taken as over {words}"
        ))),
        Some(datum) if !begins => Err(Error::invalid(
            &info.file,
            format!("its heights count from {datum}, and the way of --geoid begins at {words}; {remedy}"),
        )),
        Some(_) => Ok(None),
    }
}

fn position(a: Affine, col: f64, row: f64) -> [f64; 2] {
    [0, 1].map(|k| a.origin[k] + col * a.col_step[k] + row * a.row_step[k])
}

fn between(cell: &[[f64; 2]; 4], x: f64, y: f64) -> [f64; 2] {
    [0, 1].map(|k| {
        let upper = cell[0][k] + x * (cell[1][k] - cell[0][k]);
        let lower = cell[2][k] + x * (cell[3][k] - cell[2][k]);
        upper + y * (lower - upper)
    })
}

impl HeightSource for Lifted {
    fn info(&self) -> &SourceInfo {
        &self.info
    }

    fn set_nodata(&mut self, value: f64) {
        self.source.set_nodata(value);
    }

    fn read(&mut self, window: Window) -> Result<Samples> {
        let raw = self.source.read(window)?;
        let undulations = self.undulations(window)?;
        let from = self.source.info();
        let mut data = Vec::with_capacity(raw.valid.len() * self.info.sample_type.bytes());
        let bytes = raw.data.chunks_exact(from.sample_type.bytes());
        for (i, ((b, valid), undulation)) in bytes.zip(&raw.valid).zip(undulations).enumerate() {
            let height = match (valid, undulation) {
                (0, _) => f64::NAN,
                (_, Some(n)) => {
                    (from.sample_type.value(b) * from.scale + from.offset) * self.unit_m + self.sign * n
                }
                (_, None) => {
                    let col = window.col + (i % window.cols.max(1)) as u64;
                    let row = window.row + (i / window.cols.max(1)) as u64;
                    let [lon, lat] = self.place(col, row)?;
                    return Err(Error::invalid(
                        &self.info.file,
                        format!(
                            "the geoid grid {} has no value at longitude {lon:.5}, latitude {lat:.5} (column {col}, \
                             row {row}); give a grid that covers the file",
                            self.geoid.name()
                        ),
                    ));
                }
            };
            match self.info.sample_type {
                SampleType::F64 => data.extend_from_slice(&height.to_le_bytes()),
                _ => data.extend_from_slice(&(height as f32).to_le_bytes()),
            }
        }
        Ok(Samples { cols: raw.cols, rows: raw.rows, data, valid: raw.valid })
    }

    fn row_batch(&self) -> usize {
        self.source.row_batch()
    }
}
