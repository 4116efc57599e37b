//! Files that arrive: a new survey, further tiles of one, a corrected delivery.

use super::change::{Call, Ingest, Outcome, find_survey};
use super::commit::{Plan, Retiled};
use super::database::{Db, Policy};
use super::declare::{agree, crs_of, declare, fits, one_vertical_datum};
use super::head::{Declaration, Head, Tile};
use super::reader::stored;
use super::resample::warp_of;
use super::root::SurveyEntry;
use super::tile::{Directory, write_tile};
use super::view::{Tables, View};
use super::writing::Writing;
use crate::base::{Error, Result};
use crate::height::frame::CellRect;
use crate::height::lod::SurveyNumber;
use crate::height::source::SourceInfo;
use crate::store::segment::{PageRef, Pages, SegmentKind, SegmentWriter, file_name};
use std::collections::BTreeSet;
use std::sync::Arc;

impl Writing {
    pub(super) fn find(&self, name: &str) -> Result<&SurveyEntry> {
        find_survey(&self.view, name)
    }

    /// Brings files in: a new survey, tiles of one, or (`replace`) tiles of one in place of those they cover.
    pub fn ingest(&mut self, call: &Call, mut request: Ingest, replace: bool) -> Result<Outcome> {
        let db = call.db;
        let Foreseen { entry, before, declaration, places, mut warnings } =
            foresee(db, &self.view, &request, request.into.as_deref())?;
        let existing =
            self.view.entries().values().find(|e| entry.is_none() && e.name == declaration.name).cloned();
        let needed: u64 = request
            .sources
            .iter()
            .map(|s| s.info().cols * s.info().rows * s.info().sample_type.bytes() as u64)
            .sum::<u64>();
        self.need_space(db, needed + needed / 2 + (4 << 20))?;

        let segment_number = self.next_file();
        let mut segment = SegmentWriter::create(db.disk(), segment_number, SegmentKind::Survey)?;
        let mut tiles: Vec<Tile> = Vec::new();
        let mut dead = Vec::new();
        let (mut posts, mut voids) = (0, 0);
        let mut sources = std::mem::take(&mut request.sources);
        for (source, at) in sources.iter_mut().zip(places) {
            let info = source.info().clone();
            let tile = write_tile(source.as_mut(), &declaration, at, &mut segment, call.progress)?;
            let samples = declaration.delivered();
            warnings.extend(info.suspect(tile.z.map(|z| (z - samples.offset) / samples.scale)));
            posts += info.cols * info.rows;
            voids += info.cols * info.rows - tile.valid;
            if tile.valid == 0 {
                return Err(Error::invalid(&info.file, "holds no valid sample; check --nodata"));
            }
            if tiles.iter().any(|t| t.key == tile.key) {
                dead.extend(pages_in(&segment, &tile)?);
            } else {
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
                return self.nothing(e.clone(), posts, voids, warnings);
            }
            return Err(name_taken(&e.name));
        }
        if let (Some(e), Some(h)) = (&entry, &before)
            && same(h)
            && !replace
        {
            return self.nothing(e.clone(), posts, voids, warnings);
        }
        let survey = entry.as_ref().map_or_else(|| SurveyNumber(self.counters.survey + 1), |e| e.number);
        let mut kept: Vec<Tile> = before.as_ref().map_or(Vec::new(), |h| h.tiles.clone());
        let mut dirty: Vec<CellRect> = Vec::new();
        if replace {
            let (leave, stay) = covered_tiles(&kept, &tiles)?;
            if leave.iter().map(|t| t.key).collect::<BTreeSet<_>>() == tiles.iter().map(|t| t.key).collect() {
                let e = entry.expect("replace names a survey");
                return self.nothing(e, posts, voids, warnings);
            }
            for t in &leave {
                dirty.push(t.posts);
                dead.extend(self.tile_pages(t)?);
            }
            kept = stay;
        }
        for t in tiles {
            if kept.iter().all(|k| k.key != t.key) {
                let over: Vec<&Tile> = kept.iter().filter(|k| k.posts.overlaps(&t.posts)).collect();
                if !over.is_empty() && !replace {
                    let unequal = self.unequal(&declaration, &segment, &t, &over)?;
                    if unequal > 0 {
                        warnings.push(format!(
                            "{}: {unequal} posts differ from tiles that overlap it; the greater tile key wins there. `terraquilt replace` corrects a delivery",
                            t.file
                        ));
                    }
                }
                dirty.push(t.posts);
                kept.push(t);
            } else {
                dead.extend(pages_in(&segment, &t)?);
            }
        }
        let since = entry.as_ref().map_or(self.counters.version + 1, |e| e.since);
        let (date, precedence) = match &entry {
            Some(e) => (request.date.or(e.date), request.precedence.or(e.precedence)),
            None => (request.date, request.precedence),
        };
        let action = match (&entry, replace) {
            (None, _) => {
                let s = if kept.len() == 1 { "" } else { "s" };
                format!("ingest '{}' ({} tile{s})", declaration.name, kept.len())
            }
            (Some(e), false) => format!("ingest tiles into '{}'", e.name),
            (Some(e), true) => format!("replace tiles of '{}'", e.name),
        };
        let retiled = Retiled {
            survey,
            before,
            declaration,
            tiles: kept,
            dirty,
            compare: true,
            dead,
            segment,
            date,
            precedence,
            since,
        };
        let mut outcome =
            self.commit(call, Plan { retiled: Some(retiled), action, warnings, ..Plan::default() })?;
        outcome.posts = posts;
        outcome.voids = voids;
        Ok(outcome)
    }

    /// Everything was there already.
    fn nothing(&self, e: SurveyEntry, posts: u64, voids: u64, mut warnings: Vec<String>) -> Result<Outcome> {
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
        let w = declaration.delivered().sample_type.bytes();
        let mut count = 0;
        for o in over {
            let layered = crate::store::segment::Layered { base: &self.view.files, writing: vec![segment] };
            let old = read(&o.directory, &layered)?;
            let both = new.blocks.intersect(&old.blocks);
            for bj in both.j0..both.j1 {
                for bi in both.i0..both.i1 {
                    let (Some((a, _)), Some((b, _))) = (new.get(bi, bj), old.get(bi, bj)) else { continue };
                    let block = |at: &PageRef| stored(&layered, at, declaration.delivered().sample_type);
                    let (a, b) = (block(&a)?, block(&b)?);
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

    pub(super) fn tile_pages(&self, t: &Tile) -> Result<Vec<PageRef>> {
        let d = self.view.directory(&t.directory)?;
        Ok(std::iter::once(t.directory).chain(d.pages.iter().map(|(p, _)| *p)).collect())
    }
}

/// A new survey may not have the name of another one.
pub(super) fn name_taken(name: &str) -> Error {
    Error::invalid(
        format!("survey '{name}'"),
        "is already in the database; add tiles with --into, correct it with `terraquilt replace`, or choose another --name",
    )
}

/// What is known of an ingest before a sample is read.
pub(super) struct Foreseen {
    /// The survey that the files join, and its head.
    pub entry: Option<SurveyEntry>,
    before: Option<Arc<Head>>,
    pub declaration: Declaration,
    /// First post of each file on the lattice of the survey.
    pub places: Vec<[i64; 2]>,
    pub warnings: Vec<String>,
}

/// Refuses what can be refused without reading a sample. `into`: the survey that the files join.
pub(super) fn foresee(db: &Db, view: &View, request: &Ingest, into: Option<&str>) -> Result<Foreseen> {
    let first =
        request.sources.first().ok_or_else(|| Error::invalid("ingest", "no file was given"))?.info().clone();
    let mut warnings: Vec<String> = Vec::new();
    for s in &request.sources {
        crs_of(s.info(), request, db)?;
        warnings.extend(s.info().notes.iter().map(|n| format!("{}: {n}", s.info().file)));
    }
    let entry = into.map(|n| find_survey(view, n).cloned()).transpose()?;
    let before = entry.as_ref().map(|e| view.head(e.number).cloned()).transpose()?;
    let declaration = match &before {
        Some(h) => {
            agree(&h.declaration, &first, request)?;
            h.declaration.clone()
        }
        None => {
            let infos: Vec<&SourceInfo> = request.sources.iter().map(|s| s.info()).collect();
            declare(db, &infos, request, &mut warnings)?
        }
    };
    one_vertical_datum(&declaration, view)?;
    let warp = warp_of(&declaration)?;
    if request.name.is_none() && entry.is_none() && request.sources.len() > 1 {
        warnings.push(format!(
            "{} files make one survey, named '{}'; --name names it",
            request.sources.len(),
            declaration.name
        ));
    }
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
    let mut places = Vec::with_capacity(request.sources.len());
    for source in &request.sources {
        let info = source.info();
        fits(&declaration, info, request, db)?;
        let affine = info.affine.expect("a file without a georeference was refused");
        let at = declaration.delivered_lattice().index_of(&affine, info.cols, info.rows, &info.file)?;
        if let Some(w) = &warp {
            let posts = CellRect::new(at[0], at[1], at[0] + info.cols as i64, at[1] + info.rows as i64);
            w.target_rect(&posts, &info.file)?;
        }
        places.push(at);
    }
    Ok(Foreseen { entry, before, declaration, places, warnings })
}

/// Pages of a tile in the segment being written.
fn pages_in(segment: &SegmentWriter, t: &Tile) -> Result<Vec<PageRef>> {
    let d = Directory::decode(&segment.page(&t.directory)?, &file_name(t.directory.file))?;
    Ok(std::iter::once(t.directory).chain(d.pages.iter().map(|(p, _)| *p)).collect())
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
