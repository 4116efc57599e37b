//! The symmetries of the square and of the cube, as signed permutations of the axes.

use super::grid::strides;
use crate::{Error, Result};

/// Turns and mirrors a cube onto itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Isometry<const D: usize> {
    /// For each axis of the block that is read: the axis of the block that is made which runs along it, and whether backwards.
    pub of: [(usize, bool); D],
}

impl<const D: usize> Isometry<D> {
    /// Nothing moves.
    pub fn identity() -> Isometry<D> {
        Isometry { of: std::array::from_fn(|a| (a, false)) }
    }

    /// From a point of the block that is made (0 to `side` along each axis) to that of the block that is read.
    #[inline(always)]
    pub fn source(&self, p: [f64; D], side: f64) -> [f64; D] {
        self.of.map(|(axis, back)| if back { side - p[axis] } else { p[axis] })
    }

    /// From a sample of the block that is made to that of the block that is read.
    #[inline(always)]
    pub fn sample(&self, p: [usize; D], side: usize) -> [usize; D] {
        self.of.map(|(axis, back)| if back { side - 1 - p[axis] } else { p[axis] })
    }

    /// How to read a block of `side` that lies in a grid with these strides: where its first sample is, and the steps from there.
    #[inline(always)]
    pub fn steps(&self, strides: [usize; D], side: usize) -> (usize, [isize; D]) {
        let mut start = 0;
        let mut steps = [0; D];
        for (a, (axis, back)) in self.of.into_iter().enumerate() {
            if back {
                start += (side - 1) * strides[a];
            }
            steps[axis] = if back { -(strides[a] as isize) } else { strides[a] as isize };
        }
        (start, steps)
    }

    /// What undoes it.
    pub fn inverse(&self) -> Isometry<D> {
        let mut of = [(0, false); D];
        for (a, (axis, back)) in self.of.into_iter().enumerate() {
            of[axis] = (a, back);
        }
        Isometry { of }
    }

    /// For each sample of the block that is made, the place in memory of the sample that is read, both blocks lying alone.
    pub fn places(&self, side: usize) -> Vec<u32> {
        let (start, steps) = self.steps(strides([side; D]), side);
        super::grid::points([side; D])
            .map(|p| (start as isize + (0..D).map(|a| p[a] as isize * steps[a]).sum::<isize>()) as u32)
            .collect()
    }
}

/// The group of so many isometries, the identity first.
///
/// In the plane 1 or 8: number k transposes if `k & 4`, then turns by 90 degrees counter-clockwise `k & 3` times. In space 1, 16 (the third axis
/// kept, or turned over), 24 (all turns) or 48 (and their mirror images).
pub fn group<const D: usize>(order: usize) -> Result<Vec<Isometry<D>>> {
    let all: Vec<Isometry<D>> = match (D, order) {
        (_, 1) => vec![Isometry::identity()],
        (2, 8) => (0..8).map(planar).collect(),
        (3, 16) => cube().into_iter().filter(|i| i.of[D - 1].0 == D - 1).collect(),
        (3, 24) => cube().into_iter().filter(turns).collect(),
        (3, 48) => cube(),
        (2, _) => return Err(Error::invalid("isometries", format!("{order}; 1 or 8 in the plane"))),
        _ => return Err(Error::invalid("isometries", format!("{order}; 1, 16, 24 or 48 in space"))),
    };
    Ok(all)
}

fn planar<const D: usize>(k: usize) -> Isometry<D> {
    let mut of: [(usize, bool); D] = std::array::from_fn(|a| (a, false));
    // A turn reads column n - 1 - row, row column.
    for _ in 0..k & 3 {
        of = std::array::from_fn(|a| if a == 0 { (of[1].0, !of[1].1) } else { of[0] });
    }
    if k & 4 != 0 {
        of.swap(0, 1);
    }
    Isometry { of }
}

/// All signed permutations of the axes, the identity first.
fn cube<const D: usize>() -> Vec<Isometry<D>> {
    let mut out = Vec::new();
    for axes in 0..D.pow(D as u32) {
        let axis: [usize; D] = std::array::from_fn(|a| (axes / D.pow((D - 1 - a) as u32)) % D);
        if (0..D).any(|a| axis[..a].contains(&axis[a])) {
            continue;
        }
        for signs in 0..1 << D {
            out.push(Isometry { of: std::array::from_fn(|a| (axis[a], signs >> a & 1 == 1)) });
        }
    }
    out
}

/// Whether it can be done without a mirror.
fn turns<const D: usize>(i: &Isometry<D>) -> bool {
    let mut odd = i.of.iter().filter(|(_, back)| *back).count();
    for a in 0..D {
        odd += (a + 1..D).filter(|b| i.of[*b].0 < i.of[a].0).count();
    }
    odd % 2 == 0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn applied<const D: usize>(i: &Isometry<D>, side: usize, block: &[u32]) -> Vec<u32> {
        i.places(side).iter().map(|p| block[*p as usize]).collect()
    }

    #[test]
    fn the_eight_are_those_of_the_specification() {
        let block: Vec<u32> = (0..9).collect();
        let turned = |b: &[u32]| (0..9).map(|k| b[(k % 3) * 3 + 2 - k / 3]).collect::<Vec<u32>>();
        for (k, i) in group::<2>(8).unwrap().iter().enumerate() {
            let mut want = block.clone();
            if k & 4 != 0 {
                want = (0..9).map(|k| want[(k % 3) * 3 + k / 3]).collect();
            }
            for _ in 0..k & 3 {
                want = turned(&want);
            }
            assert_eq!(applied(i, 3, &block), want, "isometry {k}");
        }
    }

    fn is_a_group<const D: usize>(order: usize) {
        let all = group::<D>(order).unwrap();
        assert_eq!(all.len(), order);
        assert_eq!(all[0], Isometry::identity());
        let block: Vec<u32> = (0..3_u32.pow(D as u32)).collect();
        let images: Vec<Vec<u32>> = all.iter().map(|i| applied(i, 3, &block)).collect();
        for (k, a) in images.iter().enumerate() {
            assert!(!images[..k].contains(a), "two are the same");
            assert_eq!(applied(&all[k].inverse(), 3, a), block);
            assert!(all.iter().all(|i| images.contains(&applied(i, 3, a))), "not closed");
        }
    }

    #[test]
    fn each_is_a_group() {
        [1, 8].into_iter().for_each(is_a_group::<2>);
        [1, 16, 24, 48].into_iter().for_each(is_a_group::<3>);
        assert!(group::<3>(32).is_err());
    }
}
