//! A grid of heights, and the same heights as integers of a unit.

use crate::base::{Error, Result, limits};
use crate::export::{Going, go_on};
use crate::height::crs::Crs;
use crate::height::crs::vertical::{FOOT_M, US_FOOT_M};
use crate::height::source::{Affine, HeightSource, SampleType, Window};
use rayon::prelude::*;
use terraquilt_codecs::gtb::{Heights, Place, heights::HEIGHT_MAX};

/// Units that are tried for heights that are not integers: the first of which all are multiples, else the last.
const UNITS: [f64; 3] = [1.0, 0.1, 0.01];

/// Heights of a rectangle as numbers, row by row from the first (as a rule northernmost) row, and where they lie.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    /// Posts in a row.
    pub cols: usize,
    /// Rows.
    pub rows: usize,
    /// `cols * rows` heights; NaN: no data.
    pub z: Vec<f64>,
    /// Whether they were float32: numbers that come back as the same float32 are the same.
    pub single: bool,
    /// Unit and base of what are integers in the source.
    pub whole: Option<[f64; 2]>,
    /// Where the posts lie; `None`: nobody knows.
    pub affine: Option<Affine>,
    /// Coordinate system of the posts.
    pub crs: Option<Crs>,
    /// What heights count from, as [`VerticalDatum`](crate::height::crs::vertical::VerticalDatum) records it.
    pub vertical_datum: Option<String>,
    /// Metres of one unit of height; `None`: not said.
    pub vertical_unit_m: Option<f64>,
    /// How wrong the heights are before they are coded, in their unit.
    pub given_error: f64,
    /// What they come from.
    pub source: String,
    /// What a person should know of the samples.
    pub notes: Vec<String>,
}

/// A grid as the codec takes it.
#[derive(Clone, Debug)]
pub struct Units {
    /// Integers of the unit.
    pub heights: Heights,
    /// Where they lie. Its `given_error` is that of the grid and `rounding`.
    pub place: Place,
    /// The most that a height changes by becoming a multiple of the unit; 0 if none changes.
    pub rounding: f64,
}

impl Grid {
    /// Reads a whole file: 8 bytes a post. Heights are those of the file, in its own unit, its scale and offset applied.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond the side of a lattice; what the reader meets.
    pub fn read(source: &mut dyn HeightSource, going: Going) -> Result<Grid> {
        Grid::read_within(source, limits::LATTICE_SIDE_MAX, u64::MAX, going)
    }

    /// As [`read`](Grid::read), of so many posts along a side and in all.
    ///
    /// # Errors
    /// [`Error::Limit`] beyond, before anything is allocated; what the reader meets.
    pub fn read_within(
        source: &mut dyn HeightSource,
        side_max: u64,
        posts_max: u64,
        going: Going,
    ) -> Result<Grid> {
        let info = source.info().clone();
        let posts = info.cols.saturating_mul(info.rows);
        for (what, limit, wanted) in
            [("posts along a side", side_max, info.cols.max(info.rows)), ("posts", posts_max, posts)]
        {
            if wanted > limit {
                return Err(Error::limit(
                    format!("{what} of {} (cut it into tiles)", info.file),
                    limit,
                    wanted,
                ));
            }
        }
        let (cols, rows) = (info.cols as usize, info.rows as usize);
        let mut z = vec![f64::NAN; cols * rows];
        let batch = source.row_batch().max(1);
        for row in (0..rows).step_by(batch) {
            go_on(going, "reading", row as f64 / rows as f64)?;
            let n = batch.min(rows - row);
            let found = source.read(Window { col: 0, row: row as u64, cols, rows: n })?;
            let out = &mut z[row * cols..(row + n) * cols];
            info.sample_type.values(&found.data, out);
            for (v, valid) in out.iter_mut().zip(&found.valid) {
                *v = if *valid == 0 { f64::NAN } else { *v * info.scale + info.offset };
            }
        }
        let known = z.iter().filter(|z| !z.is_nan());
        let [low, high] = known.fold([f64::INFINITY, f64::NEG_INFINITY], |[l, h], z| [l.min(*z), h.max(*z)]);
        let notes = info.suspect([low, high].map(|z| (z - info.offset) / info.scale)).into_iter().collect();
        let whole = !info.sample_type.is_float() && info.scale.is_finite() && info.scale != 0.0;
        Ok(Grid {
            cols,
            rows,
            z,
            single: info.sample_type == SampleType::F32,
            whole: whole.then_some([info.scale.abs(), info.offset]),
            affine: info.affine,
            crs: info.crs,
            vertical_datum: info.vertical_datum,
            vertical_unit_m: info.vertical_unit_m,
            given_error: 0.0,
            source: name_of(&info.file),
            notes,
        })
    }

    /// The unit that is taken where none is asked for: that of the integers in the file; of other heights the coarsest of 1,
    /// 0.1 and 0.01 of which all are multiples, else 0.01.
    pub fn usual_unit(&self) -> f64 {
        if let Some([unit, _]) = self.whole {
            return unit;
        }
        let last = UNITS[UNITS.len() - 1];
        UNITS.into_iter().find(|unit| self.z.par_iter().all(|z| self.is_multiple(*z, *unit))).unwrap_or(last)
    }

    fn is_multiple(&self, z: f64, unit: f64) -> bool {
        z.is_nan() || self.change(z, (z / unit).round() * unit) == 0.0
    }

    /// How far `now` is from `z`: nothing if both are the same float32 and that is what the heights were, or if they differ in
    /// the last digits of a double, by the arithmetic alone.
    pub fn change(&self, z: f64, now: f64) -> f64 {
        let off = (now - z).abs();
        let same = self.single && now as f32 == z as f32 || off <= 4.0 * f64::EPSILON * z.abs();
        if same { 0.0 } else { off }
    }

    /// The heights as integers of a unit, above a base that is 0 (or the file's offset), or near the lowest height where 0 is
    /// too far.
    ///
    /// # Errors
    /// If the unit is no positive number, or the heights span too many of it.
    pub fn in_units(&self, unit: f64) -> Result<Units> {
        if !(unit.is_finite() && unit > 0.0) {
            return Err(Error::invalid("--unit", format!("{unit}; a positive number is needed")));
        }
        let data = self.z.par_iter().copied().filter(|z| !z.is_nan());
        let low = data.clone().reduce(|| f64::INFINITY, f64::min);
        let high = data.reduce(|| f64::NEG_INFINITY, f64::max);
        let most = f64::from(HEIGHT_MAX);
        let mut base = self.whole.map_or(0.0, |[_, base]| base);
        if low <= high && ((low - base).abs() / unit > most || (high - base).abs() / unit > most) {
            base += ((low - base) / unit).floor() * unit;
        }
        if low <= high && (high - base) / unit > most {
            return Err(Error::invalid(
                "--unit",
                format!(
                    "heights from {low:.4e} to {high:.4e} are {:.4e} units of {unit}, {most:.0} are allowed; take a larger unit",
                    (high - low) / unit
                ),
            ));
        }
        let z: Vec<i32> = self
            .z
            .par_iter()
            .map(|z| if z.is_nan() { 0 } else { ((z - base) / unit).round() as i32 })
            .collect();
        let void = self.z.par_iter().any(|z| z.is_nan());
        let void = if void { self.z.par_iter().map(|z| z.is_nan()).collect() } else { Vec::new() };
        let changes = self.z.par_iter().zip(&z).filter(|(z, _)| !z.is_nan());
        let rounding =
            changes.map(|(z, k)| self.change(*z, base + unit * f64::from(*k))).reduce(|| 0.0, f64::max);
        let place = Place {
            unit,
            base,
            given_error: self.given_error + rounding,
            transform: self.affine.map_or(Place::default().transform, transform_of),
            crs: self.crs.as_ref().map_or(String::new(), |c| c.code.clone()),
            vertical: vertical_of(self.vertical_unit_m, self.vertical_datum.as_deref()),
            source: self.source.clone(),
        };
        Ok(Units { heights: Heights { cols: self.cols, rows: self.rows, z, void }, place, rounding })
    }

    /// The greatest difference of heights of the lattice, as a receiver has them, from these; at posts with data.
    pub fn error_of(&self, z: &[i32], side: usize, place: &Place) -> f64 {
        let rows = self.z.par_chunks(self.cols).zip(z.par_chunks(side));
        let worst = |(mine, theirs): (&[f64], &[i32])| {
            let of = mine.iter().zip(theirs).filter(|(z, _)| !z.is_nan());
            of.map(|(z, k)| self.change(*z, place.base + place.unit * f64::from(*k))).fold(0.0, f64::max)
        };
        self.given_error + rows.map(worst).reduce(|| 0.0, f64::max)
    }
}

/// Whole units that an error in the unit of heights leaves to the codec, `rounding` taken off. `option` is what asked for it.
///
/// # Errors
/// If it is no number of at least 0.
pub fn units_within(option: &str, asked: f64, rounding: f64, unit: f64) -> Result<u64> {
    if !(asked.is_finite() && asked >= 0.0) {
        return Err(Error::invalid(option, format!("{asked}; a bound is a number of at least 0")));
    }
    Ok(((asked - rounding).max(0.0) / unit + 1e-9).floor() as u64)
}

/// The last part of a path.
pub fn name_of(file: &str) -> String {
    let name = file.rsplit('/').next().unwrap_or(file);
    name.chars().filter(|c| !c.is_control()).take(200).collect()
}

/// Six numbers as [`Place`] has them.
fn transform_of(a: Affine) -> [f64; 6] {
    [a.origin[0], a.col_step[0], a.row_step[0], a.origin[1], a.col_step[1], a.row_step[1]]
}

/// Unit and datum of heights in one text: `m`, `ft`, `us-ft`, metres of another unit, `?` if only the datum is known.
fn vertical_of(unit_m: Option<f64>, datum: Option<&str>) -> String {
    let unit = match unit_m {
        None if datum.is_none() => return String::new(),
        None => "?".to_string(),
        Some(1.0) => "m".to_string(),
        Some(u) if u == FOOT_M => "ft".to_string(),
        Some(u) if u == US_FOOT_M => "us-ft".to_string(),
        Some(u) => u.to_string(),
    };
    datum.map_or(unit.clone(), |d| format!("{unit} {d}"))
}

/// A grid without heights that lies where a [`Place`] says; what cannot be read of it becomes a note.
pub fn place_of(place: &Place, notes: &mut Vec<String>) -> Grid {
    let t = place.transform;
    let crs = (!place.crs.is_empty()).then(|| Crs::parse(&place.crs));
    let crs = match crs {
        Some(Err(e)) => {
            notes.push(format!("the CRS '{}' is not understood: {e}", shortened(&place.crs)));
            None
        }
        Some(Ok(crs)) => Some(crs),
        None => None,
    };
    let known = t != Place::default().transform || crs.is_some();
    let area = t[1] * t[5] - t[2] * t[4];
    if known && (area == 0.0 || !area.is_finite()) {
        notes.push(format!("the steps of the place {t:?} span no area; it is left out"));
    }
    let affine = Affine { origin: [t[0], t[3]], col_step: [t[1], t[4]], row_step: [t[2], t[5]] };
    let (unit, datum) = match place.vertical.split_once(' ') {
        Some((unit, datum)) => (unit, Some(datum.trim()).filter(|d| !d.is_empty())),
        None => (place.vertical.as_str(), None),
    };
    let number = || unit.parse().ok().filter(|m: &f64| m.is_finite() && *m > 0.0);
    Grid {
        affine: (known && area != 0.0 && area.is_finite()).then_some(affine),
        crs,
        vertical_datum: datum.map(str::to_string),
        vertical_unit_m: crate::height::crs::vertical::unit_metres(unit).or_else(number),
        given_error: place.given_error,
        source: place.source.clone(),
        ..Grid::default()
    }
}

fn shortened(text: &str) -> String {
    text.chars().filter(|c| !c.is_control()).take(80).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(z: &[f64]) -> Grid {
        Grid { cols: z.len(), rows: 1, z: z.to_vec(), ..Grid::default() }
    }

    #[test]
    fn the_coarsest_unit_that_loses_nothing_is_taken() {
        assert_eq!(grid(&[1.0, -7.0, f64::NAN]).usual_unit(), 1.0);
        assert_eq!(grid(&[1.5, 2.0]).usual_unit(), 0.1);
        assert_eq!(grid(&[1.234567, 2.0]).usual_unit(), 0.01);
        let single = Grid { single: true, ..grid(&[f64::from(1.1f32), f64::from(2345.7f32)]) };
        assert_eq!(single.usual_unit(), 0.1);
        assert_eq!(single.in_units(0.1).unwrap().rounding, 0.0);
        assert_eq!(Grid { whole: Some([0.25, 3.0]), ..grid(&[3.25]) }.usual_unit(), 0.25);
    }

    #[test]
    fn rounding_is_measured_and_the_base_moves_only_where_it_must() {
        let u = grid(&[1.004, 2.0, f64::NAN]).in_units(0.01).unwrap();
        assert_eq!((u.heights.z, u.heights.void), (vec![100, 200, 0], vec![false, false, true]));
        assert!((u.rounding - 0.004).abs() < 1e-12 && u.place.base == 0.0);
        let u = grid(&[4e9, 4e9 + 5.0]).in_units(1.0).unwrap();
        assert_eq!((u.place.base, u.heights.z), (4e9, vec![0, 5]));
        let text = grid(&[0.0, 4e9]).in_units(1.0).unwrap_err().to_string();
        assert!(text.contains("larger unit"), "{text}");
        assert!(grid(&[0.0]).in_units(0.0).is_err() && grid(&[0.0]).in_units(f64::NAN).is_err());
    }

    #[test]
    fn a_place_comes_back() {
        let crs = Crs::parse("EPSG:32610").unwrap();
        let affine = Affine { origin: [5.0, 6.0], col_step: [2.0, 0.5], row_step: [0.25, -2.0] };
        for (unit, datum) in [
            (Some(1.0), Some("EPSG:5703")),
            (Some(FOOT_M), None),
            (None, Some("own datum")),
            (None, None),
            (Some(0.25), None),
        ] {
            let from = Grid {
                affine: Some(affine),
                crs: Some(crs.clone()),
                vertical_unit_m: unit,
                vertical_datum: datum.map(str::to_string),
                ..grid(&[1.0])
            };
            let mut notes = Vec::new();
            let back = place_of(&from.in_units(1.0).unwrap().place, &mut notes);
            assert_eq!((back.affine, back.crs), (Some(affine), Some(crs.clone())));
            assert_eq!((back.vertical_unit_m, back.vertical_datum), (unit, from.vertical_datum));
            assert!(notes.is_empty());
        }
        assert!(place_of(&grid(&[1.0]).in_units(1.0).unwrap().place, &mut Vec::new()).affine.is_none());
    }
}
