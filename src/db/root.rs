//! The root page of a version: its surveys and its tree. Everything of a version is reached from here.

use super::head::{DeclarationId, check_world, put_rect, read_rect};
use crate::base::bytes::{Put, Reader};
use crate::base::date::Date;
use crate::base::lattice::Point;
use crate::base::{Error, Result};
use crate::height::frame::Frame;
use crate::height::lod::{Geometry, LEVEL_MAX, SurveyNumber};
use crate::store::quadtree::ChildRef;
use crate::store::segment::PageRef;

/// Version of the derivation: what makes tops, kernels and tree out of surveys. Part of the fingerprint.
pub const DERIVATION_VERSION: u32 = 1;

/// One survey as a version holds it.
#[derive(Clone, Debug, PartialEq)]
pub struct SurveyEntry {
    pub number: SurveyNumber,
    pub id: DeclarationId,
    pub name: String,
    pub head: PageRef,
    /// Page list of the top table.
    pub tops: PageRef,
    pub date: Option<Date>,
    /// Explicit precedence; wins over the policy.
    pub precedence: Option<i64>,
    pub geometry: Geometry,
    /// Lowest and highest valid height, metres.
    pub z: [f64; 2],
    pub live: u64,
    pub dormant: u64,
    /// The version in which the survey came.
    pub since: u64,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Root {
    /// Ascending by number.
    pub surveys: Vec<SurveyEntry>,
    pub tree: Option<ChildRef>,
}

impl Root {
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        out.put_u8(b'R');
        // Reserved for sharding the tree: 0 = one tree.
        out.put_u8(0);
        out.put_u16(0);
        out.put_u32(DERIVATION_VERSION);
        out.put_u8(u8::from(self.tree.is_some()));
        if let Some(t) = &self.tree {
            t.page.put(&mut out);
            out.put_f32(t.top_max);
            out.put_f32(t.bot_min);
            out.put_u8(u8::from(t.floor));
        }
        out.put_u32(self.surveys.len() as u32);
        for s in &self.surveys {
            out.put_u32(s.number.0);
            out.put(&s.id);
            out.put_text(&s.name);
            s.head.put(&mut out);
            s.tops.put(&mut out);
            out.put_text(&s.date.map_or(String::new(), |d| d.to_string()));
            out.put_u8(u8::from(s.precedence.is_some()));
            out.put_i64(s.precedence.unwrap_or(0));
            let g = &s.geometry;
            for p in [g.frame.anchor, g.frame.u, g.frame.v] {
                out.put_i64(p.x);
                out.put_i64(p.y);
            }
            out.put_f64(g.steps[0]);
            out.put_f64(g.steps[1]);
            out.put_f32(g.accuracy);
            out.put_i64(g.precedence);
            out.put_u8(g.level_max);
            put_rect(&mut out, &g.core);
            out.put_f64(s.z[0]);
            out.put_f64(s.z[1]);
            out.put_u64(s.live);
            out.put_u64(s.dormant);
            out.put_u64(s.since);
        }
        out
    }

    pub fn decode(bytes: &[u8], file: &str) -> Result<Root> {
        let mut r = Reader::new(bytes, file, "root page");
        let kind = r.u8()?;
        if kind != b'R' {
            return Err(r.bad(format!("page kind {kind:#04x} is not a root")));
        }
        let shards = r.u8()?;
        r.u16()?;
        let derivation = r.u32()?;
        if shards != 0 || derivation > DERIVATION_VERSION {
            return Err(Error::unsupported(
                file,
                format!(
                    "derivation {derivation}, sharding {shards}; this program knows derivation {DERIVATION_VERSION}, no sharding"
                ),
                "use a newer terraquilt",
            ));
        }
        let mut root = Root::default();
        if r.u8()? != 0 {
            let page = PageRef::read(&mut r)?;
            root.tree = Some(ChildRef { page, top_max: r.f32()?, bot_min: r.f32()?, floor: r.u8()? != 0 });
        }
        let n = r.u32()?;
        for _ in 0..n {
            let number = SurveyNumber(r.u32()?);
            let id = r.take(16)?.try_into().expect("16 bytes were taken");
            let name = r.text()?;
            let (head, tops) = (PageRef::read(&mut r)?, PageRef::read(&mut r)?);
            let date = r.text()?;
            let date = match date.as_str() {
                "" => None,
                text => Some(Date::parse(text).map_err(|e| r.bad(e))?),
            };
            let explicit = r.u8()? != 0;
            let value = r.i64()?;
            let mut p = || -> Result<Point> { Ok(Point::new(r.i64()?, r.i64()?)) };
            let frame = Frame { anchor: p()?, u: p()?, v: p()? };
            let steps = [r.f64()?, r.f64()?];
            let accuracy = r.f32()?;
            let precedence = r.i64()?;
            let level_max = r.u8()?;
            if level_max > LEVEL_MAX || frame.determinant() == 0 {
                return Err(r.bad("a survey's geometry is impossible"));
            }
            let core = read_rect(&mut r)?;
            let geometry = Geometry { frame, steps, accuracy, precedence, level_max, core };
            check_world(&geometry, &name).map_err(|e| r.bad(e))?;
            root.surveys.push(SurveyEntry {
                number,
                id,
                name,
                head,
                tops,
                date,
                precedence: explicit.then_some(value),
                geometry,
                z: [r.f64()?, r.f64()?],
                live: r.u64()?,
                dormant: r.u64()?,
                since: r.u64()?,
            });
        }
        r.end()?;
        if !root.surveys.is_sorted_by(|a, b| a.number < b.number) {
            return Err(Error::corrupt(file, "root page", "surveys out of order"));
        }
        Ok(root)
    }
}
