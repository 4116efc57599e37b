//! `Streams`: the surface of a region as a stream, made in the pool of work, sent as the client reads.
//!
//! What a client holds already is not remembered here: it says so, and it is made again by the same steps, unless it is among the
//! streams that were made lately.

use super::outgoing::{Outgoing, Stream, stream};
use crate::base::{Error, Result};
use crate::export;
use crate::server::model::stream as model;
use crate::server::{Answer, Live, State};
use crate::wire::v1;
use crate::wire::v1::streams_server::Streams;
use bytes::Bytes;
use prost::Message;
use quick_cache::sync::{Cache, DefaultLifecycle};
use quick_cache::{DefaultHashBuilder, OptionsBuilder, Weighter};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Given, Stop, decode};
use tokio::sync::Semaphore;
use tonic::{Request, Response, Status};

/// Bytes of a piece: a link that breaks loses no more of them.
const PIECE: usize = 32 << 10;
/// Streams that are waited for, made or sent at once.
const STREAMS_MAX: usize = 16;
/// Streams that are made at once, as far as there are cores to leave one.
const MADE_AT_ONCE: usize = 2;
/// Streams that are expected to be kept.
const KEPT: usize = 256;

/// The service.
pub struct StreamsService {
    state: Arc<State>,
    streams: Arc<Semaphore>,
    making: Arc<Semaphore>,
    workshop: Arc<Workshop>,
}

impl StreamsService {
    pub fn new(state: Arc<State>) -> StreamsService {
        let cores = std::thread::available_parallelism().map_or(1, usize::from);
        let making = MADE_AT_ONCE.min(cores.saturating_sub(1)).max(1);
        let semaphore = |n| Arc::new(Semaphore::new(n));
        let (live, side_max) = (state.live.clone(), state.settings.gtb_side_max);
        let workshop = Arc::new(Workshop { live, side_max, kept: kept(state.settings.gtb_cache_bytes) });
        StreamsService { state, streams: semaphore(STREAMS_MAX), making: semaphore(making), workshop }
    }
}

/// Where streams are made, and kept for a while.
struct Workshop {
    live: Arc<Live>,
    side_max: u64,
    kept: Kept,
}

type Kept = Cache<[u8; 32], Arc<Made>, ByBytes>;

#[derive(Clone)]
struct ByBytes;

impl Weighter<[u8; 32], Arc<Made>> for ByBytes {
    fn weight(&self, _: &[u8; 32], m: &Arc<Made>) -> u64 {
        // A height that was given takes five bytes.
        1024 + m.bytes.len() as u64 + m.given.as_ref().map_or(0, |g| 5 * g.z.len() as u64)
    }
}

/// One shard: a single stream may take all the room.
fn kept(bytes: u64) -> Kept {
    let options = OptionsBuilder::new()
        .shards(1)
        .estimated_items_capacity(KEPT)
        .weight_capacity(bytes)
        .build()
        .expect("all that has no default is set");
    Cache::with_options(options, ByBytes, DefaultHashBuilder::default(), DefaultLifecycle::default())
}

/// A stream that is complete.
struct Made {
    bytes: Bytes,
    /// As it is sent to who has nothing of it.
    head: v1::SurfaceHead,
    given: Option<Given>,
}

/// Tells the work that nobody waits for it any more.
struct Wanting(Arc<AtomicBool>);

impl Drop for Wanting {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

#[tonic::async_trait]
impl Streams for StreamsService {
    type SurfaceStream = Stream<v1::SurfacePiece>;

    async fn surface(&self, request: Request<v1::SurfaceRequest>) -> Answer<Response<Self::SurfaceStream>> {
        let mut r = request.into_inner();
        let Ok(one) = self.streams.clone().try_acquire_owned() else {
            return Err(Status::resource_exhausted(format!(
                "{STREAMS_MAX} streams are being made and sent already, no more at once; ask again later"
            )));
        };
        let prefix = r.prefix.take();
        let (state, making, workshop) = (self.state.clone(), self.making.clone(), self.workshop.clone());
        let looked = workshop.clone();
        // Bad requests are refused before they wait for a turn.
        let (request, lately) = state.pools.work(move || looked.look(r)).await?;
        Ok(stream(|out| async move {
            let _one = one;
            let stop = Arc::new(AtomicBool::new(false));
            let _wanting = Wanting(stop.clone());
            let made = match lately {
                Some(made) => made,
                None => {
                    let turn = making.acquire_owned().await.map_err(|e| Status::internal(e.to_string()))?;
                    let make = move || {
                        let _turn = turn;
                        workshop.make(request, &stop)
                    };
                    state.pools.work(make).await?
                }
            };
            let of = made.clone();
            let (from, note) = state.pools.work(move || Ok(agreed(prefix.as_ref(), &of))).await?;
            send(&made, from, note, &out).await
        }))
    }
}

impl Workshop {
    /// Checks a request and fixes its version; the stream, if it was made lately.
    fn look(&self, r: v1::SurfaceRequest) -> Result<(v1::SurfaceRequest, Option<Arc<Made>>)> {
        model::held(&r)?;
        let s = self.live.snapshot(r.at)?;
        model::stream(&r, &s, self.side_max)?;
        let r = v1::SurfaceRequest { at: s.number(), prefix: None, ..r };
        let lately = self.kept.get(&key(&r));
        Ok((r, lately))
    }

    fn make(&self, r: v1::SurfaceRequest, stop: &AtomicBool) -> Result<Arc<Made>> {
        let (r, lately) = self.look(r)?;
        if let Some(made) = lately {
            return Ok(made);
        }
        let s = self.live.snapshot(r.at)?;
        let wanted = model::stream(&r, &s, self.side_max)?;
        let mut notes: Vec<String> = wanted.place.coords.iter().flat_map(|c| c.notes.clone()).collect();
        let earlier = match &r.held {
            None => None,
            Some(h) => match self.held(h, stop)? {
                Ok(earlier) => Some(earlier),
                Err(note) => {
                    notes.push(note);
                    None
                }
            },
        };
        let going = |_: &str, _: f64| !stop.load(Ordering::Relaxed);
        let found = export::stream(&s, &wanted, earlier.as_ref(), None, &going)?;
        notes.extend(found.notes.iter().cloned());
        let made = Arc::new(made(found, notes)?);
        self.kept.insert(key(&r), made.clone());
        Ok(made)
    }

    /// What a client holds, made again; or why it cannot be.
    fn held(&self, h: &v1::Held, stop: &AtomicBool) -> Result<std::result::Result<Decoded, String>> {
        let Some(request) = h.request.clone() else { return Ok(Err("nothing is held".into())) };
        let at = request.at;
        match self.live.snapshot(at) {
            Err(Error::Missing { .. }) => {
                return Ok(Err(format!(
                    "version {at}, of which something is held, is gone: everything is sent"
                )));
            }
            found => drop(found?),
        }
        let made = self.make(v1::SurfaceRequest { prefix: None, ..*request }, stop)?;
        if made.head.hash != h.hash {
            return Ok(Err("what is held is not what its request gives: everything is sent".into()));
        }
        let some = if h.bytes == 0 { Stop::End } else { Stop::Bytes(h.bytes) };
        let mut going = |_: f64| !stop.load(Ordering::Relaxed);
        match decode(&made.bytes, &mut Vec::new(), some, made.given.as_ref(), &mut Alone, &mut going) {
            Ok(decoded) => Ok(Ok(decoded)),
            Err(terraquilt_codecs::Error::Stopped) => Err(Error::Stopped),
            Err(e) => Ok(Err(format!("what is held is no surface yet ({e}): everything is sent"))),
        }
    }
}

/// What names a stream: its request, version and all.
fn key(r: &v1::SurfaceRequest) -> [u8; 32] {
    *blake3::hash(&r.encode_to_vec()).as_bytes()
}

fn made(found: export::Stream, notes: Vec<String>) -> Result<Made> {
    let told = &found.told;
    let given_error_m = told.error_m - told.codec_error_m;
    let pass = |end: &terraquilt_codecs::gtb::PassEnd| v1::SurfacePass {
        bytes: end.bytes,
        layer: end.layer as u32,
        spacing: end.pass.step as u32,
        edges: end.pass.kind == terraquilt_codecs::lattice::Kind::Edges,
        error_m: given_error_m + f64::from(end.bound) * told.unit_m,
    };
    let (runs, given) = found.refines.map_or((None, None), |r| (Some(r.runs), Some(r.given)));
    let head = v1::SurfaceHead {
        version: told.version,
        bytes: told.bytes,
        hash: blake3::hash(&found.bytes).as_bytes().to_vec().into(),
        from: 0,
        passes: found.ends.iter().map(pass).collect(),
        error_m: told.error_m,
        given_error_m,
        refines: runs.map(|runs| v1::Refines { runs }),
        json: serde_json::to_string(told).map_err(|e| Error::invalid("JSON of the stream", e))?,
        notes,
    };
    Ok(Made { bytes: found.bytes.into(), head, given })
}

/// Where to begin for who says what is there already, and what to say of it.
fn agreed(prefix: Option<&v1::Prefix>, made: &Made) -> (usize, Option<String>) {
    let Some(p) = prefix.filter(|p| p.bytes > 0) else { return (0, None) };
    let whole = || p.hash == made.head.hash;
    let same = |begun: &[u8]| whole() || p.hash[..] == *blake3::hash(begun).as_bytes();
    match usize::try_from(p.bytes).ok().and_then(|n| made.bytes.get(..n)).filter(|begun| same(begun)) {
        Some(begun) => (begun.len(), None),
        None => (
            0,
            Some(format!(
                "the {} bytes that are there belong to another stream (the terrain has changed, or the request): it begins anew",
                p.bytes
            )),
        ),
    }
}

async fn send(
    made: &Made,
    from: usize,
    note: Option<String>,
    out: &Outgoing<v1::SurfacePiece>,
) -> Answer<()> {
    use v1::surface_piece::Kind;
    let piece = |kind| v1::SurfacePiece { kind: Some(kind) };
    let mut head = v1::SurfaceHead { from: from as u64, ..made.head.clone() };
    head.notes.extend(note);
    out.send(piece(Kind::Head(head))).await?;
    for at in (from..made.bytes.len()).step_by(PIECE) {
        out.room().await?;
        let data = made.bytes.slice(at..made.bytes.len().min(at + PIECE));
        out.send(piece(Kind::Data(data))).await?;
    }
    Ok(())
}
