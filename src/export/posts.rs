//! The surface of a region at posts, in whole units: what codecs of heights take.

use super::Going;
use super::place::{Place, whereabouts};
use super::raster::{Met, Raster, finest_step};
use crate::base::{Error, Result};
use crate::db::query::Query;
use crate::db::{self, Snapshot};
use terraquilt_codecs::heights::{Heights, Place as Placed};

/// What a file says of where it comes from, but for the version.
const SOURCE: &str = "terraquilt, version ";

/// What becomes of posts in the rim outside every survey's core, where no error is certified.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Rim {
    Kept,
    /// They are voids, as places without data are.
    LeftOut,
}

/// Posts, and where they lie in words.
pub struct Posts<'a> {
    pub raster: Raster<'a>,
    pub lie: String,
}

impl<'a> Posts<'a> {
    /// Posts of `step` units, at whole multiples of it. Without one as fine as the finest survey of the place, on its posts if it lies
    /// north-up. The caller limits their number.
    ///
    /// # Errors
    /// If none lies in the place.
    pub fn new(s: &Snapshot, place: &'a Place, step: Option<[f64; 2]>) -> Result<Posts<'a>> {
        let on_multiples = |step| -> Result<Option<Posts>> {
            let lie = "whole multiples of the spacing".to_string();
            Ok(Raster::on_multiples(s, place, step)?.map(|raster| Posts { raster, lie }))
        };
        let found = match step {
            Some(step) => on_multiples(step)?,
            None => match Raster::on_posts(s, place)? {
                Some((raster, survey)) => Some(Posts { raster, lie: format!("posts of survey {survey}") }),
                None => finest_step(s, place)?.map_or(Ok(None), on_multiples)?,
            },
        };
        found.ok_or_else(|| {
            Error::invalid(
                "region",
                "no post lies in it; give a larger region, or a smaller step between posts",
            )
        })
    }

    /// The surface at the posts, NaN where there is none, and the errors that it has there. 8 bytes a post.
    ///
    /// # Errors
    /// If it is nowhere; [`Error::Stopped`] when told not to go on.
    pub fn surface(
        &self,
        s: &Snapshot,
        query: &Query,
        place: &Place,
        rim: Rim,
        going: Going,
    ) -> Result<(Vec<f64>, Met)> {
        let mut z = Vec::with_capacity(self.raster.cols * self.raster.rows);
        let met = self.raster.doubles(s, query, going, |_, _, band, uncertified| {
            let first = z.len();
            z.extend_from_slice(band);
            if rim == Rim::LeftOut {
                uncertified.iter().for_each(|k| z[first + k] = f64::NAN);
            }
            Ok(())
        })?;
        if z.iter().all(|v| v.is_nan()) {
            if rim == Rim::LeftOut && met.uncertified > 0 {
                return Err(Error::invalid(
                    "region",
                    "all its posts lie in the rim of their surveys, where no error is certified; `export .tif` writes them",
                ));
            }
            return Err(nothing(s, place));
        }
        Ok((z, met))
    }

    /// Heights in whole units.
    pub fn rounded(&self, z: Vec<f64>, unit: f64) -> Heights {
        let mut out = Heights::new(self.raster.cols, self.raster.rows, Vec::with_capacity(z.len()));
        if z.iter().any(|v| v.is_nan()) {
            out.void = z.iter().map(|v| v.is_nan()).collect();
        }
        out.z = z.iter().map(|v| if v.is_nan() { 0 } else { (v / unit + 0.5).floor() as i32 }).collect();
        out
    }

    /// From posts to the ground.
    pub fn transform(&self) -> [f64; 6] {
        let ([x, y], [sx, sy]) = (self.raster.center(0, 0), self.raster.step());
        [x, sx, 0.0, y, 0.0, -sy]
    }

    /// What a file says of its heights. `given_error`: what they may be wrong before they are coded, metres.
    pub fn placed(&self, s: &Snapshot, unit: f64, given_error: f64) -> Result<Placed> {
        Ok(Placed {
            unit,
            base: 0.0,
            given_error,
            transform: self.transform(),
            crs: self.raster.crs(s).code.clone(),
            vertical: db::vertical_datum(s)?.map_or("m".to_string(), |d| format!("m {d}")),
            source: format!("{SOURCE}{}", s.number()),
        })
    }
}

/// The refusal of a region without data.
pub fn nothing(s: &Snapshot, place: &Place) -> Error {
    let reason = format!("holds no data; {}", whereabouts(s.crs(), s.bounds(), place.coords.as_ref()));
    Error::invalid("region", reason)
}

/// The version of the database that a file was made of, if its head names one.
pub fn version_of(place: &Placed) -> Option<u64> {
    place.source.strip_prefix(SOURCE)?.parse().ok()
}

/// What is said of posts whose error nobody knows.
pub fn rim_note(uncertified: u64) -> Option<String> {
    (uncertified > 0).then(|| {
        format!("{uncertified} posts lie in the rim outside every survey's core, where no error is certified")
    })
}
