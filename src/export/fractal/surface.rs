//! The surface of a region as a fractal tile.
//!
//! The surface is taken at posts; errors are those at posts. A bounded tile promises the tolerance: surface, rounding and codec share it
//! as they do in a stream. Where the number of maps is given, surface and rounding have all of the tolerance, and what the maps add is
//! measured with the decoder.

use super::{NEAR, Threads, psnr_db, told};
use crate::base::{Error, Result, limits};
use crate::db::Snapshot;
use crate::db::query::{Query, Tolerance};
use crate::export::place::Place;
use crate::export::posts::{Posts, Rim, nothing, rim_note};
use crate::export::shares::{self, Shares};
use crate::export::{Going, go_on};
use serde::{Deserialize, Serialize};
use terraquilt_codecs::fractal::{Options, Partition, Search, encode_heights};

/// What the caller chose beside the tolerance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Choice {
    /// The codec's bound, metres.
    pub bound: Option<f64>,
    /// So many maps instead, at most; nothing is promised of what they leave out.
    pub maps: Option<u64>,
    /// Metres of a unit.
    pub unit: Option<f64>,
    /// Which domains a range meets; `None`: those near it.
    pub search: Option<Search>,
}

impl Choice {
    /// # Errors
    /// If something is chosen for a file of another kind.
    pub fn only_for_ifs(&self, ending: &str) -> Result<()> {
        let chosen = [
            ("bound", self.bound.is_some()),
            ("maps", self.maps.is_some()),
            ("unit", self.unit.is_some()),
            ("search", self.search.is_some()),
        ];
        match chosen.iter().find(|(_, chosen)| *chosen && ending != "ifs") {
            Some((what, _)) => Err(Error::invalid(
                what,
                format!("is for fractal tiles (.ifs), not for .{ending}; leave it out"),
            )),
            None => Ok(()),
        }
    }

    fn shares(&self, tolerance: &Tolerance) -> Result<Shares> {
        match (self.maps, self.bound) {
            (Some(maps), Some(bound)) => Err(Error::invalid(
                "maps",
                format!("{maps} and a bound of {bound} m; a tile has one of both, leave the other out"),
            )),
            (Some(_), None) => Shares::unbounded(tolerance, self.unit),
            (None, bound) => {
                Shares::new(tolerance, &shares::Choice { bound, layers: Vec::new(), unit: self.unit })
            }
        }
    }
}

/// The names of searches, as options and answers call them.
pub fn search_name(search: Search) -> &'static str {
    match search {
        Search::Near(_) => "near",
        Search::Classes => "classes",
        Search::Exact => "exact",
    }
}

/// The search that a name means.
pub fn search_of(name: &str) -> Option<Search> {
    [Search::Near(NEAR), Search::Classes, Search::Exact].into_iter().find(|s| search_name(*s) == name)
}

/// A tile of the surface.
pub struct TileRequest<'a> {
    pub place: &'a Place,
    pub query: &'a Query,
    /// Spacing of posts: at whole multiples. `None`: as fine as the finest survey, on its posts if it lies north-up.
    pub step: Option<[f64; 2]>,
    pub choice: &'a Choice,
    /// Posts that it may have.
    pub posts_max: u64,
    /// Posts that it may have if ranges meet domains far away.
    pub far_posts_max: u64,
}

/// What there is to say of a tile.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TileTold {
    pub cols: usize,
    pub rows: usize,
    pub bytes: u64,
    /// Posts with data.
    pub samples: u64,
    pub voids: u64,
    /// Posts with data in the rim outside every survey's core, where no error is certified: left out, as voids.
    pub uncertified: u64,
    pub bits_per_sample: f64,
    pub maps: u64,
    /// Of the codec's errors at posts, the span of the heights as the peak; absent if it makes none.
    pub psnr_db: Option<f64>,
    /// At posts: the sum of the next three. Certified in a bounded tile; in another one the codec's part is measured.
    pub error_m: f64,
    pub surface_error_m: f64,
    pub rounding_m: f64,
    pub codec_error_m: f64,
    pub bounded: bool,
    /// The codec's greatest error at a post as the decoder gives it, and the root mean square.
    pub error_max_m: f64,
    pub error_rms_m: f64,
    pub unit_m: f64,
    pub search: String,
    /// Spacing of posts in units of the CRS, and where they lie.
    pub step: [f64; 2],
    pub posts: String,
    pub seams: String,
    pub version: u64,
}

impl TileTold {
    /// What a person should know; `tolerance`: what was asked.
    pub fn notes(&self, tolerance: Option<&Tolerance>) -> Vec<String> {
        let mut out: Vec<String> =
            rim_note(self.uncertified).map(|n| format!("{n}; they are left out")).into_iter().collect();
        let (codec, given) = (self.codec_error_m, self.error_m - self.codec_error_m);
        if !self.bounded {
            out.push(format!(
                "the {} maps are off by {codec:.3} m at most at posts, as measured: no bound was asked for, and between posts nothing is known",
                self.maps
            ));
        }
        if let Some(Tolerance::Constant(m)) = tolerance
            && (if self.bounded { self.error_m } else { given }) > *m
            && *m > 0.0
        {
            out.push(format!(
                "the surface alone has {given:.3} m there (the accuracy of its surveys); with the codec's {codec:.3} m that is more \
                 than the {m} m asked"
            ));
        }
        out
    }
}

/// Makes a tile.
///
/// Memory: 8 bytes a post for the surface, then what the codec needs, some 200.
///
/// # Errors
/// If nothing lies there, no post does, above limits; [`Error::Stopped`] when told not to go on.
pub fn tile(s: &Snapshot, r: &TileRequest, going: Going) -> Result<(Vec<u8>, TileTold)> {
    let shares = r.choice.shares(&r.query.tolerance)?;
    let query = Query { tolerance: shares.surface.clone(), ..r.query.clone() };
    if s.select(&query)?.records.is_empty() {
        return Err(nothing(s, r.place));
    }
    let posts = Posts::new(s, r.place, r.step)?;
    let search = r.choice.search.unwrap_or(Search::Near(NEAR));
    limited(&posts, search, r)?;
    // The file states one error for all its posts.
    let (z, met) = posts.surface(s, &query, r.place, Rim::LeftOut, going)?;
    let settled = shares.settle([met.least, met.most]);
    let heights = posts.rounded(z, settled.unit);
    let place = posts.placed(s, settled.unit, settled.given_error)?;
    let options = Options {
        bound: r.choice.maps.is_none().then(|| settled.layers[settled.layers.len() - 1]),
        partition: r.choice.maps.map(|n| Partition::Maps(usize::try_from(n).unwrap_or(usize::MAX))),
        search,
        ..Options::default()
    };
    go_on(going, "maps", 0.0)?;
    let found = encode_heights(&heights, &place, &[], &options, &Threads::new("maps", going))
        .map_err(|e| told("the tile", e))?;
    let h = &found.header;
    let metres = |units: f64| units * settled.unit;
    let codec_error_m = metres(h.bound.map_or(h.error_max, f64::from));
    let voids = heights.void.iter().filter(|v| **v).count() as u64;
    let samples = heights.z.len() as u64 - voids;
    let tile = TileTold {
        cols: heights.cols,
        rows: heights.rows,
        bytes: found.bytes.len() as u64,
        samples,
        voids,
        uncertified: met.uncertified,
        bits_per_sample: found.bytes.len() as f64 * 8.0 / samples as f64,
        maps: h.maps,
        psnr_db: psnr_db(h),
        error_m: settled.given_error + codec_error_m,
        surface_error_m: met.most,
        rounding_m: settled.unit / 2.0,
        codec_error_m,
        bounded: h.bound.is_some(),
        error_max_m: metres(h.error_max),
        error_rms_m: metres(h.error_rms),
        unit_m: settled.unit,
        search: search_name(search).into(),
        step: posts.raster.step(),
        posts: posts.lie,
        seams: r.query.how.seams.name().into(),
        version: s.number(),
    };
    Ok((found.bytes, tile))
}

/// Refuses too many posts, before anything is held for them.
fn limited(posts: &Posts, search: Search, r: &TileRequest) -> Result<()> {
    let count = (posts.raster.cols as u64).saturating_mul(posts.raster.rows as u64);
    let most = r.posts_max.min(limits::FRACTAL_POSTS_MAX);
    if count > most {
        let what = "posts of a fractal tile (give a smaller region, or a larger step between posts)";
        return Err(Error::limit(what, most, count));
    }
    let far = r.far_posts_max.min(limits::FRACTAL_FAR_POSTS_MAX);
    if count > far && !matches!(search, Search::Near(_)) {
        let what = format!(
            "posts of a fractal tile with search {} (take near, or give a smaller region)",
            search_name(search)
        );
        return Err(Error::limit(what, far, count));
    }
    Ok(())
}
