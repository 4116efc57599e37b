//! `Heights`: points, lines and rasters.
//!
//! The points of a call are taken in blocks; a block is evaluated in pieces that lie together, one task in the pool of answers
//! each, so that a large raster takes turns with everybody else. The next block is begun when the client has room for it.

use super::outgoing::{Outgoing, Stream, stream};
use crate::analysis::{Stations, Terrain};
use crate::base::{Error, Result};
use crate::server::model::heights::{Asked, Found, Manner, POINTS_A_MESSAGE, Places, Posts, points, replies};
use crate::server::model::pairs;
use crate::server::status::status;
use crate::server::{Answer, State};
use crate::wire::v1::heights_server::Heights;
use crate::wire::v1::{HeightsHeader, HeightsReply, PointsRequest, ProfileRequest, RasterRequest};
use std::sync::Arc;
use std::time::Duration;
use tonic::{Request, Response, Status, Streaming};

/// Points of a block, and where it is said who made each height.
const BLOCK: usize = 65536;
const BLOCK_EXPLAINED: usize = 4096;
/// Points of a piece, and where it is said who made each height: some milliseconds of work.
const PIECE: usize = 4096;
const PIECE_EXPLAINED: usize = 512;
/// Pieces are made of squares of so many steps of the finest survey, and of so many squares at most.
const SQUARE_STEPS: f64 = 256.0;
const SQUARES: usize = 64;

/// A caller of `Points` that sends nothing for so long is let go: its version cannot be pruned meanwhile.
const SENT_WITHIN: Duration = Duration::from_secs(600);

/// The service.
pub struct HeightsService(pub Arc<State>);

#[tonic::async_trait]
impl Heights for HeightsService {
    type PointsStream = Stream<HeightsReply>;
    type AskStream = Stream<HeightsReply>;
    type ProfileStream = Stream<HeightsReply>;
    type RasterStream = Stream<HeightsReply>;

    async fn points(
        &self,
        request: Request<Streaming<PointsRequest>>,
    ) -> Answer<Response<Self::PointsStream>> {
        let state = self.0.clone();
        let mut incoming = request.into_inner();
        Ok(stream(|out| async move {
            let Some(mut message) = sent(&mut incoming).await? else {
                return Err(Status::invalid_argument("no message came; the first one needs a header"));
            };
            let manner = manner(&state, message.header.take()).await?;
            let mut first = 0;
            loop {
                first = given(&state, &manner, &message, first, &out).await?;
                match sent(&mut incoming).await? {
                    None => return Ok(()),
                    Some(m) if m.header.is_some() => {
                        return Err(Status::invalid_argument(
                            "a second header came; all points of a call are asked alike: make another call",
                        ));
                    }
                    Some(m) => message = m,
                }
            }
        }))
    }

    async fn ask(&self, request: Request<PointsRequest>) -> Answer<Response<Self::AskStream>> {
        let state = self.0.clone();
        let mut message = request.into_inner();
        let manner = manner(&state, message.header.take()).await?;
        Ok(stream(|out| async move { given(&state, &manner, &message, 0, &out).await.map(drop) }))
    }

    async fn profile(&self, request: Request<ProfileRequest>) -> Answer<Response<Self::ProfileStream>> {
        let state = self.0.clone();
        let r = request.into_inner();
        let manner = manner(&state, r.header.clone()).await?;
        let (most, asked) = (state.settings.points_max, manner.clone());
        let places = state.pools.answer(move || line(&r, &asked, most)).await?;
        Ok(stream(|out| async move { answer(&state, &manner, places, 0, &out).await.map(drop) }))
    }

    async fn raster(&self, request: Request<RasterRequest>) -> Answer<Response<Self::RasterStream>> {
        let state = self.0.clone();
        let r = request.into_inner();
        let posts = Posts::new(&r, state.settings.points_max).map_err(status)?;
        let manner = manner(&state, r.header).await?;
        let places = Places::over(posts);
        Ok(stream(|out| async move { answer(&state, &manner, places, 0, &out).await.map(drop) }))
    }
}

/// The next message of a caller; `None`: it has ended its side.
async fn sent(incoming: &mut Streaming<PointsRequest>) -> Answer<Option<PointsRequest>> {
    tokio::time::timeout(SENT_WITHIN, incoming.message()).await.unwrap_or_else(|_| {
        let s = SENT_WITHIN.as_secs();
        Err(Status::deadline_exceeded(format!(
            "nothing was sent for {s} s; make another call when there are points"
        )))
    })
}

async fn manner(state: &Arc<State>, header: Option<HeightsHeader>) -> Answer<Arc<Manner>> {
    let Some(header) = header else {
        return Err(Status::invalid_argument(
            "header: is missing; it says the tolerance (metres, camera, foci or raster), and goes in the first message",
        ));
    };
    let live = state.live.clone();
    if !header.only_surveys.is_empty() {
        let one = live.one_subset().await;
        let made = move || {
            let _one = one;
            Manner::new(&header, live.only(header.at, &header.only_surveys)?).map(Arc::new)
        };
        return state.pools.work(made).await;
    }
    state.pools.answer(move || Ok(Arc::new(Manner::new(&header, live.snapshot(header.at)?)?))).await
}

fn line(r: &ProfileRequest, manner: &Manner, most: u64) -> Result<Places> {
    let vertices = r.line.len() / 16;
    if vertices > POINTS_A_MESSAGE {
        return Err(Error::limit("vertices of a line", POINTS_A_MESSAGE as u64, vertices as u64));
    }
    let line = pairs("line", &r.line)?;
    if let Some(k) = line.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        let reason = format!("{:?} is no place; x and y must be finite", line[k]);
        return Err(Error::invalid(format!("vertex {k} of the line (counted from 0)"), reason));
    }
    let step = (r.step_m != 0.0).then_some(r.step_m);
    if step.is_some_and(|s| !(s.is_finite() && s > 0.0)) {
        let reason = format!("{} m; give metres above 0, or 0 for the step of the finest survey", r.step_m);
        return Err(Error::invalid("step_m", reason));
    }
    let terrain = Terrain { ground: &*manner.snapshot, tolerance: manner.tolerance.clone(), how: manner.how };
    Ok(Places::Along(Box::new(Stations::new(&terrain, &line, step, most)?)))
}

/// Answers a message of points. Returns how many have come in the call.
async fn given(
    state: &Arc<State>,
    manner: &Arc<Manner>,
    message: &PointsRequest,
    first: u64,
    out: &Outgoing<HeightsReply>,
) -> Answer<u64> {
    let found = points(&message.points, first).map_err(status)?;
    let (n, most) = (first + found.len() as u64, state.settings.points_max);
    if n > most {
        return Err(status(Error::limit("points of the call", most, n)));
    }
    answer(state, manner, Places::given(found), first, out).await
}

/// Answers for places, of which the first is the `first` of the call. Returns the number after the last.
async fn answer(
    state: &Arc<State>,
    manner: &Arc<Manner>,
    mut places: Places,
    mut first: u64,
    out: &Outgoing<HeightsReply>,
) -> Answer<u64> {
    let total = places.total();
    loop {
        out.room().await?;
        let m = manner.clone();
        let begun = state.pools.answer(move || begin(&m, places)).await?;
        places = begun.places;
        if begun.asked.points.is_empty() {
            return Ok(first);
        }
        let asked = Arc::new(begun.asked);
        let n = asked.points.len();
        let found = match begun.found {
            Some(found) => found,
            None => in_pieces(state, manner, &asked, begun.pieces).await?,
        };
        let m = manner.clone();
        let messages = state.pools.answer(move || replies(&m, &asked, &found, first, total)).await?;
        for message in messages {
            out.send(message).await?;
        }
        first += n as u64;
    }
}

/// A block, before its pieces are evaluated; a block of one piece is evaluated already.
struct Begun {
    places: Places,
    asked: Asked,
    pieces: Vec<Vec<u32>>,
    found: Option<Found>,
}

fn begin(manner: &Manner, mut places: Places) -> Result<Begun> {
    let asked = places.next(if manner.explain { BLOCK_EXPLAINED } else { BLOCK });
    let pieces = pieces(manner, &asked.points);
    let found = if pieces.len() <= 1 { Some(evaluate(manner, &asked.points)?) } else { None };
    Ok(Begun { places, asked, pieces, found })
}

/// Points that lie together, by number: bounded in count and extent.
fn pieces(manner: &Manner, points: &[[f64; 2]]) -> Vec<Vec<u32>> {
    let steps = manner.snapshot.entries().flat_map(|e| e.geometry.steps);
    let side = steps.fold(f64::INFINITY, f64::min) * SQUARE_STEPS;
    let square = |p: &[f64; 2]| [(p[1] / side).floor() as i64, (p[0] / side).floor() as i64];
    let mut order: Vec<([i64; 2], u32)> =
        points.iter().enumerate().map(|(k, p)| (square(p), k as u32)).collect();
    order.sort_unstable();
    let most = if manner.explain { PIECE_EXPLAINED } else { PIECE };
    let mut out: Vec<Vec<u32>> = Vec::new();
    let (mut squares, mut last) = (0, None);
    for (square, k) in order {
        let new = last != Some(square);
        last = Some(square);
        match out.last_mut() {
            Some(piece) if piece.len() < most && (!new || squares < SQUARES) => piece.push(k),
            _ => {
                out.push(vec![k]);
                squares = 0;
            }
        }
        squares += usize::from(new);
    }
    out
}

fn evaluate(manner: &Manner, points: &[[f64; 2]]) -> Result<Found> {
    let (s, tolerance, how) = (&manner.snapshot, &manner.tolerance, manner.how);
    let heights =
        if manner.gradients { s.slopes(points, tolerance, how)? } else { s.heights(points, tolerance, how)? };
    let makers = if manner.explain { s.explained(points, tolerance, how)? } else { Vec::new() };
    Ok(Found { heights, makers })
}

async fn in_pieces(
    state: &Arc<State>,
    manner: &Arc<Manner>,
    asked: &Arc<Asked>,
    pieces: Vec<Vec<u32>>,
) -> Answer<Found> {
    let n = asked.points.len();
    let mut found = Found { heights: vec![None; n], makers: vec![None; if manner.explain { n } else { 0 }] };
    for piece in pieces {
        let (m, a) = (manner.clone(), asked.clone());
        let (piece, part) = state
            .pools
            .answer(move || {
                let points: Vec<[f64; 2]> = piece.iter().map(|k| a.points[*k as usize]).collect();
                let part = evaluate(&m, &points)?;
                Ok((piece, part))
            })
            .await?;
        for (k, e) in piece.iter().zip(part.heights) {
            found.heights[*k as usize] = e;
        }
        for (k, w) in piece.iter().zip(part.makers) {
            found.makers[*k as usize] = w;
        }
    }
    Ok(found)
}
