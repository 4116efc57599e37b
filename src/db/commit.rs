//! From a plan to a version: rebuild the survey whose samples change, derive what the set makes of it, write, publish.

use super::build::{Before, Built, Input, build};
use super::change::{Call, Outcome};
use super::contradictions::Arriving;
use super::head::{Declaration, Head, Tile, check_world};
use super::reader::block_cache;
use super::root::{Root, SurveyEntry};
use super::settling::SettlingSegment;
use super::tile::Directory;
use super::update::{Changes, Draft, Rebuilt};
use super::view::{Tables, View};
use super::writing::{Publication, Writing};
use crate::base::Result;
use crate::base::date::Date;
use crate::height::frame::CellRect;
use crate::height::lod::SurveyNumber;
use crate::store::quadtree::Editor;
use crate::store::segment::{PageRef, Pages, SegmentKind, SegmentWriter, file_name};
use crate::store::table::PageList;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Bytes of decoded blocks of samples that a commit keeps: what lies around the squares that its threads work on.
const BLOCK_BYTES: u64 = 64 << 20;

/// What a commit does to the set of surveys.
#[derive(Default)]
pub(super) struct Plan {
    /// The survey whose tiles change.
    pub retiled: Option<Retiled>,
    /// Surveys that leave.
    pub gone: Vec<SurveyEntry>,
    /// Surveys whose attributes change, as they will be.
    pub attributes: Vec<SurveyEntry>,
    pub action: String,
    pub warnings: Vec<String>,
}

/// A survey whose tiles change in this commit.
pub(super) struct Retiled {
    pub survey: SurveyNumber,
    /// `None`: a new survey.
    pub before: Option<Arc<Head>>,
    pub declaration: Declaration,
    pub tiles: Vec<Tile>,
    /// Delivered posts that may have changed.
    pub dirty: Vec<CellRect>,
    /// Whether to compare what came: resampled posts with its samples, its ground with that of other surveys.
    pub compare: bool,
    /// Pages of tiles that left.
    pub dead: Vec<PageRef>,
    pub segment: SegmentWriter,
    pub date: Option<Date>,
    pub precedence: Option<i64>,
    pub since: u64,
}

/// Tells the blocks of the survey that is built from others in the cache of a commit: there are no others.
const STAMP: u64 = 0;

impl Writing {
    /// Derives and writes a version.
    pub fn commit(&mut self, call: &Call, plan: Plan) -> Result<Outcome> {
        let Plan { retiled, gone, attributes, action, mut warnings } = plan;
        let (db, progress) = (call.db, call.progress);
        let view = &self.view;
        let mut entries = view.entries().clone();
        let mut dead: Vec<PageRef> = Vec::new();
        for g in &gone {
            entries.remove(&g.number);
            dead.extend(self.survey_pages(g)?);
        }
        for a in &attributes {
            let mut e = a.clone();
            e.geometry.precedence = db.policy().precedence(e.date, e.precedence);
            entries.insert(e.number, e);
        }
        let (mut survey_segment, mut survey_bytes) = (None, 0);
        let mut rebuilt = None;
        let (mut resampling, mut contradictions) = (None, Vec::new());
        let mut subject = gone.iter().chain(&attributes).next().map(|e| e.number);
        if let Some(r) = retiled {
            let (date, precedence, since) = (r.date, r.precedence, r.since);
            let mut segment = r.segment;
            let cache = block_cache(BLOCK_BYTES);
            let mut tiles = r.tiles;
            tiles.sort_by_key(|t| std::cmp::Reverse(t.key));
            let layered_directory = |t: &Tile| -> Result<Arc<Directory>> {
                if t.directory.file == segment.number() {
                    let bytes = segment.page(&t.directory)?;
                    return Ok(Arc::new(Directory::decode(&bytes, &file_name(t.directory.file))?));
                }
                view.directory(&t.directory)
            };
            let tiles = tiles
                .into_iter()
                .map(|t| {
                    let d = layered_directory(&t)?;
                    Ok((t, d))
                })
                .collect::<Result<Vec<_>>>()?;
            let directories = tiles.iter().map(|(_, d)| d.clone()).collect();
            let page = |at| view.patch_page(r.survey, at);
            let input = Input {
                kind: db.kind(),
                declaration: r.declaration,
                tiles,
                before: r.before.as_ref().map(|h| Before { head: h, page: &page }),
                dirty: r.dirty,
                compare: r.compare,
                cache: &cache,
                stamp: STAMP,
            };
            let compare = r.compare;
            let Built { head, pages, changed, dead: built_dead, dirty, resampling: found } =
                build(input, &view.files, &mut segment, progress)?;
            resampling = found;
            if compare {
                let new = Arriving {
                    survey: r.survey,
                    head: &head,
                    directories,
                    pages: &pages,
                    dirty,
                    segment: &segment,
                    blocks: &cache,
                    stamp: STAMP,
                };
                contradictions = self.contradictions(&new, db.unit(), db.crs().unit)?;
            }
            let precedence_rank = db.policy().precedence(date, precedence);
            let geometry = head.geometry(precedence_rank);
            check_world(&geometry, &head.declaration.name)?;
            dead.extend(r.dead);
            dead.extend(built_dead);
            if let Some(old) = view.entries().get(&r.survey) {
                dead.push(old.head);
            }
            let at = segment.append(&head.encode())?;
            let old = view.entries().get(&r.survey);
            entries.insert(
                r.survey,
                SurveyEntry {
                    number: r.survey,
                    id: head.declaration.id(),
                    name: head.declaration.name.clone(),
                    head: at,
                    tops: old.map_or(PageRef { file: 0, len: 0, offset: 0, crc: 0 }, |e| e.tops),
                    date,
                    precedence,
                    geometry,
                    z: head.z(),
                    live: old.map_or(0, |e| e.live),
                    dormant: old.map_or(0, |e| e.dormant),
                    since,
                },
            );
            warnings.extend(coarser(&entries, r.survey));
            survey_bytes = segment.len();
            if !call.dry_run {
                survey_segment = Some(SettlingSegment::start(segment)?);
            }
            rebuilt = Some(Rebuilt { survey: r.survey, pages, changed });
            subject = Some(r.survey);
        }
        let mut draft = Draft::new(view, entries);
        let changes = draft.derive(rebuilt, progress)?;

        // Write what the set makes of it.
        let derived_number = self.counters.file + 1 + u32::from(survey_bytes > 0);
        let mut derived = SegmentWriter::create(db.disk(), derived_number, SegmentKind::Derived)?;
        let entries = write_tops(view, &draft, &changes, &mut derived, &mut dead)?;
        let live_before: u64 = view.entries().values().map(|e| e.live).sum();
        let old_root = view.tree.map(|t| t.page);
        let (gone_count, come_count) = (changes.gone.len() as u64, changes.come.len() as u64);
        progress.step("tree", 0.0)?;
        let mut editor = Editor::open(&view.files, &draft, old_root)?;
        editor.apply(&changes.gone, changes.come, live_before)?;
        let (tree, replaced) = editor.write(&mut derived)?;
        dead.extend(replaced);
        if let Some(v) = &self.version {
            dead.push(v.root);
        }
        let root = Root { surveys: entries.values().cloned().collect(), tree: Some(tree) };
        let root_at = derived.append(&root.encode())?;

        let written = survey_bytes + derived.len();
        let mut outcome = Outcome {
            changed: true,
            tops_computed: changes.computed,
            records_gone: gone_count,
            records_come: come_count,
            bytes_written: written,
            warnings,
            resampling,
            contradictions,
            version: self.counters.version + 1,
            ..Outcome::default()
        };
        for (s, places) in &changes.flips {
            if Some(*s) != subject {
                let name = entries[s].name.clone();
                outcome.flipped_cells.insert(name, self.flipped(&draft, *s, places)?);
            }
        }
        if let Some(e) = subject.and_then(|s| entries.get(&s)) {
            outcome.survey = e.name.clone();
            (outcome.live, outcome.dormant, outcome.patches) = (e.live, e.dormant, e.live + e.dormant);
        } else if let Some(g) = gone.first() {
            outcome.survey = g.name.clone();
        }
        drop(draft);
        if call.dry_run {
            outcome.version = self.counters.version;
            outcome.changed = false;
            return Ok(outcome);
        }
        progress.step("committing", 0.0)?;
        let new_survey = subject.map_or(0, |s| s.0);
        let segments = survey_segment.into_iter().chain([SettlingSegment::start(derived)?]).collect();
        self.publish(
            db,
            Publication {
                segments,
                root: root_at,
                dead,
                survey: new_survey,
                action,
                operation: call.operation,
            },
        )?;
        Ok(outcome)
    }

    /// Cells of a survey that came or went from what is shown.
    fn flipped(&self, draft: &Draft, s: SurveyNumber, places: &BTreeSet<(i32, i32)>) -> Result<u64> {
        use crate::height::lod::{Cells, World};
        let (old, new) = (super::view::Rules(&self.view), super::view::Rules(draft));
        let mut n = 0;
        for (i, j) in places {
            let a = old.block(s, Cells::CorePrime, *i, *j)?;
            let b = new.block(s, Cells::CorePrime, *i, *j)?;
            n += a.0.iter().zip(&b.0).map(|(x, y)| u64::from((x ^ y).count_ones())).sum::<u64>();
        }
        Ok(n)
    }
}

/// Writes the changed pages of the top tables; returns the surveys as the root page names them.
pub(super) fn write_tops(
    view: &View,
    draft: &Draft,
    changes: &Changes,
    derived: &mut SegmentWriter,
    dead: &mut Vec<PageRef>,
) -> Result<BTreeMap<SurveyNumber, SurveyEntry>> {
    let mut lists: BTreeMap<SurveyNumber, BTreeMap<_, _>> = BTreeMap::new();
    for ((s, at), page) in &changes.tops {
        if !lists.contains_key(s) {
            let old: PageList =
                if view.entries().contains_key(s) { (**view.top_list(*s)?).clone() } else { Vec::new() };
            lists.insert(*s, old.into_iter().collect());
        }
        let list = lists.get_mut(s).expect("it was just put there");
        dead.extend(list.remove(at));
        if let Some(page) = page {
            list.insert(*at, derived.append(&page.encode(*at))?);
        }
    }
    let mut entries = draft.entries.clone();
    for (s, list) in lists {
        let e = entries.get_mut(&s).expect("changed pages belong to surveys of the version");
        if view.entries().contains_key(&s) {
            dead.push(e.tops);
        }
        let mut bytes = Vec::new();
        crate::store::table::put_list(&mut bytes, &list.into_iter().collect());
        e.tops = derived.append(&bytes)?;
    }
    for (s, (live, dormant)) in &changes.counts {
        if let Some(e) = entries.get_mut(s) {
            e.live = e.live.saturating_add_signed(*live);
            e.dormant = e.dormant.saturating_add_signed(*dormant);
        }
    }
    Ok(entries)
}

/// Says where a survey replaces a finer or more accurate one.
fn coarser(entries: &BTreeMap<SurveyNumber, SurveyEntry>, new: SurveyNumber) -> Vec<String> {
    let e = &entries[&new];
    let g = &e.geometry;
    entries
        .values()
        .filter(|o| {
            o.number != new && o.geometry.precedence < g.precedence && o.geometry.quad().overlaps(&g.quad())
        })
        .filter_map(|o| {
            let (a, b) = (g.steps[0] * g.steps[1], o.geometry.steps[0] * o.geometry.steps[1]);
            let step =
                (a > b * 1.001).then(|| format!("coarser ({} against {})", g.steps[0], o.geometry.steps[0]));
            let accuracy = (g.accuracy > o.geometry.accuracy)
                .then(|| format!("less accurate ({} m against {} m)", g.accuracy, o.geometry.accuracy));
            let what: Vec<String> = [step, accuracy].into_iter().flatten().collect();
            (!what.is_empty()).then(|| {
                format!(
                    "'{}' replaces '{}' where they meet, though it is {}",
                    e.name,
                    o.name,
                    what.join(" and ")
                )
            })
        })
        .collect()
}
