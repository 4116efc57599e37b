//! Answers of the Query service: what is selected, within which budget, and its parts in the order in which they are sent.

use super::model;
use crate::base::{Error, Result};
use crate::db::query::{self, Query, Selection};
use crate::db::{CorrectionPart, MaskPart, Snapshot};
use crate::height::lod::SurveyNumber;
use crate::height::surface::How;
use crate::store::quadtree::Record;
use crate::wire::{MESSAGE_BYTES, v1};
use bytes::Bytes;
use prost::Message;
use rayon::prelude::*;
use std::collections::{BTreeMap, HashSet, VecDeque};
use std::hash::Hash;
use std::sync::Arc;
use std::time::Instant;

/// Steps of a factor between one power of two and the next.
const STEPS: i32 = 16;
/// The largest factor that is tried, as a power of two: beyond it there is no tolerance on Earth.
const DOUBLINGS_MAX: i32 = 64;
/// Patches of the first part; each part may have twice as many as the one before.
const PATCHES_FIRST: usize = 32;
/// Patches that are packed between two looks at a budget.
const PATCHES_WEIGHED: usize = 256;
/// Bytes of a message around its contents, and of a field around a part, at most.
const AROUND: u64 = 16;

/// What may be answered.
#[derive(Clone, Copy, Debug, Default)]
pub struct Budget {
    pub bytes: Option<u64>,
    pub patches: Option<u64>,
    /// Whatever the caller allows, no more than this.
    pub patches_max: u64,
}

/// A question as it came, checked.
#[derive(Clone, Debug)]
pub struct Asked {
    pub query: Query,
    pub tolerance: v1::Tolerance,
    pub descriptors_only: bool,
    pub explain: bool,
}

impl Asked {
    /// # Errors
    /// If the region, the tolerance or the manner is none.
    pub fn new(
        region: Option<&v1::Region>,
        tolerance: Option<&v1::Tolerance>,
        how: How,
        descriptors_only: bool,
        explain: bool,
    ) -> Result<Asked> {
        let query = model::query(region, tolerance, how)?;
        let tolerance = tolerance.cloned().unwrap_or_default();
        Ok(Asked { query, tolerance, descriptors_only, explain })
    }
}

/// An answer, ready to be sent part by part. Vertices are packed when their part is made.
pub struct Parts {
    snapshot: Arc<Snapshot>,
    pub header: v1::PatchesHeader,
    pub end: v1::PatchesEnd,
    masks_removed: VecDeque<v1::MaskBlock>,
    corrections_removed: VecDeque<v1::CorrectionBlock>,
    removed: VecDeque<u8>,
    masks: VecDeque<v1::MaskBlock>,
    corrections: VecDeque<v1::CorrectionBlock>,
    changed: VecDeque<Record>,
    /// Coarse first.
    added: VecDeque<Record>,
    payload: bool,
    patches_next: usize,
    payload_ms: f64,
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

fn limit(wanted: u64, most: u64) -> Error {
    Error::limit(
        "patches of one answer (ask for a smaller region, for less exactness, or give max_patches)",
        most,
        wanted,
    )
}

/// Answers a question.
///
/// # Errors
/// [`Error::Limit`] if there are more patches than allowed, or the coarsest answer is above the budget.
pub fn patches(snapshot: Arc<Snapshot>, asked: &Asked, budget: &Budget) -> Result<Parts> {
    let started = Instant::now();
    let (factor, query, selection) = within(&snapshot, asked, budget)?;
    let select_ms = milliseconds(started);
    let (masks, corrections) = blocks(&snapshot, asked, &selection)?;
    let mut parts = Parts::new(snapshot, asked, &query, factor, &selection)?;
    parts.header.patches = selection.records.len() as u64;
    parts.masks = masks.iter().map(model::mask).collect();
    parts.corrections = corrections.iter().map(model::correction).collect();
    if asked.explain {
        parts.end.explanation = Some(explanation(&parts.snapshot, &selection, select_ms)?);
    }
    parts.added = coarse_first(&parts.snapshot, selection.records)?;
    Ok(parts)
}

/// What turns the answer at an older version (`None`: before the first) into the answer at another.
///
/// # Errors
/// As [`patches`].
pub fn difference(
    from: Option<Arc<Snapshot>>,
    to: Arc<Snapshot>,
    asked: &Asked,
    patches_max: u64,
) -> Result<Parts> {
    let budget = Budget { patches_max, ..Budget::default() };
    let (_, query, selection) = within(&to, asked, &budget)?;
    let before = match &from {
        None => None,
        Some(from) => Some((within(from, asked, &budget)?.2, from)),
    };
    let d = query::difference(before.as_ref().map_or(&[], |(s, _)| &s.records), &selection.records);
    let mut parts = Parts::new(to, asked, &query, 1.0, &selection)?;
    let old = before.as_ref().map_or(Ok(Default::default()), |(s, v)| blocks(v, asked, s))?;
    let new = blocks(&parts.snapshot, asked, &selection)?;
    let (come, gone) = changes(&old.0, &new.0, MaskPart::key);
    parts.masks = come.into_iter().map(model::mask).collect();
    let bare = |m| v1::MaskBlock { cells: Default::default(), ..model::mask(m) };
    parts.masks_removed = gone.into_iter().map(bare).collect();
    let (come, gone) = changes(&old.1, &new.1, CorrectionPart::key);
    parts.corrections = come.into_iter().map(model::correction).collect();
    let bare = |c| v1::CorrectionBlock { nodes: Default::default(), ..model::correction(c) };
    parts.corrections_removed = gone.into_iter().map(bare).collect();
    parts.header.from = from.map_or(0, |f| f.number());
    parts.header.patches = d.added.len() as u64;
    parts.removed = d.removed.iter().flat_map(|r| r.id.0).collect();
    parts.changed = d.changed.into();
    parts.added = coarse_first(&parts.snapshot, d.added)?;
    Ok(parts)
}

/// Masks and corrections of an answer.
fn blocks(s: &Snapshot, asked: &Asked, found: &Selection) -> Result<(Vec<MaskPart>, Vec<CorrectionPart>)> {
    if asked.descriptors_only {
        return Ok(Default::default());
    }
    Ok((s.masks(&found.region)?, s.corrections(found, asked.query.how)?))
}

/// Blocks that are new or others than before, and old ones whose key is gone.
fn changes<'a, B: Eq + Hash, K: Eq + Hash>(
    old: &'a [B],
    new: &'a [B],
    key: impl Fn(&B) -> K,
) -> (Vec<&'a B>, Vec<&'a B>) {
    let keys: HashSet<K> = new.iter().map(&key).collect();
    let same: HashSet<&B> = old.iter().collect();
    let come = new.iter().filter(|b| !same.contains(b)).collect();
    (come, old.iter().filter(|b| !keys.contains(&key(b))).collect())
}

/// The least factor, as a power of 2^(1/[`STEPS`]), with which the answer fits and with the next smaller one does not.
fn within(s: &Snapshot, asked: &Asked, budget: &Budget) -> Result<(f64, Query, Selection)> {
    let most = budget.patches.map_or(budget.patches_max, |p| p.min(budget.patches_max));
    let limited = budget.patches.is_some() || budget.bytes.is_some();
    let attempt = |k: i32| -> Result<(Option<u64>, (f64, Query, Selection))> {
        let factor = (f64::from(k) / f64::from(STEPS)).exp2();
        let mut query = asked.query.clone();
        if k > 0 {
            query.tolerance = model::tolerance(Some(&model::looser(&asked.tolerance, factor)))?;
        }
        let selection = s.select(&query)?;
        let mut over = (selection.records.len() as u64 > most).then_some(selection.records.len() as u64);
        if let (None, Some(bytes)) = (over, budget.bytes) {
            over = above(s, asked, &query, &selection, bytes)?;
        }
        Ok((over, (factor, query, selection)))
    };
    let (over, found) = attempt(0)?;
    match over {
        None => return Ok(found),
        Some(wanted) if !limited => return Err(limit(wanted, most)),
        Some(_) => {}
    }
    // Too much with 2^(low/16), little enough with 2^(high/16).
    let (mut low, mut high) = (0, STEPS * DOUBLINGS_MAX);
    let (over, mut best) = attempt(high)?;
    if let Some(wanted) = over {
        return Err(match budget.bytes {
            Some(b) if best.2.records.len() as u64 <= most => {
                Error::limit("bytes of the coarsest answer (max_bytes)", b, wanted)
            }
            _ => Error::limit("patches of the coarsest answer (max_patches)", most, wanted),
        });
    }
    // Factors that matter are small: grow from below first.
    let mut step = STEPS;
    while low + step < high {
        let (over, found) = attempt(low + step)?;
        if over.is_none() {
            (high, best) = (low + step, found);
            break;
        }
        low += step;
        step *= 2;
    }
    while high - low > 1 {
        let middle = (low + high) / 2;
        let (over, found) = attempt(middle)?;
        match over {
            None => (high, best) = (middle, found),
            Some(_) => low = middle,
        }
    }
    Ok(best)
}

/// The bytes of an answer, counted until they are above the allowed ones; `None` if they never are.
fn above(s: &Snapshot, asked: &Asked, query: &Query, found: &Selection, most: u64) -> Result<Option<u64>> {
    let header = header(s, asked, query, 1.0, found)?;
    let mut sum = header.encoded_len() as u64 + 4 * AROUND;
    if asked.explain {
        sum += explanation(s, found, 0.0)?.encoded_len() as u64 + 4 * AROUND;
    }
    let field = |n: usize| n as u64 + AROUND;
    let (masks, corrections) = blocks(s, asked, found)?;
    sum += masks.iter().map(|m| field(model::mask(m).encoded_len())).sum::<u64>();
    sum += corrections.iter().map(|c| field(model::correction(c).encoded_len())).sum::<u64>();
    for records in found.records.chunks(PATCHES_WEIGHED) {
        if sum > most {
            return Ok(Some(sum));
        }
        sum += records
            .par_iter()
            .map(|r| {
                let payload = if asked.descriptors_only { Default::default() } else { s.payload(r)? };
                Ok(field(model::patch(r, 0, payload).encoded_len()))
            })
            .sum::<Result<u64>>()?;
    }
    Ok((sum > most).then_some(sum))
}

fn header(
    s: &Snapshot,
    asked: &Asked,
    query: &Query,
    factor: f64,
    found: &Selection,
) -> Result<v1::PatchesHeader> {
    let (blend, seams) = model::manner(query.how);
    Ok(v1::PatchesHeader {
        ground: Some(model::ground(s)),
        surveys: model::frames(s, found)?,
        factor,
        patches: 0,
        tolerance: Some(model::looser(&asked.tolerance, factor)),
        blend: blend as i32,
        seams: seams as i32,
        from: 0,
    })
}

/// Largest patches first, by nominal area; equal ones by id.
fn coarse_first(s: &Snapshot, mut records: Vec<Record>) -> Result<VecDeque<Record>> {
    let mut area: BTreeMap<(SurveyNumber, u8), f64> = BTreeMap::new();
    for r in &records {
        if let std::collections::btree_map::Entry::Vacant(e) = area.entry((r.survey, r.place.level)) {
            e.insert(s.survey_by_number(r.survey)?.geometry.area(r.place.level));
        }
    }
    let of = |r: &Record| area[&(r.survey, r.place.level)];
    records.sort_by(|a, b| of(b).total_cmp(&of(a)).then(a.id.cmp(&b.id)));
    Ok(records.into())
}

fn explanation(s: &Snapshot, found: &Selection, select_ms: f64) -> Result<v1::Explanation> {
    let mut count: BTreeMap<(SurveyNumber, u8), u64> = BTreeMap::new();
    found.records.iter().for_each(|r| *count.entry((r.survey, r.place.level)).or_default() += 1);
    let level = |((survey, level), patches): ((SurveyNumber, u8), u64)| {
        let survey = s.survey_by_number(survey)?.name.clone();
        Ok(v1::LevelCount { survey, level: u32::from(level), patches })
    };
    Ok(v1::Explanation {
        nodes: found.nodes,
        tested: found.tested,
        found: found.records.len() as u64,
        payload_bytes: 0,
        levels: count.into_iter().map(level).collect::<Result<_>>()?,
        select_ms,
        payload_ms: 0.0,
    })
}

impl Parts {
    fn new(
        snapshot: Arc<Snapshot>,
        asked: &Asked,
        query: &Query,
        factor: f64,
        found: &Selection,
    ) -> Result<Parts> {
        Ok(Parts {
            header: header(&snapshot, asked, query, factor, found)?,
            end: v1::PatchesEnd {
                patches: found.records.len() as u64,
                hash: Bytes::copy_from_slice(&query::set_hash(found.records.iter())),
                explanation: None,
            },
            snapshot,
            masks_removed: VecDeque::new(),
            corrections_removed: VecDeque::new(),
            removed: VecDeque::new(),
            masks: VecDeque::new(),
            corrections: VecDeque::new(),
            changed: VecDeque::new(),
            added: VecDeque::new(),
            payload: !asked.descriptors_only,
            patches_next: PATCHES_FIRST,
            payload_ms: 0.0,
        })
    }

    /// The next part, of about [`MESSAGE_BYTES`]; `None` after the last.
    pub fn next_part(&mut self) -> Result<Option<v1::PatchesPart>> {
        let mut part = v1::PatchesPart::default();
        let mut room = MESSAGE_BYTES;
        fill(&mut self.masks_removed, &mut part.masks_removed, &mut room);
        fill(&mut self.corrections_removed, &mut part.corrections_removed, &mut room);
        let ids = self.removed.len().min(room / 16 * 16);
        part.removed = self.removed.drain(..ids).collect();
        room -= ids;
        fill(&mut self.masks, &mut part.masks, &mut room);
        fill(&mut self.corrections, &mut part.corrections, &mut room);
        while room > 0
            && let Some(r) = self.changed.pop_front()
        {
            let patch = model::patch(&r, 0, Default::default());
            room = room.saturating_sub(patch.encoded_len());
            part.changed.push(patch);
        }
        if room > 0 && self.changed.is_empty() {
            self.fill_patches(&mut part, room)?;
        }
        Ok((part.encoded_len() > 0).then_some(part))
    }

    fn fill_patches(&mut self, part: &mut v1::PatchesPart, room: usize) -> Result<()> {
        let started = Instant::now();
        let most = self.patches_next.min(self.added.len());
        self.patches_next = self.patches_next.saturating_mul(2).min(MESSAGE_BYTES / 64);
        let records: Vec<Record> = self.added.iter().take(most).copied().collect();
        let mut bytes = 0;
        for records in records.chunks(PATCHES_WEIGHED) {
            if bytes >= room {
                break;
            }
            let patches: Vec<v1::Patch> = records
                .par_iter()
                .map(|r| {
                    let payload = if self.payload { self.snapshot.payload(r)? } else { Default::default() };
                    Ok(model::patch(r, 0, payload))
                })
                .collect::<Result<_>>()?;
            if let Some(e) = &mut self.end.explanation {
                e.payload_bytes += patches.iter().map(|p| p.payload.len() as u64).sum::<u64>();
            }
            bytes += patches.iter().map(Message::encoded_len).sum::<usize>();
            part.patches.extend(patches);
        }
        self.added.drain(..part.patches.len());
        self.payload_ms += milliseconds(started);
        if let Some(e) = &mut self.end.explanation {
            e.payload_ms = self.payload_ms;
        }
        Ok(())
    }
}

/// Moves messages until there is no more room; at least one.
fn fill<M: Message>(from: &mut VecDeque<M>, to: &mut Vec<M>, room: &mut usize) {
    while *room > 0
        && let Some(m) = from.pop_front()
    {
        *room = room.saturating_sub(m.encoded_len() + AROUND as usize);
        to.push(m);
    }
}
