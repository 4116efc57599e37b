//! A raster of tolerances: how much error is allowed at each post, bilinear between posts, and beyond the border what the
//! nearest place of the border allows (section 5.2 of the LOD-space specification).

use super::Cut;
use crate::base::{Error, Result, limits};
use crate::height::source::Affine;
use std::sync::Arc;

/// Tolerances at the posts of a grid, metres, with a pyramid of their least and greatest values.
#[derive(Clone, Debug, PartialEq)]
pub struct ErrorRaster {
    cols: usize,
    rows: usize,
    /// Row by row.
    values: Vec<f32>,
    /// Level k holds (least, greatest) of squares of 2^(k+1) posts: columns, rows, pairs.
    pyramid: Vec<(usize, usize, Vec<[f32; 2]>)>,
    /// Position of post (0, 0), CRS units.
    origin: [f64; 2],
    /// Index coordinates of one CRS unit in x and y: `index = by_x dx + by_y dy`.
    by_x: [f64; 2],
    by_y: [f64; 2],
    affine: Affine,
}

/// Squares of the pyramid looked at along one side of a region, at most about so many.
const LOOK: usize = 8;

impl ErrorRaster {
    /// `values` row by row, `affine` says where the posts lie.
    ///
    /// # Errors
    /// If a value is negative or not a number, the grid has no post or no area, or more than
    /// [`limits::TOLERANCE_POSTS_MAX`] posts.
    pub fn new(cols: usize, rows: usize, values: Vec<f32>, affine: &Affine) -> Result<ErrorRaster> {
        let what = "--error-raster";
        let posts = cols as u64 * rows as u64;
        if posts > limits::TOLERANCE_POSTS_MAX {
            return Err(Error::limit("posts of --error-raster", limits::TOLERANCE_POSTS_MAX, posts));
        }
        if posts == 0 || values.len() as u64 != posts {
            return Err(Error::invalid(what, format!("{} values for {cols} x {rows} posts", values.len())));
        }
        if let Some(k) = values.iter().position(|v| !(*v >= 0.0 && v.is_finite())) {
            return Err(Error::invalid(
                what,
                format!(
                    "{} in column {}, row {}; every post needs an error of 0 or more (fill voids first)",
                    values[k],
                    k % cols,
                    k / cols
                ),
            ));
        }
        let (u, v) = (affine.col_step, affine.row_step);
        let d = u[0] * v[1] - u[1] * v[0];
        if !(d != 0.0 && d.is_finite() && affine.origin.iter().all(|v| v.is_finite())) {
            return Err(Error::invalid(what, format!("its steps {u:?} and {v:?} span no area")));
        }
        let mut pyramid: Vec<(usize, usize, Vec<[f32; 2]>)> = Vec::new();
        loop {
            let (w, h) = pyramid.last().map_or((cols, rows), |l| (l.0, l.1));
            if w <= 1 && h <= 1 {
                break;
            }
            let below = |x: usize, y: usize| match pyramid.last() {
                Some(l) => l.2[y * w + x],
                None => [values[y * w + x]; 2],
            };
            let (nw, nh) = (w.div_ceil(2), h.div_ceil(2));
            let mut level = Vec::with_capacity(nw * nh);
            for y in 0..nh {
                for x in 0..nw {
                    let (x1, y1) = ((2 * x + 1).min(w - 1), (2 * y + 1).min(h - 1));
                    let four = [below(2 * x, 2 * y), below(x1, 2 * y), below(2 * x, y1), below(x1, y1)];
                    level.push(four.into_iter().fold([f32::MAX, 0.0], wider));
                }
            }
            pyramid.push((nw, nh, level));
        }
        Ok(ErrorRaster {
            cols,
            rows,
            values,
            pyramid,
            origin: affine.origin,
            by_x: [v[1] / d, -u[1] / d],
            by_y: [-v[0] / d, u[0] / d],
            affine: *affine,
        })
    }

    /// Columns, rows, tolerances row by row, and where the posts lie.
    pub fn posts(&self) -> (usize, usize, &[f32], &Affine) {
        (self.cols, self.rows, &self.values, &self.affine)
    }

    /// Index coordinates of a point, not yet kept on the grid.
    fn index(&self, p: [f64; 2]) -> [f64; 2] {
        let d = [p[0] - self.origin[0], p[1] - self.origin[1]];
        [0, 1].map(|k| self.by_x[k] * d[0] + self.by_y[k] * d[1])
    }

    /// Whether a point lies between the posts.
    pub fn covers(&self, p: [f64; 2]) -> bool {
        let [i, j] = self.index(p);
        i >= -1e-9 && j >= -1e-9 && i <= self.cols as f64 - 1.0 + 1e-9 && j <= self.rows as f64 - 1.0 + 1e-9
    }

    /// Along one axis: the post before, the part of the way to the next, and whether the coordinate is on the grid.
    fn along(index: f64, posts: usize) -> (usize, f64, bool) {
        let last = (posts - 1) as f64;
        let kept = if index.is_nan() { 0.0 } else { index.clamp(0.0, last) };
        let before = kept.floor().min((last - 1.0).max(0.0));
        (before as usize, kept - before, posts > 1 && index > 0.0 && index < last)
    }

    /// The four tolerances around a point, the parts of the way between them, and which axes it moves along.
    fn around(&self, p: [f64; 2]) -> ([[f64; 2]; 2], [f64; 2], [bool; 2]) {
        let index = self.index(p);
        let (i, s, on_x) = Self::along(index[0], self.cols);
        let (j, t, on_y) = Self::along(index[1], self.rows);
        let value = |i: usize, j: usize| {
            f64::from(self.values[j.min(self.rows - 1) * self.cols + i.min(self.cols - 1)])
        };
        ([[value(i, j), value(i + 1, j)], [value(i, j + 1), value(i + 1, j + 1)]], [s, t], [on_x, on_y])
    }
}

fn wider(a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
    [a[0].min(b[0]), a[1].max(b[1])]
}

impl Cut for ErrorRaster {
    fn bounds(&self, polygon: &[[f64; 2]]) -> (f64, f64) {
        let (mut lo, mut hi) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in polygon {
            let index = self.index(*p);
            for k in 0..2 {
                // The last digits of index coordinates: a hair wider than the polygon.
                let slack = 1e-9 + 1e-12 * index[k].abs();
                lo[k] = lo[k].min(index[k] - slack);
                hi[k] = hi[k].max(index[k] + slack);
            }
        }
        let side = |k: usize, posts: usize| {
            let last = (posts - 1) as f64;
            (lo[k].clamp(0.0, last).floor() as usize, hi[k].clamp(0.0, last).ceil() as usize)
        };
        let ((i0, i1), (j0, j1)) = (side(0, self.cols), side(1, self.rows));
        let mut level = 0;
        while level < self.pyramid.len() && ((i1 - i0).max(j1 - j0) >> level) > LOOK {
            level += 1;
        }
        let mut found = [f32::MAX, 0.0];
        for j in j0 >> level..=j1 >> level {
            for i in i0 >> level..=i1 >> level {
                let here = match level {
                    0 => [self.values[j * self.cols + i]; 2],
                    _ => {
                        let (w, _, pairs) = &self.pyramid[level - 1];
                        pairs[j * w + i]
                    }
                };
                found = wider(found, here);
            }
        }
        (f64::from(found[0]) * (1.0 - 1e-12), f64::from(found[1]) * (1.0 + 1e-12))
    }

    fn at(&self, p: [f64; 2]) -> f64 {
        let ([[a, b], [c, d]], [s, t], _) = self.around(p);
        (1.0 - t) * ((1.0 - s) * a + s * b) + t * ((1.0 - s) * c + s * d)
    }

    fn gradient(&self, p: [f64; 2]) -> [f64; 2] {
        let ([[a, b], [c, d]], [s, t], on) = self.around(p);
        let by_i = if on[0] { (1.0 - t) * (b - a) + t * (d - c) } else { 0.0 };
        let by_j = if on[1] { (1.0 - s) * (c - a) + s * (d - b) } else { 0.0 };
        [by_i * self.by_x[0] + by_j * self.by_x[1], by_i * self.by_y[0] + by_j * self.by_y[1]]
    }

    /// There are kinks where the squares between posts meet.
    fn hessian(&self, p: [f64; 2]) -> [f64; 3] {
        let ([[a, b], [c, d]], _, on) = self.around(p);
        let twist = if on[0] && on[1] { a - b - c + d } else { 0.0 };
        let (x, y) = (self.by_x, self.by_y);
        [2.0 * twist * x[0] * x[1], twist * (x[0] * y[1] + x[1] * y[0]), 2.0 * twist * y[0] * y[1]]
    }
}

impl Cut for Arc<ErrorRaster> {
    fn bounds(&self, polygon: &[[f64; 2]]) -> (f64, f64) {
        self.as_ref().bounds(polygon)
    }
    fn at(&self, p: [f64; 2]) -> f64 {
        self.as_ref().at(p)
    }
    fn gradient(&self, p: [f64; 2]) -> [f64; 2] {
        self.as_ref().gradient(p)
    }
    fn hessian(&self, p: [f64; 2]) -> [f64; 3] {
        self.as_ref().hessian(p)
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{derivatives_hold, random, within_bounds};
    use super::*;

    fn some(s: &mut u64, cols: usize, rows: usize) -> ErrorRaster {
        let values = (0..cols * rows).map(|_| (5.0 * random(s).powi(3)) as f32).collect();
        let (angle, step) = (6.3 * random(s), 20.0 + 100.0 * random(s));
        let (c, n) = (angle.cos() * step, angle.sin() * step);
        let affine = Affine { origin: [-800.0, 5_000_700.0], col_step: [c, n], row_step: [n, -c] };
        ErrorRaster::new(cols, rows, values, &affine).unwrap()
    }

    #[test]
    fn bounds_hold_over_polygons() {
        let mut s = 77;
        for n in 0..300 {
            let (cols, rows) = if n % 10 == 0 { (1, 1 + n % 7) } else { (1 + n % 90, 1 + (n * 7) % 41) };
            let r = some(&mut s, cols, rows);
            for size in [30.0, 400.0, 3000.0] {
                for _ in 0..4 {
                    within_bounds(&r, [0.0, 5_000_000.0], size, 60, &mut s);
                }
            }
        }
    }

    #[test]
    fn values_at_posts_between_them_and_outside() {
        let affine = Affine { origin: [100.0, 200.0], col_step: [10.0, 0.0], row_step: [0.0, -10.0] };
        let r = ErrorRaster::new(2, 2, vec![1.0, 3.0, 5.0, 9.0], &affine).unwrap();
        assert_eq!(r.at([100.0, 200.0]), 1.0);
        assert_eq!(r.at([110.0, 190.0]), 9.0);
        assert_eq!(r.at([105.0, 195.0]), 4.5);
        assert_eq!(r.at([95.0, 300.0]), 1.0);
        assert_eq!(r.at([1e9, 195.0]), 6.0);
        let g = r.gradient([1e9, 195.0]);
        assert!(g[0] == 0.0 && (g[1] + 0.6).abs() < 1e-12, "{g:?}");
        assert!(r.covers([110.0, 190.0]) && !r.covers([111.0, 190.0]));
        assert_eq!(r.bounds(&[[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]).0, 5.0 * (1.0 - 1e-12));
    }

    #[test]
    fn continuous_across_squares_and_the_border() {
        let mut s = 3;
        let r = some(&mut s, 12, 9);
        let steepest = 5.0 / 20.0 * 2.0;
        for _ in 0..100_000 {
            let p = [4000.0 * random(&mut s) - 2000.0, 5_000_000.0 + 4000.0 * random(&mut s) - 2000.0];
            let q = [p[0] + random(&mut s) - 0.5, p[1] + random(&mut s) - 0.5];
            let apart = (p[0] - q[0]).hypot(p[1] - q[1]);
            assert!((r.at(p) - r.at(q)).abs() <= steepest * apart + 1e-9, "{p:?} {q:?}");
        }
    }

    #[test]
    fn gradient_and_hessian_are_the_derivatives() {
        let mut s = 9;
        let r = some(&mut s, 12, 9);
        let mut inside = 0;
        while inside < 60 {
            let p = [2000.0 * random(&mut s) - 1000.0, 5_000_000.0 + 2000.0 * random(&mut s) - 1000.0];
            let part = r.index(p).map(|v| v - v.floor());
            if r.covers(p) && part.iter().all(|v| (0.01..0.99).contains(v)) {
                derivatives_hold(&r, p, |p| r.hessian(p));
                inside += 1;
            }
        }
    }

    #[test]
    fn impossible_rasters_are_refused() {
        let affine = Affine { origin: [0.0; 2], col_step: [1.0, 0.0], row_step: [0.0, -1.0] };
        for bad in [-0.5, f32::NAN, f32::INFINITY] {
            let e = ErrorRaster::new(2, 1, vec![1.0, bad], &affine).unwrap_err().to_string();
            assert!(e.contains("column 1, row 0"), "{e}");
        }
        assert!(ErrorRaster::new(2, 2, vec![1.0], &affine).is_err());
        let flat = Affine { row_step: [2.0, 0.0], ..affine };
        assert!(ErrorRaster::new(1, 1, vec![1.0], &flat).is_err());
        assert!(matches!(ErrorRaster::new(1 << 20, 1 << 20, Vec::new(), &affine), Err(Error::Limit { .. })));
    }
}
