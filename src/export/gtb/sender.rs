//! A grid, and perhaps a picture, as a GTB file.

use super::told;
use crate::base::{Error, Result};
use crate::export::Going;
use crate::export::drape::{Drape, Square};
use crate::export::grid::{Grid, units_within};
use crate::format::picture::Picture;
use serde::Serialize;
use terraquilt_codecs::gtb::companion::Alone;
use terraquilt_codecs::gtb::header::BOUND_MAX;
use terraquilt_codecs::gtb::select::{self, Ground, Rule};
use terraquilt_codecs::gtb::texture::{Settings, Writer};
use terraquilt_codecs::gtb::{Encoded, Options, Profile, encode};
use terraquilt_codecs::lattice::Lattice;

/// Greatest factor between the steps of one layer and the next.
const FACTOR_MAX: u64 = 255;

/// What is asked of a file.
pub struct Request<'a> {
    /// How heights are coded.
    pub profile: Profile,
    /// Unit of the integers; `None`: [`Grid::usual_unit`].
    pub unit: Option<f64>,
    /// Bounds of the layers, coarse to fine, in the unit of heights; of [`Profile::Sparse`] one, the bound of the whole.
    pub bounds: Vec<f64>,
    /// [`Profile::Sparse`]: send this share of the posts, the best ones, instead of what the bound needs.
    pub share: Option<f64>,
    /// The picture that travels along.
    pub picture: Option<&'a mut Picture>,
    /// n of its 2^n cells a side; `None`: about as fine as the picture.
    pub cells_n: Option<u32>,
}

/// A file, and what is to be said of it.
pub struct Sent {
    /// The file and where its passes end.
    pub encoded: Encoded,
    /// In numbers.
    pub told: SentTold,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// A file in numbers.
#[derive(Clone, Debug, Serialize)]
pub struct SentTold {
    /// Bytes of the file.
    pub bytes: u64,
    /// Posts of the grid, voids included.
    pub samples: u64,
    /// 8 bytes / samples.
    pub bits_per_sample: f64,
    /// Greatest error of the whole file, measured, in the unit of heights; rounding to the unit included.
    pub error_max: f64,
    /// Unit of the integers.
    pub unit: f64,
    /// The most that rounding to it cost.
    pub rounding: f64,
    /// Bounds of the layers, in the unit of heights.
    pub layers: Vec<f64>,
    /// Posts without data.
    pub voids: u64,
    /// Posts that are sent, of sparse files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub posts_sent: Option<u64>,
    /// Cells along a side of the texture.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub texture_side: Option<u64>,
}

/// Codes a grid. Memory: some 60 bytes a post of its lattice, and what the texture takes.
///
/// # Errors
/// If what is asked cannot be; [`Error::Stopped`] when told not to go on.
pub fn send(grid: &Grid, request: Request, going: Going) -> Result<Sent> {
    let unit = request.unit.unwrap_or_else(|| grid.usual_unit());
    let units = grid.in_units(unit)?;
    let mut notes = Vec::new();
    let finest = request.bounds.last().copied().unwrap_or(0.0);
    if units.rounding > 0.0 && finest < units.rounding {
        notes.push(format!(
            "heights are rounded to multiples of {unit}, which changes them by up to {:.3e}; a finer --unit changes less",
            units.rounding
        ));
    }
    let lattice = Lattice::around(grid.cols, grid.rows)
        .ok_or_else(|| Error::limit("posts along a side", 8193, grid.cols.max(grid.rows) as u64))?;
    let mut options = Options::new(request.profile, 0);
    options.place = units.place.clone();
    options.layers = layers(&request.bounds, units.rounding, unit)?;
    let selected;
    if request.profile == Profile::Sparse {
        if options.layers.len() > 1 {
            return Err(Error::invalid("--layers", "are for the dense profiles; give --bound or --posts"));
        }
        let ground = Ground::new(&units.heights).map_err(|e| told("heights", e))?;
        selected = match request.share {
            Some(share) => {
                let posts = (share * (grid.cols * grid.rows) as f64).round() as usize;
                select::Surplus.select(&ground, select::Until::Posts(posts))
            }
            None => select::Bound.select(&ground, select::Until::Above(f64::from(options.layers[0]))),
        };
        // Heights of the posts that are sent are exact.
        options.layers = vec![1];
        options.selected = Some(&selected);
    }
    let done = |share: f64| going("heights", share);
    let encoded = match request.picture {
        None => encode(&units.heights, &options, &mut Alone, &mut |share| done(share)),
        Some(picture) => {
            let square = Square {
                lattice,
                cols: grid.cols,
                rows: grid.rows,
                affine: grid.affine,
                crs: grid.crs.as_ref(),
            };
            let mut drape = Drape::new(square, picture)?;
            let n = request.cells_n.unwrap_or_else(|| drape.usual_n());
            let cells = drape.cells(n, going)?;
            notes.append(&mut drape.notes);
            if !going("texture", 0.0) {
                return Err(Error::Stopped);
            }
            let mut writer = Writer::new(&cells, &Settings::default()).map_err(|e| told("picture", e))?;
            options.texture = Some(n);
            encode(&units.heights, &options, &mut writer, &mut |share| done(share))
        }
    };
    let encoded = encoded.map_err(|e| told("heights", e))?;
    let error_max = match request.profile {
        Profile::Sparse => f64::from(encoded.error_max) * unit + units.place.given_error,
        _ => grid.error_of(&encoded.z, lattice.side(), &units.place),
    };
    let samples = (grid.cols * grid.rows) as u64;
    let sparse = request.profile == Profile::Sparse;
    let told = SentTold {
        bytes: encoded.bytes.len() as u64,
        samples,
        bits_per_sample: encoded.bytes.len() as f64 * 8.0 / samples as f64,
        error_max,
        unit,
        rounding: units.rounding,
        layers: if sparse {
            Vec::new()
        } else {
            options.layers.iter().map(|e| f64::from(*e) * unit).collect()
        },
        voids: units.heights.void.iter().filter(|v| **v).count() as u64,
        posts_sent: options.selected.map(|s| 4 + s.iter().filter(|s| **s).count() as u64),
        texture_side: options.texture.map(|n| 1 << n),
    };
    Ok(Sent { encoded, told, notes })
}

/// Bounds in units, none above what is asked less `rounding`, so that each layer divides the intervals of the one before:
/// 2E + 1 is an odd multiple, of 3 to 255, of the next. Found from fine to coarse.
fn layers(bounds: &[f64], rounding: f64, unit: f64) -> Result<Vec<u32>> {
    let mut out: Vec<u32> = Vec::new();
    for asked in bounds.iter().rev() {
        let most = units_within("--bound", *asked, rounding, unit)?.min(u64::from(BOUND_MAX));
        let Some(fine) = out.last().map(|e| 2 * u64::from(*e) + 1) else {
            out.push(most as u32);
            continue;
        };
        let factor = ((2 * most + 1) / fine).min(FACTOR_MAX);
        let factor = if factor.is_multiple_of(2) { factor.saturating_sub(1) } else { factor };
        if factor < 3 {
            return Err(Error::invalid(
                "--layers",
                format!(
                    "{asked} is too near to the finer layer of {}; each is about three times the next or more, as in 13,4,1,0",
                    (fine / 2) as f64 * unit
                ),
            ));
        }
        out.push(((fine * factor) / 2) as u32);
    }
    out.reverse();
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::layers;

    #[test]
    fn layers_divide_each_other_and_are_no_coarser_than_asked() {
        assert_eq!(layers(&[13.0, 4.0, 1.0, 0.0], 0.0, 1.0).unwrap(), [13, 4, 1, 0]);
        assert_eq!(layers(&[20.0, 0.0], 0.0, 1.0).unwrap(), [20, 0]);
        for (asked, unit) in
            [(vec![13.0, 4.0, 1.0, 0.0], 0.01), (vec![10.0, 1.0], 0.1), (vec![60.0, 0.5], 0.25)]
        {
            let found = layers(&asked, 0.0, unit).unwrap();
            for (a, f) in asked.iter().zip(&found) {
                assert!(f64::from(*f) * unit <= a + 1e-9, "{asked:?} {found:?}");
            }
            for pair in found.windows(2) {
                let (coarse, fine) = (2 * pair[0] + 1, 2 * pair[1] + 1);
                assert!(coarse % fine == 0 && (3..=255).contains(&(coarse / fine)), "{found:?}");
            }
        }
        // What rounding costs is taken off.
        assert_eq!(layers(&[0.5], 0.004, 0.01).unwrap(), [49]);
        for bad in [vec![1.0, 1.0], vec![0.0, 1.0], vec![-1.0], vec![f64::NAN]] {
            assert!(layers(&bad, 0.0, 1.0).is_err(), "{bad:?}");
        }
    }
}
