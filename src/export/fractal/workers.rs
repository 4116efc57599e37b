//! The threads of the current pool, at work for the codec.

use crate::export::Going;
use rayon::prelude::*;
use terraquilt_codecs::work::Workers;

/// The threads of the pool that it is called in.
pub struct Threads<'a> {
    stage: &'a str,
    going: Going<'a>,
}

impl<'a> Threads<'a> {
    /// `going` is told of `stage`, and asked whether to go on.
    pub fn new(stage: &'a str, going: Going<'a>) -> Threads<'a> {
        Threads { stage, going }
    }
}

impl Workers for Threads<'_> {
    fn run(&self, parts: usize, part: &(dyn Fn(usize) + Sync)) {
        (0..parts).into_par_iter().for_each(part);
    }

    fn going(&self, share: f64) -> bool {
        (self.going)(self.stage, share)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicUsize, Ordering};

    #[test]
    fn every_part_is_done_once_and_what_is_done_is_told() {
        let done: Vec<AtomicUsize> = (0..1000).map(|_| AtomicUsize::new(0)).collect();
        let told = Mutex::new(Vec::new());
        let going = |stage: &str, share: f64| {
            told.lock().unwrap().push((stage.to_string(), share));
            share < 0.5
        };
        let threads = Threads::new("maps", &going);
        threads.run(1000, &|k| {
            done[k].fetch_add(1, Ordering::Relaxed);
        });
        assert!(done.iter().all(|n| n.load(Ordering::Relaxed) == 1));
        assert!(threads.going(0.25) && !threads.going(0.75));
        assert_eq!(*told.lock().unwrap(), [("maps".to_string(), 0.25), ("maps".to_string(), 0.75)]);
    }
}
