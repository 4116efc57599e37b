//! Decoded pages, kept for as long as a database is open and shared by its versions.
//!
//! Pages never change, and a [`PageRef`] names one for ever (numbers of files are never given out again). So what a
//! commit did not touch is as warm in the new version as it was in the old one.

use super::head::Head;
use super::reader::{BlockCache, block_cache};
use super::tile::Directory;
use crate::base::Result;
use crate::base::bytes::Reader;
use crate::store::quadtree::Node;
use crate::store::segment::{Files, PageRef, Pages, file_name};
use crate::store::table::{PageAddress, PageList, PatchPage, TopPage, read_list};
use quick_cache::sync::Cache;
use std::hash::Hash;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Pages kept decoded, by count. A patch page weighs about 10 KiB, a node 3 KiB.
const PAGES: usize = 8192;
const NODES: usize = 16_384;
const DIRECTORIES: usize = 1024;
/// Heads and lists of pages of surveys: a survey of a hundred million posts has some 100 KiB of either.
const SURVEYS: usize = 256;
/// Decoded sample blocks, bytes.
const BLOCK_BYTES: u64 = 192 << 20;

/// A head, and what tells its sample blocks from those of any other head.
pub struct Known {
    pub head: Arc<Head>,
    pub stamp: u64,
}

/// Decoded pages of a database.
pub struct Caches {
    nodes: Cache<PageRef, Arc<Node>>,
    patch_pages: Cache<(PageRef, PageAddress), Arc<PatchPage>>,
    top_pages: Cache<(PageRef, PageAddress), Arc<TopPage>>,
    directories: Cache<PageRef, Arc<Directory>>,
    heads: Cache<PageRef, Arc<Known>>,
    lists: Cache<PageRef, Arc<PageList>>,
    /// By the stamp of a head: a head names its tiles and pages, so it fixes every sample.
    pub blocks: BlockCache,
    stamps: AtomicU64,
}

impl Caches {
    pub fn new() -> Arc<Caches> {
        Arc::new(Caches {
            nodes: Cache::new(NODES),
            patch_pages: Cache::new(PAGES),
            top_pages: Cache::new(PAGES),
            directories: Cache::new(DIRECTORIES),
            heads: Cache::new(SURVEYS),
            lists: Cache::new(SURVEYS),
            blocks: block_cache(BLOCK_BYTES),
            stamps: AtomicU64::new(0),
        })
    }

    pub fn node(&self, files: &Files, at: &PageRef) -> Result<Arc<Node>> {
        kept(&self.nodes, *at, || Node::read(files, at))
    }

    pub fn patch_page(&self, files: &Files, r: &PageRef, at: PageAddress) -> Result<Arc<PatchPage>> {
        kept(&self.patch_pages, (*r, at), || PatchPage::decode(&files.page(r)?, at, &file_name(r.file)))
    }

    pub fn top_page(&self, files: &Files, r: &PageRef, at: PageAddress) -> Result<Arc<TopPage>> {
        kept(&self.top_pages, (*r, at), || TopPage::decode(&files.page(r)?, at, &file_name(r.file)))
    }

    pub fn directory(&self, files: &Files, at: &PageRef) -> Result<Arc<Directory>> {
        kept(&self.directories, *at, || Directory::decode(&files.page(at)?, &file_name(at.file)))
    }

    pub fn head(&self, files: &Files, at: &PageRef) -> Result<Arc<Known>> {
        kept(&self.heads, *at, || {
            let head = Arc::new(Head::decode(&files.page(at)?, &file_name(at.file))?);
            Ok(Known { head, stamp: self.stamps.fetch_add(1, Ordering::Relaxed) })
        })
    }

    pub fn top_list(&self, files: &Files, at: &PageRef) -> Result<Arc<PageList>> {
        kept(&self.lists, *at, || {
            let (bytes, name) = (files.page(at)?, file_name(at.file));
            let mut r = Reader::new(&bytes, &name, "top list");
            let list = read_list(&mut r)?;
            r.end()?;
            Ok(list)
        })
    }
}

/// What is kept under a key, or what `read` gives, kept from now on.
fn kept<K: Hash + Eq, V>(
    cache: &Cache<K, Arc<V>>,
    key: K,
    read: impl FnOnce() -> Result<V>,
) -> Result<Arc<V>> {
    if let Some(found) = cache.get(&key) {
        return Ok(found);
    }
    let found = Arc::new(read()?);
    cache.insert(key, found.clone());
    Ok(found)
}
