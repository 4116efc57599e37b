//! The surface of a region as a stream (GTB): goes on where it broke off, and refines what is there.

use super::Connection;
use crate::base::{Error, Result};
use crate::codec::held::{self, Posts};
use crate::wire::v1;
use crate::wire::v1::surface_piece::Kind;
use std::error::Error as _;
use std::time::Duration;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::{Decoded, Given, Header, Stop, decode};
use tonic::{Code, Status};

/// Connections that may break one after another without a byte in between.
const BREAKS_MAX: u32 = 3;
/// Until the next attempt, times the number of the attempt.
const WAIT: Duration = Duration::from_millis(300);

/// A stream, or as much of it as came.
#[derive(Clone, Debug, Default)]
pub struct Terrain {
    /// With what it is asked; its version once that is known.
    pub request: v1::SurfaceRequest,
    /// What the server said of it, the last time it was asked.
    pub head: Option<v1::SurfaceHead>,
    /// What came: the beginning of a file of GTB.
    pub bytes: Vec<u8>,
    /// Heights that it refines, at its own posts.
    given: Option<Given>,
}

impl Terrain {
    /// Nothing yet.
    pub fn new(request: v1::SurfaceRequest) -> Terrain {
        Terrain { request, ..Terrain::default() }
    }

    /// The beginning of a stream that came earlier. If it is of another stream than the request's, it is dropped.
    pub fn begun(request: v1::SurfaceRequest, bytes: Vec<u8>) -> Terrain {
        Terrain { request, bytes, ..Terrain::default() }
    }

    /// Whether nothing is missing.
    pub fn is_complete(&self) -> bool {
        self.head.as_ref().is_some_and(|h| h.bytes == self.bytes.len() as u64)
    }

    /// Whether the head of the file has come, and some of what follows it.
    pub fn is_begun(&self) -> bool {
        Header::read(&self.bytes).is_ok_and(|(_, head)| self.bytes.len() > head)
    }

    /// A request for another spacing or region, which will not be sent again what is here.
    ///
    /// # Errors
    /// If nothing of this has come.
    pub fn refined(&self, request: v1::SurfaceRequest) -> Result<v1::SurfaceRequest> {
        let head = self.head.as_ref().filter(|_| !self.bytes.is_empty());
        let head =
            head.ok_or_else(|| Error::invalid("what is held", "has not come yet; ask for it first"))?;
        let held = v1::Held {
            request: Some(Box::new(v1::SurfaceRequest { prefix: None, ..self.request.clone() })),
            hash: head.hash.clone(),
            bytes: if self.is_complete() { 0 } else { self.bytes.len() as u64 },
        };
        Ok(v1::SurfaceRequest { held: Some(Box::new(held)), ..request })
    }

    /// The surface of what came.
    ///
    /// # Errors
    /// If not even the corners are there, or bytes are damaged from the beginning on.
    pub fn decode(&self, stop: Stop) -> Result<Decoded> {
        decode(&self.bytes, &mut Vec::new(), stop, self.given.as_ref(), &mut Alone, &mut |_| true)
            .map_err(|e| Error::invalid("stream", e))
    }

    /// Fetches what is missing. When the connection breaks, goes on where it broke off; `told` after each piece.
    ///
    /// `earlier`: what [`Terrain::refined`] made the request of, if it did.
    ///
    /// # Errors
    /// What the server refuses, and a connection that does not come back: what came stays, and may be gone on with.
    pub async fn fetch(
        &mut self,
        connection: &Connection,
        earlier: Option<&Terrain>,
        mut told: impl FnMut(&Terrain) -> Result<()>,
    ) -> Result<()> {
        let (mut breaks, mut before) = (0, self.bytes.len());
        loop {
            let broke = match self.attempt(connection, earlier, &mut told).await {
                Ok(()) if self.is_complete() => return Ok(()),
                Ok(()) => None,
                Err(Ended::Error(e)) => return Err(e),
                Err(Ended::Status(s)) if s.source().is_some() || s.code() == Code::Unavailable => Some(s),
                Err(Ended::Status(s)) => return Err(connection.failed(s)),
            };
            breaks = if self.bytes.len() > before { 1 } else { breaks + 1 };
            before = self.bytes.len();
            if breaks > BREAKS_MAX {
                let message = format!("ended the stream after {before} bytes; go on with them later");
                let ended = Error::Remote { server: connection.server.clone(), message };
                return Err(broke.map_or(ended, |s| connection.failed(s)));
            }
            tokio::time::sleep(WAIT * breaks).await;
        }
    }

    async fn attempt(
        &mut self,
        connection: &Connection,
        earlier: Option<&Terrain>,
        told: &mut impl FnMut(&Terrain) -> Result<()>,
    ) -> std::result::Result<(), Ended> {
        let mut request = self.request.clone();
        if !self.bytes.is_empty() {
            let hash = match &self.head {
                Some(h) => h.hash.clone(),
                None => blake3::hash(&self.bytes).as_bytes().to_vec().into(),
            };
            request.prefix = Some(v1::Prefix { bytes: self.bytes.len() as u64, hash });
        }
        let mut stream = connection.streams().surface(request).await?.into_inner();
        while let Some(piece) = stream.message().await? {
            match piece.kind {
                Some(Kind::Head(head)) => self.begin(connection, head)?,
                Some(Kind::Data(data)) => {
                    let most = self.head.as_ref().map_or(0, |h| h.bytes);
                    if (self.bytes.len() + data.len()) as u64 > most {
                        return Err(Ended::Error(wrong(
                            connection,
                            &format!("more than the {most} bytes that it said"),
                        )));
                    }
                    self.bytes.extend_from_slice(&data);
                }
                None => {}
            }
            self.know(earlier)?;
            told(self)?;
        }
        Ok(())
    }

    fn begin(&mut self, connection: &Connection, head: v1::SurfaceHead) -> Result<()> {
        if head.from > self.bytes.len() as u64 || head.from > head.bytes {
            let what = format!("a stream from byte {} on, {} were here", head.from, self.bytes.len());
            return Err(wrong(connection, &what));
        }
        self.bytes.truncate(head.from as usize);
        if self.bytes.is_empty() {
            self.given = None;
        }
        self.request.at = head.version;
        self.head = Some(head);
        Ok(())
    }

    /// Finds the heights that the stream refines, once its head is there.
    fn know(&mut self, earlier: Option<&Terrain>) -> Result<()> {
        let Some(refines) = self.head.as_ref().and_then(|h| h.refines.as_ref()) else { return Ok(()) };
        let Ok((header, _)) = Header::read(&self.bytes) else { return Ok(()) };
        if self.given.is_some() {
            return Ok(());
        }
        let of = "what is held";
        let earlier =
            earlier.ok_or_else(|| Error::invalid(of, "is not here; give the stream that is refined"))?;
        let posts =
            Posts { cols: header.cols, rows: header.rows, lattice: header.lattice, place: &header.place };
        let mut given = held::shared(&earlier.decode(Stop::End)?, &posts)
            .ok_or_else(|| Error::invalid(of, "shares no post with the stream that is said to refine it"))?;
        held::follow(&mut given, &refines.runs)?;
        self.given = Some(given);
        Ok(())
    }
}

/// How an attempt ends before its time.
enum Ended {
    Status(Status),
    Error(Error),
}

impl From<Status> for Ended {
    fn from(s: Status) -> Ended {
        Ended::Status(s)
    }
}

impl From<Error> for Ended {
    fn from(e: Error) -> Ended {
        Ended::Error(e)
    }
}

fn wrong(connection: &Connection, what: &str) -> Error {
    let message = format!("sent {what}: it speaks another language than this program");
    Error::Remote { server: connection.server.clone(), message }
}
