//! A tile in the numbers that the shaders read.

use terraquilt_codecs::fractal::Walk;
use terraquilt_codecs::fractal::isometry::Isometry;
use terraquilt_codecs::{Error, Result};

/// Heights are shares of the range from the lowest to the highest sample: the 24 bits of a GPU's numbers then serve the range, not the
/// height above the sea.
pub(crate) struct Words {
    /// `Shape` of walk.wgsl.
    pub shape: [u32; 4],
    /// `Leaf` of walk.wgsl.
    pub leaves: Vec<[u32; 8]>,
    pub seed: Vec<f32>,
    /// Height of share 0.
    pub low: f64,
    /// How much higher share 1 is.
    pub span: f64,
}

impl Words {
    /// # Errors
    /// Invalid for heights that are no numbers, or that differ from the samples by more than float32 holds.
    pub(crate) fn of(walk: &Walk<2>) -> Result<Words> {
        let samples = &walk.grid().values;
        let low = samples.iter().copied().fold(f64::INFINITY, f64::min);
        let high = samples.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let span = if high > low { high - low } else { 1.0 };
        let turns: Vec<u32> = walk.group().iter().map(turn).collect();
        // low + span v = s (low + span w) + o
        let offsets = walk.steps().map(|l| ((l.offset + l.scale * low - low) / span) as f32);
        let offsets: Vec<f32> = offsets.collect();
        let seed: Vec<f32> = samples.iter().map(|v| ((v - low) / span) as f32).collect();
        let place = |what: &str, at: Option<usize>| at.map(|k| format!("{what} {k}"));
        let wrong = place("leaf", offsets.iter().position(|v| !v.is_finite()))
            .or(place("sample", seed.iter().position(|v| !v.is_finite())));
        if let Some(place) = wrong {
            let reason = format!("{place} is too far from the samples, which reach from {low} to {high}");
            return Err(Error::invalid("fractal tile", reason));
        }
        let leaves = walk.steps().zip(&offsets).map(|(l, offset)| {
            let ([x, y], [u, v]) = (l.range, l.domain);
            let turn = turns[usize::from(l.isometry)];
            [x, y, u, v, l.side, turn, (l.scale as f32).to_bits(), offset.to_bits()]
        });
        let mut leaves: Vec<[u32; 8]> = leaves.collect();
        if leaves.is_empty() {
            // Flat everywhere; a buffer of nothing is none.
            leaves.push([0; 8]);
        }
        let [cols, rows] = walk.grid().size.map(|n| n as u32);
        let shift = walk.cell_side().trailing_zeros();
        Ok(Words { shape: [cols, rows, cols >> shift, shift], leaves, seed, low, span })
    }
}

/// What `walk` of walk.wgsl does to find the point that is read.
fn turn(i: &Isometry<2>) -> u32 {
    let [(first, column_back), (_, row_back)] = i.of;
    first as u32 | u32::from(column_back) << 1 | u32::from(row_back) << 2
}
