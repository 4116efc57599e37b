//! Moving pages of a version to new segments, and with them every page on the way to the root.

use super::change::Progress;
use super::head::{Head, Tile};
use super::root::{Root, SurveyEntry};
use super::tile::Directory;
use super::view::{Tables, View};
use crate::base::Result;
use crate::store::disk::Disk;
use crate::store::quadtree::{ChildRef, Node};
use crate::store::segment::{PageRef, Pages, SegmentKind, SegmentWriter};
use crate::store::table::{PageList, put_list};
use std::sync::Arc;

/// Writes a version's pages anew: those in chosen files, and those that name one that moved. What they say is the same.
pub(super) struct Relocation<'a> {
    view: &'a View,
    moves: &'a dyn Fn(u32) -> bool,
    disk: &'a dyn Disk,
    /// Number of the segment for pages of surveys; the next one is for what the set makes of them.
    first: u32,
    surveys: Option<SegmentWriter>,
    derived: SegmentWriter,
    /// Pages that the new version does not read.
    pub dead: Vec<PageRef>,
    progress: &'a Progress<'a>,
    /// Live bytes of the chosen files, for the progress.
    total: u64,
    moved: u64,
}

impl<'a> Relocation<'a> {
    pub fn new(
        view: &'a View,
        moves: &'a dyn Fn(u32) -> bool,
        (disk, first): (&'a dyn Disk, u32),
        (progress, total): (&'a Progress<'a>, u64),
    ) -> Result<Relocation<'a>> {
        let derived = SegmentWriter::create(disk, first + 1, SegmentKind::Derived)?;
        let (surveys, dead) = (None, Vec::new());
        Ok(Relocation { view, moves, disk, first, surveys, derived, dead, progress, total, moved: 0 })
    }

    /// Moves what has to move. Returns the root of the new version, and the segments that were written.
    pub fn run(mut self, root: PageRef) -> Result<(PageRef, Vec<SegmentWriter>, Vec<PageRef>)> {
        let mut surveys = Vec::new();
        for e in self.view.entries().values() {
            surveys.push(SurveyEntry { head: self.head(e)?, tops: self.tops(e)?, ..e.clone() });
        }
        let tree = match &self.view.tree {
            Some(t) => Some(ChildRef { page: self.node(&t.page)?, ..*t }),
            None => None,
        };
        let page = Root { surveys, tree }.encode();
        let at = self.write(SegmentKind::Derived, &root, &page)?;
        Ok((at, self.surveys.into_iter().chain([self.derived]).collect(), self.dead))
    }

    /// Writes a page in place of an old one.
    fn write(&mut self, kind: SegmentKind, old: &PageRef, bytes: &[u8]) -> Result<PageRef> {
        self.dead.push(*old);
        self.moved += u64::from(old.len);
        if self.dead.len().is_multiple_of(256) {
            self.progress.step("moving", (self.moved as f64 / self.total.max(1) as f64).min(1.0))?;
        }
        if kind == SegmentKind::Derived {
            return self.derived.append(bytes);
        }
        let segment = match &mut self.surveys {
            Some(s) => s,
            None => self.surveys.insert(SegmentWriter::create(self.disk, self.first, kind)?),
        };
        segment.append(bytes)
    }

    /// Moves a page that names no other, if its file is chosen.
    fn leaf(&mut self, kind: SegmentKind, at: &PageRef) -> Result<PageRef> {
        if !(self.moves)(at.file) {
            return Ok(*at);
        }
        let bytes = self.view.files.page(at)?;
        self.write(kind, at, &bytes)
    }

    fn tile(&mut self, t: &Tile) -> Result<Tile> {
        let old: Arc<Directory> = self.view.directory(&t.directory)?;
        let mut new = (*old).clone();
        for (page, _) in &mut new.pages {
            *page = self.leaf(SegmentKind::Survey, page)?;
        }
        let directory = if new != *old || (self.moves)(t.directory.file) {
            self.write(SegmentKind::Survey, &t.directory, &new.encode())?
        } else {
            t.directory
        };
        Ok(Tile { directory, ..t.clone() })
    }

    fn head(&mut self, e: &SurveyEntry) -> Result<PageRef> {
        let old = self.view.head(e.number)?.clone();
        let mut new = Head::clone(&old);
        for t in &mut new.tiles {
            *t = self.tile(t)?;
        }
        for (at, page) in &mut new.pages {
            let Some(p) = self.view.patch_page(e.number, *at)? else { continue };
            let mut q = (*p).clone();
            for b in q.blocks.iter_mut().flatten() {
                *b = self.leaf(SegmentKind::Survey, b)?;
            }
            if q != *p || (self.moves)(page.file) {
                *page = self.write(SegmentKind::Survey, page, &q.encode(*at))?;
            }
        }
        if new == *old && !(self.moves)(e.head.file) {
            return Ok(e.head);
        }
        self.write(SegmentKind::Survey, &e.head, &new.encode())
    }

    fn tops(&mut self, e: &SurveyEntry) -> Result<PageRef> {
        let old = self.view.top_list(e.number)?.clone();
        let mut new: PageList = (*old).clone();
        for (_, page) in &mut new {
            *page = self.leaf(SegmentKind::Derived, page)?;
        }
        if new == *old && !(self.moves)(e.tops.file) {
            return Ok(e.tops);
        }
        let mut bytes = Vec::new();
        put_list(&mut bytes, &new);
        self.write(SegmentKind::Derived, &e.tops, &bytes)
    }

    fn node(&mut self, at: &PageRef) -> Result<PageRef> {
        let old = Node::read(&self.view.files, at)?;
        let mut new = old.clone();
        for c in new.children.iter_mut().flatten() {
            c.page = self.node(&c.page)?;
        }
        if new == old && !(self.moves)(at.file) {
            return Ok(*at);
        }
        self.write(SegmentKind::Derived, at, &new.encode())
    }
}
