//! The lattice while it is coded: what each post is, and its height as a receiver has it.

use super::header::Header;
use crate::heights::Heights;
use crate::lattice::Lattice;
use crate::{Error, Result};

/// Of so many passes of the first layer, 65 x 65 posts, a prefix shows whole ones alone: a part of a pass of few posts may be worse than
/// none of it. In them the bound of a prefix is that of the passes before.
pub const SHOWN_WHOLE: u32 = 12;

/// What a post is to the coder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Status {
    /// Its height is coded.
    Coded,
    /// Outside the grid, or a void: it takes its prediction.
    Free,
    /// The receiver has it already.
    Given,
}

/// Heights that a receiver holds already, at the posts of the lattice that it is about to receive.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Given {
    /// `side * side` heights as decoded; 0 where none is known.
    pub z: Vec<i32>,
    /// Which are known.
    pub known: Vec<bool>,
}

impl Given {
    /// A number that names this state: a stream that refines it carries the number.
    pub fn state(&self) -> u64 {
        let mut low = crc32c::crc32c(&[]);
        let mut high = !0;
        for (k, z) in self.known.iter().zip(&self.z) {
            let five = [
                u8::from(*k),
                z.to_le_bytes()[0],
                z.to_le_bytes()[1],
                z.to_le_bytes()[2],
                z.to_le_bytes()[3],
            ];
            let five = if *k { five } else { [0; 5] };
            low = crc32c::crc32c_append(low, &five);
            high = crc32c::crc32c_append(high, &[five[1] ^ 0x5a, five[0], five[4], five[3], five[2]]);
        }
        u64::from(high) << 32 | u64::from(low)
    }
}

/// The lattice of one stream.
pub struct Field {
    /// Its shape.
    pub lattice: Lattice,
    /// `side * side` heights as the receiver has them.
    pub z: Vec<i32>,
    /// What each post is; empty if all are coded.
    pub status: Vec<Status>,
    /// Which posts are known: for streams that leave posts out; empty if all before the place that was reached are.
    pub selected: Vec<bool>,
}

impl Field {
    /// Nothing known but what lies outside and what is given.
    pub fn new(header: &Header, given: Option<&Given>) -> Result<Field> {
        let (lattice, side) = (header.lattice, header.lattice.side());
        let mut status = Vec::new();
        let mut z = vec![0; side * side];
        if header.cols < side || header.rows < side || header.mask || header.given.is_some() {
            status = vec![Status::Free; side * side];
            for row in status.chunks_exact_mut(side).take(header.rows) {
                row[..header.cols].fill(Status::Coded);
            }
        }
        match (header.given, given) {
            (None, _) => {}
            (Some(state), Some(g))
                if g.known.len() == side * side && g.z.len() == side * side && g.state() == state =>
            {
                for (at, known) in g.known.iter().enumerate() {
                    if *known {
                        z[at] = g.z[at];
                        status[at] = Status::Given;
                    }
                }
            }
            (Some(state), g) => {
                let have = g.map_or("none".to_string(), |g| format!("{:016x}", g.state()));
                return Err(Error::invalid(
                    "given heights",
                    format!(
                        "the stream refines state {state:016x}, {have} was given; give the heights that it was asked for with"
                    ),
                ));
            }
        }
        Ok(Field { lattice, z, status, selected: Vec::new() })
    }

    /// What a post is.
    pub fn status(&self, at: usize) -> Status {
        self.status.get(at).copied().unwrap_or(Status::Coded)
    }
}

/// The heights of a grid on its lattice. Outside, the last column and row go on; voids take what lies to the west of them, or
/// north: the values of both only help corners.
pub(super) fn spread(h: &Heights, lattice: Lattice) -> Vec<i32> {
    let side = lattice.side();
    let mut out = Vec::with_capacity(side * side);
    let first = (0..h.z.len()).find(|k| !h.is_void(*k)).map_or(0, |k| h.z[k]);
    for y in 0..h.rows {
        let row = &h.z[y * h.cols..][..h.cols];
        if h.void.is_empty() {
            out.extend_from_slice(row);
        } else {
            let mut last = if y > 0 { out[(y - 1) * side] } else { first };
            for (x, z) in row.iter().enumerate() {
                if !h.void[y * h.cols + x] {
                    last = *z;
                }
                out.push(last);
            }
        }
        let last = out[out.len() - 1];
        out.resize((y + 1) * side, last);
    }
    for y in h.rows..side {
        out.extend_from_within((y - 1) * side..y * side);
    }
    out
}
