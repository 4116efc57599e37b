//! Terrain reduced by box means, coded as a fractal tile, and brought back to its size in several ways.

use super::spectrum::{bicubic, octaves, rms};
use terraquilt_codecs::fractal::detail::doubled;
use terraquilt_codecs::fractal::grid::Grid;
use terraquilt_codecs::fractal::{Options, Partition, Search, Tile, encode_heights};
use terraquilt_codecs::heights::{Heights, Place};
use terraquilt_codecs::work::Alone;

/// One way back.
#[allow(dead_code, reason = "the example writes what the test does not read")]
pub struct Way {
    pub name: &'static str,
    pub values: Vec<f64>,
    /// Root mean square error, as a multiple of that of bicubic interpolation of the reduced grid.
    pub error: f64,
    /// Power of each octave that the reduced grid lacks, the coarsest first, as a multiple of the true one.
    pub powers: Vec<f64>,
}

/// All ways back.
#[allow(dead_code, reason = "the example prints what the test does not read")]
pub struct Back {
    pub ways: Vec<Way>,
    pub gains: Vec<f64>,
    /// Root mean square error of bicubic interpolation, in units.
    pub bicubic: f64,
}

impl Way {
    /// Acceptance F7 of the specification.
    pub fn holds(&self) -> bool {
        self.error <= 1.25 && self.powers.iter().all(|p| (0.7..=1.4).contains(p))
    }
}

/// Reduces `truth` k times by 2 x 2 means, rounds to whole units, encodes with ranges of 4 alone, bounded if `bound` says so, decodes and
/// comes back. Sides must be multiples of 2^k. The ways: `bicubic`, `doubled` (the interpolation that keeps means), `plain` (the maps
/// alone), `controlled`.
pub fn there_and_back(
    truth: &[f64],
    cols: usize,
    k: u32,
    search: Search,
    bound: Option<u32>,
) -> terraquilt_codecs::Result<Back> {
    let mut small = Grid { size: [cols, truth.len() / cols], values: truth.to_vec() };
    for _ in 0..k {
        small = small.half();
    }
    let [width, height] = small.size;
    let z: Vec<i32> = small.values.iter().map(|v| v.round() as i32).collect();
    let options = Options { partition: Some(Partition::Const(4)), search, bound, ..Options::default() };
    let file =
        encode_heights(&Heights::new(width, height, z.clone()), &Place::default(), &[], &options, &Alone)?;
    let tile = Tile::read(&file.bytes)?;
    let fine = tile.detailed(k)?;
    let maps = tile.walk(0)?.doubled(k)?;
    let stride = maps.size[0];
    let plain =
        maps.values.chunks_exact(stride).take(height << k).flat_map(|row| &row[..cols]).copied().collect();
    let given: Vec<f64> = z.iter().map(|z| f64::from(*z)).collect();
    let mut smooth = Grid { size: small.size, values: given.clone() };
    for _ in 0..k {
        smooth = doubled(&smooth);
    }
    let simple = bicubic(&given, width, 1 << k);
    let reference = rms(&simple, truth);
    let own = octaves(truth, cols, k as usize);
    let ways =
        [("bicubic", simple), ("doubled", smooth.values), ("plain", plain), ("controlled", fine.grid.values)]
            .into_iter()
            .map(|(name, values)| Way {
                name,
                error: rms(&values, truth) / reference,
                powers: octaves(&values, cols, k as usize)
                    .iter()
                    .zip(&own)
                    .map(|(a, b)| a / b)
                    .rev()
                    .collect(),
                values,
            })
            .collect();
    Ok(Back { ways, gains: fine.gains, bicubic: reference })
}
