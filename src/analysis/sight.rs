//! What is seen along a line.
//!
//! The line of sight is straight in space. With curvature, the ground between the ends stands higher by
//! d1 d2 (1 - k) / (2 R), with the distances d1 and d2 to both ends, R = 6 371 008.8 m, and k the coefficient of
//! refraction: 0.13 by default, the value of C. F. Gauss that surveyors use by day; it varies with the weather.

use super::profile::{Station, line_length_m, stations};
use super::terrain::Terrain;
use crate::base::{Error, Result};
use serde::Serialize;

/// Mean radius of the Earth, metres.
const EARTH_M: f64 = 6_371_008.8;

/// One end of a line of sight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    pub at: [f64; 2],
    /// Metres above the ground there, or above the zero of heights.
    pub height: f64,
    pub absolute: bool,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SightOptions {
    /// Metres between the points that are looked at; default: half the finest survey's step there.
    pub step_m: Option<f64>,
    /// Coefficient of refraction; `None`: neither the Earth's curvature nor refraction.
    pub refraction: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Clear by more than the error at every point.
    Visible,
    /// The ground is in the way by more than the error.
    Hidden,
    /// Within the error both are possible, or there is no data somewhere.
    Undecided,
}

/// A point of a line of sight.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ray {
    pub distance_m: f64,
    pub x: f64,
    pub y: f64,
    /// Height of the ground; `None`: no data.
    pub z: Option<f64>,
    /// The line above the ground, curvature included; negative: the ground is in the way.
    pub clearance_m: Option<f64>,
    /// What the clearance may be wrong by: the error of the ground here, and of the ground below the ends. `None`: not
    /// promised.
    pub error_m: Option<f64>,
}

/// What is seen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Sight {
    pub verdict: Verdict,
    pub distance_m: f64,
    /// Heights of the two ends, metres.
    pub from_z: f64,
    pub to_z: f64,
    /// The first point where the ground is in the way (perhaps within the error).
    pub obstruction: Option<Ray>,
    /// The point with the least clearance.
    pub closest: Option<Ray>,
    /// Points in between that have no data, or whose error is not promised.
    pub without_data: usize,
    pub uncertified: usize,
    pub refraction: Option<f64>,
    /// Every point that was looked at, the ends left out.
    pub rays: Vec<Ray>,
}

/// Looks from one end to the other.
///
/// # Errors
/// [`Error::Invalid`] if the ends are the same point, or an end that is given above ground has no ground.
pub fn sight(terrain: &Terrain, from: End, to: End, options: SightOptions) -> Result<Sight> {
    if from.at == to.at {
        return Err(Error::invalid("--to", "both ends are the same point"));
    }
    if let Some(k) = options.refraction
        && !(-5.0..1.0).contains(&k)
    {
        return Err(Error::invalid(
            "--refraction",
            format!("{k}; it lies between -5 and 1, by day near 0.13"),
        ));
    }
    let line = stations(terrain, &[from.at, to.at], options.step_m, 0.5)?;
    let points: Vec<[f64; 2]> = line.iter().map(|s| [s.x, s.y]).collect();
    let ground = terrain.heights(&points)?;
    let length = line_length_m(&line);
    // Height of an end, and its error; none is promised in the rim.
    let end = |e: &End, name: &str, k: usize| -> Result<(f64, Option<f64>)> {
        match (&ground[k], e.absolute) {
            (_, true) => Ok((e.height, Some(0.0))),
            (Some(g), _) => Ok((g.z + e.height, g.certified.then_some(g.error_m))),
            (None, _) => Err(Error::invalid(
                name,
                format!(
                    "there is no data at {}, {}: give its height with --absolute, or another point",
                    e.at[0], e.at[1]
                ),
            )),
        }
    };
    let (from_z, from_error) = end(&from, "--from", 0)?;
    let (to_z, to_error) = end(&to, "--to", line.len() - 1)?;
    let ray = |s: &Station, e: &Option<crate::height::surface::Evaluation>| {
        let t = s.distance_m / length;
        let bulge = options
            .refraction
            .map_or(0.0, |k| s.distance_m * (length - s.distance_m) * (1.0 - k) / (2.0 * EARTH_M));
        let ends = from_error.zip(to_error).map(|(a, b)| a * (1.0 - t) + b * t);
        Ray {
            distance_m: s.distance_m,
            x: s.x,
            y: s.y,
            z: e.as_ref().map(|e| e.z),
            clearance_m: e.as_ref().map(|e| from_z + (to_z - from_z) * t - bulge - e.z),
            error_m: e.as_ref().filter(|e| e.certified).zip(ends).map(|(e, ends)| e.error_m + ends),
        }
    };
    let inner = 1..line.len() - 1;
    let rays: Vec<Ray> = inner.clone().map(|k| ray(&line[k], &ground[k])).collect();
    let clear = |r: &Ray| r.clearance_m.zip(r.error_m);
    let hidden = rays.iter().any(|r| clear(r).is_some_and(|(c, e)| c < -e));
    let visible = rays.iter().all(|r| clear(r).is_some_and(|(c, e)| c > e));
    let closest = rays
        .iter()
        .filter(|r| r.clearance_m.is_some())
        .min_by(|a, b| a.clearance_m.unwrap_or(0.0).total_cmp(&b.clearance_m.unwrap_or(0.0)));
    Ok(Sight {
        verdict: match (hidden, visible) {
            (true, _) => Verdict::Hidden,
            (_, true) => Verdict::Visible,
            _ => Verdict::Undecided,
        },
        distance_m: length,
        from_z,
        to_z,
        obstruction: rays.iter().find(|r| r.clearance_m.is_some_and(|c| c < 0.0)).cloned(),
        closest: closest.cloned(),
        without_data: rays.iter().filter(|r| r.z.is_none()).count(),
        uncertified: rays.iter().filter(|r| r.z.is_some() && r.error_m.is_none()).count(),
        refraction: options.refraction,
        rays,
    })
}
