//! What a commit does: ingest, replace, remove, set. One survey's samples change in one commit.

use super::contradictions::Contradiction;
use super::database::Db;
use super::resample::Resampling;
use super::root::SurveyEntry;
use super::view::{Tables, View};
use super::writing::Writing;
use crate::base::date::Date;
use crate::base::{Error, Result};
use crate::height::crs::{Crs, DatumChoice};
use crate::height::source::HeightSource;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Tells how far the work is, and whether to stop.
pub struct Progress<'a> {
    /// Called with a stage and the share of it that is done, from any thread.
    pub report: &'a (dyn Fn(&str, f64) + Sync),
    pub stop: &'a AtomicBool,
}

impl Progress<'_> {
    pub fn step(&self, stage: &str, share: f64) -> Result<()> {
        (self.report)(stage, share);
        self.check()
    }
    pub fn check(&self) -> Result<()> {
        if self.stop.load(Ordering::Relaxed) { Err(Error::Stopped) } else { Ok(()) }
    }
}

/// Files that arrive as one survey, or as tiles of one.
pub struct Ingest {
    pub sources: Vec<Box<dyn HeightSource>>,
    /// Default: the stem of the first file.
    pub name: Option<String>,
    /// Tiles of this survey instead of a new one.
    pub into: Option<String>,
    pub accuracy_m: Option<f64>,
    pub date: Option<Date>,
    pub precedence: Option<i64>,
    /// Metres of one vertical unit of the files; `None`: as they say, else metres.
    pub vertical_unit_m: Option<f64>,
    /// What heights count from; `None`: as the files say.
    pub vertical_datum: Option<String>,
    /// The system of the files, whatever they say.
    pub crs: Option<Crs>,
    /// What is done where that system is on another datum than the database.
    pub datum: DatumChoice,
    /// Declared lattice of the files: col step, row step (lengths), phases.
    pub lattice: Option<[f64; 4]>,
    /// Spacing of the survey's own posts where files are resampled, CRS units; `None`: that of the files.
    pub step: Option<[f64; 2]>,
}

impl Ingest {
    /// Files of which nothing is said beyond what they say themselves.
    pub fn new(sources: Vec<Box<dyn HeightSource>>) -> Ingest {
        Ingest {
            sources,
            name: None,
            into: None,
            accuracy_m: None,
            date: None,
            precedence: None,
            vertical_unit_m: None,
            vertical_datum: None,
            crs: None,
            datum: DatumChoice::default(),
            lattice: None,
            step: None,
        }
    }
}

/// What to commit.
pub enum Change {
    Ingest(Ingest),
    /// Tiles wholly inside the new files' rectangles leave, and the files come.
    Replace {
        survey: String,
        ingest: Ingest,
    },
    Remove {
        surveys: Vec<String>,
        tile: Option<String>,
    },
    Set {
        survey: String,
        date: Option<Date>,
        precedence: Option<i64>,
    },
}

/// What a commit did.
#[derive(Clone, Debug, Default, serde::Serialize, serde::Deserialize)]
pub struct Outcome {
    pub survey: String,
    pub version: u64,
    pub patches: u64,
    pub live: u64,
    pub dormant: u64,
    pub posts: u64,
    pub voids: u64,
    pub seconds: f64,
    /// False if everything was there already.
    pub changed: bool,
    /// Cells of other surveys that the commit covered or uncovered, by name.
    pub flipped_cells: BTreeMap<String, u64>,
    /// Tops recomputed, records that left and entered the tree, bytes written.
    pub tops_computed: u64,
    pub records_gone: u64,
    pub records_come: u64,
    pub bytes_written: u64,
    /// What resampling did to the samples that came; absent if nothing was resampled.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub resampling: Option<Resampling>,
    /// Surveys that say other things of the ground that the files cover, beyond the stated accuracies.
    pub contradictions: Vec<Contradiction>,
    pub warnings: Vec<String>,
}

/// The call that a commit is made for.
pub(super) struct Call<'a> {
    pub db: &'a Db,
    pub operation: Option<&'a str>,
    pub dry_run: bool,
    pub progress: &'a Progress<'a>,
}

impl Db {
    /// Carries out a change as one commit. Waits for another writer (calling `waiting` once).
    ///
    /// `operation` identifies the call: repeating it after a crash or a broken connection returns the version it made.
    /// With `dry_run` everything is computed and nothing committed.
    pub fn change(
        &self,
        change: Change,
        operation: Option<&str>,
        dry_run: bool,
        progress: &Progress,
        waiting: &mut dyn FnMut(),
    ) -> Result<Outcome> {
        let started = std::time::Instant::now();
        if operation.is_some_and(|o| o.is_empty() || o.starts_with("commit-")) {
            return Err(Error::invalid(
                "--operation",
                "give an id of your own; those that begin with 'commit-' are the program's",
            ));
        }
        let mut writing = self.begin(waiting)?;
        if let Some(op) = operation
            && let Some(version) = writing.catalog.operation(op)?
        {
            let warnings = vec![format!(
                "operation '{op}' was carried out before, as version {version}; nothing was changed"
            )];
            return Ok(Outcome { version, warnings, ..Outcome::default() });
        }
        let call = Call { db: self, operation, dry_run, progress };
        let outcome = carry_out(&mut writing, &call, change);
        if !outcome.as_ref().is_ok_and(|o| o.changed) {
            writing.discard_temporaries(self);
        }
        let mut outcome = outcome?;
        outcome.seconds = started.elapsed().as_secs_f64();
        Ok(outcome)
    }
}

fn carry_out(writing: &mut Writing, call: &Call, change: Change) -> Result<Outcome> {
    match change {
        Change::Ingest(i) => writing.ingest(call, i, false),
        Change::Replace { survey, ingest } => {
            writing.ingest(call, Ingest { into: Some(survey), ..ingest }, true)
        }
        Change::Remove { surveys, tile } => writing.remove(call, &surveys, tile),
        Change::Set { survey, date, precedence } => writing.set(call, &survey, date, precedence),
    }
}

/// A survey by name, or by a prefix of its id.
pub fn find_survey<'v>(view: &'v View, name: &str) -> Result<&'v SurveyEntry> {
    let all = view.entries();
    if let Some(e) = all.values().find(|e| e.name == name) {
        return Ok(e);
    }
    let by_id: Vec<&SurveyEntry> =
        all.values().filter(|e| name.len() >= 4 && super::head::hex(&e.id).starts_with(name)).collect();
    match by_id.as_slice() {
        [e] => Ok(e),
        _ => Err(Error::missing(
            format!("survey '{name}'"),
            "`terraquilt surveys DB` lists what is in the database",
        )),
    }
}
