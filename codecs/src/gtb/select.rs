//! Which posts to send: the rules (specification of GTB, section 3; region energy after Gross, as the paper names it).
//!
//! A [`Rule`] marks posts of a [`Ground`], as many as are wanted or as its threshold lets through. Posts without data are never
//! marked. What a selection looks like is the surface of midpoints over it, [`Ground::surface`].

use super::surface;
use crate::heights::Heights;
use crate::lattice::{Lattice, N_MAX};
use crate::{Error, Result, lifting};

/// Heights on their lattice, for rules.
pub struct Ground {
    lattice: Lattice,
    /// `side * side`; where there is no data, the midpoint of the hypotenuse.
    z: Vec<f64>,
    /// Posts without data: voids, and posts of the lattice outside the grid. Empty if there is none.
    free: Vec<bool>,
}

/// How many posts to mark.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// So many, the best ones, besides the corners.
    Posts(usize),
    /// All above a threshold: of what the rule ranks by, or the bound of the error itself for [`Bound`].
    Above(f64),
}

/// Chooses posts.
pub trait Rule {
    /// A name for tables.
    fn name(&self) -> &'static str;

    /// Marks posts of the lattice, `side * side`; corners and posts without data stay unmarked.
    fn select(&self, ground: &Ground, until: Until) -> Vec<bool>;
}

/// The published rule: magnitude of the 5/3 coefficient. The worst: heights are samples, not low-pass values, so a coefficient is
/// not the error that leaving a post out makes.
pub struct Coefficient;
/// Magnitude of the 5/3 coefficient times the step of its pass.
pub struct ScaledCoefficient;
/// Energy of the 5/3 coefficients of a region: a post's own and what the finer posts that it is an apex of hand on, half each.
pub struct RegionEnergy;
/// Distance from the midpoint of the hypotenuse, times the step of the pass: the best at a given number of posts.
pub struct Surplus;
/// A bound of the error at every post, by a closed loop: from coarse to fine a post is marked if the surface of those marked
/// before it is too far. Whatever is marked, no height is farther from the surface than the bound.
pub struct Bound;

/// All rules, for tables.
pub const RULES: [&dyn Rule; 5] = [&Coefficient, &ScaledCoefficient, &RegionEnergy, &Surplus, &Bound];

impl Ground {
    /// Puts heights on the smallest lattice that holds them. Refuses what [`Heights::check`] refuses and sides beyond the greatest
    /// lattice.
    pub fn new(heights: &Heights) -> Result<Ground> {
        heights.check()?;
        let longest = heights.cols.max(heights.rows);
        let lattice = Lattice::around(heights.cols, heights.rows).ok_or(Error::Limit {
            what: "posts along a side",
            limit: (1 << N_MAX) + 1,
            wanted: longest as u64,
        })?;
        let side = lattice.side();
        let mut z: Vec<f64> = super::field::spread(heights, lattice).into_iter().map(f64::from).collect();
        let mut free = Vec::new();
        if !heights.void.is_empty() || heights.cols < side || heights.rows < side {
            free = vec![true; side * side];
            for y in 0..heights.rows {
                for x in 0..heights.cols {
                    free[y * side + x] = heights.is_void(y * heights.cols + x);
                }
            }
            surface::fill(lattice, &mut z, |at| !free[at]);
        }
        Ok(Ground { lattice, z, free })
    }

    /// The lattice.
    pub fn lattice(&self) -> Lattice {
        self.lattice
    }

    /// Heights of the lattice, `side * side`; where there is no data, the midpoint of the hypotenuse.
    pub fn z(&self) -> &[f64] {
        &self.z
    }

    /// Whether a post has no data.
    pub fn is_free(&self, at: usize) -> bool {
        self.free.get(at).copied().unwrap_or(false)
    }

    /// The surface of a selection at every post.
    pub fn surface(&self, selected: &[bool]) -> Vec<f64> {
        let mut z = self.z.clone();
        surface::fill(self.lattice, &mut z, |at| selected[at] && !self.is_free(at));
        z
    }

    /// Root of the mean square and greatest distance of the heights from a surface.
    pub fn errors(&self, surface: &[f64]) -> (f64, f64) {
        let distances =
            (0..self.z.len()).filter(|at| !self.is_free(*at)).map(|at| (self.z[at] - surface[at]).abs());
        let (sum, count, most) = distances
            .fold((0.0, 0.0, 0.0_f64), |(sum, count, most), d| (sum + d * d, count + 1.0, most.max(d)));
        ((sum / f64::max(count, 1.0)).sqrt(), most)
    }

    /// Heights as 5/3 coefficients, magnitudes.
    fn coefficients(&self) -> Vec<f64> {
        let mut w = self.z.clone();
        lifting::posts::forward(self.lattice, &mut w);
        w.iter_mut().for_each(|v| *v = v.abs());
        w
    }

    /// Multiplies each post's rank by the step of its pass.
    fn scale(&self, ranks: &mut [f64]) {
        let side = self.lattice.side();
        for pass in self.lattice.passes() {
            pass.posts(self.lattice).for_each(|[y, x]| ranks[y * side + x] *= pass.step as f64);
        }
    }

    /// The posts with the greatest ranks; of equals the coarser, then the first in raster order.
    fn best(&self, ranks: &[f64], until: Until) -> Vec<bool> {
        let side = self.lattice.side();
        let mut marks = vec![false; ranks.len()];
        let mut posts = Vec::new();
        for pass in self.lattice.passes() {
            for [y, x] in pass.posts(self.lattice) {
                let at = y * side + x;
                if !self.is_free(at) {
                    match until {
                        Until::Above(least) => marks[at] = ranks[at] > least,
                        Until::Posts(_) => posts.push((posts.len() as u32, at as u32)),
                    }
                }
            }
        }
        if let Until::Posts(count) = until {
            if count < posts.len() {
                let order = |a: &(u32, u32), b: &(u32, u32)| {
                    ranks[b.1 as usize].total_cmp(&ranks[a.1 as usize]).then(a.0.cmp(&b.0))
                };
                posts.select_nth_unstable_by(count, order);
                posts.truncate(count);
            }
            posts.into_iter().for_each(|(_, at)| marks[at as usize] = true);
        }
        marks
    }
}

impl Rule for Coefficient {
    fn name(&self) -> &'static str {
        "5/3 coefficient"
    }
    fn select(&self, ground: &Ground, until: Until) -> Vec<bool> {
        ground.best(&ground.coefficients(), until)
    }
}

impl Rule for ScaledCoefficient {
    fn name(&self) -> &'static str {
        "5/3 coefficient x s"
    }
    fn select(&self, ground: &Ground, until: Until) -> Vec<bool> {
        let mut ranks = ground.coefficients();
        ground.scale(&mut ranks);
        ground.best(&ranks, until)
    }
}

impl Rule for RegionEnergy {
    fn name(&self) -> &'static str {
        "region energy"
    }
    fn select(&self, ground: &Ground, until: Until) -> Vec<bool> {
        let (lattice, side) = (ground.lattice, ground.lattice.side());
        let mut energy = ground.coefficients();
        energy.iter_mut().for_each(|v| *v *= *v);
        for pass in lattice.passes().rev() {
            for post in pass.posts(lattice) {
                let half = energy[post[0] * side + post[1]] / 2.0;
                let (_, apexes) = pass.parents(lattice, post);
                apexes.into_iter().flatten().for_each(|[y, x]| energy[y * side + x] += half);
            }
        }
        ground.best(&energy, until)
    }
}

impl Rule for Surplus {
    fn name(&self) -> &'static str {
        "surplus x s"
    }
    fn select(&self, ground: &Ground, until: Until) -> Vec<bool> {
        let (lattice, side) = (ground.lattice, ground.lattice.side());
        let mut ranks = vec![0.0; side * side];
        for pass in lattice.passes() {
            for post in pass.posts(lattice) {
                let ([a, b], _) = pass.parents(lattice, post);
                let middle = (ground.z[a[0] * side + a[1]] + ground.z[b[0] * side + b[1]]) / 2.0;
                let at = post[0] * side + post[1];
                ranks[at] = (ground.z[at] - middle).abs() * pass.step as f64;
            }
        }
        ground.best(&ranks, until)
    }
}

impl Rule for Bound {
    fn name(&self) -> &'static str {
        "error bound"
    }
    fn select(&self, ground: &Ground, until: Until) -> Vec<bool> {
        let count = |marks: &[bool]| marks.iter().filter(|m| **m).count();
        match until {
            Until::Above(bound) => within(ground, bound),
            Until::Posts(most) => {
                // A bound that so many posts can keep, to a 64th of a unit; about the smallest: a greater one takes more posts
                // now and then.
                let (mut low, mut high) = (-1i64, 64 << 27);
                while high - low > 1 {
                    let middle = low + (high - low) / 2;
                    match count(&within(ground, middle as f64 / 64.0)) <= most {
                        true => high = middle,
                        false => low = middle,
                    }
                }
                within(ground, high as f64 / 64.0)
            }
        }
    }
}

/// The closed loop.
fn within(ground: &Ground, bound: f64) -> Vec<bool> {
    let (lattice, side) = (ground.lattice, ground.lattice.side());
    let mut surface = ground.z.clone();
    let mut marks = vec![false; side * side];
    for pass in lattice.passes() {
        for post in pass.posts(lattice) {
            let at = post[0] * side + post[1];
            let ([a, b], _) = pass.parents(lattice, post);
            let middle = (surface[a[0] * side + a[1]] + surface[b[0] * side + b[1]]) / 2.0;
            marks[at] = !ground.is_free(at) && (surface[at] - middle).abs() > bound;
            if !marks[at] {
                surface[at] = middle;
            }
        }
    }
    marks
}
