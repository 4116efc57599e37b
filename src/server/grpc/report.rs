//! Long answers as lines of JSON: made piece by piece, each when there is room for it in the stream.

use super::super::pools::Answer;
use super::super::{State, model};
use crate::base::{Error, Result};
use crate::db::query::Tolerance;
use crate::db::{self, BoxWalk, Snapshot, TreeWalk};
use crate::height::surface::Seams;
use crate::wire::{MESSAGE_BYTES, v1};
use serde::Serialize;
use std::sync::Arc;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Lines that go into a message before it is sent: what is made at once comes on top.
const LINES_BYTES: usize = MESSAGE_BYTES / 2;

type Lines = ReceiverStream<Answer<v1::JsonLines>>;

/// Makes more lines; false: that was all.
type Maker = Box<dyn FnMut(&Snapshot, &mut Vec<u8>) -> Result<bool> + Send>;

fn line(out: &mut Vec<u8>, row: &impl Serialize) -> Result<()> {
    serde_json::to_writer(&mut *out, row).map_err(|e| Error::invalid("JSON", e))?;
    out.push(b'\n');
    Ok(())
}

/// Sends what is made, a message at a time. Nothing is made while nobody reads.
fn send(state: &Arc<State>, s: Arc<Snapshot>, mut make: Maker) -> Lines {
    let (out, replies) = mpsc::channel(1);
    let state = state.clone();
    tokio::spawn(async move {
        let mut first = true;
        loop {
            let Ok(room) = out.reserve().await else { return };
            let here = s.clone();
            let work = move || {
                let mut lines = Vec::new();
                let mut more = true;
                while more && lines.len() < LINES_BYTES {
                    more = make(&here, &mut lines)?;
                }
                Ok((make, lines, more))
            };
            match state.pools.work(work).await {
                Err(e) => return room.send(Err(e)),
                Ok((again, lines, more)) => {
                    // Even an answer without a line says which version it is of.
                    if first || !lines.is_empty() {
                        room.send(Ok(v1::JsonLines { version: s.number(), lines: lines.into() }));
                    }
                    if !more {
                        return;
                    }
                    (make, first) = (again, false);
                }
            }
        }
    });
    ReceiverStream::new(replies)
}

/// Every patch.
pub fn boxes(state: &Arc<State>, s: Arc<Snapshot>) -> Lines {
    let mut walk = BoxWalk::default();
    send(
        state,
        s,
        Box::new(move |s, out| match db::more_boxes(s, &mut walk)? {
            None => Ok(false),
            Some(rows) => rows.iter().try_for_each(|b| line(out, b)).map(|()| true),
        }),
    )
}

/// What the command line prints.
pub fn report(state: &Arc<State>, s: Arc<Snapshot>, r: v1::ReportRequest) -> Result<Lines> {
    use v1::report_request::Kind;
    let kind = Kind::try_from(r.kind).unwrap_or(Kind::Unspecified);
    let make: Maker = match kind {
        Kind::Unspecified => {
            let reason = format!("{} is none that this server knows; see catalog.proto", r.kind);
            return Err(Error::invalid("kind", reason));
        }
        Kind::Redundant => rest(db::contributions),
        Kind::Provenance => {
            let how = model::how(r.blend, r.seams, Seams::Off)?;
            let query = model::query(r.region.as_ref(), r.tolerance.as_ref(), how)?;
            if let Tolerance::Camera(_) = query.tolerance
                && s.crs().unit == crate::height::crs::AxisUnit::Degree
            {
                return Err(Error::unsupported(
                    &s.crs().code,
                    "a camera needs metres, and this database is in degrees",
                    "ask with error_m",
                ));
            }
            rest(move |s| Ok(vec![s.provenance(&query, r.step)?]))
        }
        Kind::Contradictions => {
            let named = match r.surveys.as_slice() {
                [] => None,
                [a, b] if a != b => Some([a.clone(), b.clone()]),
                _ => return Err(Error::invalid("surveys", "name two different ones, or none for all pairs")),
            };
            rest(move |s| {
                let mut found = Vec::new();
                s.contradictions(named.as_ref().map(|n| n.each_ref().map(String::as_str)), |o| {
                    found.push(o.found);
                    Ok(())
                })?;
                Ok(found)
            })
        }
        Kind::Tree => {
            let mut walk = TreeWalk::new(&s);
            Box::new(move |s, out| match walk.more(s)? {
                None => Ok(false),
                Some(node) => line(out, &node).map(|()| true),
            })
        }
    };
    Ok(send(state, s, make))
}

/// Rows that are computed at once, one line each.
fn rest<T: Serialize + Send + 'static>(
    rows: impl FnOnce(&Snapshot) -> Result<Vec<T>> + Send + 'static,
) -> Maker {
    let (mut rows, mut made) = (Some(rows), None);
    Box::new(move |s, out| {
        if let Some(rows) = rows.take() {
            made = Some(rows(s)?.into_iter());
        }
        match made.as_mut().and_then(Iterator::next) {
            None => Ok(false),
            Some(row) => line(out, &row).map(|()| true),
        }
    })
}
