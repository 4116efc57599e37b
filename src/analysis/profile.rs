//! Heights along a line.

use super::terrain::{Terrain, distance_m, no_data};
use crate::base::{Error, Result, limits};
use crate::height::crs::AxisUnit;
use serde::Serialize;

/// A point of a profile.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Station {
    /// From the first vertex along the line, metres.
    pub distance_m: f64,
    pub x: f64,
    pub y: f64,
    /// `None`: no data there.
    pub z: Option<f64>,
    /// `None` where no error is promised: without data, and in the rim of a survey.
    pub error_m: Option<f64>,
    /// This is a vertex of the line.
    pub vertex: bool,
}

/// The points of a line, one after the other: all its vertices, and between two of them equal steps of at most `step_m`
/// metres. Heights and errors are left open. Memory goes by the vertices, not by the points.
///
/// Without a step: the step of the finest survey that the segment may meet, so that no post is stepped over.
pub struct Stations {
    unit: AxisUnit,
    /// Ends of the segments that have a length, and the steps in each.
    segments: Vec<([f64; 2], [f64; 2], f64)>,
    count: u64,
    /// The segment and the step in it that come next.
    segment: usize,
    step: u64,
    last: Option<Station>,
}

impl Stations {
    /// At most `most` points.
    pub fn new(terrain: &Terrain, line: &[[f64; 2]], step_m: Option<f64>, most: u64) -> Result<Stations> {
        Stations::finer(terrain, line, step_m, 1.0, most)
    }

    /// `part`: of the finest survey's step, where no step is given.
    pub(super) fn finer(
        terrain: &Terrain,
        line: &[[f64; 2]],
        step_m: Option<f64>,
        part: f64,
        most: u64,
    ) -> Result<Stations> {
        if line.len() < 2 {
            return Err(Error::invalid("line", format!("{} points; a line needs two at least", line.len())));
        }
        if let Some(s) = step_m
            && !(s.is_finite() && s > 0.0)
        {
            return Err(Error::invalid("--step", format!("{s} m; it must be positive")));
        }
        let mut segments = Vec::with_capacity(line.len() - 1);
        let mut count = 1.0;
        for ends in line.windows(2) {
            let (a, b) = (ends[0], ends[1]);
            if ends.iter().flatten().any(|v| !v.is_finite()) {
                return Err(Error::invalid("line", format!("{a:?} to {b:?}: a coordinate is not finite")));
            }
            if a == b {
                continue;
            }
            let length = terrain.distance_m(a, b);
            let bounds = [a[0].min(b[0]), a[1].min(b[1]), a[0].max(b[0]), a[1].max(b[1])];
            let step = match (step_m, terrain.finest(bounds)) {
                (Some(s), _) => s,
                (None, Some(posts)) => {
                    let k = terrain.scale(a);
                    (posts.steps[0] * k[0]).min(posts.steps[1] * k[1]) * part
                }
                // No survey near: the ends are enough.
                (None, None) => length,
            };
            let n = (length / step - 1e-9).ceil().max(1.0);
            count += n;
            if count > most as f64 {
                let what = "points of a line (give a larger --step)";
                return Err(Error::limit(what, most, count as u64));
            }
            segments.push((a, b, n));
        }
        if segments.is_empty() {
            return Err(Error::invalid("line", "all its points are the same"));
        }
        let unit = terrain.ground.crs().unit;
        Ok(Stations { unit, segments, count: count as u64, segment: 0, step: 0, last: None })
    }

    /// How many points there are, those that have come included.
    pub fn total(&self) -> u64 {
        self.count
    }
}

impl Iterator for Stations {
    type Item = Station;

    fn next(&mut self) -> Option<Station> {
        let (a, b, n) = *self.segments.get(self.segment)?;
        let next = match &self.last {
            None => Station { distance_m: 0.0, x: a[0], y: a[1], z: None, error_m: None, vertex: true },
            Some(last) => {
                self.step += 1;
                let k = self.step as f64;
                let p = if k == n { b } else { [0, 1].map(|c| a[c] + (b[c] - a[c]) * (k / n)) };
                let distance_m = last.distance_m + distance_m(self.unit, [last.x, last.y], p);
                if k == n {
                    (self.segment, self.step) = (self.segment + 1, 0);
                }
                Station { distance_m, x: p[0], y: p[1], z: None, error_m: None, vertex: k == n }
            }
        };
        self.last = Some(next.clone());
        Some(next)
    }
}

/// All points of a line at once.
pub(super) fn stations(
    terrain: &Terrain,
    line: &[[f64; 2]],
    step_m: Option<f64>,
    part: f64,
) -> Result<Vec<Station>> {
    Ok(Stations::finer(terrain, line, step_m, part, limits::RASTER_POSTS_MAX / 10)?.collect())
}

/// The length in metres of a line of short steps.
pub fn line_length_m(stations: &[Station]) -> f64 {
    stations.last().map_or(0.0, |s| s.distance_m)
}

/// Heights and errors along a line. Distances are along the surface of the map, in a database in degrees by the length of
/// a degree at each step.
///
/// # Errors
/// [`Error::Invalid`] if the line has fewer than two different points, or no point of it has data.
pub fn profile(terrain: &Terrain, line: &[[f64; 2]], step_m: Option<f64>) -> Result<Vec<Station>> {
    let mut out = stations(terrain, line, step_m, 1.0)?;
    let points: Vec<[f64; 2]> = out.iter().map(|s| [s.x, s.y]).collect();
    let found = terrain.heights(&points)?;
    if found.iter().all(Option::is_none) {
        return Err(no_data());
    }
    for (s, e) in out.iter_mut().zip(found) {
        s.z = e.as_ref().map(|e| e.z);
        s.error_m = e.filter(|e| e.certified).map(|e| e.error_m);
    }
    Ok(out)
}
