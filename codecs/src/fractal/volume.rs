//! Volumes become files: signed distances, whose surface is what counts.

use super::encode::{Encoded, Options, head, padded, padded_weights, sealed, summed, with_room};
use super::grid::{Grid, points};
use super::header::{Header, Kind, Shapes, Space};
use super::ifs::Ifs;
use super::iterate::Stop;
use super::partition::{Candidates, Partition};
use super::tree;
use crate::heights::Place;
use crate::range::Encoder;
use crate::work::Workers;
use crate::{Error, Result};

/// Distances up to this, two voxels, tell where the surface of a volume runs,
const SURFACE: u8 = 16;
/// and count so many times as much as others.
const SURFACE_WEIGHT: f32 = 8.0;

/// Sheets and cracks up to so many samples thick come and go with single samples.
const THIN: usize = 2;
/// How often maps are given out anew, for their sake.
const ROUNDS: usize = 20;
/// How much more a sample of theirs that decodes to the wrong side counts each time.
const WRONG_WEIGHT: f64 = 256.0;

/// Encodes a volume of signed distances in eighths of a voxel, -127 to 127, the first axis fastest. Samples near the surface count more, and of so many
/// maps ([`Partition::Maps`]) more go, step by step, to thin sheets and cracks that would else close or open.
pub fn encode_volume(
    size: [usize; 3],
    values: &[i8],
    space: Space,
    source: &str,
    options: &Options,
    workers: &dyn Workers,
) -> Result<Encoded> {
    let samples = size.iter().fold(1_usize, |n, s| n.saturating_mul(*s));
    if samples == 0 || samples != values.len() {
        return Err(Error::invalid("volume", format!("{size:?} samples with {} values", values.len())));
    }
    if options.bound.is_some() {
        return Err(Error::invalid("bound", "is for heights; a volume states the error that was measured"));
    }
    let shape = with_room(options.shape(size)?, [-127.0, 127.0]);
    let grid = padded(&values.iter().map(|v| f64::from(*v)).collect::<Vec<f64>>(), size, &shape);
    let weights: Vec<f32> =
        values.iter().map(|v| if v.unsigned_abs() <= SURFACE { SURFACE_WEIGHT } else { 1.0 }).collect();
    let weights = padded_weights(&weights, size, &shape);
    let mut candidates = Candidates::search(&shape, &grid, &weights, options, workers)?;
    let partition = options.partition.unwrap_or(Partition::Slope(100.0));
    if let Partition::Maps(_) = partition {
        for _ in 0..ROUNDS {
            crate::work::check(workers, 1.0)?;
            let ifs = tree::code(&shape, &candidates.plan(partition)?, &mut Encoder::new());
            let wrong = closed(size, &grid, &ifs)?;
            if wrong.is_empty() {
                break;
            }
            candidates.heed(&wrong, WRONG_WEIGHT);
        }
    }
    let mut c = Encoder::new();
    let ifs = tree::code(&shape, &candidates.plan(partition)?, &mut c);
    let header = Header {
        kind: Kind::Volume,
        size,
        range: [-127, 127],
        place: Place { source: source.into(), ..Place::default() },
        space: Some(space),
        ..head(options, Shapes::Volume(shape))
    };
    header.check()?;
    sealed(header, ifs.maps(), c.finish(), |tile| {
        let found = tile.volume()?;
        Ok(summed(found.values.iter().zip(values).map(|(a, b)| (a - f64::from(*b)).abs())))
    })
}

/// Samples of thin sheets and cracks that are inside and decode to outside, or the other way round.
fn closed(size: [usize; 3], grid: &Grid<3>, ifs: &Ifs<3>) -> Result<Vec<[usize; 3]>> {
    let found = ifs.iterate([1, 1], 0.0, Stop::PUBLISHED, &mut || true)?.grid;
    let wrong = |p: &[usize; 3]| {
        let at = grid.at(*p);
        (grid.values[at] > 0.0) != (found.values[at] > 0.0)
    };
    Ok(points(size).filter(|p| wrong(p) && (0..3).any(|axis| is_thin(size, grid, *p, axis))).collect())
}

/// Whether a sample lies between two of the other side that are at most [`THIN`] samples of its own apart.
fn is_thin(size: [usize; 3], grid: &Grid<3>, p: [usize; 3], axis: usize) -> bool {
    let inside = |q: [usize; 3]| grid.values[grid.at(q)] > 0.0;
    let own = inside(p);
    // Samples of the same side before the other one begins; what goes on beyond the volume is not thin.
    let run = |step: isize| {
        let mut q = p;
        for n in 0..THIN {
            match q[axis].checked_add_signed(step).filter(|v| *v < size[axis]) {
                Some(v) => q[axis] = v,
                None => return THIN,
            }
            if inside(q) != own {
                return n;
            }
        }
        THIN
    };
    1 + run(1) + run(-1) <= THIN
}
