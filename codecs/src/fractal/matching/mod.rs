//! For every range the domain that is most like it (specification section 2.1).
//!
//! The **plain form** tries every pair in f64. What is done here gives the same matches, to the last bit, in a small part of the time: the
//! correlations of all pairs are found in f32 with a proven bound on their error, and only the pairs that may beat the best so far are tried as
//! the plain form does it.
//!
//! - `frame`: what is common to all ranges of a level
//! - `poses`: the orientations of a range, four or eight at the price of one
//! - `strip`: domains side by side
//! - `screen`: a range and a strip: what each pair can gain at most
//! - `sought`: a range and its best match so far
//! - `classes`: the order of quadrants
//! - `everywhere`, `near`: which ranges meet which domains, and when
//! - `plain`: the plain form

mod classes;
mod everywhere;
mod frame;
mod near;
mod plain;
mod poses;
mod screen;
mod sought;
mod strip;
#[cfg(test)]
mod tests;

use super::domains::Domains;
use super::grid::Grid;
use super::isometry::Isometry;
use super::scale::Scales;
use crate::work::{self, Workers};
use crate::{Error, Result};
use frame::Frame;
use std::sync::OnceLock;

/// Which domains a range meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// All of them, in all orientations.
    Exact,
    /// Those whose quadrants have means in the same order, or in the reversed one, each in the one orientation that makes it so; in the plane
    /// only. Of the pairs of `Exact` a twelfth.
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
    /// The levels of s.
    pub scales: Scales,
}

/// Ranges that are one part of the work where little is to be done with each.
const RANGES: usize = 512;

/// Multiplications in f32 between two questions whether to go on: some tenths of a second. In tests small grids shall fall into parts as well.
const BATCH: usize = if cfg!(test) { 100_000 } else { 4_000_000_000 };

impl<const D: usize> Level<'_, D> {
    /// The best match of each range, by its corner; `None` where nothing beats the flat range. Of equal ones that of the first domain, then of the first
    /// isometry. The same whatever the workers.
    ///
    /// Cost: samples of a range x domains that it meets x orders of the axes (2 in the plane, up to 6 in space) multiplications in f32 a range,
    /// nothing for flat ranges. Domains are laid out anew in each call: ask for many ranges at once. Memory: some 16 MiB, and a few bytes a range.
    pub fn search(
        &self,
        ranges: &[[usize; D]],
        search: Search,
        workers: &dyn Workers,
    ) -> Result<Vec<Option<Match<D>>>> {
        if search == Search::Classes && (D != 2 || self.domains.side % 2 == 1) {
            return Err(Error::invalid(
                "search",
                "classes are of the plane, of even sides; take exact or near",
            ));
        }
        work::check(workers, 0.0)?;
        let mut out = vec![None; ranges.len()];
        if !self.domains.is_empty() {
            let frame = Frame::new(self, search);
            let mut sought = Vec::new();
            for found in collect(workers, ranges.len().div_ceil(RANGES), &|k| {
                let first = k * RANGES;
                let part = &ranges[first..ranges.len().min(first + RANGES)];
                frame.sought(first, part, search)
            }) {
                sought.extend(found);
            }
            match search {
                Search::Near(width) => near::search(&frame, width, &mut sought, workers)?,
                _ => everywhere::search(&frame, &mut sought, workers)?,
            }
            for s in sought {
                out[s.index] = s.found(&frame);
            }
        }
        work::check(workers, 1.0)?;
        Ok(out)
    }

    /// How many pairs of a domain and an isometry the ranges meet in a search: what the plain form would try.
    pub fn pairs(&self, ranges: &[[usize; D]], search: Search) -> u64 {
        let orders = self.isometries.len() as u64;
        match search {
            Search::Exact => ranges.len() as u64 * self.domains.len() as u64 * orders,
            Search::Near(width) => {
                let near = |range: &[usize; D]| self.domains.near(*range, width).1;
                ranges.iter().map(|r| near(r).iter().product::<usize>() as u64 * orders).sum()
            }
            Search::Classes => classes::pairs(&Frame::new(self, search), ranges),
        }
    }
}

/// What each part of the work makes, in order.
fn collect<T: Send + Sync>(
    workers: &dyn Workers,
    parts: usize,
    make: &(dyn Fn(usize) -> T + Sync),
) -> impl Iterator<Item = T> {
    let done: Vec<OnceLock<T>> = (0..parts).map(|_| OnceLock::new()).collect();
    workers.run(parts, &|k| {
        let _ = done[k].set(make(k));
    });
    done.into_iter().filter_map(OnceLock::into_inner)
}
