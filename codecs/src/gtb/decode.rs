//! A stream, or the beginning of one, becomes a surface.

use super::companion::Companion;
use super::dense::{self, Reached};
use super::encode::{PassEnd, Profile};
use super::field::{Field, Given, SHOWN_WHOLE, Status};
use super::header::Header;
use super::{mask, sparse, surface};
use crate::blocks::{BLOCK, unblocked};
use crate::range::Decoder;
use crate::{Error, Result};

/// How far to decode.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Stop {
    /// As far as the bytes go.
    End,
    /// So many bytes of the file.
    Bytes(u64),
    /// Until the error of the codec is at most so many units.
    Error(f64),
}

/// What a prefix gives.
pub struct Decoded {
    /// The head.
    pub header: Header,
    /// `side * side` heights of the lattice in units above the base; meaningful where they are known.
    pub z: Vec<i32>,
    /// What is known.
    pub reached: Reached,
    /// Which posts are sent at all, for [`Profile::Sparse`]; else empty.
    pub selected: Vec<bool>,
    /// What each post is; empty if all are coded.
    status: Vec<Status>,
    /// The passes that are whole, and where they end: as the sender has them, but that a decoder looks some bytes ahead.
    pub passes: Vec<PassEnd>,
    /// Bytes of the file that were looked at.
    pub bytes_used: u64,
    /// Whether nothing is missing.
    pub complete: bool,
    /// The bound of the codec's error at posts with data, in units.
    pub bound: u32,
    /// A block with a wrong checksum, by its place in the body; nothing from there on was used.
    pub damaged: Option<u64>,
}

/// Decodes a file or any prefix of one. `given`: the heights that a stream refines. `going` as for [`encode()`](super::encode()).
///
/// An error where not even the corners are there, the head is damaged, or tells of a texture that the companion does not read; whatever follows, the answer is a surface. A bit that
/// was flipped within a block whose checksum is there ends the answer before that block.
pub fn decode<'a, T: Companion<Decoder<'a>>>(
    bytes: &[u8],
    body: &'a mut Vec<u8>,
    stop: Stop,
    given: Option<&Given>,
    companion: &mut T,
    going: &mut dyn FnMut(f64) -> bool,
) -> Result<Decoded> {
    decode_within(u64::MAX, bytes, body, stop, given, companion, going)
}

/// As [`decode()`], for bytes that nobody vouches for: a lattice of more than `posts_max` posts, or a texture of more cells than that, is
/// an [`Error::Limit`], before anything is allocated for it. Memory: at most 24 bytes a post of the lattice, 18 a cell of the texture
/// (50 while a picture is painted), and the bytes.
pub fn decode_within<'a, T: Companion<Decoder<'a>>>(
    posts_max: u64,
    bytes: &[u8],
    body: &'a mut Vec<u8>,
    stop: Stop,
    given: Option<&Given>,
    companion: &mut T,
    going: &mut dyn FnMut(f64) -> bool,
) -> Result<Decoded> {
    let bytes = match stop {
        Stop::Bytes(n) => &bytes[..bytes.len().min(usize::try_from(n).unwrap_or(usize::MAX))],
        _ => bytes,
    };
    let (header, head) = Header::read(bytes)?;
    let posts = (header.lattice.side() as u64).pow(2);
    if posts > posts_max {
        return Err(Error::Limit { what: "posts of the lattice", limit: posts_max, wanted: posts });
    }
    let cells = header.texture.map_or(0, |n| 1u64 << (2 * n));
    if cells > posts_max {
        return Err(Error::Limit { what: "cells of the texture", limit: posts_max, wanted: cells });
    }
    header.accompanied(companion.texture())?;
    let read = unblocked(&bytes[head..], header.body);
    *body = read.bytes;
    let mut field = Field::new(&header, given)?;
    let mut c = Decoder::new(body, read.whole);
    let mut reached = Reached::NOTHING;
    let wanted = if let Stop::Error(e) = stop { e } else { -1.0 };
    let last = 2 * header.lattice.n();
    let mut passes = Vec::new();
    let mut mark = |layer: usize, number: u32, c: &Decoder| {
        passes.push(PassEnd {
            layer,
            pass: header.lattice.pass(number),
            bytes: header.file_position(head, c.position()).min(bytes.len() as u64),
            bound: header.bound(layer, number + 1),
        });
        let done = 0.25_f64.powi(((last - number) / 2) as i32);
        if !going((layer as f64 + done) / header.layers.len() as f64) {
            return Err(Error::Stopped);
        }
        Ok(wanted.is_nan() || f64::from(header.bound(layer, number + 1)) > wanted)
    };
    if !header.mask || mask::code(&header, &mut field, None, &mut c) {
        companion.start(header.lattice, &mut c);
        reached = match header.profile {
            Profile::Sparse => sparse::code(&header, None, &mut field, &mut c, companion, &mut mark)?,
            _ => dense::code(&header, None, &mut field, &mut c, companion, &mut mark, &mut |_, _| {})?,
        };
    }
    let used = c.position();
    if !reached.corners {
        if let Some(at) = read.damaged {
            return Err(Error::damaged(
                format!("block at byte {at} of the body"),
                "its checksum is wrong, and nothing before it is whole; fetch the file again",
            ));
        }
        let has = bytes.len() as u64;
        return Err(Error::Short { what: "mask and corners", needs: has + 1, has });
    }
    let complete = read.whole && reached.layer == header.layers.len();
    let bound = header.bound(reached.layer, reached.passes);
    let Field { z, status, selected, .. } = field;
    let blocks = 4 * used.div_ceil(BLOCK);
    Ok(Decoded {
        z,
        reached,
        selected,
        status,
        passes,
        bytes_used: ((head + used + blocks) as u64).min(bytes.len() as u64),
        complete,
        bound,
        damaged: read.damaged,
        header,
    })
}

impl Decoded {
    /// Whether a post of the lattice has no data: a void, or outside of the grid.
    pub fn is_free(&self, at: usize) -> bool {
        self.status.get(at) == Some(&Status::Free)
    }

    /// Which posts of the lattice carry a height of the stream (of voids: a prediction), as far as it was read; of the first
    /// [`SHOWN_WHOLE`] passes only whole ones count.
    pub fn known(&self) -> Vec<bool> {
        let (lattice, side) = (self.header.lattice, self.header.lattice.side());
        let mut known = vec![false; side * side];
        lattice.corners().into_iter().for_each(|[y, x]| known[y * side + x] = true);
        for (k, pass) in lattice.passes().enumerate() {
            let whole = self.reached.layer > 0 || (k as u32) < self.reached.passes;
            let some = if whole {
                usize::MAX
            } else if k as u32 == self.reached.passes && k as u32 >= SHOWN_WHOLE {
                self.reached.posts
            } else {
                0
            };
            for [y, x] in pass.posts(lattice).take(some) {
                let at = y * side + x;
                known[at] = self.selected.is_empty() || self.selected[at];
            }
        }
        for (at, s) in self.status.iter().enumerate() {
            known[at] |= *s == Status::Given;
        }
        known
    }

    /// The surface at every post of the lattice, in units above the base: `side * side`.
    pub fn surface(&self) -> Vec<f64> {
        let known = self.known();
        let mut z: Vec<f64> = self.z.iter().map(|v| f64::from(*v)).collect();
        surface::fill(self.header.lattice, &mut z, |at| known[at]);
        z
    }
}
