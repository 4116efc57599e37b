//! Perspective cameras: the exact tolerance of section 5.3 of the LOD-space specification.
//!
//! A vertical shift of delta at depth w moves its image by D delta rho / (w (w -+ delta sin a)) pixels, so
//! `delta = tau w^2 / (D rho + tau |sin a| w)`. The paper's formula uses the distance in place of the depth and is not
//! conservative; this one is, at any pitch and roll.

use super::{Boxes, Cut, Foreseen, Region, pack};
use crate::base::{Error, Result};
use foreseen::{foresee, foresee_middles};

mod foreseen;

/// A pinhole camera over terrain. Lengths in metres, CRS axes x east, y north.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    pub eye: [f64; 3],
    /// Horizontal heading, unit length.
    forward: [f64; 2],
    /// Sine and cosine of the downward pitch.
    pitch_sin: f64,
    pitch_cos: f64,
    /// Pixels per unit of tangent: half the viewport height over tan(half the vertical field of view).
    focal: f64,
    half_width: f64,
    half_height: f64,
    /// Allowed displacement, pixels.
    pub pixels: f64,
    pub near: f64,
    pub far: f64,
    /// Height of the eye above the bounding height of the terrain (see [`Camera::over`]).
    h: f64,
    /// What it was made of, beside `eye` and `pixels`.
    pub look_at: [f64; 3],
    pub fov_deg: f64,
    pub viewport: [u32; 2],
}

impl Camera {
    /// `fov_deg` is the vertical field of view, `viewport` in pixels (width, height).
    pub fn new(
        eye: [f64; 3],
        look_at: [f64; 3],
        fov_deg: f64,
        viewport: [u32; 2],
        pixels: f64,
        far: Option<f64>,
    ) -> Result<Camera> {
        let d = [look_at[0] - eye[0], look_at[1] - eye[1], look_at[2] - eye[2]];
        let flat = d[0].hypot(d[1]);
        let length = flat.hypot(d[2]);
        if !(length.is_finite() && length > 0.0) {
            return Err(Error::invalid(
                "--look-at",
                "is the same point as --eye; give the point that the camera looks at",
            ));
        }
        if !(fov_deg > 0.0 && fov_deg < 180.0) {
            return Err(Error::invalid("--fov", format!("{fov_deg} degrees; it must lie between 0 and 180")));
        }
        if viewport[0] == 0 || viewport[1] == 0 {
            return Err(Error::invalid(
                "--viewport",
                format!("{} x {} pixels is empty", viewport[0], viewport[1]),
            ));
        }
        if !(pixels > 0.0 && pixels.is_finite()) {
            return Err(Error::invalid("--pixels", format!("{pixels}; it must be positive")));
        }
        let forward = if flat > 0.0 { [d[0] / flat, d[1] / flat] } else { [0.0, 1.0] };
        let half_height = (fov_deg.to_radians() / 2.0).tan();
        let far = far.unwrap_or(100_000.0);
        if !(far > 0.0 && far.is_finite()) {
            return Err(Error::invalid("--far", format!("{far} m; it must be positive")));
        }
        Ok(Camera {
            eye,
            forward,
            pitch_sin: -d[2] / length,
            pitch_cos: flat / length,
            focal: f64::from(viewport[1]) / 2.0 / half_height,
            half_width: half_height * f64::from(viewport[0]) / f64::from(viewport[1]),
            half_height,
            pixels,
            near: (far * 1e-5).max(0.01),
            far,
            h: 0.0,
            look_at,
            fov_deg,
            viewport,
        })
    }

    /// Fixes the bounding height: the highest terrain if the camera looks down, the lowest if up.
    pub fn over(mut self, z_min: f64, z_max: f64) -> Camera {
        self.h = self.eye[2] - if self.pitch_sin > 0.0 { z_max } else { z_min };
        self
    }

    /// Forward and right of the eye, horizontally.
    fn local(&self, p: [f64; 2]) -> (f64, f64) {
        let (dx, dy) = (p[0] - self.eye[0], p[1] - self.eye[1]);
        (dx * self.forward[0] + dy * self.forward[1], dx * self.forward[1] - dy * self.forward[0])
    }

    fn depth(&self, x: f64) -> f64 {
        (x * self.pitch_cos + self.h * self.pitch_sin).max(self.near)
    }

    fn tolerance(&self, w: f64, rho: f64) -> f64 {
        let s = self.pitch_sin.abs();
        self.pixels * w * w / (self.focal * rho + self.pixels * s * w)
    }

    #[inline(always)]
    fn over_polygon(&self, polygon: &[[f64; 2]]) -> (f64, f64) {
        let s = self.pitch_sin.abs();
        let flat = |p: &[f64; 2]| {
            let (x, y) = self.local(*p);
            [x, s * y]
        };
        let (mut w_min, mut w_max, mut rho_max) = (f64::INFINITY, 0.0f64, 0.0f64);
        for q in polygon.iter().map(flat) {
            let w = self.depth(q[0]);
            w_min = w_min.min(w);
            w_max = w_max.max(w);
            rho_max = rho_max.max(q[0] * q[0] + q[1] * q[1]);
        }
        let (rho_min, rho_max) = (distance_to_origin(polygon.iter().map(flat)), rho_max.sqrt());
        let lo = self.tolerance(w_min, rho_max);
        let hi = self.tolerance(w_max, rho_min);
        // The last digits: bounds may be loose, never tight in the wrong direction.
        (lo * (1.0 - 1e-12), if hi.is_nan() { f64::INFINITY } else { hi * (1.0 + 1e-12) })
    }

    /// The ground that can be seen while heights stay in `[z_min, z_max]`: a convex polygon, perhaps empty.
    pub fn footprint(&self, z_min: f64, z_max: f64) -> Region {
        let (f, (s, c)) = (self.forward, (self.pitch_sin, self.pitch_cos));
        let axis = [f[0] * c, f[1] * c, -s];
        let right = [f[1], -f[0], 0.0];
        let up = [f[0] * s, f[1] * s, c];
        let corner = |w: f64, a: f64, b: f64| -> [f64; 3] {
            [0, 1, 2].map(|k| {
                self.eye[k] + w * (axis[k] + a * self.half_width * right[k] + b * self.half_height * up[k])
            })
        };
        let signs = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let near: Vec<[f64; 3]> = signs.iter().map(|&(a, b)| corner(self.near, a, b)).collect();
        let far: Vec<[f64; 3]> = signs.iter().map(|&(a, b)| corner(self.far, a, b)).collect();
        let mut edges = Vec::new();
        for k in 0..4 {
            edges.push((near[k], near[(k + 1) % 4]));
            edges.push((far[k], far[(k + 1) % 4]));
            edges.push((near[k], far[k]));
        }
        let mut points = Vec::new();
        for (a, b) in edges {
            for p in [a, b] {
                if (z_min..=z_max).contains(&p[2]) {
                    points.push([p[0], p[1]]);
                }
            }
            for z in [z_min, z_max] {
                if (a[2] - z) * (b[2] - z) < 0.0 {
                    let t = (z - a[2]) / (b[2] - a[2]);
                    points.push([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
                }
            }
        }
        Region::hull(points)
    }
}

impl Cut for Camera {
    fn bounds(&self, polygon: &[[f64; 2]]) -> (f64, f64) {
        // Most polygons are whole cells or domains: four corners, one after the other without a loop.
        match <&[[f64; 2]; 4]>::try_from(polygon) {
            Ok(quad) => self.over_polygon(quad),
            Err(_) => self.over_polygon(polygon),
        }
    }

    fn foresee(&self, boxes: &Boxes, kappa: f64) -> Foreseen {
        let mut out = [[0; 64]; 4];
        foresee(self, boxes, kappa, &mut out);
        let [above_lo, below_hi, not_above_lo, not_below_hi] = out.each_ref().map(pack);
        Foreseen { above_lo, below_hi, not_above_lo, not_below_hi }
    }

    fn foresee_middles(&self, boxes: &Boxes, kappa: f64) -> Foreseen {
        let mut out = [[0; 64]; 2];
        foresee_middles(self, boxes, kappa, &mut out);
        let [above_lo, below_hi] = out.each_ref().map(pack);
        Foreseen { above_lo, below_hi, ..Foreseen::default() }
    }

    fn at(&self, p: [f64; 2]) -> f64 {
        let (x, y) = self.local(p);
        let t = self.tolerance(self.depth(x), x.hypot(self.pitch_sin * y));
        if t.is_nan() { f64::INFINITY } else { t }
    }

    fn gradient(&self, p: [f64; 2]) -> [f64; 2] {
        let (x, y) = self.local(p);
        let s = self.pitch_sin.abs();
        let w = self.depth(x);
        let w_x = if w > self.near { self.pitch_cos } else { 0.0 };
        let rho = x.hypot(s * y);
        let (rho_x, rho_y) = if rho > 0.0 { (x / rho, s * s * y / rho) } else { (0.0, 0.0) };
        let below = self.focal * rho + self.pixels * s * w;
        if below <= 0.0 {
            return [0.0; 2];
        }
        // d(tau w^2 / below) by w and by rho.
        let by_w = self.pixels * w * (2.0 * below - self.pixels * s * w) / (below * below);
        let by_rho = -self.pixels * w * w * self.focal / (below * below);
        let (dx, dy) = (by_w * w_x + by_rho * rho_x, by_rho * rho_y);
        let f = self.forward;
        [dx * f[0] + dy * f[1], dx * f[1] - dy * f[0]]
    }

    /// In w and rho the second derivatives of tau w^2 / B, B = D rho + tau s w, are `q (rho^2, -w rho, w^2)` with
    /// q = 2 tau D^2 / B^3. There is a kink on the line where the depth is clamped, and a point under the eye.
    fn hessian(&self, p: [f64; 2]) -> [f64; 3] {
        let (x, y) = self.local(p);
        let s = self.pitch_sin.abs();
        let w = self.depth(x);
        let w_x = if w > self.near { self.pitch_cos } else { 0.0 };
        let rho = x.hypot(s * y);
        let below = self.focal * rho + self.pixels * s * w;
        if below <= 0.0 || rho <= 0.0 {
            return [0.0; 3];
        }
        let (rho_x, rho_y) = (x / rho, s * s * y / rho);
        let bend = s * s / (rho * rho * rho);
        let q = 2.0 * self.pixels * self.focal * self.focal / (below * below * below);
        let by_rho = -self.pixels * w * w * self.focal / (below * below);
        let (along, across) = (rho * w_x - w * rho_x, -w * rho_y);
        let xx = q * along * along + by_rho * bend * y * y;
        let xy = q * along * across - by_rho * bend * x * y;
        let yy = q * across * across + by_rho * bend * x * x;
        // x = dx f0 + dy f1, y = dx f1 - dy f0.
        let f = self.forward;
        [
            xx * f[0] * f[0] + 2.0 * xy * f[0] * f[1] + yy * f[1] * f[1],
            (xx - yy) * f[0] * f[1] + xy * (f[1] * f[1] - f[0] * f[0]),
            xx * f[1] * f[1] - 2.0 * xy * f[0] * f[1] + yy * f[0] * f[0],
        ]
    }
}

/// Distance of the origin from a convex polygon (0 inside; infinite from none).
#[inline(always)]
pub(super) fn distance_to_origin(polygon: impl DoubleEndedIterator<Item = [f64; 2]> + Clone) -> f64 {
    let (mut left, mut right, mut corners) = (false, false, 0);
    let mut least = f64::INFINITY;
    let Some(mut a) = polygon.clone().next_back() else { return f64::INFINITY };
    for b in polygon {
        let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
        let turn = ex * -a[1] - ey * -a[0];
        left |= turn > 0.0;
        right |= turn < 0.0;
        corners += 1;
        let l2 = ex * ex + ey * ey;
        let t = if l2 > 0.0 { (-(a[0] * ex + a[1] * ey) / l2).clamp(0.0, 1.0) } else { 0.0 };
        let (x, y) = (a[0] + t * ex, a[1] + t * ey);
        least = least.min(x * x + y * y);
        a = b;
    }
    if corners >= 3 && !(left && right) { 0.0 } else { least.sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(state: &mut u64) -> f64 {
        *state ^= *state << 13;
        *state ^= *state >> 7;
        *state ^= *state << 17;
        (*state >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Projects a point and the same point shifted up or down by `delta`, and returns the distance in pixels.
    fn displacement(c: &Camera, p: [f64; 3], delta: f64) -> Option<f64> {
        let project = |z: f64| {
            let (x, y) = c.local([p[0], p[1]]);
            let h = c.eye[2] - z;
            let w = x * c.pitch_cos + h * c.pitch_sin;
            let v = x * c.pitch_sin - h * c.pitch_cos;
            (w, c.focal * y / w, c.focal * v / w)
        };
        let (w0, a0, b0) = project(p[2]);
        if w0 < c.near {
            return None;
        }
        let (w1, a1, b1) = project(p[2] + delta);
        (w1 > 0.0).then(|| (a1 - a0).hypot(b1 - b0))
    }

    #[test]
    fn a_shift_by_the_tolerance_moves_no_visible_point_by_more_than_asked() {
        let mut s = 0x9e37_79b9_7f4a_7c15;
        let mut seen = 0;
        for _ in 0..200_000 {
            let eye = [0.0, 0.0, 100.0 + 3000.0 * random(&mut s)];
            let look =
                [2000.0 * random(&mut s) - 1000.0, 2000.0 * random(&mut s) - 1000.0, 3000.0 * random(&mut s)];
            let pixels = 0.5 + 3.0 * random(&mut s);
            let c = Camera::new(eye, look, 20.0 + 90.0 * random(&mut s), [1280, 720], pixels, Some(20_000.0))
                .unwrap();
            let z = 90.0 * random(&mut s);
            let c = c.over(0.0, 90.0);
            let p = [20_000.0 * random(&mut s) - 10_000.0, 20_000.0 * random(&mut s) - 10_000.0];
            let delta = c.at(p);
            for sign in [-1.0, 1.0] {
                if let Some(d) = displacement(&c, [p[0], p[1], z], sign * delta) {
                    assert!(d <= pixels * (1.0 + 1e-9), "{d} px, {pixels} asked: {c:?} {p:?} {z}");
                    seen += 1;
                }
            }
        }
        assert!(seen > 100_000, "{seen}");
    }

    #[test]
    fn bounds_hold_over_polygons() {
        let mut s = 42;
        for _ in 0..3000 {
            let eye = [100.0, -50.0, 500.0];
            let look = [1000.0 * random(&mut s), 1000.0 * random(&mut s), 900.0 * random(&mut s)];
            let c = Camera::new(eye, look, 60.0, [800, 600], 1.0, None).unwrap().over(0.0, 200.0);
            let pts: Vec<[f64; 2]> = (0..5)
                .map(|_| [4000.0 * random(&mut s) - 2000.0, 4000.0 * random(&mut s) - 2000.0])
                .collect();
            let hull = Region::hull(pts).polygon;
            let (lo, hi) = c.bounds(&hull);
            for _ in 0..60 {
                let w: Vec<f64> = hull.iter().map(|_| random(&mut s)).collect();
                let t: f64 = w.iter().sum();
                let p = [0, 1].map(|k| hull.iter().zip(&w).map(|(v, w)| v[k] * w / t).sum::<f64>());
                let d = c.at(p);
                assert!(lo <= d && d <= hi, "{lo} {d} {hi}");
            }
        }
    }

    #[test]
    fn gradient_and_hessian_are_the_derivatives() {
        let c = Camera::new([10.0, 20.0, 900.0], [500.0, 300.0, 200.0], 50.0, [800, 600], 2.0, None)
            .unwrap()
            .over(0.0, 100.0);
        for p in [[400.0, 300.0], [1000.0, -50.0], [-300.0, 80.0]] {
            let g = c.gradient(p);
            let h = 1e-3;
            for k in 0..2 {
                let (mut a, mut b) = (p, p);
                a[k] -= h;
                b[k] += h;
                let d = (c.at(b) - c.at(a)) / (2.0 * h);
                assert!((d - g[k]).abs() < 1e-7 * d.abs().max(1e-3), "{d} {g:?}");
                let (ga, gb) = (c.gradient(a), c.gradient(b));
                for m in 0..2 {
                    let (d, found) = ((gb[m] - ga[m]) / (2.0 * h), c.hessian(p)[k + m]);
                    assert!((d - found).abs() < 1e-6 * d.abs().max(1e-6), "{d} {found}");
                }
            }
        }
    }

    #[test]
    fn a_level_camera_sees_a_plane() {
        let c = Camera::new([0.0, 0.0, 10.0], [1.0, 0.0, 10.0], 60.0, [800, 600], 1.0, None)
            .unwrap()
            .over(0.0, 5.0);
        let (a, b, m) = (c.at([100.0, 40.0]), c.at([300.0, -90.0]), c.at([200.0, 0.0]));
        assert!(((a + b) / 2.0 - m).abs() < 1e-9);
    }
    /// Domains of all shapes, near the eye and far away, and parts of them.
    #[test]
    fn what_is_foreseen_is_what_bounds_say() {
        let s = &mut 0xface;
        let mut certain = [0; 6];
        for n in 0..4000 {
            let far = 10f64.powf(1.0 + 4.0 * random(s));
            let place = if n % 4 == 0 { [0.0; 2] } else { [500_000.0, 4_000_000.0] };
            let near = |s: &mut u64, reach: f64| place.map(|v| v + reach * (2.0 * random(s) - 1.0));
            let (eye, mut look) = (near(s, far), near(s, far));
            let level = n % 7 == 0;
            if n % 11 == 0 && !level {
                look = eye;
            }
            let eye = [eye[0], eye[1], if level { 50.0 } else { 3000.0 * random(s) - 50.0 }];
            let look = [look[0], look[1], if level { 50.0 } else { -100.0 * random(s) - 51.0 }];
            let pixels = 0.2 + 4.0 * random(s);
            let c = Camera::new(eye, look, 45.0, [800, 600], pixels, Some(far)).unwrap().over(0.0, 90.0);
            let (mut columns, mut arms, mut heights, mut domains) =
                ([[0.0; 64]; 3], [[0f32; 64]; 4], [[0f32; 64]; 2], Vec::new());
            for k in 0..64 {
                let m = near(s, far);
                let size = far * 10f64.powf(-4.0 * random(s));
                let (turn, lean) = (6.3 * random(s), 1.57 + random(s) - 0.5);
                let a = [size * turn.cos(), size * turn.sin()];
                let b = [size * (turn + lean).cos(), size * (turn + lean).sin()];
                let domain = [(a, 1.0), (b, 1.0), (a, -1.0), (b, -1.0)]
                    .map(|(v, by)| [m[0] + by * v[0], m[1] + by * v[1]]);
                (columns[0][k], columns[1][k], columns[2][k]) = (m[0], m[1], size * (1.0 + 1e-12));
                for (arm, v) in arms.iter_mut().zip([a[0], a[1], b[0], b[1]]) {
                    arm[k] = v as f32;
                }
                let (lo, hi) = c.bounds(&domain);
                let by =
                    |s: &mut u64| 10f64.powf((random(s) - 0.5) * if random(s) < 0.3 { 1e-6 } else { 2.0 });
                heights[0][k] = if random(s) < 0.05 { f32::INFINITY } else { (lo * by(s)) as f32 };
                heights[1][k] = if random(s) < 0.05 { 0.0 } else { (hi * by(s)) as f32 };
                domains.push(domain);
            }
            let boxes = Boxes {
                x: &columns[0],
                y: &columns[1],
                radius: &columns[2],
                top: &heights[0],
                bot: &heights[1],
                arms: arms.each_ref().map(|a| &a[..]),
            };
            let f = c.foresee(&boxes, 1.1);
            let middles = c.foresee_middles(&boxes, 1.1);
            for (k, domain) in domains.iter().enumerate() {
                let (top, bot) = (1.1 * f64::from(heights[0][k]), f64::from(heights[1][k]));
                let told = [f.above_lo, f.below_hi, f.not_above_lo, f.not_below_hi].map(|m| m >> k & 1 == 1);
                told.iter().zip(&mut certain).for_each(|(t, n)| *n += usize::from(*t));
                let (lo, hi) = c.bounds(domain);
                assert!(!told[0] || lo < top, "{c:?} {domain:?}");
                assert!(!told[1] || bot <= hi, "{c:?} {domain:?}");
                // Parts that shrink to the middle.
                let m = [columns[0][k], columns[1][k]];
                let by = random(s).powi(4);
                let around = domain.map(|p| [0, 1].map(|k| m[k] + by * random(s) * (p[k] - m[k])));
                let (lo, hi) = c.bounds(&Region::hull(around.to_vec()).polygon);
                for (n, (told, holds)) in
                    [(middles.above_lo, lo < top), (middles.below_hi, bot <= hi)].into_iter().enumerate()
                {
                    let told = told >> k & 1 == 1;
                    certain[4 + n] += usize::from(told);
                    assert!(!told || holds, "{c:?} {around:?}");
                }
                let (lo, hi) = c.bounds(domain);
                let part = Region::hull((0..5).map(|_| near(s, far)).collect()).clip(domain);
                for (lo, hi) in [(lo, hi)].into_iter().chain((!part.is_empty()).then(|| c.bounds(&part))) {
                    assert!(!told[2] || lo >= top, "{c:?} {domain:?}");
                    assert!(!told[3] || bot > hi, "{c:?} {domain:?}");
                }
            }
        }
        assert!(certain.iter().all(|n| *n > 40_000), "{certain:?}");
    }
}
