//! The head of a survey: its declaration, its tiles and where its pages are. A function of one survey.

use crate::base::bytes::{Put, Reader};
use crate::base::lattice::Point;
use crate::base::{Error, Result};
use crate::height::frame::{CellRect, Frame, Lattice};
use crate::height::lod::{Geometry, LEVEL_MAX};
use crate::height::source::{Affine, SampleType};
use crate::store::segment::PageRef;
use crate::store::table::{PageList, put_list, read_list};

/// The identity of a survey: never changes, and is not derived from the tiles present.
#[derive(Clone, Debug, PartialEq)]
pub struct Declaration {
    pub name: String,
    /// `EPSG:n`.
    pub crs: String,
    pub lattice: Lattice,
    pub frame: Frame,
    pub sample_type: SampleType,
    /// height in metres = sample * scale + offset.
    pub scale: f64,
    pub offset: f64,
    /// Stated accuracy, metres.
    pub accuracy_m: f64,
    /// What heights count from (`EPSG:5703`, `ellipsoid`, a name); `None`: nobody said.
    pub vertical_datum: Option<String>,
    /// How the files were delivered, if in another system: the survey's own posts are resampled from theirs.
    pub resampled: Option<Resampled>,
}

/// Samples that were delivered in another system than the database's (section 13 of the LOD-space specification).
#[derive(Clone, Debug, PartialEq)]
pub struct Resampled {
    /// System of the files.
    pub crs: String,
    /// Lattice of the files; tiles are rectangles of it.
    pub lattice: Lattice,
    pub samples: Delivered,
    /// Longitudes, of the files or of the database, are taken within half a turn of this one, a multiple of 90.
    pub turn: f64,
    /// What the user chose about the datums, as `DatumChoice` prints it.
    pub datum: String,
    /// What was done, in words.
    pub operation: String,
}

/// Samples as they stand in the files: height in metres = sample * scale + offset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delivered {
    pub sample_type: SampleType,
    pub scale: f64,
    pub offset: f64,
}

/// Identity of a declaration: the first 16 bytes of a BLAKE3 hash of its bytes.
pub type DeclarationId = [u8; 16];

impl Declaration {
    /// `words`: with what was done in words, which is no part of the identity: it names the library.
    fn put(&self, out: &mut impl Put, words: bool) {
        out.put_text(&self.name);
        out.put_text(&self.crs);
        put_lattice(out, &self.lattice);
        for p in [self.frame.anchor, self.frame.u, self.frame.v] {
            out.put_i64(p.x);
            out.put_i64(p.y);
        }
        out.put_u8(self.sample_type as u8);
        out.put_f64(self.scale);
        out.put_f64(self.offset);
        out.put_f64(self.accuracy_m);
        // Bound of the level-0 payload: samples are stored exactly.
        out.put_f64(0.0);
        if self.is_plain() {
            return;
        }
        out.put_text(self.vertical_datum.as_deref().unwrap_or_default());
        out.put_u8(u8::from(self.resampled.is_some()));
        if let Some(s) = &self.resampled {
            out.put_text(&s.crs);
            put_lattice(out, &s.lattice);
            out.put_u8(s.samples.sample_type as u8);
            out.put_f64(s.samples.scale);
            out.put_f64(s.samples.offset);
            out.put_f64(s.turn);
            out.put_text(&s.datum);
            if words {
                out.put_text(&s.operation);
            }
        }
    }

    /// Whether format 1 can hold it: in the database's own system, nothing said of the vertical datum.
    pub fn is_plain(&self) -> bool {
        self.vertical_datum.is_none() && self.resampled.is_none()
    }

    /// The samples in the files.
    pub fn delivered(&self) -> Delivered {
        self.resampled.as_ref().map_or(
            Delivered { sample_type: self.sample_type, scale: self.scale, offset: self.offset },
            |r| r.samples,
        )
    }

    /// The lattice of the files.
    pub fn delivered_lattice(&self) -> &Lattice {
        self.resampled.as_ref().map_or(&self.lattice, |r| &r.lattice)
    }

    /// The system of the files.
    pub fn delivered_crs(&self) -> &str {
        self.resampled.as_ref().map_or(&self.crs, |r| &r.crs)
    }

    fn read(r: &mut Reader, plain: bool) -> Result<Declaration> {
        let (name, crs) = (r.text()?, r.text()?);
        let lattice = read_lattice(r)?;
        let mut p = || -> Result<Point> { Ok(Point::new(r.i64()?, r.i64()?)) };
        let frame = Frame { anchor: p()?, u: p()?, v: p()? };
        let Delivered { sample_type, scale, offset } = read_delivered(r)?;
        let mut d = Declaration {
            name,
            crs,
            lattice,
            frame,
            sample_type,
            scale,
            offset,
            accuracy_m: r.f64()?,
            vertical_datum: None,
            resampled: None,
        };
        r.f64()?;
        if !plain {
            d.vertical_datum = Some(r.text()?).filter(|t| !t.is_empty());
            if r.u8()? != 0 {
                d.resampled = Some(Resampled {
                    crs: r.text()?,
                    lattice: read_lattice(r)?,
                    samples: read_delivered(r)?,
                    turn: r.f64()?,
                    datum: r.text()?,
                    operation: r.text()?,
                });
            }
        }
        if d.frame.determinant() == 0 {
            return Err(r.bad("steps span no area"));
        }
        Ok(d)
    }

    pub fn id(&self) -> DeclarationId {
        let mut h = blake3::Hasher::new();
        h.put(b"terraquilt survey 1");
        self.put(&mut h, false);
        h.finalize().as_bytes()[..16].try_into().expect("a hash has 32 bytes")
    }

    /// Accuracy rounded up to the stored type.
    pub fn accuracy(&self) -> f32 {
        crate::base::round::up_f32(self.accuracy_m)
    }
}

fn put_lattice(out: &mut impl Put, l: &Lattice) {
    for v in l.col_step.iter().chain(&l.row_step).chain(&l.phase) {
        out.put_f64(*v);
    }
}

fn read_lattice(r: &mut Reader) -> Result<Lattice> {
    let mut f = || r.f64();
    Ok(Lattice { col_step: [f()?, f()?], row_step: [f()?, f()?], phase: [f()?, f()?] })
}

fn read_delivered(r: &mut Reader) -> Result<Delivered> {
    let code = r.u8()?;
    let sample_type = SampleType::from_code(code).ok_or_else(|| r.bad(format!("sample type {code}")))?;
    Ok(Delivered { sample_type, scale: r.f64()?, offset: r.f64()? })
}

/// One delivered file of a survey.
#[derive(Clone, Debug, PartialEq)]
pub struct Tile {
    /// Hash of index rectangle, samples and validity. Greatest key wins where tiles overlap.
    pub key: [u8; 16],
    /// Posts: `[i0, i1) x [j0, j1)` in the survey's indices.
    pub posts: CellRect,
    pub directory: PageRef,
    pub valid: u64,
    /// Lowest and highest valid height, metres.
    pub z: [f64; 2],
    /// As delivered: for raw export.
    pub file: String,
    pub affine: Affine,
    pub nodata: Option<f64>,
}

impl Tile {
    fn put(&self, out: &mut Vec<u8>) {
        out.put(&self.key);
        put_rect(out, &self.posts);
        self.directory.put(out);
        out.put_u64(self.valid);
        out.put_f64(self.z[0]);
        out.put_f64(self.z[1]);
        out.put_text(&self.file);
        for v in self.affine.origin.iter().chain(&self.affine.col_step).chain(&self.affine.row_step) {
            out.put_f64(*v);
        }
        out.put_u8(u8::from(self.nodata.is_some()));
        out.put_f64(self.nodata.unwrap_or(0.0));
    }

    fn read(r: &mut Reader) -> Result<Tile> {
        let key = r.take(16)?.try_into().expect("16 bytes were taken");
        let posts = read_rect(r)?;
        let directory = PageRef::read(r)?;
        let valid = r.u64()?;
        let z = [r.f64()?, r.f64()?];
        let file = r.text()?;
        let mut f = || r.f64();
        let affine = Affine { origin: [f()?, f()?], col_step: [f()?, f()?], row_step: [f()?, f()?] };
        let has = r.u8()? != 0;
        let value = r.f64()?;
        Ok(Tile { key, posts, directory, valid, z, file, affine, nodata: has.then_some(value) })
    }

    pub fn id(&self) -> String {
        hex(&self.key)
    }
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|b| format!("{b:02x}")).collect()
}

pub fn put_rect(out: &mut impl Put, r: &CellRect) {
    for v in [r.i0, r.j0, r.i1, r.j1] {
        out.put_i64(v);
    }
}

pub fn read_rect(r: &mut Reader) -> Result<CellRect> {
    let c = CellRect::new(r.i64()?, r.i64()?, r.i64()?, r.i64()?);
    const FAR: i64 = 1 << 40;
    if [c.i0, c.j0, c.i1, c.j1].iter().any(|v| v.abs() > FAR) {
        return Err(r.bad(format!("rectangle {c:?} out of range")));
    }
    Ok(c)
}

/// Kind of a head whose declaration is that of format 1, and of one with vertical datum and manner of delivery.
const PLAIN: u8 = b'H';
const DECLARED_IN_FULL: u8 = b'J';

/// Everything a survey is.
#[derive(Clone, Debug, PartialEq)]
pub struct Head {
    pub declaration: Declaration,
    /// Descending by key: the first valid one wins.
    pub tiles: Vec<Tile>,
    pub level_max: u8,
    /// Smallest rectangle of cells that holds core(G).
    pub core: CellRect,
    pub patches: u64,
    /// Patch pages, ascending by address.
    pub pages: PageList,
}

impl Head {
    pub fn encode(&self) -> Vec<u8> {
        let mut out = Vec::new();
        out.put_u8(if self.declaration.is_plain() { PLAIN } else { DECLARED_IN_FULL });
        self.declaration.put(&mut out, true);
        out.put_u32(self.tiles.len() as u32);
        for t in &self.tiles {
            t.put(&mut out);
        }
        out.put_u8(self.level_max);
        put_rect(&mut out, &self.core);
        out.put_u64(self.patches);
        put_list(&mut out, &self.pages);
        out
    }

    pub fn decode(bytes: &[u8], file: &str) -> Result<Head> {
        let mut r = Reader::new(bytes, file, "survey head");
        let kind = r.u8()?;
        if kind != PLAIN && kind != DECLARED_IN_FULL {
            return Err(r.bad(format!("page kind {kind:#04x} is not a survey head")));
        }
        let declaration = Declaration::read(&mut r, kind == PLAIN)?;
        let n = r.u32()? as usize;
        if n > r.remaining() / 64 {
            return Err(r.bad(format!("{n} tiles in {} bytes", r.remaining())));
        }
        let tiles = (0..n).map(|_| Tile::read(&mut r)).collect::<Result<Vec<Tile>>>()?;
        let level_max = r.u8()?;
        if level_max > LEVEL_MAX {
            return Err(r.bad(format!("level {level_max}")));
        }
        let core = read_rect(&mut r)?;
        let patches = r.u64()?;
        let pages = read_list(&mut r)?;
        r.end()?;
        Ok(Head { declaration, tiles, level_max, core, patches, pages })
    }

    pub fn geometry(&self, precedence: i64) -> Geometry {
        Geometry {
            frame: self.declaration.frame,
            steps: self.declaration.lattice.nominal_steps(),
            accuracy: self.declaration.accuracy(),
            precedence,
            level_max: self.level_max,
            core: self.core,
        }
    }

    /// The rectangle of delivered posts that the tiles span.
    pub fn posts(&self) -> CellRect {
        self.tiles.iter().fold(CellRect::new(0, 0, 0, 0), |r, t| r.union(&t.posts))
    }

    /// The rectangle of the survey's own posts: the delivered ones, or, where they are resampled, those around the core.
    pub fn own_posts(&self) -> CellRect {
        let c = self.core;
        match &self.declaration.resampled {
            None => self.posts(),
            Some(_) => CellRect::new(c.i0 - 1, c.j0 - 1, c.i1 + 2, c.j1 + 2),
        }
    }

    pub fn valid(&self) -> u64 {
        self.tiles.iter().map(|t| t.valid).sum()
    }

    /// Bounds of the heights of all posts: those of the samples, wider where cubic interpolation may overshoot.
    pub fn z(&self) -> [f64; 2] {
        let [lo, hi] = self
            .tiles
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |z, t| [z[0].min(t.z[0]), z[1].max(t.z[1])]);
        // The absolute weights of Catmull-Rom sum to at most 1.25 in each axis.
        let over = if self.declaration.resampled.is_some() {
            (hi - lo) * (1.25 * 1.25 - 1.0) / 2.0 + hi.abs().max(lo.abs()) * 1e-7
        } else {
            0.0
        };
        [lo - over, hi + over]
    }
}

/// Refuses a survey whose patches would leave the world cell.
pub fn check_world(g: &Geometry, file: &str) -> Result<()> {
    let top = crate::height::lod::places_meeting(g.level_max, &g.core);
    let s = crate::height::lod::KERNEL << g.level_max;
    let m = crate::height::lod::MARGIN << g.level_max;
    let all = CellRect::new(top.i0 * s, top.j0 * s, top.i1 * s, top.j1 * s).grow(m);
    if g.frame.holds(&all) {
        return Ok(());
    }
    Err(Error::invalid(
        file,
        "reaches outside the world of the database (33 554 km, or 512 degrees, from the CRS origin); check its georeference",
    ))
}
