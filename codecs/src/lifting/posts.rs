//! CDF 5/3 on 2^n + 1 posts a side: with the whole-point mirror there is exactly one detail coefficient a post, in the place of
//! the post (specification of GTB, section 1). Centres of squares carry the diagonal band, edges the two others; the four corners
//! carry what is left of the low band.

use crate::lattice::Lattice;

/// Heights (`side * side`) become coefficients, level by level from the finest. In place, linear in the posts.
pub fn forward(lattice: Lattice, z: &mut [f64]) {
    let side = lattice.side();
    for level in 0..lattice.n() {
        let s = 1usize << level;
        for y in (0..side).step_by(s) {
            ahead(&mut z[y * side..][..side], s);
        }
        along_columns(side, s, z, ahead);
    }
}

/// Takes [`forward`] back, but for the rounding of `f64`.
pub fn inverse(lattice: Lattice, z: &mut [f64]) {
    let side = lattice.side();
    for level in (0..lattice.n()).rev() {
        let s = 1usize << level;
        along_columns(side, s, z, back);
        for y in (0..side).step_by(s) {
            back(&mut z[y * side..][..side], s);
        }
    }
}

fn along_columns(side: usize, s: usize, z: &mut [f64], lift: fn(&mut [f64], usize)) {
    let mut line = vec![0.0; side.div_ceil(s)];
    for x in (0..side).step_by(s) {
        line.iter_mut().enumerate().for_each(|(k, v)| *v = z[k * s * side + x]);
        lift(&mut line, 1);
        line.iter().enumerate().for_each(|(k, v)| z[k * s * side + x] = *v);
    }
}

/// Odd posts less the mean of their neighbours; even posts and a quarter of both of these.
fn ahead(line: &mut [f64], s: usize) {
    for k in (s..line.len()).step_by(2 * s) {
        line[k] -= (line[k - s] + line[k + s]) / 2.0;
    }
    for k in (0..line.len()).step_by(2 * s) {
        line[k] += around(line, k, s) / 4.0;
    }
}

fn back(line: &mut [f64], s: usize) {
    for k in (0..line.len()).step_by(2 * s) {
        line[k] -= around(line, k, s) / 4.0;
    }
    for k in (s..line.len()).step_by(2 * s) {
        line[k] += (line[k - s] + line[k + s]) / 2.0;
    }
}

/// The sum of the two neighbours of an even post; mirrored at the ends.
fn around(line: &[f64], k: usize, s: usize) -> f64 {
    let west = if k >= s { line[k - s] } else { line[k + s] };
    let east = if k + s < line.len() { line[k + s] } else { west };
    west + east
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn back_and_forth() {
        for n in 0..=6 {
            let lattice = Lattice::new(n).unwrap();
            let posts = lattice.side() * lattice.side();
            let z: Vec<f64> =
                (0..posts).map(|k| f64::from((k as u32).wrapping_mul(2_654_435_761) >> 20)).collect();
            let mut w = z.clone();
            forward(lattice, &mut w);
            inverse(lattice, &mut w);
            assert!(z.iter().zip(&w).all(|(a, b)| (a - b).abs() < 1e-9), "n {n}");
        }
    }

    /// A plane has no details where no mirror bends it; of a plane along one axis none at all in the other's band.
    #[test]
    fn planes_have_no_details_inside() {
        let lattice = Lattice::new(4).unwrap();
        let side = lattice.side();
        let mut z: Vec<f64> = (0..side * side).map(|k| (k / side * 3 + k % side) as f64).collect();
        forward(lattice, &mut z);
        for p in lattice.pass(7).posts(lattice).chain(lattice.pass(6).posts(lattice)) {
            assert_eq!(z[p[0] * side + p[1]], 0.0, "{p:?}");
        }
    }
}
