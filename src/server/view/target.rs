//! What a client should hold: the answer to its question in the newest version.

use super::set::{Block, Set};
use crate::base::{Error, Result};
use crate::db::Snapshot;
use crate::db::query::{Query, Tolerance};
use crate::height::lod::SurveyNumber;
use crate::height::surface::How;
use crate::server::model;
use crate::store::quadtree::Record;
use crate::wire::v1;
use std::sync::Arc;

/// What stays the same while a session lasts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Manner {
    pub how: How,
    pub descriptors_only: bool,
}

/// What a client should hold.
#[derive(Clone, Debug)]
pub struct Target {
    pub version: u64,
    /// Ascending by id.
    pub records: Vec<Record>,
    /// Those of the patches and masks, ascending by number.
    pub surveys: Vec<Arc<v1::SurveyFrame>>,
    pub masks: Vec<Block>,
    /// None with seams off.
    pub corrections: Vec<Block>,
    pub ground: Arc<v1::Ground>,
    /// Whether the tolerance depends on how high the ground is.
    pub by_height: bool,
}

impl Target {
    /// The answer to a question. Frames and facts that the client holds of this version are shared with it.
    ///
    /// # Errors
    /// As [`Snapshot::select`] and [`Snapshot::corrections`]; `Limit` if it has more than `patches_max` patches.
    pub fn of(
        snapshot: &Snapshot,
        query: &Query,
        manner: Manner,
        patches_max: u64,
        held: &Set,
    ) -> Result<Target> {
        let selection = snapshot.select(query)?;
        let n = selection.records.len() as u64;
        if n > patches_max {
            let what = "patches of a view (ask for a smaller region or a larger tolerance)";
            return Err(Error::limit(what, patches_max, n));
        }
        let (mut masks, mut corrections) = (Vec::new(), Vec::new());
        if !manner.descriptors_only {
            let parts = snapshot.corrections(&selection, manner.how)?;
            corrections = parts.into_iter().map(Block::from).collect();
            masks = snapshot.masks(&selection.region)?.into_iter().map(Block::from).collect();
        }
        let mut numbers: Vec<u32> = Vec::new();
        let mut add = |n: u32| {
            if let Err(k) = numbers.binary_search(&n) {
                numbers.insert(k, n);
            }
        };
        masks.iter().for_each(|m: &Block| add(m.key.survey));
        selection.records.iter().for_each(|r| add(r.survey.0));
        let current = held.version == snapshot.number();
        let surveys = numbers.into_iter().map(|n| {
            if current && let Some(frame) = held.survey(n) {
                return Ok(frame.clone());
            }
            Ok(Arc::new(model::survey_frame(snapshot, SurveyNumber(n))?))
        });
        let ground = match &held.ground {
            Some(g) if g.version == snapshot.number() => g.clone(),
            _ => Arc::new(model::ground(snapshot)),
        };
        Ok(Target {
            version: snapshot.number(),
            surveys: surveys.collect::<Result<_>>()?,
            records: selection.records,
            masks,
            corrections,
            ground,
            by_height: matches!(query.tolerance, Tolerance::Camera(_)),
        })
    }
}
