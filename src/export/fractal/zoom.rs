//! Planes of a tile at any zoom.
//!
//! Cell i of zoom z covers i/z to (i + 1)/z of the tile's samples. Below 1 cells are means, by the area that they share with samples: at 1/2^k that is the
//! attractor itself (zoom theorem, specification section 4). Above 1 there is nothing measured: the maps go on, as they are or held to the
//! tile's own spectrum, or samples are joined smoothly.

use super::Opened;
use crate::base::{Error, Result, limits};
use crate::export::{Going, go_on};
use rayon::prelude::*;
use terraquilt_codecs::fractal::detail::{self, OCTAVES_MAX};
use terraquilt_codecs::fractal::grid::Grid;
use terraquilt_codecs::fractal::walk::{DEPTH_MAX, Walk};
use terraquilt_codecs::fractal::{Iterated, Kind, Stop};

/// What there is between samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// What the maps say: too rough on terrain, as published.
    Plain,
    /// Smooth, and the texture of the maps with the power that the tile's own spectrum leads to expect.
    Controlled,
    /// Smooth.
    None,
}

impl Detail {
    /// As options and files call it.
    pub fn name(self) -> &'static str {
        match self {
            Detail::Plain => "plain",
            Detail::Controlled => "controlled",
            Detail::None => "none",
        }
    }
}

/// Samples of a result in one of the tile, along each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zoom(f64);

impl Zoom {
    /// # Errors
    /// For what is no positive number, or above 2^24.
    pub fn new(zoom: f64) -> Result<Zoom> {
        if !(zoom > 0.0 && zoom <= f64::from(1 << DEPTH_MAX)) {
            return Err(Error::invalid(
                "--zoom",
                format!("{zoom}; a number above 0 is needed, at most {}", 1 << DEPTH_MAX),
            ));
        }
        Ok(Zoom(zoom))
    }

    /// The number.
    pub fn get(self) -> f64 {
        self.0
    }

    /// Whether there is more than was measured.
    pub fn is_synthetic(self) -> bool {
        self.0 > 1.0
    }

    /// Steps of a walk.
    pub fn depth(self) -> u32 {
        Walk::<2>::depth(1.0, 1.0 / self.0)
    }

    fn is_power(self) -> bool {
        self.0 == f64::from(1_u32 << self.depth().min(31))
    }

    /// Cells of so many samples: those whose middle lies on a sample, at least one.
    pub fn cells(self, samples: usize) -> usize {
        ((samples as f64 * self.0 - 0.5 - 1e-9).ceil().max(1.0)) as usize
    }

    /// Refuses a result that is too large, before anything is held for it.
    pub(super) fn check(self, size: &[usize]) -> Result<()> {
        let wanted = size.iter().fold(1.0, |n, s| n * self.cells(*s) as f64);
        let most = limits::FRACTAL_SAMPLES_MAX;
        if wanted > most as f64 {
            return Err(Error::limit("samples of the result (take a smaller --zoom)", most, wanted as u64));
        }
        Ok(())
    }
}

/// Samples of a plane at zoom 1: heights within the bound, where there is one.
pub(super) fn measured(o: &Opened, k: usize) -> Result<Grid<2>> {
    if o.tile.header.bound.is_some() {
        let h = o.tile.heights().map_err(|e| o.told(e))?;
        return Ok(Grid { size: [h.cols, h.rows], values: h.z.iter().map(|z| f64::from(*z)).collect() });
    }
    o.tile.plane(k).map_err(|e| o.told(e))
}

/// A plane at a zoom. What a bound adds to a sample holds over its cell.
///
/// # Errors
/// [`Error::Limit`] for results that are too large; [`Error::Stopped`].
pub fn plane(o: &Opened, k: usize, zoom: Zoom, detail: Detail, going: Going) -> Result<Grid<2>> {
    let size = [o.tile.header.size[0], o.tile.header.size[1]];
    zoom.check(&size)?;
    go_on(going, "decoding", 0.0)?;
    if zoom.0 == 1.0 {
        return measured(o, k);
    }
    if zoom.0 < 1.0 {
        return Ok(reduced(&measured(o, k)?, &o.tile.void, zoom));
    }
    // Detail of brightness alone: of colours the eye sees none.
    match if k > 0 && detail == Detail::Controlled { Detail::None } else { detail } {
        Detail::Plain => walked(o, k, zoom, going),
        smooth => {
            let octaves = zoom.depth();
            if octaves > OCTAVES_MAX {
                let most = 1_u64 << OCTAVES_MAX;
                return Err(Error::limit("--zoom (with --detail plain more)", most, zoom.0.ceil() as u64));
            }
            let fine = Zoom(f64::from(1 << octaves));
            fine.check(&size)?;
            let base = measured(o, k)?;
            let fine = match smooth {
                Detail::Controlled => {
                    let walk = o.tile.walk(k).map_err(|e| o.told(e))?;
                    detail::detailed(&walk, &base, octaves).map_err(|e| o.told(e))?.grid
                }
                _ => (0..octaves).try_fold(base, |g, done| {
                    go_on(going, "decoding", f64::from(done) / f64::from(octaves))?;
                    Ok::<_, Error>(detail::doubled(&g))
                })?,
            };
            if zoom.is_power() {
                return Ok(fine);
            }
            // Means of the finer cells.
            let cells = size_of(&o.tile.planes[k].shape.size, zoom);
            Ok(means(&fine, &[], zoom.0 / f64::from(1 << octaves), cells))
        }
    }
}

fn size_of(size: &[usize; 2], zoom: Zoom) -> [usize; 2] {
    size.map(|n| zoom.cells(n))
}

/// Below zoom 1. Cells without data are NaN.
fn reduced(grid: &Grid<2>, void: &[bool], zoom: Zoom) -> Grid<2> {
    means(grid, void, zoom.0, size_of(&grid.size, zoom))
}

/// Means over cells of 1/zoom samples, by the area that they share with each.
fn means(grid: &Grid<2>, void: &[bool], zoom: f64, cells: [usize; 2]) -> Grid<2> {
    let shares = |cell: usize, count: usize| {
        let (from, to) = (cell as f64 / zoom, ((cell + 1) as f64 / zoom).min(count as f64));
        let (first, last) = (from as usize, (to.ceil() as usize).min(count));
        (first..last).map(move |k| (k, (to.min((k + 1) as f64) - from.max(k as f64)).max(0.0)))
    };
    let mut out = Grid::filled(cells, f64::NAN);
    out.values.par_chunks_mut(cells[0]).enumerate().for_each(|(y, row)| {
        for (x, v) in row.iter_mut().enumerate() {
            let (mut sum, mut area) = (0.0, 0.0);
            for (r, high) in shares(y, grid.size[1]) {
                for (c, wide) in shares(x, grid.size[0]) {
                    let at = r * grid.size[0] + c;
                    if !void.get(at).copied().unwrap_or(false) {
                        sum += high * wide * grid.values[at];
                        area += high * wide;
                    }
                }
            }
            if area > 0.0 {
                *v = sum / area;
            }
        }
    });
    out
}

/// Above zoom 1, by the maps alone.
fn walked(o: &Opened, k: usize, zoom: Zoom, going: Going) -> Result<Grid<2>> {
    let walk = o.tile.walk(k).map_err(|e| o.told(e))?;
    let size = walk.size();
    let cells = size_of(&size, zoom);
    let (z, depth) = (zoom.0, zoom.depth());
    let doubled = match zoom.is_power() {
        true => Some(walk.doubled(depth).map_err(|e| o.told(e))?),
        false => None,
    };
    let mut out = Grid::filled(cells, 0.0);
    let rows = out.values.par_chunks_mut(cells[0]).enumerate();
    rows.try_for_each(|(y, row)| {
        if y % 64 == 0 {
            go_on(going, "decoding", y as f64 / cells[1] as f64)?;
        }
        let v = (y as f64 + 0.5) / z;
        for (x, value) in row.iter_mut().enumerate() {
            let u = (x as f64 + 0.5) / z;
            *value = match &doubled {
                Some(g) => g.values[y * g.size[0] + x],
                None => walk.value([u, v], depth),
            };
            if k == 0 {
                *value += o.tile.added((u as usize).min(size[0] - 1), (v as usize).min(size[1] - 1));
            }
        }
        Ok::<_, Error>(())
    })?;
    Ok(out)
}

/// How far an iteration came.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Passes over the samples, the most of any plane.
    pub passes: usize,
    /// The mean change of a sample by the last pass, the most of any plane; `None` before a whole pass.
    pub change: Option<f64>,
    /// Whether the samples are those that any decoder comes to.
    pub finished: bool,
}

/// The planes at zoom 1 after so many passes at most, or as far as `in_time` lets them come. A bound's part is added.
///
/// # Errors
/// As [`plane`].
pub fn passes(
    o: &Opened,
    most: Option<usize>,
    in_time: &mut dyn FnMut() -> bool,
    going: Going,
) -> Result<(Vec<Grid<2>>, Progress)> {
    let mut progress = Progress { passes: 0, change: Some(0.0), finished: true };
    let mut stopped = false;
    let mut planes = Vec::new();
    for ifs in &o.tile.planes {
        // One pass is the step from half the zoom.
        let half = usize::from(ifs.shape.jump.is_multiple_of(4));
        let passes_max = most.map_or(Stop::PUBLISHED.passes_max, |n| n.saturating_sub(half));
        let mut on = || {
            stopped |= !going("decoding", 0.0);
            !stopped && in_time()
        };
        let stop = Stop { passes_max, ..Stop::PUBLISHED };
        let found = ifs.iterate([1, 1], o.tile.header.seed(), stop, &mut on).map_err(|e| o.told(e))?;
        if stopped {
            return Err(Error::Stopped);
        }
        let Iterated { grid, passes, change, finished } = found;
        progress.passes = progress.passes.max(passes);
        progress.change = progress.change.filter(|_| change.is_finite()).map(|c| c.max(change));
        progress.finished &= finished && change < Stop::PUBLISHED.change;
        let size = ifs.shape.size;
        let mut values = Vec::with_capacity(size[0] * size[1]);
        for (y, row) in grid.values.chunks_exact(grid.size[0]).take(size[1]).enumerate() {
            let bounded = o.kind() == Kind::Heights && o.tile.header.bound.is_some();
            values.extend(
                row[..size[0]]
                    .iter()
                    .enumerate()
                    .map(|(x, v)| if bounded { v.round() + o.tile.added(x, y) } else { *v }),
            );
        }
        planes.push(Grid { size, values });
    }
    Ok((planes, progress))
}
