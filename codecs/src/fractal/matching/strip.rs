//! Domains side by side, as they are multiplied with ranges.

use super::frame::Frame;
use super::poses::Poses;
use multiversion::multiversion;

/// Domains that are worked on at once.
pub const LANES: usize = 16;

/// Domains side by side: what is screened in f32, and what the plain form needs to know of each.
pub struct Strip {
    /// Their numbers.
    pub domains: Vec<usize>,
    /// Lanes: the domains, filled up with flat ones to a multiple of [`LANES`].
    pub stride: usize,
    /// Rows of `stride` samples, the domains of length 1; of flat ones 0.
    pub samples: Vec<f32>,
    /// Length of each, and its inverse; of flat ones 0.
    pub lengths: Vec<f32>,
    /// See there.
    pub inverses: Vec<f32>,
    /// Mean of each.
    pub means: Vec<f64>,
    /// Sum of the squares of each without its mean.
    pub squares: Vec<f64>,
}

impl Strip {
    /// Lays domains side by side, by their numbers; `spare` more lanes stay flat.
    pub fn new<const D: usize>(frame: &Frame<D>, domains: Vec<usize>, spare: usize) -> Strip {
        let stride = (domains.len() + spare).next_multiple_of(LANES);
        let flat = vec![0.0; stride];
        let mut out = Strip {
            stride,
            samples: vec![0.0; stride * frame.poses.rows],
            lengths: flat.clone(),
            inverses: flat,
            means: vec![0.0; stride],
            squares: vec![0.0; stride],
            domains,
        };
        let mut block = vec![[0.0; LANES]; frame.samples];
        for (g, domains) in out.domains.chunks(LANES).enumerate() {
            let at = g * LANES;
            let firsts = firsts(frame, domains);
            let (means, squares) = centred(&frame.level.half.values, &firsts, &frame.offsets, &mut block);
            let mut scales = [0.0; LANES];
            for k in 0..domains.len() {
                out.means[at + k] = means[k];
                out.squares[at + k] = squares[k];
                if let Some(length) = frame.length(squares[k]) {
                    scales[k] = 1.0 / squares[k].sqrt();
                    out.lengths[at + k] = length;
                    out.inverses[at + k] = 1.0 / length;
                }
            }
            lay(&frame.poses, &mut block, &scales, &mut out.samples[at..], stride);
        }
        out
    }

    /// The length of the longest; the domains in the order of their lengths.
    pub fn longest(&self) -> f32 {
        self.domains.len().checked_sub(1).map_or(0.0, |last| self.lengths[last])
    }
}

/// Where domains begin; the last one again where there are fewer.
pub fn firsts<const D: usize>(frame: &Frame<D>, domains: &[usize]) -> [usize; LANES] {
    let last = domains.len() - 1;
    std::array::from_fn(|k| frame.first(domains[k.min(last)]))
}

/// Blocks of `values` without their means, side by side; their means and the sums of the squares. The same additions in the same order as one
/// by one.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
pub fn centred(
    values: &[f64],
    firsts: &[usize; LANES],
    offsets: &[usize],
    block: &mut [[f64; LANES]],
) -> ([f64; LANES], [f64; LANES]) {
    let mut means = [0.0; LANES];
    for (row, offset) in block.iter_mut().zip(offsets) {
        for ((v, first), sum) in row.iter_mut().zip(firsts).zip(&mut means) {
            *v = values[first + offset];
            *sum += *v;
        }
    }
    means.iter_mut().for_each(|m| *m /= offsets.len() as f64);
    let mut squares = [0.0; LANES];
    for row in block {
        for ((v, mean), sum) in row.iter_mut().zip(&means).zip(&mut squares) {
            *v -= *mean;
            *sum += *v * *v;
        }
    }
    (means, squares)
}

#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn lay(poses: &Poses, block: &mut [[f64; LANES]], scales: &[f64; LANES], out: &mut [f32], stride: usize) {
    poses.lay(block, scales, out, stride);
}
