//! Decoded pages, kept for as long as a database is open and shared by its versions.
//!
//! Pages never change, and a [`PageRef`] names one for ever (no number of a file that a version named is given out again). So what a
//! commit did not touch is as warm in the new version as it was in the old one. [`Caches::tidy`] lets go of what is no longer in
//! use.

use super::head::Head;
use super::kept::Kept;
use super::payload::Payloads;
use super::reader::{BlockCache, block_cache};
use super::tile::Directory;
use crate::base::Result;
use crate::base::bytes::Reader;
use crate::store::quadtree::{SPOTS_MAX, Shelf};
use crate::store::segment::{Files, PageRef, Pages, file_name};
use crate::store::table::{PageAddress, PageList, PatchPage, TopPage, read_list};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Pages kept decoded, by count. A patch page weighs about 10 KiB, a node some 100 bytes a record, 6.5 KiB at most.
const PAGES: usize = 8192;
const NODES: usize = SPOTS_MAX;
const DIRECTORIES: usize = 1024;
/// Heads and lists of pages of surveys: a survey of a hundred million posts has some 100 KiB of either, a small one 1 KiB. Room for
/// as many as may lie over one place: a commit there asks all of them.
const SURVEYS: usize = 2048;
/// Decoded sample blocks, bytes.
const BLOCK_BYTES: u64 = 192 << 20;

/// How long a round of the caches lasts at least.
const SWEEP_EVERY: Duration = Duration::from_secs(60);

/// A head, and what tells its sample blocks from those of any other head.
pub struct Known {
    pub head: Arc<Head>,
    pub stamp: u64,
}

/// Decoded pages of a database.
pub struct Caches {
    nodes: Kept<PageRef, Arc<Shelf>>,
    patch_pages: Kept<(PageRef, PageAddress), Arc<PatchPage>>,
    top_pages: Kept<(PageRef, PageAddress), Arc<TopPage>>,
    directories: Kept<PageRef, Arc<Directory>>,
    heads: Kept<PageRef, Arc<Known>>,
    lists: Kept<PageRef, Arc<PageList>>,
    /// By the stamp of a head: a head names its tiles and pages, so it fixes every sample.
    pub blocks: BlockCache,
    /// Packed vertices.
    pub payloads: Payloads,
    stamps: AtomicU64,
    swept: Mutex<Instant>,
}

impl Caches {
    pub fn new() -> Arc<Caches> {
        Arc::new(Caches {
            nodes: Kept::new(NODES),
            patch_pages: Kept::new(PAGES),
            top_pages: Kept::new(PAGES),
            directories: Kept::new(DIRECTORIES),
            heads: Kept::new(SURVEYS),
            lists: Kept::new(SURVEYS),
            blocks: block_cache(BLOCK_BYTES),
            payloads: Payloads::new(),
            stamps: AtomicU64::new(0),
            swept: Mutex::new(Instant::now()),
        })
    }

    /// Drops what nobody asked for lately; called whenever a version is opened or a commit begins. Of the pages that commits replace none
    /// would be asked for again, and they would fill the caches in the end.
    pub fn tidy(&self) {
        {
            let mut swept = self.swept.lock().unwrap_or_else(PoisonError::into_inner);
            if swept.elapsed() < SWEEP_EVERY {
                return;
            }
            *swept = Instant::now();
        }
        self.nodes.sweep();
        self.patch_pages.sweep();
        self.top_pages.sweep();
        self.directories.sweep();
        self.heads.sweep();
        self.lists.sweep();
        self.blocks.sweep();
        self.payloads.sweep();
    }

    /// A node of a tree, in columns. No number of a survey that a version held is given again, and a survey keeps its frame: what follows from
    /// records holds in every version that has the page.
    pub fn node(&self, at: &PageRef, read: impl FnOnce() -> Result<Shelf>) -> Result<Arc<Shelf>> {
        self.nodes.or_read(*at, || read().map(Arc::new))
    }

    pub fn patch_page(&self, files: &Files, r: &PageRef, at: PageAddress) -> Result<Arc<PatchPage>> {
        self.patch_pages
            .or_read((*r, at), || PatchPage::decode(&files.page(r)?, at, &file_name(r.file)).map(Arc::new))
    }

    pub fn top_page(&self, files: &Files, r: &PageRef, at: PageAddress) -> Result<Arc<TopPage>> {
        self.top_pages
            .or_read((*r, at), || TopPage::decode(&files.page(r)?, at, &file_name(r.file)).map(Arc::new))
    }

    pub fn directory(&self, files: &Files, at: &PageRef) -> Result<Arc<Directory>> {
        self.directories
            .or_read(*at, || Directory::decode(&files.page(at)?, &file_name(at.file)).map(Arc::new))
    }

    pub fn head(&self, files: &Files, at: &PageRef) -> Result<Arc<Known>> {
        self.heads.or_read(*at, || {
            let head = Arc::new(Head::decode(&files.page(at)?, &file_name(at.file))?);
            Ok(Arc::new(Known { head, stamp: self.stamps.fetch_add(1, Ordering::Relaxed) }))
        })
    }

    pub fn top_list(&self, files: &Files, at: &PageRef) -> Result<Arc<PageList>> {
        self.lists.or_read(*at, || {
            let (bytes, name) = (files.page(at)?, file_name(at.file));
            let mut r = Reader::new(&bytes, &name, "top list");
            let list = read_list(&mut r)?;
            r.end()?;
            Ok(Arc::new(list))
        })
    }
}
