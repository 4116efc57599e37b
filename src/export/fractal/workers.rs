//! The threads of the current pool, at work for the codec.

use crate::export::Going;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use terraquilt_codecs::work::Workers;

/// The threads of the pool that it is called in. Told to stop, it leaves the parts that have not begun.
pub struct Threads<'a> {
    stage: &'a str,
    going: Going<'a>,
    /// Share of the work that was told last: bits of a double.
    share: AtomicU64,
    stopped: AtomicBool,
}

impl<'a> Threads<'a> {
    /// `going` is told of `stage`, from any thread.
    pub fn new(stage: &'a str, going: Going<'a>) -> Threads<'a> {
        Threads { stage, going, share: AtomicU64::new(0.0_f64.to_bits()), stopped: AtomicBool::new(false) }
    }

    /// Once stopped it stays so.
    fn goes_on(&self, share: f64) -> bool {
        if !self.stopped.load(Ordering::Relaxed) && !(self.going)(self.stage, share) {
            self.stopped.store(true, Ordering::Relaxed);
        }
        !self.stopped.load(Ordering::Relaxed)
    }
}

impl Workers for Threads<'_> {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        (0..parts).into_par_iter().for_each(|k| {
            if self.goes_on(f64::from_bits(self.share.load(Ordering::Relaxed))) {
                part(k);
            }
        });
    }

    fn going(&self, share: f64) -> bool {
        self.share.store(share.to_bits(), Ordering::Relaxed);
        self.goes_on(share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::AtomicUsize;

    #[test]
    fn every_part_is_done_once_and_a_stop_leaves_the_rest() {
        let done: Vec<AtomicUsize> = (0..1000).map(|_| AtomicUsize::new(0)).collect();
        Threads::new("maps", &|_, _| true).run(1000, &|k| {
            done[k].fetch_add(1, Ordering::Relaxed);
        });
        assert!(done.iter().all(|n| n.load(Ordering::Relaxed) == 1));
        let stop = AtomicBool::new(false);
        let going = |_: &str, _: f64| !stop.load(Ordering::Relaxed);
        let threads = Threads::new("maps", &going);
        let count = AtomicUsize::new(0);
        threads.run(100_000, &|_| {
            if count.fetch_add(1, Ordering::Relaxed) == 10 {
                stop.store(true, Ordering::Relaxed);
            }
        });
        assert!(count.load(Ordering::Relaxed) < 50_000);
        // It does not begin again, whatever it is told later.
        stop.store(false, Ordering::Relaxed);
        assert!(!threads.going(1.0));
    }
}
