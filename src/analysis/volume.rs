//! What lies between two states of the ground: cut, fill, and how sure they are.

use super::Going;
use super::grid::{Grid, Spot};
use super::terrain::{Terrain, no_data};
use crate::base::{Error, Result};
use serde::Serialize;

/// Volumes between two surfaces. Rises count as fill, falls as cut; both are positive numbers.
///
/// Each cell of the grid counts with the difference at its centre times its area in metres: exact for the net volume
/// of bilinear surfaces whose posts are the corners of the grid. Cells where either state has no data, or only heights of
/// the rim whose error is not promised, are left out and their area is told.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Volumes {
    pub cut_m3: f64,
    pub fill_m3: f64,
    /// Fill minus cut.
    pub net_m3: f64,
    /// The worst case: the net volume of the ground lies within this of `net_m3` if no height is wrong by more than the
    /// `error_m` of its surface, even if all are wrong by that in the same direction. Sum of (error + error) times area.
    pub net_bound_m3: f64,
    /// In the same worst case, cut and fill lie between these.
    pub cut_range_m3: [f64; 2],
    pub fill_range_m3: [f64; 2],
    /// One standard deviation of the net volume if errors were spread evenly within +-`error_m` and independent beyond
    /// `independent_beyond_m` of each other. An assumption, not a certificate: it knows nothing of a common shift.
    pub net_std_m3: f64,
    pub independent_beyond_m: f64,
    /// Area that was compared, and its part where the difference is beyond both errors.
    pub area_m2: f64,
    pub changed_m2: f64,
    /// Area left out: no data in one state or both; heights without a promised error.
    pub without_data_m2: f64,
    pub uncertified_m2: f64,
    /// Mean of the differences, their extremes, and the largest sum of both errors, metres.
    pub mean_m: f64,
    pub lowest_m: f64,
    pub highest_m: f64,
    pub error_m: f64,
    pub cells: u64,
    pub step: [f64; 2],
}

/// Compares two states on a grid. `f` gets each row of differences `to - from`, NaN where either has no data.
///
/// `independent_beyond_m`: how far apart errors are taken for independent; default: the coarsest step of the surveys of
/// both states.
///
/// # Errors
/// [`Error::Invalid`] if there is no cell with data in both.
pub fn volumes(
    from: &Terrain,
    to: &Terrain,
    grid: &Grid,
    independent_beyond_m: Option<f64>,
    going: Going,
    mut f: impl FnMut(usize, &[f32]) -> Result<()>,
) -> Result<Volumes> {
    let beyond = match independent_beyond_m {
        Some(m) if m.is_finite() && m >= 0.0 => m,
        Some(m) => {
            return Err(Error::invalid("--independent-beyond", format!("{m} m; it must not be negative")));
        }
        None => coarsest_m(&[from, to], grid),
    };
    let mut c = Volumes {
        cut_m3: 0.0,
        fill_m3: 0.0,
        net_m3: 0.0,
        net_bound_m3: 0.0,
        cut_range_m3: [0.0; 2],
        fill_range_m3: [0.0; 2],
        net_std_m3: 0.0,
        independent_beyond_m: beyond,
        area_m2: 0.0,
        changed_m2: 0.0,
        without_data_m2: 0.0,
        uncertified_m2: 0.0,
        mean_m: 0.0,
        lowest_m: f64::INFINITY,
        highest_m: f64::NEG_INFINITY,
        error_m: 0.0,
        cells: 0,
        step: grid.step,
    };
    let mut variance = 0.0;
    let mut any = false;
    let mut line = vec![f32::NAN; grid.cols];
    for (rows, share) in grid.bands(Spot::Centres) {
        if !going(share) {
            return Err(Error::Stopped);
        }
        let before = grid.band(from, Spot::Centres, rows.clone())?;
        let after = grid.band(to, Spot::Centres, rows.clone())?;
        for (k, row) in rows.enumerate() {
            let area = grid.cell_m2(row);
            // Cells within which errors go together count as one.
            let together = (beyond * beyond / area).max(1.0);
            for (col, d) in line.iter_mut().enumerate() {
                *d = f32::NAN;
                let (a, b) = (&before[k * grid.cols + col], &after[k * grid.cols + col]);
                let (Some(a), Some(b)) = (a, b) else {
                    if grid.contains(grid.centre(col, row)) {
                        c.without_data_m2 += area;
                    }
                    continue;
                };
                let rise = b.z - a.z;
                *d = rise as f32;
                any = true;
                if !(a.certified && b.certified) {
                    c.uncertified_m2 += area;
                    continue;
                }
                let error = a.error_m + b.error_m;
                c.cells += 1;
                c.area_m2 += area;
                c.fill_m3 += rise.max(0.0) * area;
                c.cut_m3 += (-rise).max(0.0) * area;
                c.net_bound_m3 += error * area;
                for (range, v) in [(&mut c.fill_range_m3, rise), (&mut c.cut_range_m3, -rise)] {
                    range[0] += (v - error).max(0.0) * area;
                    range[1] += (v + error).max(0.0) * area;
                }
                variance += (a.error_m * a.error_m + b.error_m * b.error_m) / 3.0 * area * area * together;
                if rise.abs() > error {
                    c.changed_m2 += area;
                }
                c.lowest_m = c.lowest_m.min(rise);
                c.highest_m = c.highest_m.max(rise);
                c.error_m = c.error_m.max(error);
            }
            f(row, &line)?;
        }
    }
    if !any {
        return Err(no_data());
    }
    if c.cells == 0 {
        return Err(Error::invalid(
            "region",
            "both states have heights there only in the outermost cells of surveys, whose error is not promised",
        ));
    }
    c.net_m3 = c.fill_m3 - c.cut_m3;
    c.net_std_m3 = variance.sqrt();
    c.mean_m = c.net_m3 / c.area_m2;
    Ok(c)
}

/// The coarsest step of all surveys of some states, metres.
fn coarsest_m(terrains: &[&Terrain], grid: &Grid) -> f64 {
    let k = terrains[0].scale(grid.centre(grid.cols / 2, grid.rows / 2));
    let steps = terrains.iter().flat_map(|t| t.ground.posts()).map(|p| p.steps);
    steps.map(|s| (s[0] * k[0]).max(s[1] * k[1])).fold(0.0, f64::max)
}
