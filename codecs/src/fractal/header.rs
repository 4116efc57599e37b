//! The head of a fractal tile (drawing: docs/fractal-format.md).

use super::ifs::Shape;
use super::matching::Search;
use crate::head::{self, Reader, Writer};
use crate::heights::Place;
use crate::{Error, Result};

/// First bytes of a file.
pub const MAGIC: [u8; 8] = *b"\x89IFS\r\n\x1a\n";
/// The version that is written.
pub const VERSION: u8 = 1;
/// Greatest bound of a tile, in units.
pub const BOUND_MAX: u32 = 1 << 20;
/// Most bytes of all texts in a head.
pub const TEXT_BYTES_MAX: usize = 15 << 10;

/// What samples are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Heights: integers of a unit.
    Heights,
    /// Brightness, 0 to 255.
    Grey,
    /// Red, green, blue, 0 to 255: three planes, Y, I and Q.
    Colour,
    /// Signed distances in space, -127 to 127.
    Volume,
}

/// Where the samples of a volume lie.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Space {
    /// Centre of the first voxel.
    pub origin: [f64; 3],
    /// Side of a voxel.
    pub voxel: f64,
}

impl Space {
    fn is_sound(&self) -> bool {
        self.origin.into_iter().all(f64::is_finite) && self.voxel.is_finite() && self.voxel > 0.0
    }
}

/// The shape of a plane or of the volume.
#[derive(Clone, Debug, PartialEq)]
pub enum Shapes {
    /// Planes: the heights, the picture, or Y, I, Q.
    Planes(Vec<Shape<2>>),
    /// The volume.
    Volume(Shape<3>),
}

/// The head of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct Header {
    /// What samples are.
    pub kind: Kind,
    /// Samples along each axis; 1 along the third of a plane.
    pub size: [usize; 3],
    /// Whether a mask of voids is coded.
    pub mask: bool,
    /// The bound E in units of what decodes at zoom 1; without it what was measured is what is known.
    pub bound: Option<u32>,
    /// How domains were searched; says nothing to a decoder.
    pub search: Search,
    /// Least and greatest sample with data, in units.
    pub range: [i32; 2],
    /// Greatest error of a sample as decoded, in units: of the whole file, measured by the encoder with the decoder.
    pub error_max: f64,
    /// Root mean square error of the samples as decoded.
    pub error_rms: f64,
    /// Maps in all.
    pub maps: u64,
    /// Where heights lie; of other kinds only the source counts.
    pub place: Place,
    /// Where a volume lies.
    pub space: Option<Space>,
    /// How leaves are told.
    pub shapes: Shapes,
    /// Bytes of the body without checksums.
    pub body: u64,
}

const MASK: u8 = 1;
const BOUND: u8 = 2;
const TURNED: u8 = 4;

fn code_of(search: Search) -> u8 {
    match search {
        Search::Exact => 0,
        Search::Classes => 1,
        Search::Near(_) => 2,
    }
}

impl Header {
    /// Samples.
    pub fn samples(&self) -> u64 {
        self.size.iter().map(|n| *n as u64).product()
    }

    /// What to begin with where nothing is known: half way between the least and the greatest sample.
    pub fn seed(&self) -> f64 {
        f64::from(self.range[0]) * 0.5 + f64::from(self.range[1]) * 0.5
    }

    /// How many times smaller a plane is than the tile: 1, 2 or 4.
    pub fn smaller<const D: usize>(&self, plane: &Shape<D>) -> usize {
        smaller(self.size, plane)
    }

    /// Bytes of the whole file, behind a head of `head` bytes.
    pub fn file_bytes(&self, head: usize) -> u64 {
        let sums = self.body.div_ceil(crate::blocks::BLOCK as u64).saturating_mul(4);
        (head as u64).saturating_add(self.body).saturating_add(sums)
    }

    /// The bytes of the head: magic, version, length, fields, CRC-32C.
    pub fn bytes(&self) -> Vec<u8> {
        let t = &self.place.transform;
        let turned = t[2] != 0.0 || t[4] != 0.0;
        let flag = |on: bool, f: u8| if on { f } else { 0 };
        let mut w = Writer::new(&MAGIC, VERSION);
        w.0.push(self.kind as u8);
        w.0.push(flag(self.mask, MASK) | flag(self.bound.is_some(), BOUND) | flag(turned, TURNED));
        self.size.iter().for_each(|n| w.varint(*n as u64));
        if let Some(e) = self.bound {
            w.varint(u64::from(e));
        }
        w.0.push(code_of(self.search));
        self.range.iter().for_each(|v| w.0.extend_from_slice(&v.to_le_bytes()));
        w.real(self.error_max);
        w.real(self.error_rms);
        w.varint(self.maps);
        if self.kind == Kind::Heights {
            let p = &self.place;
            [p.unit, p.base, p.given_error, t[0], t[1], t[3], t[5]].into_iter().for_each(|v| w.real(v));
            if turned {
                w.real(t[2]);
                w.real(t[4]);
            }
            w.text(&p.crs);
            w.text(&p.vertical);
        }
        w.text(&self.place.source);
        if let Some(s) = self.space {
            s.origin.into_iter().chain([s.voxel]).for_each(|v| w.real(v));
        }
        match &self.shapes {
            Shapes::Planes(planes) => planes.iter().for_each(|s| shape_out(s, self.size, &mut w)),
            Shapes::Volume(s) => shape_out(s, self.size, &mut w),
        }
        w.varint(self.body);
        w.sealed()
    }

    /// Reads the head of a file or of a prefix of one. Returns it and its length.
    pub fn read(bytes: &[u8]) -> Result<(Header, usize)> {
        let (fields, len) = head::opened(bytes, &MAGIC, VERSION, "fractal tile")?;
        Header::fields(fields).map(|h| (h, len))
    }

    fn fields(bytes: &[u8]) -> Result<Header> {
        let mut r = Reader { bytes, at: head::FIXED };
        let kind = match r.byte()? {
            0 => Kind::Heights,
            1 => Kind::Grey,
            2 => Kind::Colour,
            3 => Kind::Volume,
            k => {
                return Err(Error::damaged(
                    "head",
                    format!("samples of kind {k}; 0 to 3 are known, take a newer program"),
                ));
            }
        };
        let flags = r.byte()?;
        if flags >= 8 {
            return Err(Error::damaged(
                "head",
                format!("flags {flags:#x} are unknown; take a newer program"),
            ));
        }
        let mut size = [0; 3];
        for n in &mut size {
            let v = r.varint()?;
            *n = usize::try_from(v).unwrap_or(usize::MAX);
        }
        if kind != Kind::Volume && size[2] != 1 {
            return Err(Error::damaged("head", format!("a plane of {} layers; 1 is needed", size[2])));
        }
        let bound = if flags & BOUND != 0 { Some(r.varint()?) } else { None };
        if let Some(e) = bound.filter(|e| *e > u64::from(BOUND_MAX)) {
            return Err(Error::Limit { what: "bound", limit: u64::from(BOUND_MAX), wanted: e });
        }
        let mut search = match r.byte()? {
            0 => Search::Exact,
            1 => Search::Classes,
            2 => Search::Near(0),
            k => return Err(Error::damaged("head", format!("search {k}; 0 to 2 are known"))),
        };
        let mut range = [0; 2];
        for v in &mut range {
            *v = i32::from_le_bytes([r.byte()?, r.byte()?, r.byte()?, r.byte()?]);
        }
        let (error_max, error_rms) = (r.real()?, r.real()?);
        if range[0] > range[1]
            || !(error_max >= 0.0 && error_max.is_finite() && error_rms >= 0.0 && error_rms.is_finite())
        {
            return Err(Error::damaged(
                "head",
                format!(
                    "samples from {} to {} with errors of {error_max} and {error_rms}",
                    range[0], range[1]
                ),
            ));
        }
        let maps = r.varint()?;
        let mut place = Place::default();
        if kind == Kind::Heights {
            let mut reals = [0.0; 7];
            for v in &mut reals {
                *v = r.real()?;
            }
            let turn = if flags & TURNED != 0 { [r.real()?, r.real()?] } else { [0.0; 2] };
            let [unit, base, given_error, x0, dx, y0, dy] = reals;
            place = Place { unit, base, given_error, transform: [x0, dx, turn[0], y0, turn[1], dy], ..place };
            if !sound(&place) {
                return Err(Error::damaged(
                    "head",
                    format!("unit {unit}, base {base}, error {given_error} or place make no sense"),
                ));
            }
            place.crs = r.text()?;
            place.vertical = r.text()?;
        }
        place.source = r.text()?;
        let space = if kind == Kind::Volume {
            let s = Space { origin: [r.real()?, r.real()?, r.real()?], voxel: r.real()? };
            if !s.is_sound() {
                return Err(Error::damaged(
                    "head",
                    format!("a volume at {:?} with voxels of {}", s.origin, s.voxel),
                ));
            }
            Some(s)
        } else {
            None
        };
        let shapes = match kind {
            Kind::Volume => Shapes::Volume(shape_in(size, 1, &mut r)?),
            Kind::Colour => {
                let plane = [size[0], size[1]];
                Shapes::Planes(
                    [1, 4, 4].map(|most| shape_in(plane, most, &mut r)).into_iter().collect::<Result<_>>()?,
                )
            }
            _ => Shapes::Planes(vec![shape_in([size[0], size[1]], 1, &mut r)?]),
        };
        if let Search::Near(width) = &mut search {
            *width = match &shapes {
                Shapes::Planes(planes) => planes[0].near,
                Shapes::Volume(s) => s.near,
            };
        }
        let body = r.varint()?;
        if r.at != bytes.len() {
            return Err(Error::damaged(
                "head",
                format!("its fields end at byte {}, it at {}", r.at, bytes.len()),
            ));
        }
        let bound = bound.map(|e| e as u32);
        let mask = flags & MASK != 0;
        if kind != Kind::Heights && (mask || bound.is_some()) {
            return Err(Error::damaged("head", "voids or a bound for samples that are no heights"));
        }
        Ok(Header {
            kind,
            size,
            mask,
            bound,
            search,
            range,
            error_max,
            error_rms,
            maps,
            place,
            space,
            shapes,
            body,
        })
    }

    /// Refuses what a reader would.
    pub(super) fn check(&self) -> Result<()> {
        let p = &self.place;
        if !sound(p) {
            return Err(Error::invalid(
                "place",
                format!(
                    "unit {}, base {}, error {}, transform {:?}; finite numbers, a unit above 0 and no error below 0 are needed",
                    p.unit, p.base, p.given_error, p.transform
                ),
            ));
        }
        if let Some(s) = self.space.filter(|s| !s.is_sound()) {
            return Err(Error::invalid(
                "place",
                format!(
                    "a volume at {:?} with voxels of {}; finite numbers and a side above 0 are needed",
                    s.origin, s.voxel
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
        match &self.shapes {
            Shapes::Planes(planes) => planes.iter().try_for_each(Shape::check),
            Shapes::Volume(s) => s.check(),
        }
    }
}

fn sound(p: &Place) -> bool {
    let reals = [p.unit, p.base, p.given_error].into_iter().chain(p.transform);
    reals.into_iter().all(f64::is_finite) && p.unit > 0.0 && p.given_error >= 0.0
}

/// The least of 1, 2 and 4 that takes the tile's size to the plane's.
fn smaller<const D: usize>(size: [usize; 3], plane: &Shape<D>) -> usize {
    let fits = |by: &usize| (0..D).all(|a| size[a].div_ceil(*by) == plane.size[a]);
    [1, 2].into_iter().find(fits).unwrap_or(4)
}

/// A shape; its size as how often it is smaller than the tile.
fn shape_out<const D: usize>(s: &Shape<D>, size: [usize; 3], w: &mut Writer) {
    w.0.push(smaller(size, s) as u8);
    w.0.extend_from_slice(&[s.range_max_log as u8, s.range_min_log as u8]);
    w.varint(s.jump as u64);
    w.0.extend_from_slice(&[s.isometries as u8, s.near as u8, s.scale_bits as u8]);
    w.real(s.step);
    w.real(s.origin);
}

/// A shape that is at most so many times smaller than the tile.
fn shape_in<const D: usize>(size: [usize; D], smaller_max: usize, r: &mut Reader) -> Result<Shape<D>> {
    let by = usize::from(r.byte()?);
    if ![1, 2, 4].contains(&by) || by > smaller_max {
        return Err(Error::damaged(
            "head",
            format!(
                "a plane that is {by} times smaller than the tile; I and Q are 1, 2 or 4 times, others 1"
            ),
        ));
    }
    let (max, min) = (u32::from(r.byte()?), u32::from(r.byte()?));
    let jump = usize::try_from(r.varint()?).unwrap_or(usize::MAX);
    let (isometries, near) = (usize::from(r.byte()?), usize::from(r.byte()?));
    let scale_bits = u32::from(r.byte()?);
    let (step, origin) = (r.real()?, r.real()?);
    let size = size.map(|n| n.div_ceil(by));
    let shape = Shape {
        size,
        range_max_log: max,
        range_min_log: min,
        jump,
        isometries,
        near,
        scale_bits,
        step,
        origin,
    };
    shape.check().map(|()| shape)
}
