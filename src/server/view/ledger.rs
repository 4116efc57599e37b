//! What was sent to one client: the set it holds now, and earlier ones that it may come back with.

use super::difference::{Difference, lead};
use super::set::Set;
use super::target::Target;
use std::collections::VecDeque;
use std::sync::Arc;

/// Sets that are remembered for clients that come back.
const SETS_KEPT: usize = 32;
/// Patches and blocks of remembered sets, those that several share counted once. The two newest sets are always kept.
const WEIGHT_KEPT: usize = 1 << 16;

/// What was sent to one client, in the order of the stream.
#[derive(Clone, Debug)]
pub struct Ledger {
    /// Ascending by number; the last is what the client holds when it has read everything.
    sent: VecDeque<Arc<Set>>,
    /// Number of the newest difference that was ever sent. Numbers and handles are never given twice.
    number: u64,
    handle: u32,
}

impl Default for Ledger {
    fn default() -> Ledger {
        Ledger { sent: VecDeque::from([Arc::new(Set::empty())]), number: 0, handle: 1 }
    }
}

impl Ledger {
    /// As last sent.
    pub fn last(&self) -> &Arc<Set> {
        self.sent.back().expect("a ledger is never empty")
    }

    /// Number of the newest difference.
    pub fn number(&self) -> u64 {
        self.number
    }

    /// Patches and blocks that it keeps in memory.
    pub fn weight(&self) -> usize {
        let empty = Set::empty();
        let mut before = &empty;
        let mut sum = 0;
        for set in &self.sent {
            sum += set.weight_beside(before);
            before = set;
        }
        sum
    }

    /// Leads the client to a target: the difference that it has to be sent. `answers`: the question that it answers; without
    /// one, there is a difference only if the ground of the view has changed.
    pub fn step(&mut self, target: Target, answers: Option<u64>) -> Option<Difference> {
        if u64::from(self.handle) + target.records.len() as u64 > u64::from(u32::MAX) {
            self.begin();
            self.handle = 1;
        }
        let by_height = target.by_height;
        let mut handle = self.handle;
        let (mut set, mut d) = lead(self.last(), target, &mut handle);
        if answers.is_none() && d.is_empty() && !(by_height && d.other_heights) {
            return None;
        }
        self.handle = handle;
        self.number += 1;
        set.number = self.number;
        d.to = self.number;
        d.answers = answers.unwrap_or(0);
        self.sent.push_back(Arc::new(set));
        self.forget();
        Some(d)
    }

    fn forget(&mut self) {
        while self.sent.len() > 2 && (self.sent.len() > SETS_KEPT || self.weight() > WEIGHT_KEPT) {
            self.sent.pop_front();
        }
    }

    /// The client has applied a difference: it will not come back with an earlier one.
    pub fn applied(&mut self, number: u64) {
        while self.sent.len() > 1 && self.sent[0].number < number {
            self.sent.pop_front();
        }
    }

    /// Goes back to what a client says it holds. False, and nothing changed, if that set is not remembered.
    pub fn resume(&mut self, applied: u64, hash: &[u8]) -> bool {
        match self.sent.iter().position(|s| s.number == applied && s.hash == hash) {
            Some(k) => {
                self.sent.truncate(k + 1);
                true
            }
            None => false,
        }
    }

    /// Begins anew: the client holds nothing.
    pub fn begin(&mut self) {
        self.sent = VecDeque::from([Arc::new(Set::empty())]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::height::lod::{PatchId, Place, SurveyNumber};
    use crate::store::quadtree::Record;

    /// The patches `from..to` of no survey in particular.
    fn target(from: u8, to: u8) -> Target {
        let record = |k: u8| Record {
            top: 1.0,
            bot: 0.0,
            floor: false,
            survey: SurveyNumber(1),
            place: Place { level: 0, i: i32::from(k), j: 0 },
            id: PatchId([k; 16]),
        };
        Target {
            version: 1,
            records: (from..to).map(record).collect(),
            surveys: Vec::new(),
            masks: Vec::new(),
            corrections: Vec::new(),
            ground: Arc::default(),
            by_height: false,
        }
    }

    #[test]
    fn when_handles_run_out_the_view_begins_anew() {
        let mut ledger = Ledger::default();
        ledger.step(target(0, 10), Some(1));
        ledger.handle = u32::MAX - 15;
        let d = ledger.step(target(5, 15), Some(2)).unwrap();
        assert_eq!((d.from, d.removed.len(), d.added.len()), (1, 5, 5));
        assert_eq!(d.added[0].handle, u32::MAX - 15);
        let d = ledger.step(target(8, 20), Some(3)).unwrap();
        assert_eq!((d.from, d.to, d.removed.len(), d.added.len()), (0, 3, 0, 12));
        assert_eq!(d.added[0].handle, 1);
    }

    #[test]
    fn handles_and_numbers_are_given_once() {
        let mut ledger = Ledger::default();
        let first = ledger.step(target(0, 4), Some(1)).unwrap();
        let lost = ledger.step(target(0, 6), Some(2)).unwrap();
        assert!(ledger.resume(1, &first.hash));
        let again = ledger.step(target(0, 8), Some(3)).unwrap();
        assert_eq!((again.from, again.to, again.added.len()), (1, 3, 4));
        assert!(again.added.iter().all(|m| m.handle > lost.added[1].handle));
        assert!(!ledger.resume(2, &lost.hash), "what was lost is no set to come back with");
    }

    #[test]
    fn old_sets_are_forgotten() {
        let mut ledger = Ledger::default();
        let hashes: Vec<_> = (0..100).map(|k| ledger.step(target(0, k + 1), Some(1)).unwrap().hash).collect();
        let known = |l: &Ledger, n: usize| l.clone().resume(n as u64, &hashes[n - 1]);
        assert!(known(&ledger, 100) && known(&ledger, 101 - SETS_KEPT) && !known(&ledger, 100 - SETS_KEPT));
        ledger.applied(95);
        assert!(known(&ledger, 95) && !known(&ledger, 94));
        ledger.applied(u64::MAX);
        assert!(known(&ledger, 100) && ledger.sent.len() == 1);
    }
}
