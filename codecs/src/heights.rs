//! Heights as the codec takes them: integers of a unit, row by row from the north-west corner, voids marked.

use crate::{Error, Result};

/// Greatest magnitude of a height in units above the base: 32 times a prediction stays within 31 bits.
pub const HEIGHT_MAX: i32 = 1 << 25;

/// A rectangle of heights.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Heights {
    /// Posts in a row.
    pub cols: usize,
    /// Rows.
    pub rows: usize,
    /// `cols * rows` heights in units above the base; of voids anything.
    pub z: Vec<i32>,
    /// Which are voids; empty if none is.
    pub void: Vec<bool>,
}

impl Heights {
    /// Heights without voids.
    pub fn new(cols: usize, rows: usize, z: Vec<i32>) -> Heights {
        Heights { cols, rows, z, void: Vec::new() }
    }

    /// Whether a post has no data.
    pub fn is_void(&self, at: usize) -> bool {
        self.void.get(at).copied().unwrap_or(false)
    }

    /// Refuses shapes that do not fit and heights beyond [`HEIGHT_MAX`].
    pub fn check(&self) -> Result<()> {
        let posts = self.cols.saturating_mul(self.rows);
        if posts == 0 || self.z.len() != posts || !(self.void.is_empty() || self.void.len() == posts) {
            return Err(Error::invalid(
                "heights",
                format!(
                    "{} x {} posts with {} heights and {} void marks; one of each a post is needed",
                    self.cols,
                    self.rows,
                    self.z.len(),
                    self.void.len()
                ),
            ));
        }
        let beyond = (0..posts).find(|k| !self.is_void(*k) && self.z[*k].unsigned_abs() > HEIGHT_MAX as u32);
        beyond.map_or(Ok(()), |k| {
            Err(Error::invalid(
                "heights",
                format!(
                    "post {k} is {} units above the base, {HEIGHT_MAX} are allowed; take a larger unit",
                    self.z[k]
                ),
            ))
        })
    }
}

/// Where heights lie and what their numbers mean. The codec carries it and does not look at it.
#[derive(Clone, Debug, PartialEq)]
pub struct Place {
    /// Metres (or what `vertical` says) of one unit.
    pub unit: f64,
    /// Height of the base: a height is `base + unit * z`.
    pub base: f64,
    /// What the heights may be wrong already, before they are coded, in the unit of heights: of the surface that they were taken
    /// from, and of rounding to units.
    pub given_error: f64,
    /// Posts to the plane, as of GDAL but for the *centre* of the first post: x = t\[0\] + col t\[1\] + row t\[2\],
    /// y = t\[3\] + col t\[4\] + row t\[5\].
    pub transform: [f64; 6],
    /// `EPSG:n`, or WKT; empty if unknown.
    pub crs: String,
    /// Unit and datum of heights, as far as known: `m`, `m EGM96 height`; empty if unknown.
    pub vertical: String,
    /// What the heights come from: a file's name, a database's version.
    pub source: String,
}

impl Default for Place {
    fn default() -> Place {
        Place {
            unit: 1.0,
            base: 0.0,
            given_error: 0.0,
            transform: [0.0, 1.0, 0.0, 0.0, 0.0, -1.0],
            crs: String::new(),
            vertical: String::new(),
            source: String::new(),
        }
    }
}
