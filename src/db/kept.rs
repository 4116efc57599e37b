//! A cache whose memory follows what is in use: what nobody asked for in a while goes, however much room there is.

use quick_cache::sync::Cache;
use quick_cache::{UnitWeighter, Weighter};
use std::hash::Hash;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// A value, and the round in which it was last asked for.
pub struct Entry<V>(V, AtomicU32);

/// Weighs an entry as its value.
#[derive(Clone)]
pub struct ByValue<W>(W);

impl<K, V, W: Weighter<K, V>> Weighter<K, Arc<Entry<V>>> for ByValue<W> {
    fn weight(&self, key: &K, e: &Arc<Entry<V>>) -> u64 {
        self.0.weight(key, &e.0)
    }
}

/// Values by key, at most so many or so heavy. A round ends with [`Kept::sweep`]; what was asked for in neither of two rounds is
/// dropped then.
pub struct Kept<K, V, W = UnitWeighter> {
    entries: Cache<K, Arc<Entry<V>>, ByValue<W>>,
    round: AtomicU32,
}

impl<K: Hash + Eq, V: Clone> Kept<K, V> {
    /// At most `count` values.
    pub fn new(count: usize) -> Kept<K, V> {
        Kept::weighing(count, count as u64, UnitWeighter)
    }
}

impl<K: Hash + Eq, V: Clone, W: Weighter<K, V> + Clone> Kept<K, V, W> {
    /// Values that together weigh `most` at most; `count` of them are expected.
    pub fn weighing(count: usize, most: u64, weighter: W) -> Kept<K, V, W> {
        Kept { entries: Cache::with_weighter(count, most, ByValue(weighter)), round: AtomicU32::new(0) }
    }

    pub fn get(&self, key: &K) -> Option<V> {
        let e = self.entries.get(key)?;
        e.1.store(self.round.load(Ordering::Relaxed), Ordering::Relaxed);
        Some(e.0.clone())
    }

    pub fn insert(&self, key: K, value: V) {
        let round = AtomicU32::new(self.round.load(Ordering::Relaxed));
        self.entries.insert(key, Arc::new(Entry(value, round)));
    }

    /// The value under a key, or what `read` gives, kept from now on.
    pub fn or_read<E>(&self, key: K, read: impl FnOnce() -> Result<V, E>) -> Result<V, E> {
        if let Some(found) = self.get(&key) {
            return Ok(found);
        }
        let found = read()?;
        self.insert(key, found.clone());
        Ok(found)
    }

    /// Ends a round.
    pub fn sweep(&self) {
        let ended = self.round.fetch_add(1, Ordering::Relaxed);
        self.entries.retain(|_, e| ended.wrapping_sub(e.1.load(Ordering::Relaxed)) <= 1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_for_stays_and_what_is_not_goes() {
        let kept: Kept<u8, u8> = Kept::new(100);
        (0..10).for_each(|k| kept.insert(k, k));
        for _ in 0..5 {
            assert_eq!(kept.get(&3), Some(3));
            kept.sweep();
        }
        assert_eq!((kept.get(&3), kept.get(&4)), (Some(3), None));
        assert_eq!(kept.or_read(4, || Err("unreadable")), Err("unreadable"));
        assert_eq!(kept.or_read::<()>(4, || Ok(5)), Ok(5));
        assert_eq!(kept.get(&4), Some(5));
    }
}
