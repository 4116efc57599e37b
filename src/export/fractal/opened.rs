//! A tile as it was read, and what its samples are worth.

use super::told;
use crate::base::{Error, Result, limits};
use crate::export::grid::{Grid, place_of};
use serde::Serialize;
use terraquilt_codecs::fractal::{Kind, Tile};

/// A tile, whole or the beginning of one.
pub struct Opened {
    /// What was read.
    pub tile: Tile,
    /// Where heights lie; without heights.
    pub place: Grid,
    /// What the samples at zoom 1 are worth.
    pub worth: Worth,
    /// What a person should know.
    pub notes: Vec<String>,
    file: String,
}

/// What is known of the samples of a tile at zoom 1, and of means of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Worth {
    /// No sample is farther from its source: in the unit of heights, in grey levels, in eighths of a voxel. Absent where nobody knows.
    pub error_max: Option<f64>,
    /// Whether the maker guarantees it; else it was measured.
    pub certified: bool,
    /// Whether nothing is missing.
    pub complete: bool,
    /// A block whose checksum is wrong, by its first byte in the body.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub damaged_at: Option<u64>,
}

impl Worth {
    /// Of what nobody knows the error of.
    pub fn unknown(&self) -> Worth {
        Worth { error_max: None, certified: false, ..self.clone() }
    }
}

impl Opened {
    /// Reads a tile, or the beginning of one: what is missing is flat.
    ///
    /// # Errors
    /// Where the head is not there or damaged; [`Error::Limit`] for tiles of more samples than are decoded.
    pub fn read(file: &str, bytes: &[u8]) -> Result<Opened> {
        let tile = Tile::read_within(limits::FRACTAL_SAMPLES_MAX, bytes).map_err(|e| told(file, e))?;
        let h = &tile.header;
        let mut notes = Vec::new();
        let place = if h.kind == Kind::Heights { place_of(&h.place, &mut notes) } else { Grid::default() };
        let unit = if h.kind == Kind::Heights { h.place.unit } else { 1.0 };
        let given = if h.kind == Kind::Heights { h.place.given_error } else { 0.0 };
        let units = h.bound.map_or(h.error_max, f64::from);
        let whole = tile.error_known();
        let worth = Worth {
            error_max: whole.then_some(units * unit + given),
            certified: whole && h.bound.is_some(),
            complete: tile.complete,
            damaged_at: tile.damaged,
        };
        if !tile.complete {
            let what = match tile.damaged {
                Some(at) => format!("the block at byte {at} of its body is damaged"),
                None => "it ends before its last leaf".to_string(),
            };
            notes.push(format!(
                "{file} is not whole: {what}; what is missing is flat, and nobody knows how wrong that is"
            ));
        }
        Ok(Opened { tile, place, worth, notes, file: file.to_string() })
    }

    /// A refusal of the codec, with the name of the file.
    pub fn told(&self, e: terraquilt_codecs::Error) -> Error {
        told(&self.file, e)
    }

    /// What it holds.
    pub fn kind(&self) -> Kind {
        self.tile.header.kind
    }

    /// Height of a sample.
    pub fn height(&self, units: f64) -> f64 {
        let p = &self.tile.header.place;
        p.base + p.unit * units
    }
}
