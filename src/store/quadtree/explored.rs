//! The part of one version's tree that questions have reached: shelves side by side, linked by number.
//!
//! A question that finds a node through a cache of pages pays for a hash and a lock at each. Here it follows a number. What
//! decides about a node lies in one array, in the order in which nodes were first reached: a walk over all of them reads memory
//! forwards. Nodes are shared with other versions (they are immutable); links are of this version.

use super::node::Record;
use super::shelf::{Shelf, Summary, first};
use crate::base::Result;
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Spots of a part of the array.
const PART: usize = 1024;
const PARTS: usize = 32;
/// Nodes that are linked at most; what lies beyond is found through the cache each time.
pub const SPOTS_MAX: usize = PART * PARTS;

/// Link of a shelf to the rest of its node, after the four children.
pub const REST: usize = 4;

/// A reached node, or a part of one.
pub struct Spot {
    pub summary: Summary,
    pub shelf: Arc<Shelf>,
    /// Those of the shelf: who reads an answer need not touch the shelf itself.
    pub records: Arc<[Record]>,
    /// Numbers of the children and of the rest; 0: not reached yet.
    links: [AtomicU32; 5],
}

impl Spot {
    fn new(shelf: Arc<Shelf>) -> Spot {
        Spot { summary: shelf.summary, records: shelf.records.clone(), shelf, links: Default::default() }
    }

    /// Records with at least this top. The shelf is touched only where its records differ.
    #[inline]
    pub fn of_top(&self, least: f32) -> u64 {
        if self.summary.top_least >= least { self.summary.all } else { first(self.shelf.of_top(least)) }
    }

    /// Records with at most this bot.
    #[inline]
    pub fn of_bot(&self, most: f32) -> u64 {
        let s = &self.summary;
        if s.bot_least > most {
            0
        } else if s.bot_most <= most {
            s.all
        } else {
            self.shelf.of_bot(most)
        }
    }
}

/// A spot with its number, or one that found no room.
pub enum Reached<'a> {
    Linked(u32, &'a Spot),
    Apart(Box<Spot>),
}

/// Reached nodes of one version.
pub struct Explored {
    parts: [OnceLock<Box<[OnceLock<Spot>]>>; PARTS],
    /// Stands above the root.
    door: AtomicU32,
    count: Mutex<usize>,
    most: usize,
}

impl Default for Explored {
    fn default() -> Explored {
        Explored::of(SPOTS_MAX)
    }
}

impl Explored {
    /// With room for so many, [`SPOTS_MAX`] at most.
    pub fn of(most: usize) -> Explored {
        Explored {
            parts: [const { OnceLock::new() }; PARTS],
            door: AtomicU32::new(0),
            count: Mutex::new(0),
            most: most.min(SPOTS_MAX),
        }
    }

    /// Whether there is no more room.
    pub fn is_full(&self) -> bool {
        *self.count.lock().unwrap_or_else(PoisonError::into_inner) == self.most
    }

    /// The spot of a number that this gave.
    #[inline]
    pub fn spot(&self, number: u32) -> &Spot {
        let k = number as usize - 1;
        let spot = self.parts[k / PART].get().and_then(|p| p[k % PART].get());
        spot.expect("a number is given after its spot is there")
    }

    /// The root, from `read` if it was not reached yet.
    pub fn root(&self, read: impl FnOnce() -> Result<Arc<Shelf>>) -> Result<Reached<'_>> {
        self.follow(&self.door, read)
    }

    /// What a link of a spot leads to, from `read` if it was not reached yet.
    #[inline]
    pub fn below<'a>(
        &'a self,
        spot: &Spot,
        link: usize,
        read: impl FnOnce() -> Result<Arc<Shelf>>,
    ) -> Result<Reached<'a>> {
        self.follow(&spot.links[link], read)
    }

    #[inline]
    fn follow(&self, link: &AtomicU32, read: impl FnOnce() -> Result<Arc<Shelf>>) -> Result<Reached<'_>> {
        match link.load(Ordering::Acquire) {
            0 => Ok(self.reach(link, read()?)),
            number => Ok(Reached::Linked(number, self.spot(number))),
        }
    }

    fn reach(&self, link: &AtomicU32, shelf: Arc<Shelf>) -> Reached<'_> {
        let mut count = self.count.lock().unwrap_or_else(PoisonError::into_inner);
        // Another question may have come here meanwhile.
        let mut number = link.load(Ordering::Acquire);
        if number == 0 {
            if *count == self.most {
                return Reached::Apart(Box::new(Spot::new(shelf)));
            }
            let part = self.parts[*count / PART]
                .get_or_init(|| std::iter::repeat_with(OnceLock::new).take(PART).collect());
            part[*count % PART].get_or_init(|| Spot::new(shelf));
            *count += 1;
            number = *count as u32;
            link.store(number, Ordering::Release);
        }
        Reached::Linked(number, self.spot(number))
    }
}
