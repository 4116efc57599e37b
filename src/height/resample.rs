//! From the lattice on which a survey was delivered to one in the CRS of the database (section 13 of the LOD-space
//! specification).
//!
//! Every target post is a function of the declaration and of the union of the delivered samples: its place among them is
//! interpolated in a control grid that is anchored at absolute post indices, its height is cubic between 4 x 4 samples
//! (Catmull-Rom, as `gdalwarp -r cubic` at equal spacing) and bilinear between 2 x 2 where one of the sixteen is void. It
//! is void unless the four samples around it are valid. So tiles may come in any order, and a sample changes only target
//! posts within two source cells.

use super::block::{BLOCK, RawBlock};
use super::crs::Transform;
use super::frame::{CellRect, Frame, Lattice, LatticeUnit};
use super::source::SampleType;
use crate::base::{Error, Result, limits};

const N: usize = BLOCK as usize;
/// Posts between nodes of the control grid.
const CONTROL: usize = 16;
/// How far, in steps, a place interpolated in a square of the control grid may lie from the true one at the middle of the
/// square or of two of its sides; where it is further, every place of the square is computed.
const CONTROL_TOLERANCE: f64 = 1.0 / 256.0;
/// Largest index of a post.
const INDEX_MAX: f64 = 1e9;
/// Places along each side of a rectangle at which a transform is tried before anything is resampled.
const TRIED: i64 = 64;

/// Two lattices and the transform between their systems.
pub struct Warp {
    source: Lattice,
    target: Lattice,
    frame: Frame,
    unit: LatticeUnit,
    transform: Transform,
    /// Longitudes, of either side, are taken within half a turn of this one.
    turn: f64,
    /// Whether source and target are in degrees.
    degrees: [bool; 2],
}

impl Warp {
    /// `turn`: longitudes are taken within half a turn of this one; `degrees`: which of source and target have longitudes.
    pub fn new(
        source: Lattice,
        target: Lattice,
        unit: LatticeUnit,
        transform: Transform,
        turn: f64,
        degrees: [bool; 2],
    ) -> Result<Warp> {
        let frame = target.frame(unit)?;
        Ok(Warp { source, target, frame, unit, transform, turn, degrees })
    }

    /// Within half a turn, if the side is in degrees.
    fn turned(&self, mut p: [f64; 2], side: usize) -> [f64; 2] {
        if self.degrees[side] {
            p[0] -= ((p[0] - self.turn) / 360.0).round() * 360.0;
        }
        p
    }

    /// A target position in the source system.
    fn back(&self, p: [f64; 2]) -> Option<[f64; 2]> {
        Some(self.turned(self.transform.inverse(p)?, 0))
    }

    /// Where a target post lies among the source posts, in source steps. A target longitude beyond half a turn is no place: it
    /// is another name of one within.
    fn in_source(&self, i: i64, j: i64) -> Option<[f64; 2]> {
        let p = self.frame.post(i, j);
        let size = self.unit.size();
        let p = [p.x as f64 * size, p.y as f64 * size];
        if self.degrees[1] && !(self.turn - 180.0..self.turn + 180.0).contains(&p[0]) {
            return None;
        }
        finite(self.source.index(self.back(p)?))
    }

    /// Where a source post lies in the target system.
    fn over(&self, i: i64, j: i64) -> Option<[f64; 2]> {
        Some(self.turned(self.transform.forward(self.source.post(i, j))?, 1))
    }

    /// Where a source post lies among the target posts, in target steps.
    fn in_target(&self, i: i64, j: i64) -> Option<[f64; 2]> {
        finite(self.target.index(self.over(i, j)?))
    }

    /// Whether a source post, brought over and back, is where it was, to a hundredth of a step.
    fn returns(&self, i: i64, j: i64) -> bool {
        let p = self.source.post(i, j);
        let Some(q) = self.over(i, j).and_then(|q| self.transform.inverse(q)) else { return false };
        let mut off = [q[0] - p[0], q[1] - p[1]];
        if self.degrees[0] {
            // A meridian has many names, and a pole lies on all of them.
            off[0] = (off[0] - (off[0] / 360.0).round() * 360.0) * p[1].to_radians().cos();
        }
        let [u, v] = self.source.nominal_steps();
        off[0].abs() <= 0.01 * u.max(v) && off[1].abs() <= 0.01 * u.max(v)
    }

    /// Target posts that source posts can change: a rectangle that holds them all, and more.
    ///
    /// # Errors
    /// If the transform does not hold over the whole rectangle of source posts, there and back.
    pub fn target_rect(&self, posts: &CellRect, file: &str) -> Result<CellRect> {
        let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
        let along = |a: i64, n: i64, k: i64| a + ((n - 1) as i128 * k as i128 / TRIED as i128) as i64;
        for l in 0..=TRIED {
            for k in 0..=TRIED {
                let (i, j) = (along(posts.i0, posts.width(), k), along(posts.j0, posts.height(), l));
                let Some(p) = self.in_target(i, j) else {
                    return Err(self.outside(i, j, file, "has no place"));
                };
                if p.iter().any(|v| v.abs() > INDEX_MAX) {
                    let what = format!(
                        "index of a post of {file} from the origin of the database's CRS (--step is too fine)"
                    );
                    return Err(Error::limit(what, INDEX_MAX as u64, p[0].abs().max(p[1].abs()) as u64));
                }
                // Elsewhere is another branch of the projection.
                if !self.returns(i, j) {
                    return Err(self.outside(i, j, file, "does not come back to where it was"));
                }
                b = [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])];
            }
        }
        // Between the tried places a smooth map strays by far less than one of their distances.
        let pad = [0, 1].map(|k| (b[k + 2] - b[k]) / TRIED as f64 + 16.0);
        Ok(CellRect::new(
            (b[0] - pad[0]).floor() as i64,
            (b[1] - pad[1]).floor() as i64,
            (b[2] + pad[0]).ceil() as i64,
            (b[3] + pad[1]).ceil() as i64,
        ))
    }

    fn outside(&self, i: i64, j: i64, file: &str, what: &str) -> Error {
        let p = self.source.post(i, j);
        Error::invalid(
            file,
            format!(
                "its post at {}, {} {what} in the database's CRS ({}); cut the file to the area where that CRS is used, or make a \
                 database in a CRS that suits it",
                p[0],
                p[1],
                self.transform.description()
            ),
        )
    }

    /// One block of target posts as samples (`float32`, metres). `extent` holds all source posts; `posts` reads their
    /// heights, voids as NaN; `none` says that a rectangle of them holds nothing valid. `None` if the block holds nothing valid.
    pub fn block(
        &self,
        bi: i64,
        bj: i64,
        extent: &CellRect,
        posts: &dyn Fn(&CellRect) -> Result<Vec<f64>>,
        none: &dyn Fn(&CellRect) -> bool,
    ) -> Result<Option<RawBlock>> {
        let mut places = places(bi, bj, &|i, j| self.in_source(i, j));
        let lies = |v: f64, a: i64, b: i64| v >= a as f64 && v <= (b - 1) as f64;
        for p in &mut places {
            if !(lies(p[0], extent.i0, extent.i1) && lies(p[1], extent.j0, extent.j1)) {
                *p = [f64::NAN; 2];
            }
        }
        let mut z = vec![f32::NAN; N * N];
        for square in 0..(N / CONTROL) * (N / CONTROL) {
            let (a0, b0) = (square % (N / CONTROL) * CONTROL, square / (N / CONTROL) * CONTROL);
            let inside = || (b0..b0 + CONTROL).flat_map(|b| (a0..a0 + CONTROL).map(move |a| b * N + a));
            let Some(window) = around(inside().map(|k| places[k])) else { continue };
            let count = window.width() as u64 * window.height() as u64;
            if count > limits::WINDOW_POSTS_MAX {
                return Err(Error::limit(
                    format!(
                        "source posts under 16 x 16 posts of the database ({})",
                        self.transform.description()
                    ),
                    limits::WINDOW_POSTS_MAX,
                    count,
                ));
            }
            if none(&window) {
                continue;
            }
            let read = posts(&window)?;
            for k in inside() {
                let [s, t] = places[k];
                let at = [s - window.i0 as f64, t - window.j0 as f64];
                if let Some(h) = sample(&read, window.width() as usize, at) {
                    z[k] = h as f32;
                }
            }
        }
        Ok(held(&z))
    }

    /// How far the target surface (bilinear between its posts) is from the delivered samples of one block of source posts:
    /// calls `f` with each absolute difference, by index. `source` and `target` read posts, voids as NaN.
    pub fn differences(
        &self,
        bi: i64,
        bj: i64,
        source: &dyn Fn(&CellRect) -> Result<Vec<f64>>,
        target: &dyn Fn(&CellRect) -> Result<Vec<f64>>,
        mut f: impl FnMut(f64),
    ) -> Result<()> {
        let own = CellRect::new(bi * BLOCK, bj * BLOCK, (bi + 1) * BLOCK, (bj + 1) * BLOCK);
        let have = source(&own)?;
        let places = places(bi, bj, &|i, j| self.in_target(i, j));
        for square in 0..(N / CONTROL) * (N / CONTROL) {
            let (a0, b0) = (square % (N / CONTROL) * CONTROL, square / (N / CONTROL) * CONTROL);
            let inside = || {
                (b0..b0 + CONTROL)
                    .flat_map(|b| (a0..a0 + CONTROL).map(move |a| b * N + a))
                    .filter(|k| !have[*k].is_nan())
            };
            let Some(window) = around(inside().map(|k| places[k])) else { continue };
            if window.width() as u64 * window.height() as u64 > limits::WINDOW_POSTS_MAX {
                continue;
            }
            let read = target(&window)?;
            for k in inside() {
                let [s, t] = places[k];
                let at = [s - window.i0 as f64, t - window.j0 as f64];
                if let Some(h) = bilinear(&read, window.width() as usize, at) {
                    f((h - have[k]).abs());
                }
            }
        }
        Ok(())
    }
}

fn finite(p: [f64; 2]) -> Option<[f64; 2]> {
    p.iter().all(|v| v.is_finite()).then_some(p)
}

/// The places of a block's posts on another lattice, row-major; NaN where there is none. Nodes of the control grid are
/// posts of the block and of the next ones, so neighbours agree.
fn places(bi: i64, bj: i64, map: &dyn Fn(i64, i64) -> Option<[f64; 2]>) -> Vec<[f64; 2]> {
    const NODES: usize = N / CONTROL + 1;
    const STEP: i64 = CONTROL as i64;
    let (i0, j0) = (bi * BLOCK, bj * BLOCK);
    let nodes: Vec<Option<[f64; 2]>> = (0..NODES * NODES)
        .map(|k| map(i0 + (k % NODES) as i64 * STEP, j0 + (k / NODES) as i64 * STEP))
        .collect();
    let mut out = vec![[f64::NAN; 2]; N * N];
    for square in 0..(NODES - 1) * (NODES - 1) {
        let (p, q) = (square % (NODES - 1), square / (NODES - 1));
        let corner = |a: usize, b: usize| nodes[(q + b) * NODES + p + a];
        let (i, j) = (i0 + p as i64 * STEP, j0 + q as i64 * STEP);
        let corners = [corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let between = |c: &[[f64; 2]; 4], x: f64, y: f64| {
            [0, 1].map(|k| {
                let low = c[0][k] + (c[1][k] - c[0][k]) * x;
                let high = c[2][k] + (c[3][k] - c[2][k]) * x;
                low + (high - low) * y
            })
        };
        let smooth = match corners {
            [Some(a), Some(b), Some(c), Some(d)] => {
                let c = [a, b, c, d];
                // At the middle, and at the middles of two sides: between two conformal maps the first says nothing.
                let near = |a: i64, b: i64| {
                    map(i + a, j + b).is_some_and(|m| {
                        let g = between(&c, a as f64 / STEP as f64, b as f64 / STEP as f64);
                        (g[0] - m[0]).abs().max((g[1] - m[1]).abs()) <= CONTROL_TOLERANCE
                    })
                };
                let half = STEP / 2;
                (near(half, half) && near(half, 0) && near(0, half)).then_some(c)
            }
            _ => None,
        };
        for b in 0..CONTROL {
            for a in 0..CONTROL {
                let at = (q * CONTROL + b) * N + p * CONTROL + a;
                out[at] = match &smooth {
                    Some(c) => between(c, a as f64 / CONTROL as f64, b as f64 / CONTROL as f64),
                    None => map(i + a as i64, j + b as i64).unwrap_or([f64::NAN; 2]),
                };
            }
        }
    }
    out
}

/// The posts that cubic interpolation at the places needs: `None` if there is no place.
fn around(places: impl Iterator<Item = [f64; 2]>) -> Option<CellRect> {
    let mut b = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for p in places.filter(|p| !p[0].is_nan()) {
        b = [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])];
    }
    const FAR: f64 = (1i64 << 40) as f64;
    (b[0] <= b[2] && b[0] > -FAR && b[1] > -FAR && b[2] < FAR && b[3] < FAR).then(|| {
        CellRect::new(
            b[0].floor() as i64 - 1,
            b[1].floor() as i64 - 1,
            b[2].floor() as i64 + 3,
            b[3].floor() as i64 + 3,
        )
    })
}

/// Weights of four samples in a row at `t` in [0, 1) between the middle two (Catmull-Rom).
fn weights(t: f64) -> [f64; 4] {
    [
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]
}

/// The height at a place of a window (in steps from its first post), which holds a post before it and two after it.
fn sample(z: &[f64], cols: usize, at: [f64; 2]) -> Option<f64> {
    if at[0].is_nan() {
        return None;
    }
    let (a, b) = (at[0].floor() as usize, at[1].floor() as usize);
    let (x, y) = (weights(at[0] - a as f64), weights(at[1] - b as f64));
    let mut sum = 0.0;
    for (r, wy) in y.iter().enumerate() {
        let row = &z[(b + r - 1) * cols + a - 1..][..4];
        sum += wy * (x[0] * row[0] + x[1] * row[1] + x[2] * row[2] + x[3] * row[3]);
    }
    // One void makes the sum NaN.
    if sum.is_nan() { bilinear(z, cols, at) } else { Some(sum) }
}

fn bilinear(z: &[f64], cols: usize, at: [f64; 2]) -> Option<f64> {
    if at[0].is_nan() {
        return None;
    }
    let (a, b) = (at[0].floor() as usize, at[1].floor() as usize);
    let (x, y) = (at[0] - a as f64, at[1] - b as f64);
    let low = z[b * cols + a] + (z[b * cols + a + 1] - z[b * cols + a]) * x;
    let high = z[(b + 1) * cols + a] + (z[(b + 1) * cols + a + 1] - z[(b + 1) * cols + a]) * x;
    let h = low + (high - low) * y;
    (!h.is_nan()).then_some(h)
}

/// The smallest rectangle of a block that holds every valid sample.
fn held(z: &[f32]) -> Option<RawBlock> {
    let mut r = CellRect::new(0, 0, 0, 0);
    for (k, _) in z.iter().enumerate().filter(|(_, v)| !v.is_nan()) {
        let (a, b) = ((k % N) as i64, (k / N) as i64);
        r = r.union(&CellRect::new(a, b, a + 1, b + 1));
    }
    if r.is_empty() {
        return None;
    }
    let (cols, rows) = (r.width() as usize, r.height() as usize);
    let (mut samples, mut valid) = (Vec::with_capacity(cols * rows * 4), Vec::with_capacity(cols * rows));
    for b in r.j0 as usize..r.j1 as usize {
        for v in &z[b * N + r.i0 as usize..b * N + r.i1 as usize] {
            samples.extend_from_slice(&(if v.is_nan() { 0.0 } else { *v }).to_le_bytes());
            valid.push(u8::from(!v.is_nan()));
        }
    }
    Some(RawBlock {
        col: r.i0 as usize,
        row: r.j0 as usize,
        cols,
        rows,
        sample_type: SampleType::F32,
        samples,
        valid: valid.contains(&0).then_some(valid),
        fills: Vec::new(),
    })
}
