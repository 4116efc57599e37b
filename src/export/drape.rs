//! A picture onto the cells of a lattice: what colour the ground has.

use super::{Going, go_on};
use crate::base::{Error, Result, limits};
use crate::format::picture::{Picture, Pixels};
use crate::height::crs::{Crs, DatumChoice, Transform};
use crate::height::source::{Affine, Window};
use terraquilt_codecs::gtb::texture::Cells;
use terraquilt_codecs::lattice::Lattice;

/// Cells along a side are at most two to the power of this, unless more are asked for: pictures are analysed as a whole.
const CELLS_N_USUAL: u32 = 11;
/// Above so many pixels of the picture in a cell, the cell takes the mean of them.
const MEAN_FROM: f64 = 1.5;

/// The square of a lattice of 2^n + 1 posts a side, of which a rectangle in the north-west carries heights.
#[derive(Clone, Debug)]
pub struct Square<'a> {
    /// Its posts.
    pub lattice: Lattice,
    /// Posts in a row of the rectangle.
    pub cols: usize,
    /// Rows of the rectangle.
    pub rows: usize,
    /// Where the posts lie; `None`: nobody knows.
    pub affine: Option<Affine>,
    /// `None`: nobody knows.
    pub crs: Option<&'a Crs>,
}

/// A picture laid over a square.
pub struct Drape<'a> {
    square: Square<'a>,
    picture: &'a mut Picture,
    way: Way,
    /// What a person should know.
    pub notes: Vec<String>,
}

/// From posts (column, row) to pixels (column, row), both counted from centres.
enum Way {
    /// The picture is spread over the rectangle.
    Spread([f64; 2]),
    /// Over the ground.
    Ground { posts: Affine, crs: Option<Box<Transform>>, pixels: Affine },
}

impl<'a> Drape<'a> {
    /// Finds the way between the two. A picture without a place is spread over the rectangle, a pixel a post where they are as
    /// many; one without a CRS is taken to be in that of the heights.
    ///
    /// # Errors
    /// If the picture has a place and the heights have none, or no way leads from one CRS to the other.
    pub fn new(square: Square<'a>, picture: &'a mut Picture) -> Result<Drape<'a>> {
        let info = picture.info();
        let mut notes = info.notes.clone();
        let way = match (info.affine, square.affine) {
            (None, _) => {
                notes.push(format!("{} does not say where it lies; it is spread over the grid", info.file));
                Way::Spread([info.cols as f64 / square.cols as f64, info.rows as f64 / square.rows as f64])
            }
            (Some(_), None) => {
                return Err(Error::invalid(
                    &info.file,
                    "has a place, and the grid has none; give the grid a world file or a georeference, or the picture none",
                ));
            }
            (Some(pixels), Some(posts)) => {
                let crs = match (square.crs, &info.crs) {
                    (Some(a), Some(b)) if a.same_as(b) => None,
                    (Some(a), Some(b)) => {
                        let way = Transform::new(a, b, &DatumChoice::None)?;
                        notes.extend(way.notes().iter().cloned());
                        Some(Box::new(way))
                    }
                    (a, None) => {
                        let name = a.map_or("of the grid".to_string(), |c| c.code.clone());
                        notes.push(format!("{} names no CRS; its place is taken as {name}", info.file));
                        None
                    }
                    (None, Some(b)) => {
                        notes.push(format!("the grid names no CRS; its place is taken as {}", b.code));
                        None
                    }
                };
                Way::Ground { posts, crs, pixels }
            }
        };
        Ok(Drape { square, picture, way, notes })
    }

    /// The n of 2^n cells a side that are about as fine as the picture: at most [`CELLS_N_USUAL`], and no fewer cells than
    /// that make sense for the lattice.
    pub fn usual_n(&self) -> u32 {
        let [col, row] = [(self.square.cols / 2) as f64, (self.square.rows / 2) as f64];
        let pixels = self.pixels_of(col, row, 1.0).unwrap_or([1.0, 1.0]);
        let across = self.square.lattice.last() as f64 * pixels[0].max(pixels[1]);
        let n = across.max(1.0).log2().round() as u32;
        n.clamp(1, CELLS_N_USUAL)
    }

    /// The picture on 2^n x 2^n cells over the square, each the mean of its pixels where the picture is finer, else bilinear
    /// between pixel centres. Cells off the picture or over void pixels are void. Cells off the rectangle, which nobody sees, go on as the
    /// nearest of it. Holds the part of the picture that is needed and 4 bytes a cell.
    ///
    /// # Errors
    /// [`Error::Invalid`] if the picture has no pixel there; [`Error::Limit`] for n beyond that of a lattice and if the part of
    /// the picture is too large; as [`Picture::read`].
    pub fn cells(&mut self, n: u32, going: Going) -> Result<Cells> {
        if n > terraquilt_codecs::lattice::N_MAX {
            return Err(Error::limit(
                "n of 2^n cells a side",
                terraquilt_codecs::lattice::N_MAX.into(),
                n.into(),
            ));
        }
        let side = 1usize << n;
        let posts_a_cell = self.square.lattice.last() as f64 / side as f64;
        let Some(window) = self.window(side, posts_a_cell, going)? else {
            return Err(Error::invalid(
                &self.picture.info().file,
                "the picture lies beside the grid: no cell of it has a pixel; name a picture of the same ground",
            ));
        };
        let pixels = self.picture.read(window)?;
        let mut out = Cells { n, rgb: vec![[0; 3]; side * side], void: vec![true; side * side] };
        for i in 0..side {
            if i % 64 == 0 {
                go_on(going, "picture", 0.5 + 0.5 * i as f64 / side as f64)?;
            }
            for j in 0..side {
                let (row, col) = ((i as f64 + 0.5) * posts_a_cell, (j as f64 + 0.5) * posts_a_cell);
                let Some(p) = self.pixel(i, j, posts_a_cell) else { continue };
                let size = self.pixels_of(col, row, posts_a_cell).unwrap_or([1.0; 2]);
                let p = [p[0] - window.col as f64, p[1] - window.row as f64];
                let colour = if size[0].max(size[1]) > MEAN_FROM {
                    mean(&pixels, p, size)
                } else {
                    bilinear(&pixels, p)
                };
                if let Some(colour) = colour {
                    out.rgb[i * side + j] = colour;
                    out.void[i * side + j] = false;
                }
            }
        }
        self.go_on_outside(&mut out, posts_a_cell);
        if !out.void.contains(&true) {
            out.void.clear();
        }
        Ok(out)
    }

    /// Gives cells off the rectangle what the nearest cell of it has.
    fn go_on_outside(&self, cells: &mut Cells, posts_a_cell: f64) {
        let side = 1usize << cells.n;
        let inside = |posts: usize| (1..side).take_while(|k| begins_inside(*k, posts, posts_a_cell)).count();
        let (last_row, last_col) = (inside(self.square.rows), inside(self.square.cols));
        for k in 0..side * side {
            let (i, j) = (k / side, k % side);
            let from = i.min(last_row) * side + j.min(last_col);
            cells.rgb[k] = cells.rgb[from];
            cells.void[k] = cells.void[from];
        }
    }

    /// Column and row of the picture, counted from the centre of its first pixel, at the centre of a cell that touches the
    /// rectangle.
    fn pixel(&self, i: usize, j: usize, posts_a_cell: f64) -> Option<[f64; 2]> {
        let inside = |k: usize, posts: usize| begins_inside(k, posts, posts_a_cell);
        if !inside(i, self.square.rows) || !inside(j, self.square.cols) {
            return None;
        }
        let p = self.at((j as f64 + 0.5) * posts_a_cell, (i as f64 + 0.5) * posts_a_cell)?;
        let info = self.picture.info();
        let on = |v: f64, n: u64| v >= -0.5 && v < n as f64 - 0.5;
        (on(p[0], info.cols) && on(p[1], info.rows)).then_some(p)
    }

    /// The pixel at a post.
    fn at(&self, col: f64, row: f64) -> Option<[f64; 2]> {
        match &self.way {
            Way::Spread(scale) => Some([(col + 0.5) * scale[0] - 0.5, (row + 0.5) * scale[1] - 0.5]),
            Way::Ground { posts, crs, pixels } => {
                let p = [0, 1].map(|k| posts.origin[k] + col * posts.col_step[k] + row * posts.row_step[k]);
                let p = match crs {
                    None => p,
                    Some(way) => way.forward(p)?,
                };
                let d = [p[0] - pixels.origin[0], p[1] - pixels.origin[1]];
                let (c, r) = (pixels.col_step, pixels.row_step);
                let area = c[0] * r[1] - c[1] * r[0];
                let found = [(d[0] * r[1] - d[1] * r[0]) / area, (c[0] * d[1] - c[1] * d[0]) / area];
                found.iter().all(|v| v.is_finite()).then_some(found)
            }
        }
    }

    /// How many columns and rows of the picture a square of `size` posts around a post spans.
    fn pixels_of(&self, col: f64, row: f64, size: f64) -> Option<[f64; 2]> {
        let h = size / 2.0;
        let (w, e) = (self.at(col - h, row)?, self.at(col + h, row)?);
        let (n, s) = (self.at(col, row - h)?, self.at(col, row + h)?);
        Some([0, 1].map(|k| (e[k] - w[k]).abs().max((s[k] - n[k]).abs())))
    }

    /// The part of the picture under the square: around the centres of all its cells, and what their means reach.
    fn window(&self, side: usize, posts_a_cell: f64, going: Going) -> Result<Option<Window>> {
        let mut hull: Option<[[f64; 2]; 2]> = None;
        for i in 0..side {
            if i % 64 == 0 {
                go_on(going, "picture", 0.5 * i as f64 / side as f64)?;
            }
            for p in (0..side).filter_map(|j| self.pixel(i, j, posts_a_cell)) {
                let [low, high] = hull.unwrap_or([p, p]);
                hull = Some([[0, 1].map(|k| low[k].min(p[k])), [0, 1].map(|k| high[k].max(p[k]))]);
            }
        }
        let Some([low, high]) = hull else { return Ok(None) };
        let info = self.picture.info();
        let middle = [(self.square.cols / 2) as f64, (self.square.rows / 2) as f64];
        let reach = self.pixels_of(middle[0], middle[1], posts_a_cell).unwrap_or([1.0; 2]).map(|v| v + 2.0);
        let from = [0, 1].map(|k| (low[k] - reach[k]).floor().max(0.0) as u64);
        let end = [info.cols, info.rows];
        let to = [0, 1].map(|k| ((high[k] + reach[k]).ceil() as u64 + 1).min(end[k]));
        let [cols, rows] = [0, 1].map(|k| to[k] - from[k]);
        if cols * rows > limits::WINDOW_POSTS_MAX {
            let what = format!("pixels of {} under the grid (shrink it: gdal_translate -outsize)", info.file);
            return Err(Error::limit(what, limits::WINDOW_POSTS_MAX, cols * rows));
        }
        Ok(Some(Window { col: from[0], row: from[1], cols: cols as usize, rows: rows as usize }))
    }
}

/// Whether a row or column of cells touches the rectangle of so many posts.
fn begins_inside(k: usize, posts: usize, posts_a_cell: f64) -> bool {
    k == 0 || (k as f64) * posts_a_cell < (posts - 1) as f64
}

/// The mean of the pixels whose centres lie in a box around `p`; `None` if fewer than half of them have a colour.
fn mean(pixels: &Pixels, p: [f64; 2], size: [f64; 2]) -> Option<[u8; 3]> {
    let span = |k: usize, n: usize| {
        let first = (p[k] - size[k] / 2.0 + 0.5).floor().max(0.0) as usize;
        let last = ((p[k] + size[k] / 2.0 + 0.5).floor().max(0.0) as usize).max(first + 1);
        first.min(n - 1)..last.min(n)
    };
    let (mut sum, mut count, mut all) = ([0u64; 3], 0u64, 0u64);
    for row in span(1, pixels.rows) {
        for col in span(0, pixels.cols) {
            let at = row * pixels.cols + col;
            all += 1;
            if !pixels.void[at] {
                count += 1;
                (0..3).for_each(|k| sum[k] += u64::from(pixels.rgb[at][k]));
            }
        }
    }
    (2 * count >= all && count > 0).then(|| sum.map(|s| ((2 * s + count) / (2 * count)) as u8))
}

/// Between the four nearest centres, of those that have a colour; `None` if the nearest has none.
fn bilinear(pixels: &Pixels, p: [f64; 2]) -> Option<[u8; 3]> {
    let last = [pixels.cols - 1, pixels.rows - 1];
    let near = [0, 1].map(|k| (p[k].round().max(0.0) as usize).min(last[k]));
    if pixels.void[near[1] * pixels.cols + near[0]] {
        return None;
    }
    let low = p.map(f64::floor);
    let (mut sum, mut weight) = ([0.0; 3], 0.0);
    for (dy, dx) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
        let q = [low[0] + f64::from(dx), low[1] + f64::from(dy)];
        let w = (1.0 - (p[0] - q[0]).abs()) * (1.0 - (p[1] - q[1]).abs());
        let [col, row] = [0, 1].map(|k| (q[k].max(0.0) as usize).min(last[k]));
        let at = row * pixels.cols + col;
        if !pixels.void[at] && w > 0.0 {
            weight += w;
            (0..3).for_each(|k| sum[k] += w * f64::from(pixels.rgb[at][k]));
        }
    }
    (weight > 0.0).then(|| sum.map(|s| (s / weight + 0.5).clamp(0.0, 255.0) as u8))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pixels(cols: usize, rgb: &[u8], void: &[usize]) -> Pixels {
        Pixels {
            cols,
            rows: rgb.len() / cols,
            rgb: rgb.iter().map(|v| [*v; 3]).collect(),
            void: (0..rgb.len()).map(|k| void.contains(&k)).collect(),
        }
    }

    #[test]
    fn between_centres_colours_are_bilinear_and_voids_count_for_nothing() {
        let p = pixels(2, &[0, 100, 100, 200], &[]);
        assert_eq!(bilinear(&p, [0.0, 0.0]), Some([0; 3]));
        assert_eq!(bilinear(&p, [0.5, 0.5]), Some([100; 3]));
        assert_eq!(bilinear(&p, [-0.5, -0.5]), Some([0; 3]));
        let p = pixels(2, &[0, 100, 100, 200], &[0]);
        assert_eq!(bilinear(&p, [0.1, 0.1]), None);
        assert_eq!(bilinear(&p, [0.9, 0.0]), Some([100; 3]));
    }

    #[test]
    fn a_finer_picture_is_averaged() {
        let p = pixels(4, &[0, 2, 4, 6, 8, 10, 12, 14], &[]);
        assert_eq!(mean(&p, [0.5, 0.5], [2.0, 2.0]), Some([5; 3]));
        assert_eq!(mean(&p, [2.5, 0.5], [2.0, 2.0]), Some([9; 3]));
        let p = pixels(4, &[0, 2, 4, 6, 8, 10, 12, 14], &[0, 1, 4]);
        assert_eq!(mean(&p, [0.5, 0.5], [2.0, 2.0]), None);
    }
}
