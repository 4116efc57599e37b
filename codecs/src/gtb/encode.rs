//! Heights (and a texture) become a stream.

use super::companion::Companion;
use super::field::{Field, Given, spread};
use super::header::{Header, check_layers};
use super::{bounds, dense, mask, sparse};
use crate::blocks::blocks;
use crate::heights::{Heights, Place};
use crate::lattice::{Lattice, N_MAX, Pass};
use crate::range::Encoder;
use crate::{Error, Result};

/// How heights are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Profile {
    /// G1, the scheme as published: a part of the posts, the others by midpoints (specification, section 4).
    Sparse,
    /// G2, every post, predicted by a cubic: integers alone (section 5).
    Cubic,
    /// G2, every post, predicted by least squares that follow the ground (section 5).
    Adaptive,
}

impl Profile {
    pub(super) fn code(self) -> u8 {
        match self {
            Profile::Sparse => 1,
            Profile::Cubic => 2,
            Profile::Adaptive => 3,
        }
    }

    pub(super) fn of_code(code: u8) -> Result<Profile> {
        match code {
            1 => Ok(Profile::Sparse),
            2 => Ok(Profile::Cubic),
            3 => Ok(Profile::Adaptive),
            _ => Err(Error::damaged(
                "head",
                format!("profile {code} is unknown, 1 to 3 are known; take a newer program"),
            )),
        }
    }
}

/// What the caller wants.
pub struct Options<'a> {
    /// How heights are coded.
    pub profile: Profile,
    /// Bounds of the layers in units, coarse to fine; of [`Profile::Sparse`] the step of heights alone.
    pub layers: Vec<u32>,
    /// Where the heights lie.
    pub place: Place,
    /// Heights that the receiver has.
    pub given: Option<&'a Given>,
    /// n of the cells of the texture that travels along.
    pub texture: Option<u32>,
    /// [`Profile::Sparse`]: which posts of the lattice are sent, as a [`Rule`](super::select::Rule) marks them; `None`: all. Posts
    /// without data, and such whose height is the midpoint of their hypotenuse already, are not sent in either case.
    pub selected: Option<&'a [bool]>,
}

impl Options<'_> {
    /// One layer of this bound, nothing else.
    pub fn new(profile: Profile, bound: u32) -> Options<'static> {
        Options {
            profile,
            layers: vec![bound],
            place: Place::default(),
            given: None,
            texture: None,
            selected: None,
        }
    }
}

/// Where a pass ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassEnd {
    /// Of which layer.
    pub layer: usize,
    /// The pass.
    pub pass: Pass,
    /// Bytes of the file after which it is whole.
    pub bytes: u64,
    /// The bound of the error, in units, from there on until the next end.
    pub bound: u32,
}

/// A stream and what is known of it.
pub struct Encoded {
    /// The file.
    pub bytes: Vec<u8>,
    /// Greatest error of the whole file, in units.
    pub error_max: u32,
    /// Where passes end.
    pub passes: Vec<PassEnd>,
    /// Heights as a receiver of the whole has them, `side * side`.
    pub z: Vec<i32>,
}

/// Encodes heights, with a companion that takes its turns ([`Alone`](super::companion::Alone): none). `going` is told the part
/// that is done and may stop the work.
///
/// Memory: 8 bytes a post of the lattice and what the profile needs; time: see docs/measured.md.
pub fn encode<T: Companion<Encoder>>(
    heights: &Heights,
    options: &Options,
    companion: &mut T,
    going: &mut dyn FnMut(f64) -> bool,
) -> Result<Encoded> {
    heights.check()?;
    check_layers(options.profile, &options.layers)?;
    let longest = heights.cols.max(heights.rows) as u64;
    let lattice = Lattice::around(heights.cols, heights.rows).ok_or(Error::Limit {
        what: "posts along a side",
        limit: (1 << N_MAX) + 1,
        wanted: longest,
    })?;
    let mut header = Header {
        cols: heights.cols,
        rows: heights.rows,
        lattice,
        profile: options.profile,
        layers: options.layers.clone(),
        mask: heights.void.contains(&true),
        texture: options.texture,
        given: options.given.map(Given::state),
        place: options.place.clone(),
        bounds: Vec::new(),
        body: 0,
    };
    header.check()?;
    header.accompanied(companion.texture())?;
    let z = spread(heights, lattice);
    let mut field = Field::new(&header, options.given)?;
    let mut c = Encoder::new();
    if header.mask {
        mask::code(&header, &mut field, Some(&heights.void), &mut c);
    }
    companion.start(lattice, &mut c);
    let mut ends = Vec::new();
    let mut mark = |layer: usize, number: u32, c: &Encoder| {
        ends.push((layer, number, c.position()));
        let done = 0.25_f64.powi(((2 * lattice.n() - number) / 2) as i32);
        match going((layer as f64 + done) / options.layers.len() as f64) {
            true => Ok(true),
            false => Err(Error::Stopped),
        }
    };
    let mut errors = Vec::new();
    match options.profile {
        Profile::Sparse => {
            field.selected = options.selected.map_or_else(|| vec![true; z.len()], <[bool]>::to_vec);
            if field.selected.len() != z.len() {
                return Err(Error::invalid(
                    "selected posts",
                    format!("{} marks for {} posts of the lattice", field.selected.len(), z.len()),
                ));
            }
            sparse::code(&header, Some(&z), &mut field, &mut c, companion, &mut mark)?;
            errors = bounds::measure(&header, &z, &field);
        }
        Profile::Cubic | Profile::Adaptive => {
            let mut whole = |layer: usize, field: &Field| match layer {
                0 => errors = bounds::measure(&header, &z, field),
                _ => errors.push(bounds::greatest(&header, &z, field)),
            };
            dense::code(&header, Some(&z), &mut field, &mut c, companion, &mut mark, &mut whole)?;
        }
    }
    header.bounds = errors;
    let error_max = header.bounds.last().copied().unwrap_or(0);
    let body = c.finish();
    header.body = body.len() as u64;
    let mut bytes = header.bytes();
    let head = bytes.len();
    bytes.extend_from_slice(&blocks(&body));
    let passes = ends
        .into_iter()
        .map(|(layer, number, at)| PassEnd {
            layer,
            pass: lattice.pass(number),
            bytes: header.file_position(head, at).min(bytes.len() as u64),
            bound: header.bound(layer, number + 1),
        })
        .collect();
    Ok(Encoded { bytes, error_max, passes, z: field.z })
}
