//! Heights along a line.

use super::terrain::{Terrain, no_data};
use crate::base::{Error, Result, limits};
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

/// Points along a line: all its vertices, and between two of them equal steps of at most `step_m` metres.
///
/// Without a step: the step of the finest survey that the segment may meet, so that no post is stepped over.
/// Also returns whether any survey is near.
pub(super) fn stations(
    terrain: &Terrain,
    line: &[[f64; 2]],
    step_m: Option<f64>,
    part: f64,
) -> Result<Vec<Station>> {
    if line.len() < 2 {
        return Err(Error::invalid("line", format!("{} points; a line needs two at least", line.len())));
    }
    if let Some(s) = step_m
        && !(s.is_finite() && s > 0.0)
    {
        return Err(Error::invalid("--step", format!("{s} m; it must be positive")));
    }
    let mut out =
        vec![Station { distance_m: 0.0, x: line[0][0], y: line[0][1], z: None, error_m: None, vertex: true }];
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
            (None, Some(n)) => {
                let steps = terrain.snapshot.survey_by_number(n)?.geometry.steps;
                let k = terrain.scale(a);
                (steps[0] * k[0]).min(steps[1] * k[1]) * part
            }
            // No survey near: the ends are enough.
            (None, None) => length,
        };
        let n = (length / step - 1e-9).ceil().max(1.0);
        if out.len() as f64 + n > limits::RASTER_POSTS_MAX as f64 / 10.0 {
            return Err(Error::limit(
                "points of a line (give a larger --step)",
                limits::RASTER_POSTS_MAX / 10,
                (out.len() as f64 + n) as u64,
            ));
        }
        for k in 1..=n as usize {
            let t = k as f64 / n;
            let p = if k as f64 == n { b } else { [0, 1].map(|c| a[c] + (b[c] - a[c]) * t) };
            let last = out.last().expect("the first vertex is there");
            let distance_m = last.distance_m + terrain.distance_m([last.x, last.y], p);
            out.push(Station { distance_m, x: p[0], y: p[1], z: None, error_m: None, vertex: k as f64 == n });
        }
    }
    if out.len() < 2 {
        return Err(Error::invalid("line", "all its points are the same"));
    }
    Ok(out)
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
