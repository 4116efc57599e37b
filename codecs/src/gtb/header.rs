//! The head of a file, and the blocks that carry the body (drawing: docs/gtb-format.md).

use super::encode::Profile;
use crate::blocks;
use crate::head::{self, Reader, Writer};
use crate::heights::Place;
use crate::lattice::{Lattice, N_MAX};
use crate::{Error, Result};

/// First bytes of a file. The high bit, the line ends and the stop character show transfers that change bytes.
pub const MAGIC: [u8; 8] = *b"\x89GTB\r\n\x1a\n";
/// The version that is written.
pub const VERSION: u8 = 1;
/// Most bytes of all texts in a head: what is left beside the numbers.
pub const TEXT_BYTES_MAX: usize = 15 << 10;
/// Layers at most.
pub const LAYERS_MAX: usize = 8;
/// Greatest bound of a layer, in units.
pub const BOUND_MAX: u32 = 1 << 20;

/// The head of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// Posts in a row, and rows: the north-west part of the lattice.
    pub cols: usize,
    /// Rows.
    pub rows: usize,
    /// The lattice is 2^n + 1 posts a side.
    pub lattice: Lattice,
    /// How heights are coded.
    pub profile: Profile,
    /// Bounds E of the layers in units, coarse to fine; of [`Profile::Sparse`] the step of heights alone.
    pub layers: Vec<u32>,
    /// Whether a mask of voids is coded.
    pub mask: bool,
    /// Whether a texture travels along: n of its cells, 2^n a side over the lattice's square.
    pub texture: Option<u32>,
    /// Whether the posts of some area are known to the receiver already and are left out: a number that names that state.
    pub given: Option<u64>,
    /// Where the heights lie.
    pub place: Place,
    /// The greatest error in units of any prefix that ends in pass k of the first layer, k from 0 to 2n - 1; then of each whole layer.
    pub bounds: Vec<u32>,
    /// Bytes of the body without checksums.
    pub body: u64,
}

const MASK: u8 = 1;
const TEXTURE: u8 = 2;
const GIVEN: u8 = 4;
const TURNED: u8 = 8;

impl Header {
    /// The bytes of the head: magic, version, length, fields, CRC-32C.
    pub fn bytes(&self) -> Vec<u8> {
        let t = &self.place.transform;
        let turned = t[2] != 0.0 || t[4] != 0.0;
        let flag = |on: bool, f: u8| if on { f } else { 0 };
        let mut w = Writer::new(&MAGIC, VERSION);
        w.0.push(self.profile.code());
        w.0.push(
            flag(self.mask, MASK)
                | flag(self.texture.is_some(), TEXTURE)
                | flag(self.given.is_some(), GIVEN)
                | flag(turned, TURNED),
        );
        w.0.push(self.lattice.n() as u8);
        w.varint(self.cols as u64);
        w.varint(self.rows as u64);
        w.0.push(self.layers.len() as u8);
        self.layers.iter().for_each(|e| w.varint(u64::from(*e)));
        if let Some(n) = self.texture {
            w.0.push(n as u8);
        }
        if let Some(state) = self.given {
            w.0.extend_from_slice(&state.to_le_bytes());
        }
        let p = &self.place;
        [p.unit, p.base, p.given_error, t[0], t[1], t[3], t[5]].into_iter().for_each(|v| w.real(v));
        if turned {
            w.real(t[2]);
            w.real(t[4]);
        }
        [&p.crs, &p.vertical, &p.source].into_iter().for_each(|t| w.text(t));
        self.bounds.iter().for_each(|b| w.varint(u64::from(*b)));
        w.varint(self.body);
        w.sealed()
    }

    /// Reads the head of a file or of a prefix of one. Returns it and its length.
    pub fn read(bytes: &[u8]) -> Result<(Header, usize)> {
        let (fields, len) = head::opened(bytes, &MAGIC, VERSION, "GTB")?;
        Header::fields(fields).map(|h| (h, len))
    }

    fn fields(bytes: &[u8]) -> Result<Header> {
        let mut r = Reader { bytes, at: head::FIXED };
        let profile = Profile::of_code(r.byte()?)?;
        let flags = r.byte()?;
        if flags >= 16 {
            return Err(Error::damaged(
                "head",
                format!("flags {flags:#x} are unknown; take a newer program"),
            ));
        }
        let n = u32::from(r.byte()?);
        let lattice = Lattice::new(n).ok_or(Error::Limit {
            what: "n of the lattice",
            limit: u64::from(N_MAX),
            wanted: u64::from(n),
        })?;
        let side = lattice.side() as u64;
        let (cols, rows) = (r.varint()?, r.varint()?);
        if cols == 0 || rows == 0 || cols > side || rows > side {
            return Err(Error::damaged(
                "head",
                format!("{cols} x {rows} posts in a lattice of {side} a side"),
            ));
        }
        let count = usize::from(r.byte()?);
        if count == 0 || count > LAYERS_MAX {
            return Err(Error::Limit { what: "layers", limit: LAYERS_MAX as u64, wanted: count as u64 });
        }
        let layers = (0..count)
            .map(|_| match r.varint()? {
                e if e <= u64::from(BOUND_MAX) => Ok(e as u32),
                e => Err(Error::Limit { what: "bound of a layer", limit: u64::from(BOUND_MAX), wanted: e }),
            })
            .collect::<Result<Vec<u32>>>()?;
        check_layers(profile, &layers)?;
        let texture = (flags & TEXTURE != 0).then(|| r.byte().map(u32::from)).transpose()?;
        if texture == Some(0) {
            return Err(Error::damaged("head", "a texture of one cell; 2^m a side with m from 1 are known"));
        }
        if let Some(n) = texture.filter(|n| *n > N_MAX) {
            return Err(Error::Limit {
                what: "n of the texture",
                limit: u64::from(N_MAX),
                wanted: u64::from(n),
            });
        }
        let given = if flags & GIVEN != 0 {
            let mut eight = [0; 8];
            for b in &mut eight {
                *b = r.byte()?;
            }
            Some(u64::from_le_bytes(eight))
        } else {
            None
        };
        let mut reals = [0.0; 7];
        for v in &mut reals {
            *v = r.real()?;
        }
        let turn = if flags & TURNED != 0 { [r.real()?, r.real()?] } else { [0.0; 2] };
        let [unit, base, given_error, x0, dx, y0, dy] = reals;
        if reals.iter().chain(&turn).any(|v| !v.is_finite()) || unit <= 0.0 || given_error < 0.0 {
            return Err(Error::damaged(
                "head",
                format!("unit {unit}, base {base}, error {given_error} or place make no sense"),
            ));
        }
        let place = Place {
            unit,
            base,
            given_error,
            transform: [x0, dx, turn[0], y0, turn[1], dy],
            crs: r.text()?,
            vertical: r.text()?,
            source: r.text()?,
        };
        let bounds = (0..2 * n + count as u32)
            .map(|_| {
                let b = r.varint()?;
                u32::try_from(b).map_err(|_| Error::damaged("head", format!("an error of {b} units")))
            })
            .collect::<Result<Vec<u32>>>()?;
        let body = r.varint()?;
        if r.at != bytes.len() {
            return Err(Error::damaged(
                "head",
                format!("its fields end at byte {}, it at {}", r.at, bytes.len()),
            ));
        }
        let mask = flags & MASK != 0;
        let (cols, rows) = (cols as usize, rows as usize);
        Ok(Header { cols, rows, lattice, profile, layers, mask, texture, given, place, bounds, body })
    }

    /// Refuses what a reader would: places that are no numbers, units of nothing, a texture of one cell, texts that no head can hold.
    pub(super) fn check(&self) -> Result<()> {
        let p = &self.place;
        let reals = [p.unit, p.base, p.given_error].into_iter().chain(p.transform);
        if reals.into_iter().any(|v| !v.is_finite()) || p.unit <= 0.0 || p.given_error < 0.0 {
            return Err(Error::invalid(
                "place",
                format!(
                    "unit {}, base {}, error {}, transform {:?}; finite numbers, a unit above 0 and no error below 0 are needed",
                    p.unit, p.base, p.given_error, p.transform
                ),
            ));
        }
        let texts = p.crs.len() + p.vertical.len() + p.source.len();
        if texts > TEXT_BYTES_MAX {
            return Err(Error::Limit {
                what: "bytes of texts (CRS, vertical, source) in the head",
                limit: TEXT_BYTES_MAX as u64,
                wanted: texts as u64,
            });
        }
        match self.texture {
            Some(n) if !(1..=N_MAX).contains(&n) => {
                Err(Error::invalid("texture", format!("2^{n} cells a side; n is 1 to {N_MAX}")))
            }
            _ => Ok(()),
        }
    }

    /// Refuses a companion whose texture (n of its cells) is not the head's: what it does not take would be read as heights.
    pub(super) fn accompanied(&self, texture: Option<u32>) -> Result<()> {
        if self.texture == texture {
            return Ok(());
        }
        let tell = |n: Option<u32>| n.map_or("none".to_string(), |n| format!("2^{n} cells a side"));
        Err(Error::invalid(
            "texture",
            format!(
                "the head says {}, the companion takes {}; take the companion that the head asks for",
                tell(self.texture),
                tell(texture)
            ),
        ))
    }

    /// The greatest error in units of a prefix that holds so many passes of a layer, wholly or with a part of the next.
    pub fn bound(&self, layer: usize, passes: u32) -> u32 {
        let all = 2 * self.lattice.n();
        let at = match layer {
            0 => passes.min(all) as usize,
            _ => all as usize + layer - usize::from(passes < all.max(1)),
        };
        self.bounds.get(at).or(self.bounds.last()).copied().unwrap_or(u32::MAX)
    }

    /// The byte of the file at which a byte of the body lies, behind a head of `head` bytes.
    pub fn file_position(&self, head: usize, at: usize) -> u64 {
        blocks::file_position(head, at)
    }
}

/// Refuses layers that cannot refine each other: 2E + 1 of each must be an odd multiple, of at least three, of the next.
pub(super) fn check_layers(profile: Profile, layers: &[u32]) -> Result<()> {
    if layers.is_empty() || layers.len() > LAYERS_MAX || layers.iter().any(|e| *e > BOUND_MAX) {
        return Err(Error::invalid(
            "layers",
            format!("{layers:?}; 1 to {LAYERS_MAX} bounds up to {BOUND_MAX}"),
        ));
    }
    if matches!(profile, Profile::Sparse) && layers.len() > 1 {
        return Err(Error::invalid("layers", "the sparse stream has one; name one bound"));
    }
    if matches!(profile, Profile::Sparse) && layers[0] == 0 {
        return Err(Error::invalid("layers", "a step of 0 for the sparse stream; 1 sends heights exactly"));
    }
    for pair in layers.windows(2) {
        let (coarse, fine) = (2 * pair[0] + 1, 2 * pair[1] + 1);
        if pair[1] >= pair[0] || coarse % fine != 0 || coarse / fine > 255 {
            return Err(Error::invalid(
                "layers",
                format!(
                    "{} after {}: 2E + 1 must divide ({fine} into {coarse}), as in 13,4,1,0 or 40,13,4,1,0",
                    pair[1], pair[0]
                ),
            ));
        }
    }
    Ok(())
}
