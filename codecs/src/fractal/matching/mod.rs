//! For every range the domain that is most like it (specification section 2.1).

use super::domains::Domains;
use super::grid::{Grid, points};
use super::isometry::Isometry;
use super::scale;
use crate::work::{self, Workers};
use crate::{Error, Result};
use std::sync::OnceLock;

/// Which domains a range meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// All of them, in all orientations.
    Exact,
    /// Those whose quadrants have means in the same order, or in the reversed one for s < 0; in the plane only.
    Classes,
    /// Those of the so many by so many round the range, in all orientations.
    Near(usize),
}

/// The map of a range, but for its mean.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Match<const D: usize> {
    /// The domain, by its place among the domains of this side.
    pub domain: [usize; D],
    /// Number of the isometry in its group.
    pub isometry: usize,
    /// Level of s, not 0.
    pub scale: i8,
    /// Squared error over the samples of the range, with s as stored and the mean as it is.
    pub error: f64,
}

/// What ranges of one side are matched with.
pub struct Level<'a, const D: usize> {
    /// The tile; each side a multiple of the ranges'.
    pub grid: &'a Grid<D>,
    /// Its half.
    pub half: &'a Grid<D>,
    /// The domains.
    pub domains: Domains<D>,
    /// The orientations that they are tried in.
    pub isometries: &'a [Isometry<D>],
}

/// Ranges that are one part of the work.
const RANGES: usize = 64;

impl<const D: usize> Level<'_, D> {
    /// The best match of each range, by its corner; `None` where nothing beats the flat range. Of equal ones that of the first domain, then of the first
    /// isometry. The same whatever the workers.
    pub fn search(
        &self,
        ranges: &[[usize; D]],
        search: Search,
        workers: &dyn Workers,
    ) -> Result<Vec<Option<Match<D>>>> {
        if search == Search::Classes && D != 2 {
            return Err(Error::invalid("search", "classes are of the plane; take exact or near in space"));
        }
        let places: Vec<Vec<u32>> =
            self.isometries.iter().map(|i| i.inverse().places(self.domains.side)).collect();
        let parts = ranges.len().div_ceil(RANGES);
        let done: Vec<OnceLock<Vec<Option<Match<D>>>>> = vec![OnceLock::new(); parts];
        workers.run(parts, &|k| {
            let part = &ranges[k * RANGES..ranges.len().min((k + 1) * RANGES)];
            let width = if let Search::Near(w) = search { w } else { usize::MAX };
            let found = part.iter().map(|range| self.match_one(*range, width, &places)).collect();
            let _ = done[k].set(found);
        });
        work::check(workers, 1.0)?;
        Ok(done.into_iter().flat_map(|d| d.into_inner().unwrap_or_default()).collect())
    }

    fn match_one(&self, range: [usize; D], width: usize, places: &[Vec<u32>]) -> Option<Match<D>> {
        let side = self.domains.side;
        let n = side.pow(D as u32);
        let (mut r, mut d, mut turned) = (vec![0.0; n], vec![0.0; n], vec![0.0; n]);
        self.grid.block(range, side, &mut r);
        let rr = centre(&mut r);
        let mut best: Option<Match<D>> = None;
        let (first, count) = self.domains.near(range, width);
        for p in points(count) {
            let mut place = first;
            (0..D).for_each(|a| place[a] += p[a]);
            self.half.block(self.domains.corner(place).map(|v| v / 2), side, &mut d);
            let dd = centre(&mut d);
            for (isometry, places) in places.iter().enumerate() {
                turned.iter_mut().zip(places).for_each(|(t, p)| *t = r[*p as usize]);
                let rd = turned.iter().zip(&d).map(|(a, b)| a * b).sum::<f64>();
                let scale = scale::nearest(rd, dd);
                let error = scale::error(scale, rr, rd, dd);
                if scale != 0 && error < best.map_or(rr, |b| b.error) {
                    best = Some(Match { domain: place, isometry, scale, error });
                }
            }
        }
        best
    }
}

/// Takes the mean away; returns the sum of squares that is left.
fn centre(block: &mut [f64]) -> f64 {
    let mean = block.iter().sum::<f64>() / block.len() as f64;
    block.iter_mut().for_each(|v| *v -= mean);
    block.iter().map(|v| *v * *v).sum()
}
