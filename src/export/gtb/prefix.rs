//! What a prefix of a stream gives: a surface with a place, its error, and the picture as far as it came.

use super::told;
use crate::base::Result;
use crate::export::grid::{Grid, place_of};
use serde::Serialize;
use terraquilt_codecs::gtb::companion::Companion;
use terraquilt_codecs::gtb::texture::{Cells, Reader};
use terraquilt_codecs::gtb::{Decoded, Given, Header, PassEnd, Stop, companion::Alone, decode};
use terraquilt_codecs::lattice::{Lattice, Pass, Post};
use terraquilt_codecs::range::{Coder, Decoder};

/// How far to read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// As far as the bytes go.
    End,
    /// So many bytes of the file.
    Bytes(u64),
    /// Until heights are wrong by at most this, in their own unit.
    Error(f64),
}

/// A surface that a prefix gives.
pub struct Prefix {
    /// The head of the file.
    pub header: Header,
    /// Where it lies; its heights are those of the surface, NaN at voids, in their own unit.
    pub grid: Grid,
    /// The surface at every post of the lattice, voids and what lies outside of the grid included.
    pub surface: Vec<f64>,
    /// Posts of the lattice without data.
    pub free: Vec<bool>,
    /// What it is worth.
    pub reached: Reached,
    /// The picture, painted.
    pub picture: Option<Cells>,
    /// Ends of the passes that came whole.
    pub passes: Vec<PassEnd>,
    /// Bytes of the body that carried texture.
    pub texture_bytes: u64,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// How far a prefix reaches.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Reached {
    /// Bytes of the file that were looked at.
    pub bytes_used: u64,
    /// No height is farther from the truth, in the unit of heights.
    pub error_bound: f64,
    /// Whether nothing is missing.
    pub complete: bool,
    /// Every post of the lattice this many posts apart is known.
    pub spacing: u64,
    /// Layers that are whole, and how many there are.
    pub layers: [usize; 2],
    /// The block whose checksum is wrong, by its first byte in the body.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damaged_at: Option<u64>,
}

/// Reads a prefix. `given`: heights that a stream refines; `seed`: of what is made up where no texture came; `going` is told
/// the share that is done.
///
/// # Errors
/// Where not even the corners are there, or the head is damaged.
pub fn read_prefix(
    file: &str,
    bytes: &[u8],
    until: Until,
    given: Option<&Given>,
    seed: u64,
    going: &mut dyn FnMut(f64) -> bool,
) -> Result<Prefix> {
    let (header, _) = Header::read(bytes).map_err(|e| told(file, e))?;
    let stop = match until {
        Until::End => Stop::End,
        Until::Bytes(n) => Stop::Bytes(n),
        Until::Error(e) => Stop::Error(((e - header.place.given_error) / header.place.unit) * (1.0 + 1e-12)),
    };
    let mut body = Vec::new();
    let (decoded, picture, texture_bytes) = match header.texture {
        None => {
            let decoded =
                decode(bytes, &mut body, stop, given, &mut Alone, going).map_err(|e| told(file, e))?;
            (decoded, None, 0)
        }
        Some(n) => {
            let mut reader = Weighed { inner: Reader::new(n), bytes: 0 };
            let decoded =
                decode(bytes, &mut body, stop, given, &mut reader, going).map_err(|e| told(file, e))?;
            (decoded, Some(reader.inner.picture(seed)), reader.bytes)
        }
    };
    Ok(Prefix::of(decoded, picture, texture_bytes))
}

impl Prefix {
    fn of(mut decoded: Decoded, picture: Option<Cells>, texture_bytes: u64) -> Prefix {
        let header = decoded.header.clone();
        let (lattice, place) = (header.lattice, &header.place);
        let side = lattice.side();
        let mut surface = decoded.surface();
        surface.iter_mut().for_each(|z| *z = place.base + place.unit * *z);
        let free: Vec<bool> = (0..surface.len()).map(|at| decoded.is_free(at)).collect();
        let mut z = Vec::with_capacity(header.cols * header.rows);
        for row in 0..header.rows {
            let at = row * side..row * side + header.cols;
            z.extend(
                surface[at.clone()].iter().zip(&free[at]).map(|(z, free)| if *free { f64::NAN } else { *z }),
            );
        }
        let mut notes = Vec::new();
        let grid = Grid { cols: header.cols, rows: header.rows, z, ..place_of(place, &mut notes) };
        let whole = decoded.reached.layer;
        let passes = if whole > 0 { 2 * lattice.n() } else { decoded.reached.passes };
        let reached = Reached {
            bytes_used: decoded.bytes_used,
            error_bound: f64::from(decoded.bound) * place.unit + place.given_error,
            complete: decoded.complete,
            spacing: lattice.last() as u64 >> (passes / 2),
            layers: [whole, header.layers.len()],
            damaged_at: decoded.damaged,
        };
        let passes = std::mem::take(&mut decoded.passes);
        Prefix { header, grid, surface, free, reached, picture, passes, texture_bytes, notes }
    }

    /// Whether every height is a whole number because the unit is 1 and each was sent.
    pub fn is_whole(&self) -> bool {
        let p = &self.header.place;
        p.unit == 1.0 && p.base.fract() == 0.0 && self.grid.z.iter().all(|z| z.is_nan() || z.fract() == 0.0)
    }
}

/// A companion, and how many bytes it took.
struct Weighed<T> {
    inner: T,
    bytes: u64,
}

impl<T> Weighed<T> {
    fn weigh<'a>(&mut self, c: &mut Decoder<'a>, work: impl FnOnce(&mut T, &mut Decoder<'a>)) {
        let before = c.position();
        work(&mut self.inner, c);
        self.bytes += (c.position() - before) as u64;
    }
}

impl<'a, T: Companion<Decoder<'a>>> Companion<Decoder<'a>> for Weighed<T>
where
    Decoder<'a>: Coder,
{
    const ACTIVE: bool = T::ACTIVE;

    fn texture(&self) -> Option<u32> {
        self.inner.texture()
    }

    fn start(&mut self, lattice: Lattice, c: &mut Decoder<'a>) {
        self.weigh(c, |t, c| t.start(lattice, c));
    }

    fn after_post(&mut self, pass: Pass, post: Post, c: &mut Decoder<'a>) {
        self.weigh(c, |t, c| t.after_post(pass, post, c));
    }

    fn after_pass(&mut self, pass: Pass, c: &mut Decoder<'a>) {
        self.weigh(c, |t, c| t.after_pass(pass, c));
    }

    fn finish(&mut self, c: &mut Decoder<'a>) {
        self.weigh(c, |t, c| t.finish(c));
    }
}
