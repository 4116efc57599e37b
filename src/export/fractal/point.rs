//! A tile as a function: its value at single points.

use super::{Opened, Zoom, zoom};
use crate::base::{Error, Result};
use crate::height::source::Affine;
use terraquilt_codecs::fractal::grid::Grid;
use terraquilt_codecs::fractal::walk::Walk;
use terraquilt_codecs::fractal::{Kind, Picture};

/// What a tile says of a point.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer {
    /// A height in its unit; a grey; red, green and blue; a distance in units of the mesh, positive inside.
    pub values: Vec<f64>,
    /// How far they are from the source's sample at most, in the same unit; `None` where nobody knows: of what is synthetic, and of tiles that are not whole.
    pub error: Option<f64>,
    /// Where the sample lies whose cell holds the point.
    pub sample: Vec<f64>,
}

/// A tile that is asked point by point.
pub struct Points<'a> {
    o: &'a Opened,
    zoom: Zoom,
    known: Known,
}

enum Known {
    /// Samples at zoom 1, and the maps where more is asked.
    Heights(Grid<2>, Option<Walk<2>>),
    Picture(Picture, Vec<Walk<2>>),
    Volume(Grid<3>, Option<Walk<3>>),
}

impl<'a> Points<'a> {
    /// Prepares a tile. At zoom 1 points get measured samples; above it what the maps say at that zoom.
    ///
    /// # Errors
    /// For a zoom below 1, and what decoding meets.
    pub fn new(o: &'a Opened, zoom: Zoom) -> Result<Points<'a>> {
        if zoom.get() < 1.0 {
            return Err(Error::invalid(
                "--zoom",
                format!("{}; points are asked at 1 (measured samples) or more", zoom.get()),
            ));
        }
        let walk = |k: usize| o.tile.walk(k).map_err(|e| o.told(e));
        let fine = zoom.is_synthetic();
        let known = match o.kind() {
            Kind::Heights => Known::Heights(zoom::measured(o, 0)?, fine.then(|| walk(0)).transpose()?),
            Kind::Grey | Kind::Colour => {
                let walks = (0..o.tile.planes.len()).filter(|_| fine).map(walk).collect::<Result<_>>()?;
                Known::Picture(o.tile.picture(1).map_err(|e| o.told(e))?, walks)
            }
            Kind::Volume => {
                let ifs = o.tile.volume.as_ref().filter(|_| fine);
                let walk = ifs.map(Walk::<3>::new).transpose().map_err(|e| o.told(e))?;
                Known::Volume(o.tile.volume().map_err(|e| o.told(e))?, walk)
            }
        };
        Ok(Points { o, zoom, known })
    }

    /// Coordinates of a point: two, three of a volume.
    pub fn axes(&self) -> usize {
        if self.o.kind() == Kind::Volume { 3 } else { 2 }
    }

    /// The value at a point in the coordinates of the source (of pictures: pixels from the upper left corner, downwards). `None` beyond the tile and
    /// where there is no data.
    pub fn value(&self, p: &[f64]) -> Option<Answer> {
        let depth = self.zoom.depth();
        let error =
            |unit: f64| self.o.worth.error_max.filter(|_| !self.zoom.is_synthetic()).map(|e| e * unit);
        match &self.known {
            Known::Heights(grid, walk) => {
                let affine = self.o.place.affine.unwrap_or(PIXELS);
                let at = to_samples(affine, [p[0], p[1]])?;
                let [col, row] = cell(at, grid.size)?;
                if self.o.tile.void.get(row * grid.size[0] + col).copied().unwrap_or(false) {
                    return None;
                }
                let units = match walk {
                    None => grid.values[row * grid.size[0] + col],
                    Some(walk) => walk.value(at, depth) + self.o.tile.added(col, row),
                };
                let [c, r] = [col as f64, row as f64];
                let sample = [0, 1]
                    .map(|k| affine.origin[k] + c * affine.col_step[k] + r * affine.row_step[k])
                    .to_vec();
                Some(Answer { values: vec![self.o.height(units)], error: error(1.0), sample })
            }
            Known::Picture(picture, walks) => {
                let at = [p[0], p[1]];
                let [col, row] = cell(at, [picture.cols, picture.rows])?;
                let n = picture.channels;
                let bytes = match &walks[..] {
                    [] => picture.samples[(row * picture.cols + col) * n..][..n].to_vec(),
                    walks => self.pixel(walks, at, depth)?,
                };
                let values = bytes.into_iter().map(f64::from).collect();
                Some(Answer { values, error: error(1.0), sample: vec![col as f64 + 0.5, row as f64 + 0.5] })
            }
            Known::Volume(grid, walk) => {
                let space = self.o.tile.header.space?;
                let at = [0, 1, 2].map(|k| (p[k] - space.origin[k]) / space.voxel + 0.5);
                let cell = cell(at, grid.size)?;
                let eighths = match walk {
                    None => grid.values[grid.at(cell)],
                    Some(walk) => walk.value(at, depth),
                };
                let unit = space.voxel / 8.0;
                let sample = (0..3).map(|k| space.origin[k] + cell[k] as f64 * space.voxel).collect();
                Some(Answer { values: vec![eighths * unit], error: error(unit), sample })
            }
        }
    }

    /// The colour at a point, by the maps.
    fn pixel(&self, walks: &[Walk<2>], at: [f64; 2], depth: u32) -> Option<Vec<u8>> {
        let planes: Vec<Grid<2>> = walks
            .iter()
            .zip(&self.o.tile.planes)
            .map(|(walk, ifs)| {
                let by = self.o.tile.header.smaller(&ifs.shape) as f64;
                Grid { size: [1, 1], values: vec![walk.value(at.map(|v| v / by), depth)] }
            })
            .collect();
        self.o.tile.picture_of(&planes, [1, 1]).ok().map(|p| p.samples)
    }
}

/// Where nothing is known: columns and rows from the first sample, rows downwards.
pub(super) const PIXELS: Affine = Affine { origin: [0.0; 2], col_step: [1.0, 0.0], row_step: [0.0, -1.0] };

/// A point in samples from the corner of the tile.
fn to_samples(a: Affine, p: [f64; 2]) -> Option<[f64; 2]> {
    let area = a.col_step[0] * a.row_step[1] - a.col_step[1] * a.row_step[0];
    let d = [p[0] - a.origin[0], p[1] - a.origin[1]];
    let col = (d[0] * a.row_step[1] - d[1] * a.row_step[0]) / area;
    let row = (a.col_step[0] * d[1] - a.col_step[1] * d[0]) / area;
    (col.is_finite() && row.is_finite()).then_some([col + 0.5, row + 0.5])
}

/// The sample that holds a point; one on the far border belongs to the last.
fn cell<const D: usize>(at: [f64; D], size: [usize; D]) -> Option<[usize; D]> {
    let inside = (0..D).all(|a| at[a] >= 0.0 && at[a] <= size[a] as f64);
    inside.then(|| std::array::from_fn(|a| (at[a] as usize).min(size[a] - 1)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_find_their_samples_in_turned_grids_too() {
        let a = Affine { origin: [100.0, 50.0], col_step: [2.0, 1.0], row_step: [1.0, -2.0] };
        for (c, r) in [(0.0, 0.0), (3.25, 7.5), (-0.5, 2.0)] {
            let p = [0, 1].map(|k| a.origin[k] + c * a.col_step[k] + r * a.row_step[k]);
            let at = to_samples(a, p).unwrap();
            assert!((at[0] - c - 0.5).abs() < 1e-12 && (at[1] - r - 0.5).abs() < 1e-12);
        }
        assert_eq!(cell([0.0, 3.0], [4, 3]), Some([0, 2]));
        assert_eq!(cell([-0.1, 3.0], [4, 3]), None);
        assert_eq!(cell([4.1, 0.0], [4, 3]), None);
        assert_eq!(cell([f64::NAN, 0.0], [4, 3]), None);
    }
}
