//! Which class each cell of a picture belongs to (specification of GTB, sections 6.1 and 6.2).

use super::Cells;
use super::isodata::{Bounds, Classes, classify};
use crate::lifting::cells::{Band, Wavelet};

/// Levels of the wavelet that classes are sought on, the coarsest first.
const COARSEST: u32 = 4;
/// Classes are taken from this level: squares of 8 x 8 cells.
const FINEST: u32 = 3;
/// What the centre of the parent's class weighs.
const PARENT: f64 = 0.7;
/// Colours and energies of three bands.
const AXES: usize = 6;

/// Class of each cell, from 1; 0 where there is no picture. Cells without one are [`filled`].
pub fn labels(cells: &Cells) -> Vec<u8> {
    let side = 1usize << cells.n;
    let coarsest = COARSEST.min(cells.n);
    let finest = FINEST.min(coarsest);
    let planes = [0, 1, 2].map(|ch| cells.rgb.iter().map(|c| i32::from(c[ch])).collect::<Vec<i32>>());
    let mut before: Option<(usize, Classes)> = None;
    for level in (finest..=coarsest).rev() {
        let own = features(&planes, side, level);
        let width = side >> level;
        let (vectors, axes) = match &before {
            None => (own, AXES),
            Some((above, classes)) => {
                let inherit = |k: usize| {
                    let parent = &classes.centres[classes.labels[(k / width / 2) * above + k % width / 2]];
                    parent[..AXES].iter().map(|v| v * PARENT).collect::<Vec<f64>>()
                };
                let both = own.chunks_exact(AXES).enumerate();
                (both.flat_map(|(k, v)| [v.to_vec(), inherit(k)].concat()).collect(), 2 * AXES)
            }
        };
        before = Some((width, classify(&vectors, axes, &Bounds::default())));
    }
    let (width, classes) = before.unwrap_or((1, Classes { labels: vec![0], centres: Vec::new() }));
    let smooth = majority(&classes.labels, width);
    let cell = |y: usize, x: usize| smooth[(y >> finest) * width + (x >> finest)] as u8 + 1;
    let mut out: Vec<u8> = (0..side * side).map(|k| cell(k / side, k % side)).collect();
    out.iter_mut().zip(&cells.void).filter(|(_, v)| **v).for_each(|(l, _)| *l = 0);
    out
}

/// The colours, with cells without a picture like the last one to the west, or to the north: no edges where there are none.
pub fn filled(cells: &Cells) -> Vec<[u8; 3]> {
    let mut out = cells.rgb.clone();
    let side = 1usize << cells.n;
    let Some(first) = cells.void.iter().position(|v| !v) else { return out };
    let mut last = out[first];
    for (k, void) in cells.void.iter().enumerate() {
        if !void {
            last = out[k];
        } else {
            if k % side == 0 && k >= side {
                last = out[k - side];
            }
            out[k] = last;
        }
    }
    out
}

/// [`AXES`] numbers of each place of a level, in deviations from the mean: the low band of the channels, and the mean of each band's
/// magnitudes over 5 x 5 places and the channels.
pub fn features(planes: &[Vec<i32>; 3], side: usize, level: u32) -> Vec<f64> {
    let width = side >> level;
    let mut out = vec![0.0; width * width * AXES];
    let mut energy = vec![0.0; width * width];
    let mut lifted = planes.clone();
    lifted.iter_mut().for_each(|p| Wavelet::FiveThree.forward(p, side, level));
    for (axis, p) in lifted.iter().enumerate() {
        (0..width * width).for_each(|k| out[k * AXES + axis] = f64::from(p[(k / width) * side + k % width]));
    }
    for (b, band) in Band::ALL.into_iter().enumerate().filter(|_| level > 0) {
        let [ys, xs] = band.area(side, level);
        for (k, e) in energy.iter_mut().enumerate() {
            let at = (ys.start + k / width) * side + xs.start + k % width;
            *e = lifted.iter().map(|p| f64::from(p[at].abs())).sum::<f64>() / 3.0;
        }
        for k in 0..width * width {
            let around = |v: usize| v.saturating_sub(2)..(v + 3).min(width);
            let (mut sum, mut count) = (0.0, 0.0);
            for y in around(k / width) {
                for x in around(k % width) {
                    sum += energy[y * width + x];
                    count += 1.0;
                }
            }
            out[k * AXES + 3 + b] = sum / count;
        }
    }
    for axis in 0..AXES {
        let n = (width * width) as f64;
        let mean = (0..width * width).map(|k| out[k * AXES + axis]).sum::<f64>() / n;
        let square = (0..width * width)
            .map(|k| (out[k * AXES + axis] - mean) * (out[k * AXES + axis] - mean))
            .sum::<f64>()
            / n;
        let deviation = square.sqrt().max(1e-9);
        (0..width * width).for_each(|k| out[k * AXES + axis] = (out[k * AXES + axis] - mean) / deviation);
    }
    out
}

/// The commonest label of 3 x 3; the own one if it is among the commonest.
fn majority(labels: &[usize], width: usize) -> Vec<usize> {
    let most = labels.iter().max().map_or(0, |k| k + 1);
    (0..width * width)
        .map(|k| {
            let around = |v: usize| v.saturating_sub(1)..(v + 2).min(width);
            let mut counts = vec![0; most];
            for y in around(k / width) {
                for x in around(k % width) {
                    counts[labels[y * width + x]] += 1;
                }
            }
            let best = (0..most).max_by_key(|l| (counts[*l], usize::MAX - l)).unwrap_or(0);
            if counts[labels[k]] == counts[best] { labels[k] } else { best }
        })
        .collect()
}
