//! A version of a database behind a server: the same questions as to a directory, the same answers.

use super::line::Line;
use super::question::{manner, region, tolerance};
use super::reader::{Commit, Maker, Needed};
use crate::analysis::{Ground, Posts};
use crate::base::lattice::Point;
use crate::base::{Error, Result};
use crate::client::{catalog, heights};
use crate::db::query::{Query, Tolerance};
use crate::height::crs::{AxisUnit, Crs};
use crate::height::frame::{CellRect, Frame, LatticeUnit};
use crate::height::lod::{PatchId, Place, SurveyNumber};
use crate::height::surface::{Evaluation, How};
use crate::store::quadtree::Record;
use crate::wire::v1;
use serde::de::DeserializeOwned;
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// One version, behind a server.
pub struct Remote {
    pub line: Rc<Line>,
    /// The version; 0 before the first commit.
    pub version: u64,
    crs: Crs,
    unit: LatticeUnit,
    bounds: Option<[f64; 4]>,
    /// Heights are asked as if only these were there; empty: all are.
    only: Vec<String>,
    /// Asked for when they are first needed.
    frames: OnceCell<Vec<v1::SurveyFrame>>,
}

impl Remote {
    /// A version, the newest if none is named.
    pub fn open(line: Rc<Line>, at: Option<u64>) -> Result<Remote> {
        // On the wire 0 asks for the newest.
        let nothing = at == Some(0);
        let info = line.wait(catalog::info(&line.connection, at.unwrap_or(0), false))?;
        let wrong = |what: String| Error::Remote { server: line.connection.server.clone(), message: what };
        let ground = info.ground.ok_or_else(|| wrong("says nothing of its ground".into()))?;
        let unit = match info.metres_per_unit {
            0.0 => AxisUnit::Degree,
            m if m.is_finite() && m > 0.0 => AxisUnit::Metre(m),
            m => return Err(wrong(format!("says that a unit of its CRS has {m} m"))),
        };
        let exponent = i8::try_from(ground.lattice_unit_log2)
            .map_err(|_| wrong(format!("says that its lattice unit is 2^{}", ground.lattice_unit_log2)))?;
        let frames = OnceCell::new();
        if nothing {
            let _ = frames.set(Vec::new());
        }
        Ok(Remote {
            version: if nothing { 0 } else { ground.version },
            crs: Crs { code: ground.crs, unit },
            unit: LatticeUnit { exponent },
            bounds: ground.bounds.map(|b| [b.xmin, b.ymin, b.xmax, b.ymax]).filter(|_| !nothing),
            only: Vec::new(),
            frames,
            line,
        })
    }

    /// This version as if only some surveys were in it, to be measured.
    pub fn only(self, surveys: &[String]) -> Result<Remote> {
        if surveys.is_empty() {
            return Err(Error::invalid("surveys", "none is named; `terraquilt surveys DB` lists them"));
        }
        let mut frames = BTreeMap::new();
        for name in surveys {
            let found = self.line.wait(catalog::survey(&self.line.connection, self.version, name))?;
            frames.extend(found.frame.map(|f| (f.survey, f)));
        }
        let all: Vec<v1::SurveyFrame> = frames.into_values().collect();
        let one = Remote { only: surveys.to_vec(), frames: OnceCell::from(all), ..self };
        let size = one.unit.size();
        let around = one.posts().map(|p| p.bounds()).reduce(|a, b| a.union(&b));
        let bounds = around.map(|b| [b.min.x, b.min.y, b.max.x, b.max.y].map(|v| v as f64 * size));
        Ok(Remote { bounds, ..one })
    }

    /// As a ground to measure: with its surveys.
    pub fn ground(&self) -> Result<&dyn Ground> {
        self.frames()?;
        Ok(self)
    }

    fn frames(&self) -> Result<&[v1::SurveyFrame]> {
        if self.frames.get().is_none() {
            let listed = self.line.wait(catalog::surveys(&self.line.connection, self.version, true))?;
            let _ = self.frames.set(listed.frames);
        }
        Ok(self.frames.get().map_or(&[], Vec::as_slice))
    }

    /// Whether this is version 0 of a database that has others: it cannot be named on the wire.
    fn before_all(&self) -> bool {
        self.version == 0
    }

    pub fn surveys<T: DeserializeOwned>(&self) -> Result<Vec<T>> {
        if self.before_all() {
            return Ok(Vec::new());
        }
        let listed = self.line.wait(catalog::surveys(&self.line.connection, self.version, false))?;
        listed.surveys.iter().map(|s| self.line.read(s.json.as_bytes())).collect()
    }

    pub fn tiles<T: DeserializeOwned>(&self, survey: &str) -> Result<Vec<T>> {
        let listed = self.line.wait(catalog::tiles(&self.line.connection, self.version, survey))?;
        listed.tiles.iter().map(|t| self.line.read(t.json.as_bytes())).collect()
    }

    pub fn versions(&self) -> Result<Vec<Commit>> {
        let listed = self.line.wait(catalog::versions(&self.line.connection))?;
        let one = |v: v1::VersionInfo| Commit {
            action: v.action,
            made_at: v.made_at_s,
            operation: v.operation,
            version: v.number,
        };
        Ok(listed.versions.into_iter().map(one).collect())
    }

    pub fn info<T: DeserializeOwned>(&self) -> Result<T> {
        let info = self.line.wait(catalog::info(&self.line.connection, self.version, true))?;
        self.line.read(info.json.as_bytes())
    }

    pub fn fingerprint(&self) -> Result<String> {
        let found = self.line.wait(catalog::fingerprint(&self.line.connection, self.version))?;
        Ok(found.fingerprint)
    }

    pub fn verify<T: DeserializeOwned>(&self, told: impl Fn(&str, f64)) -> Result<T> {
        let found = self.line.wait(catalog::verify(&self.line.connection, self.version, told))?;
        self.line.read(found.json.as_bytes())
    }

    /// Lines of JSON, as they come.
    pub fn boxes(&self, each: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        self.line.wait(catalog::boxes(&self.line.connection, self.version, each)).map(|_| ())
    }

    pub fn report<T: DeserializeOwned>(
        &self,
        kind: v1::report_request::Kind,
        more: v1::ReportRequest,
    ) -> Result<Vec<T>> {
        let mut rows = Vec::new();
        let request = v1::ReportRequest { kind: kind as i32, at: self.version, ..more };
        self.line.wait(catalog::report(&self.line.connection, request, |line| {
            rows.push(self.line.read(line)?);
            Ok(())
        }))?;
        Ok(rows)
    }

    /// What a question is in a report.
    pub fn asked(query: &Query) -> Result<v1::ReportRequest> {
        let (blend, seams) = manner(query.how);
        Ok(v1::ReportRequest {
            region: region(&query.area),
            tolerance: Some(tolerance(&query.tolerance)?),
            blend: blend as i32,
            seams: seams as i32,
            ..Default::default()
        })
    }

    /// The patches that an answer needs, ascending by id.
    pub fn select(&self, query: &Query) -> Result<Needed> {
        if self.before_all() {
            return Ok(Needed { version: 0, records: Vec::new(), nodes: 0, tested: 0 });
        }
        let (blend, seams) = manner(query.how);
        let request = v1::PatchesRequest {
            region: region(&query.area),
            tolerance: Some(tolerance(&query.tolerance)?),
            blend: blend as i32,
            seams: seams as i32,
            at: self.version,
            descriptors_only: true,
            explain: true,
            ..Default::default()
        };
        let found = self.line.wait(self.line.connection.patches(request))?;
        let mut records = found.patches.iter().map(|p| self.record(p)).collect::<Result<Vec<_>>>()?;
        records.sort_by_key(|r| r.id);
        let how = found.end.explanation.unwrap_or_default();
        Ok(Needed { version: self.version, records, nodes: how.nodes, tested: how.tested })
    }

    fn record(&self, p: &v1::Patch) -> Result<Record> {
        let place = u8::try_from(p.level).ok().map(|level| Place { level, i: p.i, j: p.j });
        let id = <[u8; 16]>::try_from(p.id.as_ref()).ok().map(PatchId);
        let (Some(place), Some(id)) = (place, id) else {
            let message = format!("sent a patch of level {} with an id of {} bytes", p.level, p.id.len());
            return Err(Error::Remote { server: self.line.connection.server.clone(), message });
        };
        let survey = SurveyNumber(p.survey);
        Ok(Record { top: p.top_m, bot: p.bot_m, floor: p.floor, survey, place, id })
    }

    fn header(&self, t: &Tolerance, how: How) -> Result<v1::HeightsHeader> {
        let (blend, seams) = manner(how);
        Ok(v1::HeightsHeader {
            tolerance: Some(tolerance(t)?),
            blend: blend as i32,
            seams: seams as i32,
            at: self.version,
            only_surveys: self.only.clone(),
            ..Default::default()
        })
    }

    fn evaluate(&self, points: &[[f64; 2]], header: v1::HeightsHeader) -> Result<Vec<Option<Evaluation>>> {
        if self.before_all() {
            return Ok(vec![None; points.len()]);
        }
        self.line.wait(heights::points(&self.line.connection, header, points)).map(|(_, found)| found)
    }

    /// Who makes the height at each point, largest weight first.
    pub fn explain(&self, points: &[[f64; 2]], tolerance: &Tolerance, how: How) -> Result<Vec<Vec<Maker>>> {
        if self.before_all() {
            return Ok(vec![Vec::new(); points.len()]);
        }
        let header = v1::HeightsHeader { explain: true, ..self.header(tolerance, how)? };
        let found = self.line.wait(heights::asked(&self.line.connection, header, points))?;
        let one = |c: &v1::Contributor| {
            let name = found.surveys.iter().find(|s| s.survey == c.survey);
            let id = <[u8; 16]>::try_from(c.patch.as_ref()).map(PatchId);
            Maker {
                survey: name.map_or(String::new(), |s| s.name.clone()),
                patch: id.map_or(String::new(), |id| id.to_string()),
                weight: c.weight,
                level: c.level as u8,
                error_m: c.error_m,
                floor: c.floor,
            }
        };
        Ok(found.makers.iter().map(|m| m.iter().map(one).collect()).collect())
    }
}

impl Ground for Remote {
    fn crs(&self) -> &Crs {
        &self.crs
    }

    fn unit(&self) -> LatticeUnit {
        self.unit
    }

    fn bounds(&self) -> Option<[f64; 4]> {
        self.bounds
    }

    fn posts(&self) -> Box<dyn Iterator<Item = Posts<'_>> + '_> {
        let frames = self.frames.get().map_or(&[][..], Vec::as_slice);
        Box::new(frames.iter().map(|f| Posts {
            number: SurveyNumber(f.survey),
            name: &f.name,
            frame: Frame {
                anchor: Point::new(f.anchor_x, f.anchor_y),
                u: Point::new(f.u_x, f.u_y),
                v: Point::new(f.v_x, f.v_y),
            },
            steps: [f.step_x, f.step_y],
            core: CellRect::new(f.core_i0, f.core_j0, f.core_i1, f.core_j1),
        }))
    }

    fn heights(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>> {
        self.evaluate(points, self.header(tolerance, how)?)
    }

    fn slopes(
        &self,
        points: &[[f64; 2]],
        tolerance: &Tolerance,
        how: How,
    ) -> Result<Vec<Option<Evaluation>>> {
        self.evaluate(points, v1::HeightsHeader { gradients: true, ..self.header(tolerance, how)? })
    }
}
