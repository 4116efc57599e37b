//! What a commit does: ingest, replace, remove, set. One survey's samples change in one commit.

use super::build::{Before, Built, Input, build};
use super::database::{Db, Policy, Writing};
use super::head::{Declaration, Head, Tile, check_world};
use super::reader::block_cache;
use super::root::{Root, SurveyEntry};
use super::tile::{Directory, write_tile};
use super::update::{Draft, Rebuilt};
use super::view::{Tables, View};
use crate::base::date::Date;
use crate::base::{Error, Result, limits};
use crate::height::frame::{CellRect, Lattice};
use crate::height::lod::SurveyNumber;
use crate::height::source::{HeightSource, SourceInfo};
use crate::store::quadtree::Editor;
use crate::store::segment::{PageRef, Pages, SegmentKind, SegmentWriter, file_name};
use crate::store::table::PageList;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Tells how far the work is, and whether to stop.
pub struct Progress<'a> {
    /// Called with a stage and the share of it that is done, from any thread.
    pub report: &'a (dyn Fn(&str, f64) + Sync),
    pub stop: &'a AtomicBool,
}

impl Progress<'_> {
    pub fn step(&self, stage: &str, share: f64) -> Result<()> {
        (self.report)(stage, share);
        self.check()
    }
    pub fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
    }
}

/// Files that arrive as one survey, or as tiles of one.
pub struct Ingest {
    pub sources: Vec<Box<dyn HeightSource>>,
    /// Default: the stem of the first file.
    pub name: Option<String>,
    /// Tiles of this survey instead of a new one.
    pub into: Option<String>,
    pub accuracy_m: Option<f64>,
    pub date: Option<Date>,
    pub precedence: Option<i64>,
    /// Metres of one vertical unit of the files.
    pub vertical_unit_m: f64,
    /// The user says that files without a CRS, or with another, are in the database's CRS.
    pub assume_crs: bool,
    /// Declared lattice: col step, row step (lengths), phases.
    pub lattice: Option<[f64; 4]>,
}

/// What to commit.
pub enum Change {
    Ingest(Ingest),
    /// Tiles wholly inside the new files' rectangles leave, and the files come.
    Replace {
        survey: String,
        ingest: Ingest,
    },
    Remove {
        surveys: Vec<String>,
        tile: Option<String>,
    },
    Set {
        survey: String,
        date: Option<Date>,
        precedence: Option<i64>,
    },
}

/// What a commit did.
#[derive(Clone, Debug, Default, serde::Serialize)]
pub struct Outcome {
    pub survey: String,
    pub version: u64,
    pub patches: u64,
    pub live: u64,
    pub dormant: u64,
    pub posts: u64,
    pub voids: u64,
    pub seconds: f64,
    /// False if everything was there already.
    pub changed: bool,
    /// Posts of other surveys' cells that the commit covered or uncovered, by name: cells.
    pub flipped_cells: BTreeMap<String, u64>,
    /// Tops recomputed, records that left and entered the tree, bytes written.
    pub tops_computed: u64,
    pub records_gone: u64,
    pub records_come: u64,
    pub bytes_written: u64,
    pub warnings: Vec<String>,
}

impl Db {
    /// Carries out a change as one commit. Waits for another writer (calling `waiting` once).
    ///
    /// `operation` identifies the call: repeating it after a crash or a broken connection returns the version it made.
    /// With `dry_run` everything is computed and nothing committed.
    pub fn change(
        &self,
        change: Change,
        operation: Option<&str>,
        dry_run: bool,
        progress: &Progress,
        waiting: &mut dyn FnMut(),
    ) -> Result<Outcome> {
        let started = std::time::Instant::now();
        let mut writing = self.begin(waiting)?;
        if let Some(op) = operation
            && let Some(version) = writing.catalog.operation(op)?
        {
            return Ok(Outcome { version, ..Outcome::default() });
        }
        let mut outcome = match change {
            Change::Ingest(i) => writing.ingest(self, i, None, operation, dry_run, progress)?,
            Change::Replace { survey, ingest } => writing.ingest(
                self,
                Ingest { into: Some(survey.clone()), ..ingest },
                Some(()),
                operation,
                dry_run,
                progress,
            )?,
            Change::Remove { surveys, tile } => {
                writing.remove(self, &surveys, tile, operation, dry_run, progress)?
            }
            Change::Set { survey, date, precedence } => {
                writing.set(self, &survey, date, precedence, operation, dry_run, progress)?
            }
        };
        outcome.seconds = started.elapsed().as_secs_f64();
        Ok(outcome)
    }
}

/// A survey whose tiles change in this commit.
struct Retiled {
    survey: SurveyNumber,
    /// `None`: a new survey.
    before: Option<Arc<Head>>,
    declaration: Declaration,
    tiles: Vec<Tile>,
    dirty: CellRect,
    /// Pages of tiles that left.
    dead: Vec<PageRef>,
    segment: SegmentWriter,
}

impl Writing {
    fn find(&self, name: &str) -> Result<&SurveyEntry> {
        find_survey(&self.view, name)
    }

    fn ingest(
        &mut self,
        db: &Db,
        mut request: Ingest,
        replace: Option<()>,
        operation: Option<&str>,
        dry_run: bool,
        progress: &Progress,
    ) -> Result<Outcome> {
        let first = request
            .sources
            .first()
            .ok_or_else(|| Error::invalid("ingest", "no file was given"))?
            .info()
            .clone();
        let mut warnings: Vec<String> = Vec::new();
        for s in &request.sources {
            check_source(s.info(), db, request.assume_crs)?;
            warnings.extend(s.info().notes.iter().map(|n| format!("{}: {n}", s.info().file)));
        }
        let entry = request.into.as_deref().map(|n| self.find(n).cloned()).transpose()?;
        let before = entry.as_ref().map(|e| self.view.head(e.number).cloned()).transpose()?;
        let declaration = match &before {
            Some(h) => {
                agree(&h.declaration, &first, &request)?;
                h.declaration.clone()
            }
            None => declare(db, &first, &request)?,
        };
        if request.name.is_none() && entry.is_none() && request.sources.len() > 1 {
            warnings.push(format!(
                "{} files make one survey, named '{}'; --name names it",
                request.sources.len(),
                declaration.name
            ));
        }
        let existing =
            self.view.entries().values().find(|e| entry.is_none() && e.name == declaration.name).cloned();
        if db.policy() == Policy::Newest
            && entry.is_none()
            && request.date.is_none()
            && request.precedence.is_none()
        {
            return Err(Error::invalid(
                "date",
                format!(
                    "policy 'newest' ranks surveys by date, and '{}' has none; give --date YYYY-MM-DD (or --precedence N)",
                    declaration.name
                ),
            ));
        }
        let needed: u64 = request
            .sources
            .iter()
            .map(|s| s.info().cols * s.info().rows * s.info().sample_type.bytes() as u64)
            .sum::<u64>();
        self.need_space(db, needed + needed / 2 + (4 << 20))?;

        let segment_number = self.next_file();
        let mut segment = SegmentWriter::create(db.disk(), segment_number, SegmentKind::Survey)?;
        let mut tiles: Vec<Tile> = Vec::new();
        let (mut posts, mut voids) = (0, 0);
        for source in &mut request.sources {
            let info = source.info().clone();
            if info.sample_type != declaration.sample_type
                || info.scale * request.vertical_unit_m != declaration.scale
                || info.offset * request.vertical_unit_m != declaration.offset
            {
                return Err(Error::invalid(
                    &info.file,
                    format!(
                        "samples are {} (scale {}, offset {}), the survey's are {} (scale {}, offset {}); ingest it as a survey of its own",
                        info.sample_type.name(),
                        info.scale * request.vertical_unit_m,
                        info.offset * request.vertical_unit_m,
                        declaration.sample_type.name(),
                        declaration.scale,
                        declaration.offset
                    ),
                ));
            }
            let affine = info.affine.expect("check_source saw a georeference");
            let at = declaration.lattice.index_of(&affine, info.cols, info.rows, &info.file)?;
            let tile = write_tile(source.as_mut(), &declaration, at, &mut segment, progress)?;
            posts += info.cols * info.rows;
            voids += info.cols * info.rows - tile.valid;
            if tile.valid == 0 {
                return Err(Error::invalid(&info.file, "holds no valid sample; check --nodata"));
            }
            if !tiles.iter().any(|t| t.key == tile.key) {
                tiles.push(tile);
            }
        }
        // What is there already.
        let same = |head: &Head| {
            let have: BTreeSet<[u8; 16]> = head.tiles.iter().map(|t| t.key).collect();
            tiles.iter().all(|t| have.contains(&t.key))
        };
        if let Some(e) = &existing {
            let head = self.view.head(e.number)?;
            if head.declaration == declaration && same(head) {
                return self.nothing(db, segment, segment_number, e.clone(), posts, voids, warnings);
            }
            drop(segment);
            self.discard(db, segment_number);
            return Err(Error::invalid(
                format!("survey '{}'", e.name),
                "is already in the database; add tiles with --into, correct it with `terraquilt replace`, or choose another --name",
            ));
        }
        if let (Some(e), Some(h)) = (&entry, &before)
            && same(h)
            && replace.is_none()
        {
            return self.nothing(db, segment, segment_number, e.clone(), posts, voids, warnings);
        }
        let survey = entry.as_ref().map_or_else(|| SurveyNumber(self.counters.survey + 1), |e| e.number);
        let mut kept: Vec<Tile> = before.as_ref().map_or(Vec::new(), |h| h.tiles.clone());
        let mut dirty = CellRect::new(0, 0, 0, 0);
        let mut dead = Vec::new();
        if replace.is_some() {
            let (leave, stay) = covered_tiles(&kept, &tiles)?;
            if leave.iter().map(|t| t.key).collect::<BTreeSet<_>>() == tiles.iter().map(|t| t.key).collect() {
                let e = entry.expect("replace names a survey");
                return self.nothing(db, segment, segment_number, e, posts, voids, warnings);
            }
            for t in &leave {
                dirty = dirty.union(&t.posts);
                dead.extend(self.tile_pages(t)?);
            }
            kept = stay;
        }
        for t in tiles {
            if kept.iter().all(|k| k.key != t.key) {
                let over: Vec<&Tile> = kept.iter().filter(|k| k.posts.overlaps(&t.posts)).collect();
                if !over.is_empty() && replace.is_none() {
                    let unequal = self.unequal(&declaration, &segment, &t, &over)?;
                    if unequal > 0 {
                        warnings.push(format!(
                            "{}: {unequal} posts differ from tiles that overlap it; the greater tile key wins there. `terraquilt replace` corrects a delivery",
                            t.file
                        ));
                    }
                }
                dirty = dirty.union(&t.posts);
                kept.push(t);
            }
        }
        let since = entry.as_ref().map_or(self.counters.version + 1, |e| e.since);
        let (date, precedence) = match &entry {
            Some(e) => (request.date.or(e.date), request.precedence.or(e.precedence)),
            None => (request.date, request.precedence),
        };
        let action = match (&entry, replace) {
            (None, _) => format!("ingest '{}' ({} tiles)", declaration.name, kept.len()),
            (Some(e), None) => format!("ingest tiles into '{}'", e.name),
            (Some(e), Some(())) => format!("replace tiles of '{}'", e.name),
        };
        let retiled = Retiled { survey, before, declaration, tiles: kept, dirty, dead, segment };
        let attributes = (date, precedence, since);
        let mut outcome = self.commit(
            db,
            Some((retiled, attributes)),
            &[],
            &[],
            action,
            operation,
            dry_run,
            warnings,
            progress,
        )?;
        outcome.posts = posts;
        outcome.voids = voids;
        Ok(outcome)
    }

    /// Everything was there already.
    #[allow(clippy::too_many_arguments)]
    fn nothing(
        &mut self,
        db: &Db,
        segment: SegmentWriter,
        number: u32,
        e: SurveyEntry,
        posts: u64,
        voids: u64,
        mut warnings: Vec<String>,
    ) -> Result<Outcome> {
        drop(segment);
        self.discard(db, number);
        warnings.push(format!("survey '{}' holds these samples already; nothing was changed", e.name));
        Ok(Outcome {
            survey: e.name,
            version: self.counters.version,
            patches: e.live + e.dormant,
            live: e.live,
            dormant: e.dormant,
            posts,
            voids,
            warnings,
            ..Outcome::default()
        })
    }

    /// Posts at which a tile differs from tiles that overlap it.
    fn unequal(
        &self,
        declaration: &Declaration,
        segment: &SegmentWriter,
        t: &Tile,
        over: &[&Tile],
    ) -> Result<u64> {
        let read = |at: &PageRef, pages: &dyn Pages| Directory::decode(&pages.page(at)?, &file_name(at.file));
        let new = read(&t.directory, segment)?;
        let w = declaration.sample_type.bytes();
        let mut count = 0;
        for o in over {
            let layered = crate::store::segment::Layered { base: &self.view.files, writing: vec![segment] };
            let old = read(&o.directory, &layered)?;
            let both = new.blocks.intersect(&old.blocks);
            for bj in both.j0..both.j1 {
                for bi in both.i0..both.i1 {
                    let (Some((a, _)), Some((b, _))) = (new.get(bi, bj), old.get(bi, bj)) else { continue };
                    let a = crate::height::block::decode(&layered.page(&a)?, &file_name(a.file))?;
                    let b = crate::height::block::decode(&layered.page(&b)?, &file_name(b.file))?;
                    for r in a.row.max(b.row)..(a.row + a.rows).min(b.row + b.rows) {
                        for c in a.col.max(b.col)..(a.col + a.cols).min(b.col + b.cols) {
                            let ka = (r - a.row) * a.cols + c - a.col;
                            let kb = (r - b.row) * b.cols + c - b.col;
                            let ok = |v: &Option<Vec<u8>>, k: usize| v.as_ref().is_none_or(|v| v[k] != 0);
                            if ok(&a.valid, ka)
                                && ok(&b.valid, kb)
                                && a.samples[ka * w..(ka + 1) * w] != b.samples[kb * w..(kb + 1) * w]
                            {
                                count += 1;
                            }
                        }
                    }
                }
            }
        }
        Ok(count)
    }

    fn tile_pages(&self, t: &Tile) -> Result<Vec<PageRef>> {
        let d = self.view.directory(&t.directory)?;
        Ok(std::iter::once(t.directory).chain(d.pages.iter().map(|(p, _)| *p)).collect())
    }

    /// Every page that only this survey holds.
    fn survey_pages(&self, e: &SurveyEntry) -> Result<Vec<PageRef>> {
        let head = self.view.head(e.number)?.clone();
        let mut dead = vec![e.head, e.tops];
        for t in &head.tiles {
            dead.extend(self.tile_pages(t)?);
        }
        self.view.each_patch_page(e.number, |_, p| {
            dead.extend(p.blocks.iter().flatten());
            Ok(())
        })?;
        dead.extend(head.pages.iter().map(|(_, r)| *r));
        dead.extend(self.view.top_list(e.number)?.iter().map(|(_, r)| *r));
        Ok(dead)
    }

    fn remove(
        &mut self,
        db: &Db,
        names: &[String],
        tile: Option<String>,
        operation: Option<&str>,
        dry_run: bool,
        progress: &Progress,
    ) -> Result<Outcome> {
        if let Some(tile) = tile {
            let [name] = names else {
                return Err(Error::invalid("--tile", "names a tile of one survey; give exactly one survey"));
            };
            let e = self.find(name)?.clone();
            let head = self.view.head(e.number)?.clone();
            let found: Vec<&Tile> =
                head.tiles.iter().filter(|t| t.id().starts_with(&tile) || t.file == tile).collect();
            let [t] = found.as_slice() else {
                return Err(Error::missing(
                    format!("tile '{tile}' of survey '{}' ({} match)", e.name, found.len()),
                    "see `terraquilt tiles`",
                ));
            };
            let t = (*t).clone();
            if head.tiles.len() > 1 {
                let number = self.next_file();
                let segment = SegmentWriter::create(db.disk(), number, SegmentKind::Survey)?;
                let retiled = Retiled {
                    survey: e.number,
                    before: Some(head.clone()),
                    declaration: head.declaration.clone(),
                    tiles: head.tiles.iter().filter(|k| k.key != t.key).cloned().collect(),
                    dirty: t.posts,
                    dead: self.tile_pages(&t)?,
                    segment,
                };
                let action = format!("remove tile '{}' of '{}'", t.file, e.name);
                let attributes = (e.date, e.precedence, e.since);
                return self.commit(
                    db,
                    Some((retiled, attributes)),
                    &[],
                    &[],
                    action,
                    operation,
                    dry_run,
                    Vec::new(),
                    progress,
                );
            }
        }
        let mut gone = Vec::new();
        for n in names {
            let e = self.find(n)?.clone();
            if !gone.iter().any(|g: &SurveyEntry| g.number == e.number) {
                gone.push(e);
            }
        }
        let list: Vec<&str> = gone.iter().map(|e| e.name.as_str()).collect();
        let action = format!("remove '{}'", list.join("', '"));
        self.commit(db, None, &gone, &[], action, operation, dry_run, Vec::new(), progress)
    }

    #[allow(clippy::too_many_arguments)]
    fn set(
        &mut self,
        db: &Db,
        name: &str,
        date: Option<Date>,
        precedence: Option<i64>,
        operation: Option<&str>,
        dry_run: bool,
        progress: &Progress,
    ) -> Result<Outcome> {
        let e = self.find(name)?.clone();
        let mut new = e.clone();
        new.date = date.or(e.date);
        new.precedence = precedence.or(e.precedence);
        if new == e {
            return Ok(Outcome {
                survey: e.name.clone(),
                version: self.counters.version,
                live: e.live,
                dormant: e.dormant,
                patches: e.live + e.dormant,
                warnings: vec![format!(
                    "survey '{}' has these attributes already; nothing was changed",
                    e.name
                )],
                ..Outcome::default()
            });
        }
        let action = format!("set '{}'", e.name);
        self.commit(db, None, &[], &[new], action, operation, dry_run, Vec::new(), progress)
    }

    /// Derives and writes a version.
    #[allow(clippy::too_many_arguments)]
    fn commit(
        &mut self,
        db: &Db,
        retiled: Option<(Retiled, (Option<Date>, Option<i64>, u64))>,
        gone: &[SurveyEntry],
        attributes: &[SurveyEntry],
        action: String,
        operation: Option<&str>,
        dry_run: bool,
        mut warnings: Vec<String>,
        progress: &Progress,
    ) -> Result<Outcome> {
        let view = &self.view;
        let mut entries = view.entries().clone();
        let mut dead: Vec<PageRef> = Vec::new();
        for g in gone {
            entries.remove(&g.number);
            dead.extend(self.survey_pages(g)?);
        }
        for a in attributes {
            let mut e = a.clone();
            e.geometry.precedence = db.policy().precedence(e.date, e.precedence);
            entries.insert(e.number, e);
        }
        let mut survey_segment = None;
        let mut rebuilt = None;
        let mut new_head = None;
        let mut subject = gone.iter().chain(attributes).next().map(|e| e.number);
        if let Some((r, (date, precedence, since))) = retiled {
            let mut segment = r.segment;
            let cache = block_cache(256 << 20);
            let mut tiles = r.tiles;
            tiles.sort_by(|a, b| b.key.cmp(&a.key));
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
            let page = |at| view.patch_page(r.survey, at);
            let input = Input {
                declaration: r.declaration,
                tiles,
                before: r.before.as_ref().map(|h| Before { head: h, page: &page }),
                dirty: r.dirty,
                cache: &cache,
                stamp: 0,
            };
            let Built { head, pages, changed, dead: built_dead } =
                build(input, &view.files, &mut segment, progress)?;
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
            new_head = Some(head);
            survey_segment = Some(segment);
            rebuilt = Some(Rebuilt { survey: r.survey, pages, changed });
            subject = Some(r.survey);
        }
        let mut draft = Draft::new(view, entries);
        let changes = draft.derive(rebuilt, progress)?;

        // Write what the set makes of it.
        let derived_number = self.counters.file + 1 + u32::from(survey_segment.is_some());
        let mut derived = SegmentWriter::create(db.disk(), derived_number, SegmentKind::Derived)?;
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

        let written = survey_segment.as_ref().map_or(0, SegmentWriter::len) + derived.len();
        let mut outcome = Outcome {
            changed: true,
            tops_computed: changes.computed,
            records_gone: gone_count,
            records_come: come_count,
            bytes_written: written,
            warnings,
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
        let _ = new_head;
        drop(draft);
        if dry_run {
            let numbers: Vec<u32> =
                survey_segment.iter().map(SegmentWriter::number).chain([derived.number()]).collect();
            drop((survey_segment, derived));
            for n in numbers {
                self.discard(db, n);
            }
            outcome.version = self.counters.version;
            outcome.changed = false;
            return Ok(outcome);
        }
        progress.step("committing", 0.0)?;
        let new_survey = subject.map_or(0, |s| s.0);
        self.publish(db, survey_segment, derived, root_at, dead, new_survey, action, operation)?;
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

/// A survey by name, or by a prefix of its id.
pub fn find_survey<'v>(view: &'v View, name: &str) -> Result<&'v SurveyEntry> {
    let all = view.entries();
    if let Some(e) = all.values().find(|e| e.name == name) {
        return Ok(e);
    }
    let by_id: Vec<&SurveyEntry> =
        all.values().filter(|e| name.len() >= 4 && super::head::hex(&e.id).starts_with(name)).collect();
    match by_id.as_slice() {
        [e] => Ok(e),
        _ => Err(Error::missing(
            format!("survey '{name}'"),
            "`terraquilt surveys DB` lists what is in the database",
        )),
    }
}

fn check_source(info: &SourceInfo, db: &Db, assume_crs: bool) -> Result<()> {
    if info.affine.is_none() {
        return Err(Error::invalid(
            &info.file,
            "has no georeference: where its posts lie is unknown; write one with gdal_translate -a_ullr ... -a_srs EPSG:n",
        ));
    }
    if info.cols < 4 || info.rows < 4 {
        return Err(Error::invalid(
            &info.file,
            format!("{} x {} posts; at least 4 x 4 are needed", info.cols, info.rows),
        ));
    }
    let here = db.crs();
    match &info.crs {
        Some(c) if c.code == here.code => Ok(()),
        _ if assume_crs => Ok(()),
        Some(c) => Err(Error::unsupported(
            &info.file,
            format!("is in {}, the database in {}; reprojection is not there yet", c.code, here.code),
            format!(
                "warp it first: gdalwarp -t_srs {} IN.tif OUT.tif, or make a database with --crs {}",
                here.code, c.code
            ),
        )),
        None => Err(Error::invalid(
            &info.file,
            format!(
                "does not say its CRS by an EPSG code; if it is {}, say so with --crs {}",
                here.code, here.code
            ),
        )),
    }
}

fn declare(db: &Db, first: &SourceInfo, request: &Ingest) -> Result<Declaration> {
    let affine = first.affine.expect("check_source saw a georeference");
    let mut lattice = Lattice::of_affine(&affine)?;
    if let Some([sx, sy, px, py]) = request.lattice {
        let [nx, ny] = lattice.nominal_steps();
        if !(sx > 0.0 && sy > 0.0 && px.is_finite() && py.is_finite()) {
            return Err(Error::invalid("--lattice", format!("steps {sx}, {sy} must be positive")));
        }
        lattice.col_step = lattice.col_step.map(|s| crate::base::round::significant(s / nx * sx, 12));
        lattice.row_step = lattice.row_step.map(|s| crate::base::round::significant(s / ny * sy, 12));
        lattice.phase = [px.rem_euclid(1.0), py.rem_euclid(1.0)];
    }
    let accuracy_m = match (request.accuracy_m, first.accuracy_m) {
        (Some(a), _) => a,
        (None, Some(a)) => a,
        (None, None) => {
            return Err(Error::invalid(
                "accuracy",
                format!(
                    "{} does not say how accurate its heights are; give --accuracy METRES (the largest error you trust it not to exceed)",
                    first.file
                ),
            ));
        }
    };
    if !(accuracy_m >= 0.0 && accuracy_m <= 1e6) {
        return Err(Error::invalid(
            "--accuracy",
            format!("{accuracy_m} m; it must be between 0 and 1000000"),
        ));
    }
    let name = request.name.clone().unwrap_or_else(|| {
        std::path::Path::new(&first.file)
            .file_stem()
            .map_or_else(|| first.file.clone(), |s| s.to_string_lossy().into_owned())
    });
    if name.is_empty() || name.len() > limits::TEXT_BYTES_MAX / 4 {
        return Err(Error::invalid("--name", format!("'{name}' is empty or too long")));
    }
    let frame = lattice.frame(db.unit())?;
    Ok(Declaration {
        name,
        crs: db.crs().code.clone(),
        lattice,
        frame,
        sample_type: first.sample_type,
        scale: first.scale * request.vertical_unit_m,
        offset: first.offset * request.vertical_unit_m,
        accuracy_m,
    })
}

/// Whether what the user says of new tiles agrees with the survey that they join.
fn agree(d: &Declaration, first: &SourceInfo, request: &Ingest) -> Result<()> {
    if let Some(a) = request.accuracy_m
        && a != d.accuracy_m
    {
        return Err(Error::invalid(
            "--accuracy",
            format!(
                "{a} m, survey '{}' declares {} m; a declaration never changes: leave it out, or ingest {} as a survey of its own",
                d.name, d.accuracy_m, first.file
            ),
        ));
    }
    Ok(())
}

/// Tiles that lie wholly inside the new rectangles leave; one that is partly covered is refused.
fn covered_tiles(old: &[Tile], new: &[Tile]) -> Result<(Vec<Tile>, Vec<Tile>)> {
    let (mut leave, mut stay) = (Vec::new(), Vec::new());
    for t in old {
        let mut rest = vec![t.posts];
        for n in new {
            rest = rest.iter().flat_map(|r| subtract(r, &n.posts)).collect();
        }
        if rest.is_empty() {
            leave.push(t.clone());
        } else if new.iter().any(|n| n.posts.overlaps(&t.posts)) {
            let r: Vec<String> =
                new.iter().filter(|n| n.posts.overlaps(&t.posts)).map(|n| show(&n.posts)).collect();
            return Err(Error::invalid(
                "replace",
                format!(
                    "tile '{}' (posts {}) is only partly covered by the new files (posts {}); deliver the whole tile, or add tiles with `ingest --into`",
                    t.file,
                    show(&t.posts),
                    r.join(", ")
                ),
            ));
        } else {
            stay.push(t.clone());
        }
    }
    Ok((leave, stay))
}

fn show(r: &CellRect) -> String {
    format!("{}..{} x {}..{}", r.i0, r.i1, r.j0, r.j1)
}

fn subtract(r: &CellRect, n: &CellRect) -> Vec<CellRect> {
    let m = r.intersect(n);
    if m.is_empty() {
        return vec![*r];
    }
    [
        CellRect::new(r.i0, r.j0, r.i1, m.j0),
        CellRect::new(r.i0, m.j1, r.i1, r.j1),
        CellRect::new(r.i0, m.j0, m.i0, m.j1),
        CellRect::new(m.i1, m.j0, r.i1, m.j1),
    ]
    .into_iter()
    .filter(|x| !x.is_empty())
    .collect()
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
