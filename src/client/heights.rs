//! Heights from a server: points, lines, rasters.

use super::Connection;
use crate::base::{Error, Result};
use crate::height::surface::Evaluation;
use crate::wire::v1;
use std::collections::VecDeque;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use tonic::{Request, Streaming};

/// Points in a message.
const POINTS_A_MESSAGE: usize = 65536;
/// Messages of points that are on their way before the first is answered.
const IN_FLIGHT: usize = 2;

/// Patches of one height and their shares, largest first.
pub type Makers = Vec<v1::Contributor>;

/// What came of some points.
#[derive(Clone, Debug, Default)]
pub struct Heights {
    pub version: u64,
    /// `None` where there is no data. A profile's points are in `line`.
    pub heights: Vec<Option<Evaluation>>,
    /// Where asked for: who made each height, and the surveys that are meant.
    pub makers: Vec<Makers>,
    pub surveys: Vec<v1::SurveyName>,
    /// Of a profile: its points.
    pub line: Vec<LinePoint>,
}

/// A point of a profile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LinePoint {
    pub at: [f64; 2],
    pub distance_m: f64,
    pub vertex: bool,
}

/// Heights at points, in order: a stream of messages, a few of them under way. All are of one version.
///
/// # Errors
/// What the server refuses; among it points that are not finite, by number.
pub async fn points(
    connection: &Connection,
    header: v1::HeightsHeader,
    points: &[[f64; 2]],
) -> Result<(u64, Vec<Option<Evaluation>>)> {
    let found = asked(connection, header, points).await?;
    Ok((found.version, found.heights))
}

/// As [`points`], with all that was asked for beside the heights.
pub async fn asked(
    connection: &Connection,
    header: v1::HeightsHeader,
    points: &[[f64; 2]],
) -> Result<Heights> {
    let (sender, receiver) = mpsc::channel(IN_FLIGHT);
    let first = v1::PointsRequest { header: Some(header), points: Default::default() };
    let mut messages: VecDeque<v1::PointsRequest> = points
        .chunks(POINTS_A_MESSAGE)
        .map(|c| v1::PointsRequest { header: None, points: packed(c).into() })
        .collect();
    messages.push_front(first);
    let send = async move {
        for m in messages {
            // The server has ended the call: its status says why.
            if sender.send(m).await.is_err() {
                break;
            }
        }
        Ok(())
    };
    let receive = async {
        let call = connection.heights().points(Request::new(ReceiverStream::new(receiver))).await;
        let mut stream = call.map_err(|s| connection.failed(s))?.into_inner();
        gather(connection, &mut stream).await
    };
    let ((), found) = tokio::try_join!(send, receive)?;
    counted(connection, found, points.len())
}

/// Heights along a line; `step_m`: 0 for the step of the finest survey.
pub async fn profile(
    connection: &Connection,
    header: v1::HeightsHeader,
    line: &[[f64; 2]],
    step_m: f64,
) -> Result<Heights> {
    let request = v1::ProfileRequest { header: Some(header), line: packed(line).into(), step_m };
    let call = connection.heights().profile(request).await;
    let mut stream = call.map_err(|s| connection.failed(s))?.into_inner();
    let found = gather(connection, &mut stream).await?;
    let n = found.line.len();
    counted(connection, found, n)
}

/// Heights of a raster, row by row. Hands over what comes, message by message: memory does not go by the raster.
///
/// Returns the version.
pub async fn raster(
    connection: &Connection,
    request: v1::RasterRequest,
    mut each: impl FnMut(u64, Vec<Option<Evaluation>>) -> Result<()>,
) -> Result<u64> {
    let wanted = u64::from(request.cols) * u64::from(request.rows);
    let call = connection.heights().raster(request).await;
    let mut stream = call.map_err(|s| connection.failed(s))?.into_inner();
    let (mut version, mut came) = (0, 0);
    while let Some(reply) = stream.message().await.map_err(|s| connection.failed(s))? {
        let found = unpacked(connection, &reply)?;
        if reply.first != came {
            return Err(wrong(connection, format!("post {} where {came} comes next", reply.first)));
        }
        (version, came) = (reply.version, came + found.len() as u64);
        each(reply.first, found)?;
    }
    if came != wanted {
        return Err(wrong(connection, format!("{came} posts where {wanted} were asked")));
    }
    Ok(version)
}

/// Points as they travel.
pub fn packed(points: &[[f64; 2]]) -> Vec<u8> {
    points.iter().flatten().flat_map(|v| v.to_le_bytes()).collect()
}

async fn gather(connection: &Connection, stream: &mut Streaming<v1::HeightsReply>) -> Result<Heights> {
    let mut out = Heights::default();
    while let Some(reply) = stream.message().await.map_err(|s| connection.failed(s))? {
        if reply.first != out.heights.len() as u64 {
            let n = out.heights.len();
            return Err(wrong(connection, format!("point {} where {n} comes next", reply.first)));
        }
        if !out.heights.is_empty() && out.version != reply.version {
            let (a, b) = (out.version, reply.version);
            return Err(wrong(connection, format!("versions {a} and {b} in one call")));
        }
        out.version = reply.version;
        out.heights.extend(unpacked(connection, &reply)?);
        out.line.extend(line_points(connection, &reply)?);
        out.makers.extend(reply.contributors.into_iter().map(|c| c.contributors));
        for s in reply.surveys {
            if out.surveys.iter().all(|o| o.survey != s.survey) {
                out.surveys.push(s);
            }
        }
    }
    Ok(out)
}

fn counted(connection: &Connection, found: Heights, wanted: usize) -> Result<Heights> {
    let n = found.heights.len();
    if n != wanted {
        return Err(wrong(connection, format!("{n} heights for {wanted} points")));
    }
    Ok(found)
}

fn wrong(connection: &Connection, what: String) -> Error {
    let message = format!("sent {what}: it speaks another language than this program");
    Error::Remote { server: connection.server.clone(), message }
}

/// The heights of a message: bit for bit what the server's database gives (float32 where `single` was asked).
pub fn unpacked(connection: &Connection, r: &v1::HeightsReply) -> Result<Vec<Option<Evaluation>>> {
    let n = r.count as usize;
    let wide = if r.z.len() == n * 4 { 4 } else { 8 };
    let optional = |bytes: usize, each: usize| bytes == 0 || bytes == n * each;
    let fits = r.z.len() == n * wide
        && r.flags.len() == n
        && r.error_m.len() == n * 8
        && r.accuracy_m.len() == n * 8
        && optional(r.correction_m.len(), 8)
        && optional(r.gradients.len(), 16);
    if !fits {
        return Err(wrong(connection, format!("arrays of other lengths than its count of {n}")));
    }
    let z = |k: usize| if wide == 4 { f64::from(single(&r.z, k)) } else { double(&r.z, k) };
    let some = |bytes: &[u8], k: usize| if bytes.is_empty() { 0.0 } else { double(bytes, k) };
    let one = |k: usize| {
        (r.flags[k] & 1 != 0).then(|| Evaluation {
            z: z(k),
            gradient: [some(&r.gradients, 2 * k), some(&r.gradients, 2 * k + 1)],
            error_m: double(&r.error_m, k),
            accuracy_m: double(&r.accuracy_m, k),
            certified: r.flags[k] & 2 != 0,
            correction_m: some(&r.correction_m, k),
            contradiction: r.flags[k] & 4 != 0,
        })
    };
    Ok((0..n).map(one).collect())
}

fn line_points(connection: &Connection, r: &v1::HeightsReply) -> Result<Vec<LinePoint>> {
    let n = r.vertices.len();
    if r.points.len() != n * 16 || r.distance_m.len() != n * 8 || (n != 0 && n != r.count as usize) {
        return Err(wrong(connection, format!("{n} points of a line of other lengths")));
    }
    let one = |k: usize| LinePoint {
        at: [double(&r.points, 2 * k), double(&r.points, 2 * k + 1)],
        distance_m: double(&r.distance_m, k),
        vertex: r.vertices[k] != 0,
    };
    Ok((0..n).map(one).collect())
}

/// The k-th number of an array; NaN beyond it.
fn double(bytes: &[u8], k: usize) -> f64 {
    let b = bytes.get(8 * k..8 * k + 8).and_then(|b| b.try_into().ok());
    b.map_or(f64::NAN, f64::from_le_bytes)
}

fn single(bytes: &[u8], k: usize) -> f32 {
    let b = bytes.get(4 * k..4 * k + 4).and_then(|b| b.try_into().ok());
    b.map_or(f32::NAN, f32::from_le_bytes)
}
