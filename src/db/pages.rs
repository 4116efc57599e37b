//! The pages of a version, found by walking down from its root.

use super::root::SurveyEntry;
use super::view::{Tables, View};
use crate::base::Result;
use crate::store::quadtree::Node;
use crate::store::segment::{PageRef, Pages};
use std::collections::HashSet;

/// Adds every page that a version reads to `seen`. What is below a page that was seen already is not walked again:
/// versions share most of their pages. Every page but sample blocks and top pages is read, its checksum compared.
///
/// # Errors
/// If a page that is walked is damaged: file and place are named.
pub(super) fn gather(view: &View, root: PageRef, seen: &mut HashSet<PageRef>) -> Result<()> {
    seen.insert(root);
    let mut stack: Vec<PageRef> = view.tree.iter().map(|t| t.page).collect();
    while let Some(at) = stack.pop() {
        if seen.insert(at) {
            stack.extend(Node::read(&view.files, &at)?.children.iter().flatten().map(|c| c.page));
        }
    }
    view.entries().values().try_for_each(|e| gather_survey(view, e, seen))
}

/// The same for the pages of one survey.
pub(super) fn gather_survey(view: &View, e: &SurveyEntry, seen: &mut HashSet<PageRef>) -> Result<()> {
    if seen.insert(e.tops) {
        seen.extend(view.top_list(e.number)?.iter().map(|(_, page)| *page));
    }
    if !seen.insert(e.head) {
        return Ok(());
    }
    let head = view.head(e.number)?.clone();
    for t in &head.tiles {
        if seen.insert(t.directory) {
            seen.extend(view.directory(&t.directory)?.pages.iter().map(|(page, _)| *page));
        }
    }
    for (at, page) in &head.pages {
        if seen.insert(*page)
            && let Some(p) = view.patch_page(e.number, *at)?
        {
            seen.extend(p.blocks.iter().flatten());
        }
    }
    Ok(())
}

/// Reads every page of a list, so that their checksums are compared.
pub(super) fn check(pages: &dyn Pages, all: &[PageRef]) -> Result<()> {
    all.iter().try_for_each(|at| pages.page(at).map(|_| ()))
}
