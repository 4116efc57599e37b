//! Heights and pictures become files.

use super::colour;
use super::grid::{Grid, points};
use super::header::{BOUND_MAX, Header, Kind, Shapes};
use super::ifs::{RANGE_LOG_MAX, Shape};
use super::iterate::Stop;
use super::mask;
use super::matching::Search;
use super::partition::{Candidates, Partition};
use super::residual;
use super::tile::Tile;
use super::tree;
use crate::blocks::blocks;
use crate::heights::{Heights, Place};
use crate::range::Encoder;
use crate::work::Workers;
use crate::{Error, Result};

/// How to encode.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Where splitting ends. `None`: for a bounded tile what makes the smallest file, else [`Partition::Slope`] of 100.
    pub partition: Option<Partition>,
    /// Which domains a range meets, beside the near ones.
    pub search: Search,
    /// The greatest error of a height, in units; 0 is lossless. Of heights only.
    pub bound: Option<u32>,
    /// Side of the largest ranges, a power of two from 2 to 32. `None`: as large as the tile allows.
    pub range_max: Option<usize>,
    /// Side of the smallest ranges, a power of two. `None`: 2 in the plane, 1 in space.
    pub range_min: Option<usize>,
    /// Distance of neighbouring domains: even.
    pub jump: usize,
    /// Isometries: 1 or 8 in the plane; 1, 16, 24 or 48 in space. `None`: 8 in the plane, 1 in space.
    pub isometries: Option<usize>,
    /// Along each axis so many domains round a range have short numbers; 0: none has.
    pub near: Option<usize>,
    /// Bits of a level of s, 2 to 8. `None`: 5, 7 where all ranges have one side.
    pub scale_bits: Option<u32>,
    /// Step of the means in units. `None`: of a bounded tile 1, or half the bound if that is more; else 1/2, 1/4 where less than eight samples share a map.
    pub step: Option<f64>,
    /// I and Q of colours are so many times smaller along each axis: 1, 2 or 4.
    pub chroma: usize,
}

impl Default for Options {
    fn default() -> Options {
        Options {
            partition: None,
            search: Search::Exact,
            bound: None,
            range_max: None,
            range_min: None,
            jump: 4,
            isometries: None,
            near: None,
            scale_bits: None,
            step: None,
            chroma: 2,
        }
    }
}

/// A file.
pub struct Encoded {
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// Its head: with the errors that were measured.
    pub header: Header,
}

/// Slopes that a bounded tile is tried with, in squares of 2E + 1.
const SLOPES: [f64; 4] = [0.25, 1.0, 4.0, 16.0];

impl Options {
    /// Whether so few samples share a map that its numbers are what errors come from.
    fn fine<const D: usize>(&self, size: [usize; D]) -> bool {
        let samples: usize = size.iter().product();
        match self.partition {
            Some(Partition::Maps(n)) => samples < n.saturating_mul(8),
            Some(Partition::Const(r)) => r.saturating_pow(D as u32) < 8,
            _ => false,
        }
    }

    pub(super) fn shape<const D: usize>(&self, size: [usize; D]) -> Result<Shape<D>> {
        self.partition.map_or(Ok(()), Partition::check)?;
        if self.search == Search::Near(0) {
            return Err(Error::invalid(
                "search",
                "near 0 domains along each axis; at least 1, or no range has a map",
            ));
        }
        let mut min = self.range_min.unwrap_or(if D == 2 { 2 } else { 1 });
        if let Some(Partition::Const(r)) = self.partition {
            min = r;
        }
        let log = |what: &'static str, side: usize| {
            if side.is_power_of_two() && side <= 1 << RANGE_LOG_MAX {
                Ok(side.trailing_zeros())
            } else {
                Err(Error::invalid(what, format!("{side}; a power of two from 1 to {}", 1 << RANGE_LOG_MAX)))
            }
        };
        let range_min_log = log("side of the smallest ranges", min)?;
        let bound = f64::from(self.bound.unwrap_or(0));
        let mut shape = Shape {
            size,
            range_max_log: RANGE_LOG_MAX,
            range_min_log,
            jump: self.jump,
            isometries: self.isometries.unwrap_or(if D == 2 { 8 } else { 1 }),
            near: match self.search {
                Search::Near(w) => w,
                _ => self.near.unwrap_or(if D == 2 { 16 } else { 4 }),
            },
            scale_bits: self.scale_bits.unwrap_or(match self.partition {
                Some(Partition::Const(_)) => 7,
                _ => 5,
            }),
            step: self.step.unwrap_or_else(|| match self.bound {
                Some(_) => 1.0_f64.max(bound / 2.0),
                None if self.fine(size) => 0.25,
                None => 0.5,
            }),
            origin: 0.0,
        };
        match self.range_max {
            Some(side) => shape.range_max_log = log("side of the largest ranges", side)?,
            // The largest ranges that add next to nothing to the tile, and have domains.
            None => {
                let fits = |log: u32| {
                    let n = 1 << log;
                    let padded: usize = size.iter().map(|s| s.next_multiple_of(n)).product();
                    let own: usize = size.iter().product();
                    padded <= own + own / 16 + 1024 && size.iter().all(|s| s.next_multiple_of(n) >= 2 * n)
                };
                shape.range_max_log = (2..=RANGE_LOG_MAX).rev().find(|log| fits(*log)).unwrap_or(1);
                shape.range_max_log = shape.range_max_log.max(range_min_log);
            }
        }
        shape.check().map(|()| shape)
    }
}

/// Encodes heights. `weights`: one a post, at least 1, more where errors matter more (a region of interest); empty: 1 everywhere.
///
/// Cost: with [`Search::Exact`] posts x domains x 8 multiplications a level; memory some 200 bytes a post.
///
/// # Errors
/// [`Error::Invalid`] where heights, options or place make no sense, [`Error::Limit`] for tiles too large, [`Error::Stopped`].
pub fn encode_heights(
    heights: &Heights,
    place: &Place,
    weights: &[f32],
    options: &Options,
    workers: &dyn Workers,
) -> Result<Encoded> {
    heights.check()?;
    let size = [heights.cols, heights.rows];
    check_weights(weights, heights.z.len())?;
    if let Some(e) = options.bound.filter(|e| *e > BOUND_MAX) {
        return Err(Error::Limit { what: "bound", limit: u64::from(BOUND_MAX), wanted: u64::from(e) });
    }
    let known = || heights.z.iter().enumerate().filter(|(k, _)| !heights.is_void(*k)).map(|(_, z)| *z);
    let range = [known().min().unwrap_or(0), known().max().unwrap_or(0)];
    let shape =
        with_room(Shape { origin: f64::from(range[0]), ..options.shape(size)? }, range.map(f64::from));
    let mut values: Vec<f64> = heights.z.iter().map(|z| f64::from(*z)).collect();
    mask::filled(&mut values, &heights.void, heights.cols);
    let weights: Vec<f32> = (0..values.len())
        .map(|k| if heights.is_void(k) { 0.0 } else { weights.get(k).copied().unwrap_or(1.0) })
        .collect();
    let grid = padded(&values, size, &shape);
    let weights = padded_weights(&weights, size, &shape);
    let candidates = Candidates::search(&shape, &grid, &weights, options, workers)?;
    let header = Header {
        kind: Kind::Heights,
        size: [size[0], size[1], 1],
        mask: heights.void.contains(&true),
        bound: options.bound,
        range,
        place: place.clone(),
        ..head(options, Shapes::Planes(vec![shape.clone()]))
    };
    header.check()?;
    let file = |partition: Partition| -> Result<Encoded> {
        let go_on = || crate::work::check(workers, 1.0);
        let plan = candidates.plan(partition)?;
        go_on()?;
        let mut c = Encoder::new();
        if header.mask {
            mask::code(&mut heights.void.clone(), heights.cols, &mut c);
        }
        let ifs = tree::code(&shape, &plan, &mut c);
        go_on()?;
        if let Some(e) = header.bound {
            let rec = ifs.rounded(header.seed(), Stop::PUBLISHED)?;
            let stride = shape.padded()[0];
            let step = 2 * i64::from(e) + 1;
            let mut q = vec![0; rec.len()];
            for (k, z) in heights.z.iter().enumerate().filter(|(k, _)| !heights.is_void(*k)) {
                let at = k / size[0] * stride + k % size[0];
                let off = i64::from(*z) - i64::from(rec[at]);
                q[at] = (off.signum() * ((off.abs() + i64::from(e)) / step)) as i32;
            }
            go_on()?;
            residual::code(&mut q, stride, size, &heights.void, &mut c);
        }
        go_on()?;
        sealed(header.clone(), ifs.maps(), c.finish(), |tile| {
            go_on()?;
            let errors = |k: usize, v: f64| {
                if heights.is_void(k) { None } else { Some((v - f64::from(heights.z[k])).abs()) }
            };
            if header.bound.is_some() {
                let found = tile.heights()?;
                return Ok(summed(found.z.iter().enumerate().filter_map(|(k, v)| errors(k, f64::from(*v)))));
            }
            let found = tile.plane(0)?;
            Ok(summed(found.values.iter().enumerate().filter_map(|(k, v)| errors(k, *v))))
        })
    };
    let best = match (options.partition, options.bound) {
        (Some(p), _) => file(p)?,
        (None, None) => file(Partition::Slope(100.0))?,
        (None, Some(e)) => {
            let square = f64::from(2 * e + 1).powi(2);
            let mut best: Option<Encoded> = None;
            for slope in SLOPES {
                crate::work::check(workers, 1.0)?;
                let next = file(Partition::Slope(slope * square))?;
                if best.as_ref().is_none_or(|b| next.bytes.len() < b.bytes.len()) {
                    best = Some(next);
                }
            }
            best.ok_or(Error::Stopped)?
        }
    };
    if let Some(e) = options.bound.filter(|e| best.header.error_max > f64::from(*e)) {
        return Err(Error::invalid(
            "bound",
            format!("{e} units wanted, the decoder is off by {}", best.header.error_max),
        ));
    }
    Ok(best)
}

/// Encodes a picture of one channel (brightness) or three (red, green, blue), a byte each, row by row. Weights as for heights.
pub fn encode_picture(
    [cols, rows]: [usize; 2],
    channels: usize,
    samples: &[u8],
    source: &str,
    weights: &[f32],
    options: &Options,
    workers: &dyn Workers,
) -> Result<Encoded> {
    let pixels = cols.saturating_mul(rows);
    if pixels == 0 || ![1, 3].contains(&channels) || samples.len() != pixels.saturating_mul(channels) {
        return Err(Error::invalid(
            "picture",
            format!(
                "{cols} x {rows} pixels of {channels} channels with {} bytes; 1 or 3 channels, a byte each",
                samples.len()
            ),
        ));
    }
    check_weights(weights, pixels)?;
    if options.bound.is_some() {
        return Err(Error::invalid("bound", "is for heights; a picture states the error that was measured"));
    }
    if ![1, 2, 4].contains(&options.chroma) {
        return Err(Error::invalid(
            "chroma",
            format!("{}; I and Q are 1, 2 or 4 times smaller", options.chroma),
        ));
    }
    let mut planes = Vec::new();
    if channels == 1 {
        planes.push((samples.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>(), [cols, rows]));
    } else {
        let yiq: Vec<[f64; 3]> =
            samples.chunks_exact(3).map(|p| colour::yiq([p[0], p[1], p[2]].map(f64::from))).collect();
        for k in 0..3 {
            let plane: Vec<f64> = yiq.iter().map(|p| p[k]).collect();
            planes.push(colour::reduced(&plane, [cols, rows], if k == 0 { 1 } else { options.chroma }));
        }
    }
    let total: usize = planes.iter().map(|p| p.0.len()).sum();
    let mut shapes = Vec::new();
    let mut coded = Vec::new();
    let mut c = Encoder::new();
    let mut maps = 0;
    for (values, size) in &planes {
        let shape = with_room(options.shape(*size)?, [-255.0, 255.0]);
        let grid = padded(values, *size, &shape);
        let by = if size == &[cols, rows] { 1 } else { options.chroma };
        let weights = match weights {
            [] => Vec::new(),
            w => {
                let w: Vec<f64> = w.iter().map(|w| f64::from(*w)).collect();
                colour::reduced(&w, [cols, rows], by).0.iter().map(|w| *w as f32).collect()
            }
        };
        let weights = padded_weights(&weights, *size, &shape);
        let candidates = Candidates::search(&shape, &grid, &weights, options, workers)?;
        // A plane gets maps by its samples.
        let partition = match options.partition.unwrap_or(Partition::Slope(100.0)) {
            Partition::Maps(n) => {
                let own = n as u128 * values.len() as u128 / total as u128;
                Partition::Maps(usize::try_from(own).unwrap_or(usize::MAX))
            }
            p => p,
        };
        let ifs = tree::code(&shape, &candidates.plan(partition)?, &mut c);
        maps += ifs.maps();
        shapes.push(shape);
        coded.push(ifs);
    }
    let header = Header {
        kind: if channels == 1 { Kind::Grey } else { Kind::Colour },
        size: [cols, rows, 1],
        range: [0, 255],
        place: Place { source: source.into(), ..Place::default() },
        ..head(options, Shapes::Planes(shapes))
    };
    header.check()?;
    sealed(header, maps, c.finish(), |tile| {
        let found = tile.picture(1)?;
        Ok(summed(found.samples.iter().zip(samples).map(|(a, b)| f64::from(a.abs_diff(*b)))))
    })
}

/// The same with the step doubled until numbers of means have room for values from the one to the other.
pub(super) fn with_room<const D: usize>(mut shape: Shape<D>, values: [f64; 2]) -> Shape<D> {
    let farthest = values.map(|v| (v - shape.origin).abs()).into_iter().fold(0.0, f64::max);
    while farthest / shape.step > f64::from(tree::MEAN_MAX / 2) {
        shape.step *= 2.0;
    }
    shape
}

pub(super) fn head(options: &Options, shapes: Shapes) -> Header {
    Header {
        kind: Kind::Heights,
        size: [0; 3],
        mask: false,
        bound: None,
        search: options.search,
        range: [0; 2],
        error_max: 0.0,
        error_rms: 0.0,
        maps: 0,
        place: Place::default(),
        space: None,
        shapes,
        body: 0,
    }
}

/// The file, its errors measured by decoding it.
pub(super) fn sealed(
    mut header: Header,
    maps: usize,
    body: Vec<u8>,
    measure: impl Fn(&Tile) -> Result<[f64; 2]>,
) -> Result<Encoded> {
    header.maps = maps as u64;
    header.body = body.len() as u64;
    let file = |header: &Header| {
        let mut bytes = header.bytes();
        bytes.extend_from_slice(&blocks(&body));
        bytes
    };
    [header.error_max, header.error_rms] = measure(&Tile::read(&file(&header))?)?;
    Ok(Encoded { bytes: file(&header), header })
}

/// The greatest and the root mean square.
pub(super) fn summed(errors: impl Iterator<Item = f64>) -> [f64; 2] {
    let (mut max, mut sum, mut count) = (0.0_f64, 0.0, 0.0_f64);
    for e in errors {
        max = max.max(e);
        sum += e * e;
        count += 1.0;
    }
    [max, (sum / count.max(1.0)).sqrt()]
}

fn check_weights(weights: &[f32], samples: usize) -> Result<()> {
    if !weights.is_empty() && weights.len() != samples {
        return Err(Error::invalid(
            "weights",
            format!("{} for {samples} samples; one each is needed", weights.len()),
        ));
    }
    match weights.iter().position(|w| !(*w >= 1.0 && w.is_finite())) {
        Some(k) => {
            Err(Error::invalid("weights", format!("{} for sample {k}; at least 1 is needed", weights[k])))
        }
        None => Ok(()),
    }
}

/// Samples in whole ranges: the last ones are repeated.
pub(super) fn padded<const D: usize>(values: &[f64], size: [usize; D], shape: &Shape<D>) -> Grid<D> {
    let whole = shape.padded();
    let values = points(whole)
        .map(|p| values[(0..D).rev().fold(0, |at, a| at * size[a] + p[a].min(size[a] - 1))])
        .collect();
    Grid { size: whole, values }
}

/// Weights in whole ranges: what is beyond the tile has none.
pub(super) fn padded_weights<const D: usize>(
    weights: &[f32],
    size: [usize; D],
    shape: &Shape<D>,
) -> Vec<f32> {
    let whole = shape.padded();
    if weights.is_empty() && whole == size {
        return Vec::new();
    }
    points(whole)
        .map(|p| {
            if (0..D).any(|a| p[a] >= size[a]) {
                return 0.0;
            }
            weights.get((0..D).rev().fold(0, |at, a| at * size[a] + p[a])).copied().unwrap_or(1.0)
        })
        .collect()
}
