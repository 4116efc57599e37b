//! Heights of a region as figures.

use super::Going;
use super::grid::{Grid, Spot};
use super::terrain::{Terrain, no_data};
use crate::base::Result;
use serde::Serialize;

/// What the heights of a region are like.
///
/// Area, mean and deviation weigh the centre of each cell with the cell's area in metres; min and max look at the
/// corners, too. On the default grid over one upright survey at tolerance 0 that makes min, max, mean and area those of
/// the bilinear surface exactly: a bilinear cell has its extremes at its posts and its mean at its centre. Elsewhere
/// (several surveys, coarser patches, a step of one's own) they are those of the points that were asked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistics {
    pub min_m: f64,
    pub min_at: [f64; 2],
    pub max_m: f64,
    pub max_at: [f64; 2],
    pub mean_m: f64,
    /// Standard deviation of the heights (not of their mean).
    pub std_m: f64,
    /// Largest certified error that was met, metres.
    pub error_m: f64,
    /// Region, and the part of it with data, square metres.
    pub area_m2: f64,
    pub data_m2: f64,
    /// Shares of the region: without data; with heights in the rim, whose error is not promised.
    pub share_without_data: f64,
    pub share_uncertified: f64,
    pub cells: u64,
    pub step: [f64; 2],
}

/// Weighted sums about a height near the mean, so that digits are kept.
#[derive(Default)]
struct Moments {
    origin: Option<f64>,
    weight: f64,
    first: f64,
    second: f64,
}

impl Moments {
    fn add(&mut self, z: f64, w: f64) {
        let d = z - *self.origin.get_or_insert(z);
        self.weight += w;
        self.first += w * d;
        self.second += w * d * d;
    }
    fn mean(&self) -> f64 {
        self.origin.unwrap_or(0.0) + self.first / self.weight
    }
    fn std(&self) -> f64 {
        let m = self.first / self.weight;
        (self.second / self.weight - m * m).max(0.0).sqrt()
    }
}

/// Statistics of the cells of a grid.
///
/// # Errors
/// [`crate::base::Error::Invalid`] if no point of the region has data.
pub fn statistics(terrain: &Terrain, grid: &Grid, going: Going) -> Result<Statistics> {
    let mut s = Statistics {
        min_m: f64::INFINITY,
        min_at: [0.0; 2],
        max_m: f64::NEG_INFINITY,
        max_at: [0.0; 2],
        mean_m: 0.0,
        std_m: 0.0,
        error_m: 0.0,
        area_m2: 0.0,
        data_m2: 0.0,
        share_without_data: 0.0,
        share_uncertified: 0.0,
        cells: 0,
        step: grid.step,
    };
    fn extremes(s: &mut Statistics, z: f64, at: [f64; 2]) {
        if z < s.min_m {
            (s.min_m, s.min_at) = (z, at);
        }
        if z > s.max_m {
            (s.max_m, s.max_at) = (z, at);
        }
    }
    let mut moments = Moments::default();
    let mut rim = 0.0;
    grid.ask(terrain, Spot::Centres, &|share| going(share / 2.0), |row, found| {
        let area = grid.cell_m2(row);
        for (col, e) in found.iter().enumerate() {
            let at = grid.centre(col, row);
            if !grid.contains(at) {
                continue;
            }
            s.area_m2 += area;
            s.cells += 1;
            let Some(e) = e else { continue };
            s.data_m2 += area;
            moments.add(e.z, area);
            extremes(&mut s, e.z, at);
            if e.certified {
                s.error_m = s.error_m.max(e.error_m);
            } else {
                rim += area;
            }
        }
        Ok(())
    })?;
    grid.ask(terrain, Spot::Corners, &|share| going(0.5 + share / 2.0), |row, found| {
        for (col, e) in found.iter().enumerate() {
            if let Some(e) = e {
                extremes(&mut s, e.z, grid.corner(col, row));
                if e.certified {
                    s.error_m = s.error_m.max(e.error_m);
                }
            }
        }
        Ok(())
    })?;
    if s.data_m2 == 0.0 {
        return Err(no_data());
    }
    (s.mean_m, s.std_m) = (moments.mean(), moments.std());
    s.share_without_data = 1.0 - s.data_m2 / s.area_m2;
    s.share_uncertified = rim / s.area_m2;
    Ok(s)
}
