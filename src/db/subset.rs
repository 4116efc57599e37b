//! A version with only some of its surveys: what the database would be had the others never come.
//!
//! It is what a commit that removes the others would make, by the same local update (section 12 of the LOD-space
//! specification), but its pages are kept in memory and nothing is published: samples and patches are read from the
//! database's own files. It costs what such a removal costs, and the memory of the changed top and tree pages.

use super::Progress;
use super::commit::write_tops;
use super::database::Snapshot;
use super::root::Root;
use super::update::Draft;
use super::view::{Tables, View};
use crate::base::{Error, Result};
use crate::height::lod::SurveyNumber;
use crate::store::quadtree::Editor;
use crate::store::segment::{PageRef, SegmentKind, SegmentWriter};
use std::collections::BTreeSet;

impl Snapshot {
    /// This version as if only the named surveys (names or id prefixes) were in it.
    ///
    /// # Errors
    /// [`Error::Missing`] if a survey is not in this version, [`Error::Invalid`] if none is named.
    pub fn only(&self, surveys: &[String], progress: &Progress) -> Result<Snapshot> {
        if surveys.is_empty() {
            return Err(Error::invalid("surveys", "none is named; `terraquilt surveys DB` lists them"));
        }
        let kept: BTreeSet<SurveyNumber> =
            surveys.iter().map(|n| Ok(self.survey(n)?.number)).collect::<Result<_>>()?;
        let mut entries = self.view.entries().clone();
        entries.retain(|n, _| kept.contains(n));
        let mut draft = Draft::new(&self.view, entries);
        let changes = draft.derive(None, progress)?;
        let number = self.view.files.lengths().last().map_or(1, |(n, _)| n + 1);
        let mut derived = SegmentWriter::in_memory(number, SegmentKind::Derived)?;
        let mut dead: Vec<PageRef> = Vec::new();
        let entries = write_tops(&self.view, &draft, &changes, &mut derived, &mut dead)?;
        let live_before: u64 = self.view.entries().values().map(|e| e.live).sum();
        let mut editor = Editor::open(&self.view.files, &draft, self.view.tree.map(|t| t.page))?;
        editor.apply(&changes.gone, changes.come, live_before)?;
        let (tree, _) = editor.write(&mut derived)?;
        let root = Root { surveys: entries.into_values().collect(), tree: Some(tree) };
        let at = derived.append(&root.encode())?;
        drop(draft);
        let view = View::open(self.view.files.with(derived)?, Some(at))?;
        Ok(self.seen_as(view))
    }
}
