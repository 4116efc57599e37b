//! Where heights come from: which surveys make the surface of a region, and how much of it.

use super::database::Snapshot;
use super::head::hex;
use super::query::Query;
use crate::base::{Error, Result};
use crate::height::lod::SurveyNumber;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Points that a grid has unless its step is given: 200 x 200.
const POINTS_WANTED: f64 = 40_000.0;
/// Points that a grid may have.
const POINTS_MAX: u64 = 4_000_000;

/// What one survey gives to a surface.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Share {
    pub id: String,
    pub name: String,
    pub date: Option<String>,
    pub accuracy_m: f64,
    /// Share of the surface that it makes: its weight, on average over the points with data.
    pub share: f64,
    /// Share of the points with data where it weighs most.
    pub dominant_share: f64,
    /// Largest error of its patches that contribute at a point.
    pub error_max_m: f32,
    /// Finest and coarsest level of those patches.
    pub levels: [u8; 2],
}

/// Where the heights of a region come from.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Provenance {
    pub version: u64,
    /// xmin, ymin, xmax, ymax of the region, CRS units; `null` where it is empty.
    pub bounds: Option<[f64; 4]>,
    /// Spacing of the points, CRS units.
    pub step: [f64; 2],
    /// Points in the region, and those with data.
    pub points: u64,
    pub points_with_data: u64,
    /// Largest share first. Shares sum to 1 if there is any data.
    pub surveys: Vec<Share>,
}

/// What the points of a row say of one survey.
#[derive(Clone, Copy)]
struct Tally {
    weight: f64,
    dominant: u64,
    error: f32,
    levels: [u8; 2],
}

impl Tally {
    const NOTHING: Tally = Tally { weight: 0.0, dominant: 0, error: 0.0, levels: [u8::MAX, 0] };

    fn add(&mut self, other: &Tally) {
        self.weight += other.weight;
        self.dominant += other.dominant;
        self.error = self.error.max(other.error);
        self.levels = [self.levels[0].min(other.levels[0]), self.levels[1].max(other.levels[1])];
    }
}

impl Snapshot {
    /// Evaluates the weights of the surface at the centres of a grid over the region of a query. `step` is the spacing in
    /// CRS units; by default such that there are about 40 000 points. All points count alike.
    pub fn provenance(&self, query: &Query, step: Option<f64>) -> Result<Provenance> {
        if step.is_some_and(|s| !(s > 0.0 && s.is_finite())) {
            return Err(Error::invalid("--step", "must be a length above 0, in units of the CRS"));
        }
        let ground = self.surface(query)?;
        let b = ground.selection.region.bounds();
        let mut out = Provenance {
            version: self.number(),
            bounds: b[0].is_finite().then_some(b),
            step: [0.0; 2],
            points: 0,
            points_with_data: 0,
            surveys: Vec::new(),
        };
        if out.bounds.is_none() {
            return Ok(out);
        }
        let size = [b[2] - b[0], b[3] - b[1]];
        let step = step.unwrap_or((size[0] * size[1] / POINTS_WANTED).sqrt());
        let n = size.map(|s| (s / step).round().max(1.0));
        if n[0] * n[1] > POINTS_MAX as f64 {
            return Err(Error::limit("points of the grid", POINTS_MAX, (n[0] * n[1]) as u64));
        }
        out.step = [size[0] / n[0], size[1] / n[1]];
        let rows: Vec<(u64, u64, BTreeMap<SurveyNumber, Tally>)> = (0..n[1] as u64)
            .into_par_iter()
            .map(|j| -> Result<_> {
                let mut tallies: BTreeMap<SurveyNumber, Tally> = BTreeMap::new();
                let (mut inside, mut with_data) = (0, 0);
                for i in 0..n[0] as u64 {
                    let p = [0, 1].map(|k| b[k] + ([i, j][k] as f64 + 0.5) * out.step[k]);
                    if !query.area.contains(p) || ground.selection.region.clip(&[p]).is_empty() {
                        continue;
                    }
                    inside += 1;
                    let Some((_, who)) = ground.sheet().explain(p)? else { continue };
                    with_data += 1;
                    for (rank, (patch, weight)) in who.iter().enumerate() {
                        let r = &ground.selection.records[*patch];
                        tallies.entry(r.survey).or_insert(Tally::NOTHING).add(&Tally {
                            weight: *weight,
                            dominant: u64::from(rank == 0),
                            error: r.bot,
                            levels: [r.place.level; 2],
                        });
                    }
                }
                Ok((inside, with_data, tallies))
            })
            .collect::<Result<_>>()?;
        // Row by row, so that the sums do not depend on the threads.
        let mut all: BTreeMap<SurveyNumber, Tally> = BTreeMap::new();
        for (inside, with_data, tallies) in rows {
            out.points += inside;
            out.points_with_data += with_data;
            for (survey, t) in tallies {
                all.entry(survey).or_insert(Tally::NOTHING).add(&t);
            }
        }
        for (survey, t) in all {
            let e = self.view.entry(survey)?;
            let of = out.points_with_data as f64;
            out.surveys.push(Share {
                id: hex(&e.id),
                name: e.name.clone(),
                date: e.date.map(|d| d.to_string()),
                accuracy_m: self.view.head(survey)?.declaration.accuracy_m,
                share: t.weight / of,
                dominant_share: t.dominant as f64 / of,
                error_max_m: t.error,
                levels: t.levels,
            });
        }
        out.surveys.sort_by(|a, b| b.share.total_cmp(&a.share).then(a.name.cmp(&b.name)));
        Ok(out)
    }
}
