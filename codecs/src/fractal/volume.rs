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

/// How often maps are given to where the surface runs on the wrong side of a sample.
const ROUNDS: usize = 20;
/// How much more such a sample counts each time.
const WRONG_WEIGHT: f64 = 256.0;

/// Encodes a volume of signed distances in eighths of a voxel, -127 to 127, the first axis fastest. Samples near the surface count more, and of so many
/// maps ([`Partition::Maps`]) more go, step by step, to where the surface would run on the wrong side of a sample.
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
            let wrong = wrong_sides(size, &grid, &ifs)?;
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

/// Samples that are inside and decode to outside, or the other way round: a surface that is nearer than a voxel to another one comes and goes with them.
fn wrong_sides(size: [usize; 3], grid: &Grid<3>, ifs: &Ifs<3>) -> Result<Vec<[usize; 3]>> {
    let found = ifs.iterate([1, 1], 0.0, Stop::PUBLISHED, &mut || true)?.grid;
    let inside = |g: &Grid<3>, p: &[usize; 3]| g.values[g.at(*p)] > 0.0;
    Ok(points(size).filter(|p| inside(grid, p) != inside(&found, p)).collect())
}
