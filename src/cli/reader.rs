//! Where a command reads: a version of a database, in a directory or behind a server.

use super::line::{Line, server};
use super::output::{Meter, stop_flag};
use super::remote::Remote;
use crate::analysis::Ground;
use crate::base::{Error, Result};
use crate::db::query::{Query, Tolerance};
use crate::db::{self, Db, Progress, Snapshot};
use crate::height::surface::How;
use crate::store::quadtree::Record;
use crate::wire::v1;
use crate::wire::v1::report_request::Kind;
use serde::Serialize;
use std::path::Path;
use std::rc::Rc;

/// A version to read from.
pub enum Reader {
    Disk(Rc<Db>, Box<Snapshot>),
    Server(Remote),
}

/// A commit, as `terraquilt versions` shows it.
#[derive(Serialize)]
pub struct Commit {
    pub action: String,
    /// Seconds since 1970 UTC.
    pub made_at: i64,
    pub operation: String,
    pub version: u64,
}

/// The patches that an answer needs, ascending by id.
pub struct Needed {
    pub version: u64,
    pub records: Vec<Record>,
    /// Nodes of the tree that were read, records that were looked at.
    pub nodes: u64,
    pub tested: u64,
}

/// A patch that has a part in a height.
#[derive(Clone, Serialize)]
pub struct Maker {
    pub error_m: f32,
    pub floor: bool,
    pub level: u8,
    pub patch: String,
    pub survey: String,
    pub weight: f64,
}

impl Reader {
    /// A version, the newest if none is named.
    pub fn open(db: &Path, at: Option<u64>) -> Result<Reader> {
        if let Some(server) = server(db) {
            return Ok(Reader::Server(Remote::open(Rc::new(Line::open(server)?), at)?));
        }
        let db = Rc::new(Db::open(db)?);
        let s = Box::new(db.snapshot(at)?);
        Ok(Reader::Disk(db, s))
    }

    /// Another version of the same database.
    pub fn at(&self, at: Option<u64>) -> Result<Reader> {
        match self {
            Reader::Disk(db, _) => Ok(Reader::Disk(db.clone(), Box::new(db.snapshot(at)?))),
            Reader::Server(r) => Ok(Reader::Server(Remote::open(r.line.clone(), at)?)),
        }
    }

    /// This version as if only some surveys were in it.
    pub fn only(self, surveys: &[String]) -> Result<Reader> {
        match self {
            Reader::Disk(db, s) => {
                let (meter, stop) = (Meter::new(), stop_flag());
                let report = |stage: &str, share: f64| meter.report(stage, share);
                let only = s.only(surveys, &Progress { report: &report, stop: &stop });
                meter.clear();
                Ok(Reader::Disk(db, Box::new(only?)))
            }
            Reader::Server(r) => Ok(Reader::Server(r.only(surveys)?)),
        }
    }

    /// Number of the version; 0 before the first commit.
    pub fn version(&self) -> u64 {
        match self {
            Reader::Disk(_, s) => s.number(),
            Reader::Server(r) => r.version,
        }
    }

    /// As a ground to measure.
    pub fn ground(&self) -> Result<&dyn Ground> {
        match self {
            Reader::Disk(_, s) => Ok(&**s),
            Reader::Server(r) => r.ground(),
        }
    }

    pub fn surveys(&self) -> Result<Vec<db::SurveyRow>> {
        match self {
            Reader::Disk(_, s) => db::surveys(s),
            Reader::Server(r) => r.surveys(),
        }
    }

    pub fn tiles(&self, survey: &str) -> Result<Vec<db::TileRow>> {
        match self {
            Reader::Disk(_, s) => db::tiles(s, survey),
            Reader::Server(r) => r.tiles(survey),
        }
    }

    /// Every commit of a database. Reads the catalog alone: also of a database whose pages are damaged.
    pub fn versions(db: &Path) -> Result<Vec<Commit>> {
        if server(db).is_some()
            && let Reader::Server(r) = Reader::open(db, None)?
        {
            return r.versions();
        }
        let all = Db::open(db)?.versions()?.into_iter().map(|v| Commit {
            action: v.action,
            made_at: v.made_at,
            operation: v.operation,
            version: v.number,
        });
        Ok(all.collect())
    }

    pub fn info(&self) -> Result<db::Info> {
        match self {
            Reader::Disk(db, s) => db::info(db, s),
            Reader::Server(r) => r.info(),
        }
    }

    pub fn fingerprint(&self) -> Result<String> {
        match self {
            Reader::Disk(_, s) => db::fingerprint(s),
            Reader::Server(r) => r.fingerprint(),
        }
    }

    /// Checks everything, with a bar.
    pub fn verify(&self) -> Result<db::Report> {
        let meter = Meter::new();
        let report = |stage: &str, share: f64| meter.report(stage, share);
        let found = match self {
            Reader::Disk(db, s) => db::verify(db, s, &Progress { report: &report, stop: &stop_flag() }),
            Reader::Server(r) => r.verify(report),
        };
        meter.clear();
        found
    }

    /// Every patch, as lines of JSON with their line feeds.
    pub fn boxes(&self, mut each: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        match self {
            Reader::Disk(_, s) => db::boxes(s, |b| {
                let mut line = serde_json::to_vec(&b).map_err(|e| Error::invalid("JSON", e))?;
                line.push(b'\n');
                each(&line)
            }),
            Reader::Server(r) => r.boxes(each),
        }
    }

    pub fn contributions(&self) -> Result<Vec<db::Contribution>> {
        match self {
            Reader::Disk(_, s) => db::contributions(s),
            Reader::Server(r) => r.report(Kind::Redundant, v1::ReportRequest::default()),
        }
    }

    pub fn provenance(&self, query: &Query, step: Option<f64>) -> Result<db::Provenance> {
        match self {
            Reader::Disk(_, s) => s.provenance(query, step),
            Reader::Server(r) => {
                let asked = v1::ReportRequest { step, ..Remote::asked(query)? };
                let mut rows = r.report(Kind::Provenance, asked)?;
                let server = || r.line.connection.server.clone();
                rows.pop().ok_or_else(|| Error::Remote { server: server(), message: "sent no answer".into() })
            }
        }
    }

    /// Pairs of surveys that share ground, compared; of the two that are named, or all.
    pub fn contradictions(&self, named: Option<[&str; 2]>) -> Result<Vec<db::Contradiction>> {
        match self {
            Reader::Disk(_, s) => {
                let mut found = Vec::new();
                s.contradictions(named, |o| {
                    found.push(o.found);
                    Ok(())
                })?;
                Ok(found)
            }
            Reader::Server(r) => {
                let surveys = named.iter().flatten().map(|n| n.to_string()).collect();
                r.report(Kind::Contradictions, v1::ReportRequest { surveys, ..Default::default() })
            }
        }
    }

    /// The patches that a question needs.
    pub fn select(&self, query: &Query) -> Result<Needed> {
        match self {
            Reader::Disk(_, s) => {
                let found = s.select(query)?;
                let (version, nodes, tested) = (found.version, found.nodes, found.tested);
                Ok(Needed { version, records: found.records, nodes, tested })
            }
            Reader::Server(r) => r.select(query),
        }
    }

    /// Who makes the height at each point, largest weight first.
    pub fn explain(&self, points: &[[f64; 2]], tolerance: &Tolerance, how: How) -> Result<Vec<Vec<Maker>>> {
        let s = match self {
            Reader::Disk(_, s) => s,
            Reader::Server(r) => return r.explain(points, tolerance, how),
        };
        let maker = |(record, weight): (Record, f64)| {
            Ok(Maker {
                error_m: record.bot,
                floor: record.floor,
                level: record.place.level,
                patch: record.id.to_string(),
                survey: s.survey_by_number(record.survey)?.name.clone(),
                weight,
            })
        };
        points.iter().map(|p| s.explain(*p, tolerance, how)?.into_iter().map(maker).collect()).collect()
    }
}
