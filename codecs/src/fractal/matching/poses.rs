//! The orientations of a range as they are multiplied with domains.
//!
//! A mirror image along an axis adds nothing to the work: a block falls into the 2^D parts that each of the mirrors keeps or negates, and the
//! products of the parts, with signs, add up to the correlation under every combination of mirrors. A **pose** is an order of the axes; it stands
//! for 2^D isometries and costs as much as one.

use super::super::grid::points;
use super::super::isometry::Isometry;

/// The orientations of the ranges of one side.
pub struct Poses {
    /// Sums that are kept apart: 4, or 8 in space with mirrors.
    pub parts: usize,
    /// Whether the parts are those of the mirrors; otherwise their sum is the correlation.
    pub mirrors: bool,
    /// Numbers of a block: its samples, filled up to a multiple of the parts.
    pub rows: usize,
    /// The orders of the axes, or else the isometries one by one.
    pub poses: Vec<Pose>,
    /// Samples that mirror each other, axis after axis.
    pairs: Vec<(u32, u32)>,
    /// For each row the sample that becomes it: part after part, and then the next sample of each part.
    order: Vec<u32>,
    /// By how much mirroring makes a block longer.
    length: f64,
}

/// One orientation, or 2^D that differ by mirrors.
pub struct Pose {
    /// The sample of the range that meets each sample of the domain.
    places: Vec<u32>,
    /// The isometry for each combination of mirrors, bit a for axis a; `None` where it is not asked for.
    pub isometries: Vec<Option<usize>>,
}

impl Poses {
    /// Of these isometries, with mirrors if it pays and may be.
    pub fn new<const D: usize>(isometries: &[Isometry<D>], side: usize, mirrors: bool) -> Poses {
        let samples = side.pow(D as u32);
        let mut poses: Vec<(Isometry<D>, Pose)> = Vec::new();
        for (number, isometry) in isometries.iter().enumerate() {
            // The range is turned back to meet the domain.
            let of = isometry.inverse().of;
            let straight = Isometry { of: of.map(|(axis, _)| (axis, false)) };
            let mirrored = of.iter().map(|(axis, back)| usize::from(*back) << axis).sum::<usize>();
            let known = poses.iter().position(|(i, _)| *i == straight).unwrap_or_else(|| {
                let pose = Pose { places: straight.places(side), isometries: vec![None; 1 << D] };
                poses.push((straight, pose));
                poses.len() - 1
            });
            poses[known].1.isometries[mirrored] = Some(number);
        }
        let mirrors = mirrors && side.is_multiple_of(2) && poses.len() < isometries.len();
        if !mirrors {
            let one = |(k, i): (usize, &Isometry<D>)| Pose {
                places: i.inverse().places(side),
                isometries: vec![Some(k)],
            };
            let rows = samples.next_multiple_of(4);
            let order = (0..samples as u32).collect();
            let poses = isometries.iter().enumerate().map(one).collect();
            return Poses { parts: 4, mirrors, rows, poses, pairs: Vec::new(), order, length: 1.0 };
        }
        let at = |p: [usize; D]| (0..D).rev().fold(0, |n, a| n * side + p[a]) as u32;
        let opposite = |mut p: [usize; D], axes: usize| {
            (0..D).filter(|a| axes >> a & 1 == 1).for_each(|a| p[a] = side - 1 - p[a]);
            p
        };
        let mut pairs = Vec::new();
        for a in 0..D {
            let first = points([side; D]).filter(|p| p[a] < side / 2);
            pairs.extend(first.map(|p| (at(p), at(opposite(p, 1 << a)))));
        }
        let corner = points([side / 2; D]);
        let order = corner.flat_map(|p| (0..1 << D).map(move |part| at(opposite(p, part)))).collect();
        let poses = poses.into_iter().map(|(_, pose)| pose).collect();
        let length = f64::from(1_u32 << D).sqrt();
        Poses { parts: 1 << D, mirrors, rows: samples, poses, pairs, order, length }
    }

    /// A block without its mean, by its length, in all poses: one after the other, `rows` each, all of length 1.
    pub fn of(&self, block: &[f64], length: f64) -> Vec<f32> {
        let mut out = vec![0.0; self.poses.len() * self.rows];
        let mut turned = vec![[0.0]; block.len()];
        for (pose, out) in self.poses.iter().zip(out.chunks_exact_mut(self.rows)) {
            turned.iter_mut().zip(&pose.places).for_each(|(t, p)| t[0] = block[*p as usize]);
            self.lay(&mut turned, &[1.0 / length], out, 1);
        }
        out
    }

    /// Blocks beside each other into rows that are `stride` apart, each times its scale; they lose what was in them.
    #[inline(always)]
    pub fn lay<const N: usize>(
        &self,
        blocks: &mut [[f64; N]],
        scales: &[f64; N],
        out: &mut [f32],
        stride: usize,
    ) {
        for (i, j) in &self.pairs {
            let (front, back) = blocks.split_at_mut(*j as usize);
            for (a, b) in front[*i as usize].iter_mut().zip(&mut back[0]) {
                (*a, *b) = (*a + *b, *a - *b);
            }
        }
        let scales = scales.map(|s| s / self.length);
        for (from, out) in self.order.iter().zip(out.chunks_mut(stride)) {
            for ((out, v), s) in out.iter_mut().zip(&blocks[*from as usize]).zip(&scales) {
                *out = (*v * *s) as f32;
            }
        }
    }
}
