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
        if answers.is_none() && d.same_ground() && !(by_height && d.other_heights) {
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
