//! Everything that can be checked: bytes, tables against samples, rules against tables, tree against definition.

use super::build::{Input, build};
use super::change::Progress;
use super::database::{Db, Snapshot};
use super::listing::name_of;
use super::reader::block_cache;
use super::tile::Directory;
use super::view::{Rules, Tables, View};
use crate::base::{Error, Result};
use crate::height::cells::Fill;
use crate::height::lod::{Place, SurveyNumber, cover, cutter};
use crate::store::catalog::Version;
use crate::store::disk::{Disk, Finished, Growing};
use crate::store::quadtree::{Node, Record, check as check_tree};
use crate::store::record::{VersionRecord, record_name};
use crate::store::segment::{Files, PageRef, Pages, SegmentKind, SegmentWriter, file_name};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

/// One thing that is wrong.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Problem {
    pub what: String,
    #[serde(rename = "where")]
    pub place: String,
}

/// What was checked and what was found.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Report {
    pub ok: bool,
    pub checked: BTreeMap<String, u64>,
    pub problems: Vec<Problem>,
}

/// Problems that are told; more are only counted.
const PROBLEMS_TOLD: usize = 100;

impl Report {
    fn count(&mut self, what: &str, n: u64) {
        *self.checked.entry(what.to_string()).or_default() += n;
    }
    fn problem(&mut self, what: impl ToString, place: impl ToString) {
        self.count("problems", 1);
        if self.problems.len() < PROBLEMS_TOLD {
            self.problems.push(Problem { what: what.to_string(), place: place.to_string() });
        }
    }
    /// Takes an error as a finding.
    fn found<T>(&mut self, place: impl ToString, r: Result<T>) -> Result<Option<T>> {
        match r {
            Ok(v) => Ok(Some(v)),
            Err(Error::Stopped) => Err(Error::Stopped),
            Err(e) => {
                self.problem(e, place);
                Ok(None)
            }
        }
    }
}

/// Checks a version: every page's checksum; the patch table rebuilt from the samples; kernels, tops and floors computed
/// afresh; invariants Q1-Q8 of the tree; counts and live bytes in the catalog. Costs about as much as building it.
pub fn verify(db: &Db, s: &Snapshot, progress: &Progress) -> Result<Report> {
    let mut r = Report::default();
    for p in db.catalog_for_reading()?.check()? {
        r.problem(p, "catalog.sqlite");
    }
    let Some(version) = s.version() else {
        r.ok = r.problems.is_empty();
        return Ok(r);
    };
    record(db, version, &mut r)?;
    pages(db, s, version.root, &mut r)?;
    if r.problems.is_empty() {
        // With caches of its own: what is checked is what the files hold now.
        let files = Files::new(db.shared_disk(), s.view.files.lengths());
        let s = &s.seen_as(View::open(files, Some(version.root))?);
        for e in s.entries().map(|e| e.number).collect::<Vec<_>>() {
            let name = name_of(&s.view, e);
            let found = survey(s, e, &mut r, progress);
            r.found(format!("survey '{name}'"), found)?;
        }
        let found = standings(s, &mut r, progress);
        r.found("tops", found)?;
        let found = tree(s, &mut r);
        r.found("tree", found)?;
    } else {
        r.problem("derived data was not checked, since bytes are damaged", "the whole version");
    }
    r.ok = r.problems.is_empty();
    Ok(r)
}

/// The record of the version, if it has one, says what the catalog says. Counters may have been ahead of it: a restored
/// version keeps those of the database that it came from.
fn record(db: &Db, version: &Version, r: &mut Report) -> Result<()> {
    let name = record_name(version.number);
    let Some((_, length)) = db.disk().names()?.into_iter().find(|(n, _)| *n == name) else { return Ok(()) };
    r.count("records", 1);
    let read = VersionRecord::read(db.disk(), &name, length);
    let Some(record) = r.found(&name, read)? else { return Ok(()) };
    let catalog = db.catalog_for_reading()?;
    let same = record.version == *version
        && record.files == catalog.files(version.number)?
        && record.constants == catalog.constants()?;
    if !same {
        r.problem(
            "the record says otherwise than the catalog; remove it, the next commit writes it anew",
            name,
        );
    }
    Ok(())
}

/// Reads every page of the version once, and adds up the bytes of each file.
fn pages(db: &Db, s: &Snapshot, root: PageRef, r: &mut Report) -> Result<()> {
    let mut live: HashMap<u32, u64> = HashMap::new();
    let view = &s.view;
    for (number, _) in view.files.lengths() {
        r.count("files", 1);
        let opened = view.files.check_header(number);
        r.found(file_name(number), opened)?;
    }
    let mut touch = |r: &mut Report, at: &PageRef, what: &str| -> Result<()> {
        r.count("pages", 1);
        *live.entry(at.file).or_default() += u64::from(at.len);
        let read = view.files.page(at).map(|_| ());
        r.found(what, read)?;
        Ok(())
    };
    touch(r, &root, "root page")?;
    let mut stack: Vec<PageRef> = view.tree.iter().map(|t| t.page).collect();
    while let Some(at) = stack.pop() {
        touch(r, &at, "tree node")?;
        if let Ok(n) = Node::read(&view.files, &at) {
            stack.extend(n.children.iter().flatten().map(|c| c.page));
        }
    }
    for e in s.entries() {
        let place = format!("survey '{}'", e.name);
        touch(r, &e.head, &place)?;
        touch(r, &e.tops, &place)?;
        let head = view.head(e.number).cloned();
        let Some(head) = r.found(&place, head)? else { continue };
        for t in &head.tiles {
            touch(r, &t.directory, &place)?;
            let d = view.directory(&t.directory);
            if let Some(d) = r.found(&place, d)? {
                for (at, valid) in &d.pages {
                    touch(r, at, &format!("{place}, tile '{}'", t.file))?;
                    r.count("sample blocks", 1);
                    let raw = view
                        .files
                        .page(at)
                        .and_then(|b| crate::height::block::decode(&b, &file_name(at.file)));
                    if let Ok(raw) = raw
                        && raw.valid_count() != *valid
                    {
                        r.problem(
                            format!("{} valid samples, the directory says {valid}", raw.valid_count()),
                            at.place(),
                        );
                    }
                }
            }
        }
        for (at, page) in &head.pages {
            touch(r, page, &place)?;
            let p = view.patch_page(e.number, *at);
            if let Some(Some(p)) = r.found(&place, p)? {
                for b in p.blocks.iter().flatten() {
                    touch(r, b, &place)?;
                    r.count("sample blocks", 1);
                }
            }
        }
        let tops = view.top_list(e.number).cloned();
        if let Some(tops) = r.found(&place, tops)? {
            for (at, page) in tops.iter() {
                touch(r, page, &place)?;
                let t = view.top_page(e.number, *at);
                r.found(&place, t)?;
            }
        }
    }
    for f in db.catalog_for_reading()?.files(s.number())? {
        let found = live.get(&f.number).copied().unwrap_or(0);
        if found != f.live {
            r.problem(format!("{found} bytes are in use, the catalog says {}", f.live), file_name(f.number));
        }
    }
    Ok(())
}

/// A disk that keeps nothing: rebuilding a survey writes its levels somewhere.
struct Void;

struct Kept(Vec<u8>);

impl Growing for Kept {
    fn append(&mut self, bytes: &[u8]) -> Result<()> {
        self.0.extend_from_slice(bytes);
        Ok(())
    }
    fn read_at(&self, offset: u64, buffer: &mut [u8]) -> Result<()> {
        let at = offset as usize;
        buffer.copy_from_slice(&self.0[at..at + buffer.len()]);
        Ok(())
    }
    fn sync(&mut self) -> Result<()> {
        Ok(())
    }
}

impl Disk for Void {
    fn create(&self, _: &str) -> Result<Box<dyn Growing>> {
        Ok(Box::new(Kept(Vec::new())))
    }
    fn rename(&self, _: &str, _: &str) -> Result<()> {
        Ok(())
    }
    fn sync_names(&self) -> Result<()> {
        Ok(())
    }
    fn remove(&self, _: &str) -> Result<()> {
        Ok(())
    }
    fn names(&self) -> Result<Vec<(String, u64)>> {
        Ok(Vec::new())
    }
    fn open(&self, name: &str, _: u64) -> Result<Finished> {
        Err(Error::missing(name, "nothing is kept here"))
    }
    fn free_bytes(&self) -> Result<Option<u64>> {
        Ok(None)
    }
    fn place(&self) -> String {
        "memory".into()
    }
}

/// The patch table of a survey, rebuilt from its samples.
fn survey(s: &Snapshot, n: SurveyNumber, r: &mut Report, progress: &Progress) -> Result<()> {
    let head = s.view.head(n)?.clone();
    let name = format!("survey '{}'", head.declaration.name);
    let mut segment = SegmentWriter::create(&Void, u32::MAX, SegmentKind::Survey)?;
    let cache = block_cache(64 << 20);
    let tiles = head
        .tiles
        .iter()
        .map(|t| -> Result<_> {
            let d: Arc<Directory> = s.view.directory(&t.directory)?;
            Ok((t.clone(), d))
        })
        .collect::<Result<Vec<_>>>()?;
    if !head.tiles.is_sorted_by(|a, b| a.key > b.key) {
        r.problem("tiles out of order", &name);
    }
    let entry = s.view.entry(n)?;
    if entry.id != head.declaration.id() || entry.geometry != head.geometry(entry.geometry.precedence) {
        r.problem("the root page describes the survey otherwise than its head", &name);
    }
    if entry.geometry.precedence != s.policy().precedence(entry.date, entry.precedence) {
        r.problem(format!("precedence {} does not follow from the policy", entry.geometry.precedence), &name);
    }
    let input = Input {
        kind: s.kind(),
        declaration: head.declaration.clone(),
        tiles,
        before: None,
        dirty: head.tiles.iter().map(|t| t.posts).collect(),
        compare: false,
        cache: &cache,
        stamp: 0,
    };
    let built = build(input, &s.view.files, &mut segment, progress)?;
    if built.head.level_max != head.level_max
        || built.head.core != head.core
        || built.head.patches != head.patches
    {
        r.problem(
            format!(
                "levels {} core {:?} patches {}, rebuilt {} {:?} {}",
                head.level_max,
                head.core,
                head.patches,
                built.head.level_max,
                built.head.core,
                built.head.patches
            ),
            &name,
        );
    }
    let known: Vec<_> = head.pages.iter().map(|(a, _)| *a).collect();
    for a in known.iter().filter(|a| !built.pages.contains_key(a)) {
        r.problem(format!("page {a:?} should not exist"), &name);
    }
    for (at, page) in &built.pages {
        let Some(page) = page else { continue };
        let stored = s.view.patch_page(n, *at)?;
        r.count("patches", page.patches.iter().flatten().count() as u64);
        let Some(stored) = stored else {
            r.problem(format!("page {at:?} is missing"), &name);
            continue;
        };
        for k in 0..page.patches.len() {
            if page.patches[k] != stored.patches[k] {
                r.problem(
                    format!(
                        "patch {:?} is {:?}, rebuilt {:?}",
                        at.place(k),
                        stored.patches[k],
                        page.patches[k]
                    ),
                    &name,
                );
            }
            if at.level == 0 && page.block(k) != stored.block(k) {
                r.problem(format!("core cells of {:?} differ from the samples", at.place(k)), &name);
            }
        }
        for (a, b) in page.blocks.iter().zip(&stored.blocks) {
            let same = match (a, b) {
                (None, None) => true,
                (Some(a), Some(b)) => (a.len, a.crc) == (b.len, b.crc) || same_block(s, &segment, a, b)?,
                _ => false,
            };
            if !same {
                r.problem(format!("a sample block of page {at:?} differs from the level below"), &name);
            }
        }
    }
    Ok(())
}

/// Whether two blocks hold the same samples; their bytes may differ if another zstd made them.
fn same_block(s: &Snapshot, rebuilt: &SegmentWriter, a: &PageRef, b: &PageRef) -> Result<bool> {
    use crate::height::block::decode;
    let a = decode(&rebuilt.page(a)?, "memory")?;
    Ok(a == decode(&s.view.files.page(b)?, &file_name(b.file))?)
}

/// core', tops and floors, computed afresh.
fn standings(s: &Snapshot, r: &mut Report, progress: &Progress) -> Result<()> {
    let rules = Rules(&s.view);
    for e in s.entries().cloned().collect::<Vec<_>>() {
        let mut all: Vec<(Place, crate::store::table::PatchEntry, crate::store::table::TopEntry)> =
            Vec::new();
        s.view.each_patch(e.number, |place, p, t| {
            all.push((place, *p, *t));
            Ok(())
        })?;
        let (mut live, mut dormant) = (0, 0);
        let done = std::sync::atomic::AtomicU64::new(0);
        let wrong: Vec<Option<String>> = all
            .par_iter()
            .map(|(place, p, t)| -> Result<Option<String>> {
                let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                if n.is_multiple_of(256) {
                    progress.step("tops", n as f64 / all.len() as f64)?;
                }
                let is = cutter::standing(&rules, e.number, *place, &p.fact)?;
                if is != t.standing {
                    return Ok(Some(format!("{place:?}: top {:?}, afresh {is:?}", t.standing)));
                }
                if place.level == 0 {
                    let fresh = cover::core_prime(&rules, e.number, place.i, place.j)?;
                    let at = crate::store::table::PageAddress::of_place(*place);
                    let stored =
                        s.view.top_page(e.number, at)?.map(|x| x.block(crate::store::table::slot(*place)));
                    if stored != Some(fresh) {
                        return Ok(Some(format!("{place:?}: core' differs from the rule of precedence")));
                    }
                } else {
                    let mut fills = [Fill::Empty; 4];
                    for (f, c) in fills.iter_mut().zip(place.children()) {
                        *f = s.view.top(e.number, c)?.map_or(Fill::Empty, |x| x.kernel);
                    }
                    if Fill::join(fills) != t.kernel {
                        return Ok(Some(format!(
                            "{place:?}: kernel {:?} does not follow from its children",
                            t.kernel
                        )));
                    }
                }
                Ok(None)
            })
            .collect::<Result<_>>()?;
        for w in wrong.into_iter().flatten() {
            r.problem(w, format!("survey '{}'", e.name));
        }
        for (_, p, t) in &all {
            if t.standing.top > p.fact.bot { live += 1 } else { dormant += 1 }
        }
        r.count("tops", all.len() as u64);
        if (live, dormant) != (e.live, e.dormant) {
            r.problem(
                format!(
                    "{live} live and {dormant} dormant patches, the root page says {} and {}",
                    e.live, e.dormant
                ),
                format!("survey '{}'", e.name),
            );
        }
    }
    Ok(())
}

/// The tree against its definition.
fn tree(s: &Snapshot, r: &mut Report) -> Result<()> {
    let mut live: HashMap<(SurveyNumber, Place), Record> = HashMap::new();
    for e in s.entries() {
        s.view.each_patch(e.number, |place, p, t| {
            if let Some(record) = View::record(e.number, place, p, t) {
                live.insert((e.number, place), record);
            }
            Ok(())
        })?;
    }
    let Some(t) = &s.view.tree else {
        if !live.is_empty() {
            r.problem("there are live patches but no tree", "root page");
        }
        return Ok(());
    };
    let mut problems = Vec::new();
    let stats = check_tree(&s.view.files, &Rules(&s.view), t, &live, &mut problems)?;
    r.count("tree nodes", stats.nodes);
    r.count("tree records", stats.records);
    for p in problems {
        r.problem(p, "tree");
    }
    Ok(())
}
