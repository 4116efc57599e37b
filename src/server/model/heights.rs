//! Points that are asked for, and what the surface is there, as messages.

use super::{how, pairs, tolerance};
use crate::analysis::{Station, Stations};
use crate::base::bytes::Put;
use crate::base::{Error, Result};
use crate::db::Snapshot;
use crate::db::query::{Makers, Tolerance};
use crate::height::crs::AxisUnit;
use crate::height::surface::{Evaluation, How, Seams};
use crate::store::quadtree::Record;
use crate::wire::{MESSAGE_BYTES, v1};
use std::collections::BTreeSet;
use std::ops::Range;
use std::sync::Arc;

/// Points in one message of a caller, vertices of one line.
pub const POINTS_A_MESSAGE: usize = 65536;
/// Points in one message of an answer.
const POINTS_A_REPLY: usize = 16384;

/// What a call asks of points: of which version, how exact, and what is sent.
pub struct Manner {
    pub snapshot: Arc<Snapshot>,
    pub tolerance: Tolerance,
    pub how: How,
    pub gradients: bool,
    pub explain: bool,
    single: bool,
}

impl Manner {
    pub fn new(header: &v1::HeightsHeader, snapshot: Arc<Snapshot>) -> Result<Manner> {
        let tolerance = tolerance(header.tolerance.as_ref())?;
        if let (Tolerance::Camera(_), AxisUnit::Degree) = (&tolerance, snapshot.crs().unit) {
            return Err(Error::unsupported(
                &snapshot.crs().code,
                "a camera needs metres, and this database is in degrees",
                "ask with error_m",
            ));
        }
        Ok(Manner {
            snapshot,
            tolerance,
            how: how(header.blend, header.seams, Seams::Off)?,
            gradients: header.gradients,
            explain: header.explain,
            single: header.single,
        })
    }
}

/// Points of a message; `first`: how many came before it in the call. All are finite.
pub fn points(bytes: &[u8], first: u64) -> Result<Vec<[f64; 2]>> {
    let n = bytes.len() / 16;
    if n > POINTS_A_MESSAGE {
        return Err(Error::limit("points of one message", POINTS_A_MESSAGE as u64, n as u64));
    }
    let found = pairs("points", bytes)?;
    if let Some(k) = found.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        let at = first + k as u64;
        let reason = format!("{:?} is no place; x and y must be finite", found[k]);
        return Err(Error::invalid(format!("point {at} of the call (counted from 0)"), reason));
    }
    Ok(found)
}

/// Posts of a raster.
pub struct Posts {
    origin: [f64; 2],
    step: [f64; 2],
    cols: u64,
    rows: u64,
}

impl Posts {
    /// At most `most` of them.
    pub fn new(r: &v1::RasterRequest, most: u64) -> Result<Posts> {
        let (cols, rows) = (u64::from(r.cols), u64::from(r.rows));
        if cols == 0 || rows == 0 {
            return Err(Error::invalid("raster", format!("{cols} x {rows} posts; give one at least")));
        }
        if cols * rows > most {
            return Err(Error::limit("posts of the raster (cols x rows)", most, cols * rows));
        }
        let posts = Posts { origin: [r.x, r.y], step: [r.dx, r.dy], cols, rows };
        let end = posts.at(cols * rows - 1);
        let numbers = [r.x, r.y, r.dx, r.dy, end[0], end[1]];
        if !numbers.iter().all(|v| v.is_finite()) {
            let reason = format!(
                "x {}, y {}, dx {}, dy {}: the last post would lie at {}, {}; give finite numbers",
                r.x, r.y, r.dx, r.dy, end[0], end[1]
            );
            return Err(Error::invalid("raster", reason));
        }
        if (cols > 1 && r.dx == 0.0) || (rows > 1 && r.dy == 0.0) {
            let reason = format!(
                "dx {}, dy {} put {cols} x {rows} posts on top of each other; give steps other than 0",
                r.dx, r.dy
            );
            return Err(Error::invalid("raster", reason));
        }
        Ok(posts)
    }

    fn at(&self, k: u64) -> [f64; 2] {
        let (col, row) = ((k % self.cols) as f64, (k / self.cols) as f64);
        [self.origin[0] + col * self.step[0], self.origin[1] + row * self.step[1]]
    }
}

/// Where heights are asked, in order.
pub enum Places {
    Given(std::vec::IntoIter<[f64; 2]>),
    Along(Box<Stations>),
    Over(Posts, Range<u64>),
}

impl Places {
    pub fn given(points: Vec<[f64; 2]>) -> Places {
        Places::Given(points.into_iter())
    }

    pub fn over(posts: Posts) -> Places {
        let all = 0..posts.cols * posts.rows;
        Places::Over(posts, all)
    }

    /// How many there are, where the caller does not know.
    pub fn total(&self) -> u64 {
        match self {
            Places::Given(_) => 0,
            Places::Along(stations) => stations.total(),
            Places::Over(posts, _) => posts.cols * posts.rows,
        }
    }

    /// The next ones, `most` of them at most.
    pub fn next(&mut self, most: usize) -> Asked {
        match self {
            Places::Given(points) => Asked { points: points.take(most).collect(), stations: Vec::new() },
            Places::Along(line) => {
                let stations: Vec<Station> = line.take(most).collect();
                Asked { points: stations.iter().map(|s| [s.x, s.y]).collect(), stations }
            }
            Places::Over(posts, left) => {
                Asked { points: left.take(most).map(|k| posts.at(k)).collect(), stations: Vec::new() }
            }
        }
    }
}

/// Some points of a call; of a profile, the stations that they are.
pub struct Asked {
    pub points: Vec<[f64; 2]>,
    pub stations: Vec<Station>,
}

/// What the surface is at some points.
#[derive(Clone, Default)]
pub struct Found {
    pub heights: Vec<Option<Evaluation>>,
    /// Where asked for, who made each height.
    pub makers: Vec<Option<Makers>>,
}

/// The messages that say what was found; `first`: how many points came before in the call.
pub fn replies(
    manner: &Manner,
    asked: &Asked,
    found: &Found,
    first: u64,
    total: u64,
) -> Result<Vec<v1::HeightsReply>> {
    const MAKER_BYTES: usize = 48;
    let mut out = Vec::new();
    let mut from = 0;
    while from < found.heights.len() {
        let (mut to, mut bytes) = (from, 0);
        while to < found.heights.len() && to - from < POINTS_A_REPLY && bytes < MESSAGE_BYTES {
            if let Some(makers) = found.makers.get(to) {
                bytes += 4 + makers.as_ref().map_or(0, Vec::len) * MAKER_BYTES;
            }
            to += 1;
        }
        let mut reply = reply(manner, asked, found, from..to)?;
        reply.first = first + from as u64;
        reply.total = total;
        out.push(reply);
        from = to;
    }
    Ok(out)
}

fn reply(manner: &Manner, asked: &Asked, found: &Found, which: Range<usize>) -> Result<v1::HeightsReply> {
    let heights = &found.heights[which.clone()];
    let numbers = |one: &dyn Fn(&Evaluation) -> f64| {
        let mut out = Vec::with_capacity(heights.len() * 8);
        heights.iter().for_each(|e| out.put_f64(e.as_ref().map_or(f64::NAN, one)));
        out.into()
    };
    let mut reply = v1::HeightsReply {
        version: manner.snapshot.number(),
        count: heights.len() as u32,
        error_m: numbers(&|e| e.error_m),
        accuracy_m: numbers(&|e| e.accuracy_m),
        flags: heights.iter().map(flags).collect::<Vec<u8>>().into(),
        ..Default::default()
    };
    reply.z = if manner.single {
        let mut out = Vec::with_capacity(heights.len() * 4);
        heights.iter().for_each(|e| out.put_f32(e.as_ref().map_or(f32::NAN, |e| e.z as f32)));
        out.into()
    } else {
        numbers(&|e| e.z)
    };
    if manner.how.seams != Seams::Off {
        reply.correction_m = numbers(&|e| e.correction_m);
    }
    if manner.gradients {
        let mut out = Vec::with_capacity(heights.len() * 16);
        let gradient = |e: &Option<Evaluation>| e.as_ref().map_or([f64::NAN; 2], |e| e.gradient);
        heights.iter().flat_map(gradient).for_each(|v| out.put_f64(v));
        reply.gradients = out.into();
    }
    if let Some(stations) = asked.stations.get(which.clone()) {
        let (mut points, mut distances) = (Vec::new(), Vec::new());
        for s in stations {
            points.put_f64(s.x);
            points.put_f64(s.y);
            distances.put_f64(s.distance_m);
        }
        (reply.points, reply.distance_m) = (points.into(), distances.into());
        reply.vertices = stations.iter().map(|s| u8::from(s.vertex)).collect::<Vec<u8>>().into();
    }
    if let Some(makers) = found.makers.get(which) {
        reply.contributors = makers.iter().map(contributors).collect();
        let surveys: BTreeSet<_> = makers.iter().flatten().flatten().map(|(r, _)| r.survey).collect();
        for n in surveys {
            let name = manner.snapshot.survey_by_number(n)?.name.clone();
            reply.surveys.push(v1::SurveyName { survey: n.0, name });
        }
    }
    Ok(reply)
}

fn flags(e: &Option<Evaluation>) -> u8 {
    e.as_ref().map_or(0, |e| 1 | u8::from(e.certified) << 1 | u8::from(e.contradiction) << 2)
}

fn contributors(makers: &Option<Makers>) -> v1::Contributors {
    let one = |(r, weight): &(Record, f64)| v1::Contributor {
        survey: r.survey.0,
        patch: r.id.0.to_vec().into(),
        weight: *weight,
        level: u32::from(r.place.level),
        error_m: r.bot,
        floor: r.floor,
    };
    v1::Contributors { contributors: makers.iter().flatten().map(one).collect() }
}
