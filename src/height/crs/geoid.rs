//! Geoid undulations on a grid in longitude and latitude: metres from the ellipsoid up to the zero of heights.

use crate::base::limits::GEOID_POSTS_MAX;
use crate::base::{Error, Result};

/// A grid of undulations, given by the user as a file.
///
/// Between posts values are bilinear, as PROJ's vertical shifts are. Longitudes are taken modulo 360; a grid that
/// goes all the way round continues over its edge.
pub struct Geoid {
    name: String,
    digest: String,
    west: f64,
    south: f64,
    step: [f64; 2],
    cols: usize,
    rows: usize,
    /// Row-major from the south-west; NaN where there is none.
    values: Vec<f32>,
    /// Columns after which it starts again; 0 for a grid that does not go round.
    round: usize,
}

impl Geoid {
    /// `west`, `south`: position of the first value in degrees; `step`: degrees between columns and rows; values
    /// row by row from the south, NaN where there is none.
    ///
    /// # Errors
    /// If sizes do not fit, or the grid does not lie on the globe.
    pub fn new(
        name: &str,
        [west, south]: [f64; 2],
        step: [f64; 2],
        [cols, rows]: [usize; 2],
        values: Vec<f32>,
    ) -> Result<Geoid> {
        let posts = (cols as u64).saturating_mul(rows as u64);
        if posts > GEOID_POSTS_MAX {
            return Err(Error::limit(format!("posts of {name}"), GEOID_POSTS_MAX, posts));
        }
        let north = south + step[1] * rows.saturating_sub(1) as f64;
        let width = step[0] * cols.saturating_sub(1) as f64;
        let slack = 1e-6;
        let sound = cols >= 2
            && rows >= 2
            && values.len() as u64 == posts
            && step.iter().all(|s| s.is_finite() && *s > 0.0)
            && (-360.0..=360.0).contains(&west)
            && south >= -90.0 - slack
            && north <= 90.0 + slack
            && width <= 360.0 + step[0];
        if !sound {
            return Err(Error::corrupt(
                name,
                "header of the geoid grid",
                format!(
                    "{cols} x {rows} values from ({west}, {south}) by ({}, {}) degrees do not lie on the globe",
                    step[0], step[1]
                ),
            ));
        }
        // Columns of a full turn; a last column may repeat the first.
        let turn = 360.0 / step[0];
        let whole = (turn - turn.round()).abs() < 1e-4;
        let round = if whole && cols as f64 >= turn.round() { turn.round() as usize } else { 0 };
        let mut hash = blake3::Hasher::new();
        for v in [west, south, step[0], step[1]] {
            hash.update(&v.to_le_bytes());
        }
        hash.update(&(cols as u64).to_le_bytes());
        for v in &values {
            hash.update(&v.to_le_bytes());
        }
        let digest = hash.finalize().to_hex()[..32].to_string();
        Ok(Geoid { name: name.to_string(), digest, west, south, step, cols, rows, values, round })
    }

    /// The file it came from.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// First 32 hexadecimal digits of the blake3 hash of positions and values: equal for equal grids, whatever
    /// the format of their files.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// West, south, east, north of the values, degrees.
    pub fn bounds(&self) -> [f64; 4] {
        let width = if self.round > 0 { 360.0 } else { self.step[0] * (self.cols - 1) as f64 };
        let north = self.south + self.step[1] * (self.rows - 1) as f64;
        [self.west, self.south, self.west + width, north]
    }

    /// Metres at a place given in degrees; None outside the grid, and beside posts without a value.
    pub fn undulation(&self, lon: f64, lat: f64) -> Option<f64> {
        let (col, x) = self.place_in_columns(lon)?;
        let (row, y) = place((lat - self.south) / self.step[1], self.rows)?;
        let next = if self.round > 0 { (col + 1) % self.round } else { col + 1 };
        let at = |c: usize, r: usize| f64::from(self.values[r * self.cols + c]);
        let lower = at(col, row) * (1.0 - x) + at(next, row) * x;
        let upper = at(col, row + 1) * (1.0 - x) + at(next, row + 1) * x;
        let value = lower * (1.0 - y) + upper * y;
        value.is_finite().then_some(value)
    }

    fn place_in_columns(&self, lon: f64) -> Option<(usize, f64)> {
        let from_west = lon - self.west;
        // Into one turn, forgiving a rounding error at the western edge.
        let turned = from_west - 360.0 * ((from_west + EDGE_DEGREES) / 360.0).floor();
        if self.round == 0 {
            return place(turned / self.step[0], self.cols);
        }
        if !turned.is_finite() {
            return None;
        }
        let at = (turned / self.step[0]).max(0.0);
        let col = at.floor();
        Some((col as usize % self.round, at - col))
    }

    /// Whether every place of a rectangle (west, south, east, north in degrees) is within the grid.
    pub fn covers(&self, [west, south, east, north]: [f64; 4]) -> bool {
        let [w, s, e, n] = self.bounds();
        let rows = south >= s - EDGE_DEGREES && north <= n + EDGE_DEGREES;
        let turned = west - w - 360.0 * ((west - w + EDGE_DEGREES) / 360.0).floor();
        rows && (self.round > 0 || turned + (east - west) <= e - w + EDGE_DEGREES)
    }
}

/// A ten-thousandth of a second of arc: places as far outside count as the edge.
const EDGE_DEGREES: f64 = 3e-8;

/// Cell and place within it of a coordinate in steps; None outside.
fn place(at: f64, posts: usize) -> Option<(usize, f64)> {
    let last = (posts - 1) as f64;
    let slack = 1e-5;
    if !(at >= -slack && at <= last + slack) {
        return None;
    }
    let at = at.clamp(0.0, last);
    let cell = at.floor().min(last - 1.0);
    Some((cell as usize, at - cell))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(west: f64, step: f64, cols: usize, rows: usize) -> Geoid {
        let values = (0..cols * rows).map(|i| ((i % cols) * 10 + i / cols) as f32).collect();
        Geoid::new("test", [west, -10.0], [step, 1.0], [cols, rows], values).unwrap()
    }

    #[test]
    fn bilinear_within_and_nothing_outside() {
        let g = grid(10.0, 1.0, 3, 4);
        assert_eq!(g.undulation(10.0, -10.0), Some(0.0));
        assert_eq!(g.undulation(12.0, -7.0), Some(23.0));
        assert_eq!(g.undulation(370.25, -9.5), Some(3.0));
        assert_eq!(g.undulation(-348.0, -7.0), Some(23.0));
        assert!(g.undulation(9.9, -9.0).is_none() && g.undulation(12.1, -9.0).is_none());
        assert!(g.undulation(11.0, -6.9).is_none() && g.undulation(f64::NAN, -9.0).is_none());
        assert!(g.covers([10.0, -10.0, 12.0, -7.0]) && g.covers([-350.0, -10.0, -348.0, -7.0]));
        assert!(!g.covers([10.0, -10.0, 12.5, -7.0]) && !g.covers([9.0, -10.0, 12.0, -7.0]));
    }

    #[test]
    fn a_full_turn_has_no_edge() {
        for cols in [36, 37] {
            let mut g = grid(0.0, 10.0, cols, 2);
            if cols == 37 {
                // The last column repeats the first.
                for row in 0..2 {
                    g.values[row * 37 + 36] = g.values[row * 37];
                }
            }
            assert_eq!(g.undulation(355.0, -10.0), Some((350.0 + 0.0) / 2.0), "{cols}");
            assert_eq!(g.undulation(-5.0, -10.0), g.undulation(355.0, -10.0));
            assert_eq!(g.undulation(360.0, -10.0), Some(0.0));
            assert!(g.covers([170.0, -10.0, 190.0, -9.0]));
        }
    }

    #[test]
    fn odd_headers_are_refused() {
        let new = |at, step, size: [usize; 2]| {
            Geoid::new("test", at, step, size, vec![0.0; size[0].saturating_mul(size[1]).min(100)]).err()
        };
        assert!(new([0.0, 0.0], [1.0, 1.0], [1, 10]).is_some());
        assert!(new([0.0, 85.0], [1.0, 1.0], [10, 10]).is_some());
        assert!(new([0.0, 0.0], [0.0, 1.0], [10, 10]).is_some());
        assert!(new([f64::NAN, 0.0], [1.0, 1.0], [10, 10]).is_some());
        let text = new([0.0, 0.0], [1.0, 1.0], [1 << 20, 1 << 20]).unwrap().to_string();
        assert!(text.contains("at most"), "{text}");
    }
}
