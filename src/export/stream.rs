//! The surface of a region as one progressive stream: a GTB file (`docs/gtb-format.md`).
//!
//! The surface is taken at the posts of a lattice; errors are those at posts. What lies outside of a polygon or has no data is a
//! void.

use super::drape::{Drape, Square};
use super::gtb;
use super::place::Place;
use super::posts::{Posts, Rim, nothing, rim_note};
use super::raster::{Met, Raster};
use super::shares::{Choice, Settled, Shares};
use super::{Going, go_on};
use crate::base::{Error, Result, limits};
use crate::codec::held;
use crate::db::Snapshot;
use crate::db::query::Query;
use crate::format::picture::Picture;
use crate::height::source::Affine;
use serde::{Deserialize, Serialize};
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::texture::{Cells, Settings, Writer};
use terraquilt_codecs::gtb::{Decoded, Encoded, Given, Header, Heights, Options, Profile, encode};
use terraquilt_codecs::gtb::{PassEnd, Place as Placed};
use terraquilt_codecs::lattice::Lattice;

/// A stream of the surface.
pub struct StreamRequest {
    pub place: Place,
    /// Its tolerance is the file's; [`Choice`] shares it out.
    pub query: Query,
    /// Spacing of posts: at whole multiples. `None`: as fine as the finest survey, on its posts if it lies north-up.
    pub step: Option<[f64; 2]>,
    pub profile: Profile,
    pub choice: Choice,
    /// Posts along a side that it may have; no lattice has more than [`limits::LATTICE_SIDE_MAX`].
    pub side_max: u64,
}

/// A stream.
pub struct Stream {
    /// The file.
    pub bytes: Vec<u8>,
    /// Where passes end.
    pub ends: Vec<PassEnd>,
    pub told: Told,
    pub notes: Vec<String>,
    /// What the receiver must have, if it refines heights that the receiver has: which of those at its posts stay, and which fall.
    pub refines: Option<Refined>,
}

/// Heights that a receiver has, as they enter a stream.
pub struct Refined {
    pub given: Given,
    /// How many of the heights that both streams share stay and fall, by turns (`codec::held`).
    pub runs: Vec<u64>,
}

/// What there is to say of a stream.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Told {
    pub cols: usize,
    pub rows: usize,
    pub bytes: u64,
    /// Posts with data.
    pub samples: u64,
    pub voids: u64,
    /// Posts with data in the rim outside every survey's core, where no error is certified.
    pub uncertified: u64,
    pub bits_per_sample: f64,
    /// Certified at posts: the sum of the next three.
    pub error_m: f64,
    pub surface_error_m: f64,
    pub rounding_m: f64,
    pub codec_error_m: f64,
    pub unit_m: f64,
    pub layers_m: Vec<f64>,
    pub profile: String,
    /// Spacing of posts in units of the CRS, and where they lie.
    pub step: [f64; 2],
    pub posts: String,
    pub seams: String,
    pub version: u64,
}

/// Makes a stream. `earlier`: what the receiver has of another one. `picture`: what the ground looks like, to travel along.
///
/// Memory: 8 bytes a post for the surface, then what the codec needs.
///
/// # Errors
/// If nothing lies there, no post does, above limits; [`Error::Stopped`] when told not to go on.
pub fn stream(
    s: &Snapshot,
    r: &StreamRequest,
    earlier: Option<&Decoded>,
    picture: Option<&mut Picture>,
    going: Going,
) -> Result<Stream> {
    let shares = Shares::new(&r.query.tolerance, &r.choice)?;
    let query = Query { tolerance: shares.surface.clone(), ..r.query.clone() };
    if s.select(&query)?.records.is_empty() {
        return Err(nothing(s, &r.place));
    }
    let posts = posts(s, r, earlier)?;
    let (z, met) = posts.surface(s, &query, &r.place, Rim::Kept, going)?;
    let settled = shares.settle([met.least, met.most]);
    let heights = posts.rounded(z, settled.unit);
    let place = posts.placed(s, settled.unit, settled.given_error)?;
    let mut notes: Vec<String> = rim_note(met.uncertified).into_iter().collect();
    let refines = match earlier {
        None => None,
        Some(e) => refined(e, &heights, &place, &settled, &mut notes)?,
    };
    let cells = picture.map(|p| draped(p, (s, &posts.raster), &heights, &mut notes, going)).transpose()?;
    let options = Options {
        layers: settled.layers.clone(),
        place,
        given: refines.as_ref().map(|r: &Refined| &r.given),
        texture: cells.as_ref().map(|c| c.n),
        ..Options::new(r.profile, 0)
    };
    go_on(going, "coding", 0.0)?;
    let mut on = |share: f64| going("coding", share);
    let found = match &cells {
        None => encode(&heights, &options, &mut Alone, &mut on),
        Some(cells) => {
            let mut writer = Writer::new(cells, &Settings::default()).map_err(codec)?;
            encode(&heights, &options, &mut writer, &mut on)
        }
    };
    let found = found.map_err(codec)?;
    let told = told(s, r, &posts, (&settled, met), &heights, &found)?;
    let notes = [notes, settled.notes(told.codec_error_m)].concat();
    Ok(Stream { bytes: found.bytes, ends: found.passes, told, notes, refines })
}

fn codec(e: terraquilt_codecs::Error) -> Error {
    gtb::told("the stream", e)
}

/// The posts. Beside an earlier stream of a coarser spacing they begin on a post of it, by less than its spacing outside of the region.
fn posts<'a>(s: &Snapshot, r: &'a StreamRequest, earlier: Option<&Decoded>) -> Result<Posts<'a>> {
    let posts = Posts::new(s, &r.place, r.step)?;
    let side_max = r.side_max.min(limits::LATTICE_SIDE_MAX);
    let (cols, rows) = (posts.raster.cols, posts.raster.rows);
    let longest = cols.max(rows) as u64;
    if longest > side_max {
        let what = "posts along a side of a stream (give a smaller region, or a larger step between posts)";
        return Err(Error::limit(what, side_max, longest));
    }
    let [west, north] = earlier.map_or([0; 2], |e| {
        held::beginning(&e.header.place, &Placed { transform: posts.transform(), ..Placed::default() })
    });
    if (cols + west).max(rows + north) as u64 > side_max {
        return Ok(posts);
    }
    Ok(Posts { raster: posts.raster.grown(west, north), ..posts })
}

fn lattice(heights: &Heights) -> Result<Lattice> {
    let (cols, rows) = (heights.cols, heights.rows);
    Lattice::around(cols, rows).ok_or_else(|| {
        Error::limit("posts along a side of a stream", limits::LATTICE_SIDE_MAX, cols.max(rows) as u64)
    })
}

/// A picture on the cells of the stream's square.
fn draped(
    picture: &mut Picture,
    (s, raster): (&Snapshot, &Raster),
    heights: &Heights,
    notes: &mut Vec<String>,
    going: Going,
) -> Result<Cells> {
    let ([x, y], [sx, sy]) = (raster.center(0, 0), raster.step());
    let affine = Affine { origin: [x, y], col_step: [sx, 0.0], row_step: [0.0, -sy] };
    let square = Square {
        lattice: lattice(heights)?,
        cols: heights.cols,
        rows: heights.rows,
        affine: Some(affine),
        crs: Some(raster.crs(s)),
    };
    let mut drape = Drape::new(square, picture)?;
    notes.append(&mut drape.notes);
    drape.cells(drape.usual_n(), going)
}

/// The heights of an earlier stream that are good enough for this one.
fn refined(
    earlier: &Decoded,
    heights: &Heights,
    place: &Placed,
    settled: &Settled,
    notes: &mut Vec<String>,
) -> Result<Option<Refined>> {
    let lattice = lattice(heights)?;
    let at = held::Posts { cols: heights.cols, rows: heights.rows, lattice, place };
    let Some(mut given) = held::shared(earlier, &at) else {
        notes.push("what is held shares no post with what is asked: everything is sent".into());
        return Ok(None);
    };
    let e = i64::from(settled.layers[settled.layers.len() - 1]);
    let width = lattice.side();
    let shared = given.known.iter().filter(|k| **k).count();
    let runs = held::sift(&mut given, |at, z| {
        let k = at / width * heights.cols + at % width;
        !heights.is_void(k) && (i64::from(heights.z[k]) - i64::from(z)).abs() <= e
    });
    let good = given.known.iter().filter(|k| **k).count();
    if good * 2 < shared {
        notes.push(format!(
            "of {shared} heights that are held at posts of what is asked, {good} are good enough for it: everything is sent"
        ));
        return Ok(None);
    }
    Ok(Some(Refined { given, runs }))
}

fn told(
    s: &Snapshot,
    r: &StreamRequest,
    posts: &Posts,
    (settled, met): (&Settled, Met),
    heights: &Heights,
    found: &Encoded,
) -> Result<Told> {
    let (header, _) = Header::read(&found.bytes).map_err(codec)?;
    let codec_error_m = f64::from(header.bound(header.layers.len() - 1, u32::MAX)) * settled.unit;
    let voids = heights.void.iter().filter(|v| **v).count() as u64;
    let samples = heights.z.len() as u64 - voids;
    let rounding_m = settled.unit / 2.0;
    Ok(Told {
        cols: posts.raster.cols,
        rows: posts.raster.rows,
        bytes: found.bytes.len() as u64,
        samples,
        voids,
        uncertified: met.uncertified,
        bits_per_sample: found.bytes.len() as f64 * 8.0 / samples as f64,
        error_m: settled.given_error + codec_error_m,
        surface_error_m: met.most,
        rounding_m,
        codec_error_m,
        unit_m: settled.unit,
        layers_m: settled.layers_m(),
        profile: if r.profile == Profile::Adaptive { "adaptive" } else { "cubic" }.into(),
        step: posts.raster.step(),
        posts: posts.lie.clone(),
        seams: r.query.how.seams.name().into(),
        version: s.number(),
    })
}
