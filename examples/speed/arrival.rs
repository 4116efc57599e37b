//! A survey arrives on a database and leaves it again, over and over; the database ends as it began.

use crate::summary;
use serde_json::{Value, json};
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;
use terraquilt::base::{Error, Result};
use terraquilt::db::query::{Area, Query, Tolerance};
use terraquilt::db::{Change, Db, Ingest, Outcome, Progress, Snapshot, fingerprint};
use terraquilt::format;
use terraquilt::height::surface::Blend;

const NAME: &str = "speed-arrival";

pub fn run(db: &str, file: &str, rounds: usize) -> Result<Value> {
    let started = Instant::now();
    let db = Db::open(Path::new(db))?;
    let before = db.snapshot(None)?;
    let opened = milliseconds(started);
    let first = fingerprint(&before)?;
    let (mut come, mut leave) = (Vec::new(), Vec::new());
    let mut outcomes = Vec::new();
    for _ in 0..rounds {
        let (ms, outcome) = timed(&db, || Ok(Change::Ingest(ingest(file)?)), true)?;
        come.push(ms);
        outcomes.push(outcome);
        let (ms, outcome) =
            timed(&db, || Ok(Change::Remove { surveys: vec![NAME.to_string()], tile: None }), false)?;
        leave.push(ms);
        outcomes.push(outcome);
    }
    let last = fingerprint(&db.snapshot(None)?)?;
    if first != last {
        return Err(Error::corrupt(
            "speed arrival",
            "fingerprint",
            format!("{first} before, {last} after the survey came and went"),
        ));
    }
    let counts = |o: &Outcome| {
        json!({
            "patches": o.patches, "flipped_cells": o.flipped_cells.values().sum::<u64>(), "tops_computed": o.tops_computed,
            "records_gone": o.records_gone, "records_come": o.records_come, "bytes_written": o.bytes_written,
        })
    };
    Ok(json!({
        "part": "arrival", "open_ms": opened, "arrival_ms": summary(come), "removal_ms": summary(leave),
        "arrival": counts(&outcomes[0]), "removal": counts(&outcomes[1]), "fingerprint": last,
    }))
}

fn milliseconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64() * 1e3
}

fn ingest(file: &str) -> Result<Ingest> {
    Ok(Ingest {
        name: Some(NAME.to_string()),
        accuracy_m: Some(0.5),
        date: Some(terraquilt::base::date::Date::parse("2026-01-01")?),
        ..Ingest::new(vec![format::open(Path::new(file))?])
    })
}

/// Commits a change, opens the new version and asks it for patches of the ground that changed. The time is that of all
/// three; it includes opening the file.
fn timed(db: &Db, change: impl Fn() -> Result<Change>, comes: bool) -> Result<(f64, Outcome)> {
    let stop = AtomicBool::new(false);
    let progress = Progress { report: &|_, _| (), stop: &stop };
    let started = Instant::now();
    let outcome = db.change(change()?, None, false, &progress, &mut || ())?;
    let now = db.snapshot(Some(outcome.version))?;
    let seen = sees(&now)?;
    let ms = milliseconds(started);
    if seen != comes {
        return Err(Error::corrupt(
            "speed arrival",
            format!("version {}", outcome.version),
            format!("a query sees the survey: {seen}; it should be {comes}"),
        ));
    }
    Ok((ms, outcome))
}

/// Whether a query over the middle of the survey is answered with patches of it.
fn sees(now: &Snapshot) -> Result<bool> {
    let Some(entry) = now.entries().find(|e| e.name == NAME) else { return Ok(false) };
    let (b, size) = (entry.geometry.bounds(), now.unit().size());
    let middle = [(b.min.x + b.max.x) as f64 / 2.0 * size, (b.min.y + b.max.y) as f64 / 2.0 * size];
    let area: Area = Some([middle[0] - 50.0, middle[1] - 50.0, middle[0] + 50.0, middle[1] + 50.0]).into();
    let query = Query { area, tolerance: Tolerance::Constant(0.0), how: Blend::Exact.into() };
    Ok(now.select(&query)?.records.iter().any(|r| r.survey == entry.number))
}
