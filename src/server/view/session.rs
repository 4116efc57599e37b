//! One view: its question, what was sent of it, and the stream that has it now.

use super::ledger::Ledger;
use super::target::Manner;
use crate::base::{Error, Result};
use crate::db::query::Query;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex as Short, PoisonError};
use std::time::Instant;
use tokio::sync::{Mutex, watch};

/// Random bytes that name a session: who knows them may steer it.
pub type SessionId = [u8; 16];

/// Where a client looks.
#[derive(Clone, Debug)]
pub struct Question {
    /// The client's number of it.
    pub number: u64,
    pub query: Query,
}

/// What a client wants and has said, newest.
#[derive(Clone, Debug)]
pub struct Wanted {
    pub question: Arc<Question>,
    /// Number of the newest difference that it says to have applied.
    pub applied: u64,
    /// Differences that may be under way; 0: as many as the transport takes in.
    pub ahead: u32,
}

/// One view.
pub struct Session {
    pub id: SessionId,
    pub manner: Manner,
    pub wanted: watch::Sender<Wanted>,
    /// The stream that has the view holds it locked.
    pub ledger: Arc<Mutex<Ledger>>,
    /// Counts the streams that have had the view; the last one has it.
    streams: watch::Sender<u64>,
    /// When the last stream ended; `None`: it goes on.
    ended: Short<Option<Instant>>,
    /// Patches and blocks in memory, as of the last step.
    pub weight: AtomicUsize,
}

impl Session {
    pub fn new(id: SessionId, manner: Manner, wanted: Wanted) -> Session {
        Session {
            id,
            manner,
            wanted: watch::Sender::new(wanted),
            ledger: Arc::default(),
            streams: watch::Sender::new(0),
            ended: Short::new(Some(Instant::now())),
            weight: AtomicUsize::new(0),
        }
    }

    /// Gives the view to a new stream. An older one learns of it and ends.
    pub fn attach(self: &Arc<Self>) -> Attached {
        let mut ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        *ended = None;
        let number = *self.streams.borrow() + 1;
        self.streams.send_replace(number);
        Attached { session: self.clone(), number, streams: self.streams.subscribe() }
    }

    /// When its last stream ended; `None`: a stream has it.
    pub fn ended(&self) -> Option<Instant> {
        *self.ended.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Moves the view, unless a newer question is there already: then that one's number is the error.
    pub fn steer(&self, question: Question) -> std::result::Result<(), u64> {
        let mut overtaken = Ok(());
        self.wanted.send_if_modified(|w| {
            if question.number > w.question.number {
                w.question = Arc::new(question);
                return true;
            }
            overtaken = Err(w.question.number);
            false
        });
        overtaken
    }

    /// The client says what it has applied.
    pub fn applied(&self, number: u64) {
        self.wanted.send_if_modified(|w| {
            let newer = number > w.applied;
            w.applied = w.applied.max(number);
            newer
        });
    }

    /// Notes how much it holds. Returns how much that was before.
    pub fn weighs(&self, weight: usize) -> usize {
        self.weight.swap(weight, Ordering::Relaxed)
    }
}

/// A stream that has a view, or had it.
pub struct Attached {
    pub session: Arc<Session>,
    number: u64,
    streams: watch::Receiver<u64>,
}

impl Attached {
    /// Waits until another stream takes the view.
    pub async fn taken(&mut self) {
        let mine = self.number;
        // The sender lives in the session, which is held here.
        let _ = self.streams.wait_for(|n| *n != mine).await;
    }

    /// What the client's side of the stream steers with.
    pub fn reins(&self) -> Reins {
        Reins { session: self.session.clone(), number: self.number }
    }
}

impl Drop for Attached {
    fn drop(&mut self) {
        let mut ended = self.session.ended.lock().unwrap_or_else(PoisonError::into_inner);
        if *self.session.streams.borrow() == self.number {
            *ended = Some(Instant::now());
        }
    }
}

/// Steers a view as long as its stream has it.
pub struct Reins {
    session: Arc<Session>,
    number: u64,
}

impl Reins {
    pub fn manner(&self) -> Manner {
        self.session.manner
    }

    /// Moves the view.
    ///
    /// # Errors
    /// `Invalid` if the number is not above that of the question before.
    pub fn steer(&self, question: Question) -> Result<()> {
        let number = question.number;
        if *self.session.streams.borrow() != self.number {
            return Ok(());
        }
        self.session.steer(question).map_err(|newest| {
            let reason = format!("{number} follows {newest}; count questions upwards");
            Error::invalid("question.number", reason)
        })
    }

    /// The client says what it has applied.
    pub fn applied(&self, number: u64) {
        if *self.session.streams.borrow() == self.number {
            self.session.applied(number);
        }
    }
}
