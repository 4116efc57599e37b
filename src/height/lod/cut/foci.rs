//! Foci: places around which little error is allowed, and more the farther away (section 5.2 of the LOD-space
//! specification): `delta(p) = min over k of d_k + c_k max(0, r_k - R_k)`.

use super::camera::distance_to_origin;
use super::{Cut, bounds};
use crate::base::{Error, Result};

/// One place: inside the radius the error is allowed as it is, outside it grows with the distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Focus {
    /// Where, in CRS units.
    pub center: [f64; 2],
    /// Metres.
    pub radius: f64,
    /// Metres allowed within the radius.
    pub error: f64,
    /// Metres more for each metre beyond it.
    pub growth: f64,
}

/// The least of what several foci allow.
///
/// Distances are in metres, taken in the plane that is true to scale at the focus: in a CRS in degrees a circle is an
/// ellipse there.
#[derive(Clone, Debug, PartialEq)]
pub struct Foci {
    foci: Vec<Focus>,
    /// Metres of one CRS unit in x and y at each focus.
    scales: Vec<[f64; 2]>,
}

impl Foci {
    /// Foci in a CRS in metres.
    ///
    /// # Errors
    /// If there is none, or a number is negative or not finite.
    pub fn new(foci: Vec<Focus>) -> Result<Foci> {
        if foci.is_empty() {
            return Err(Error::invalid("--focus", "none given"));
        }
        for f in &foci {
            if !f.center.iter().all(|v| v.is_finite()) {
                return Err(Error::invalid("--focus", format!("{:?} is no place", f.center)));
            }
            for (what, v) in [("RADIUS", f.radius), ("ERROR", f.error), ("GROWTH", f.growth)] {
                if !(v >= 0.0 && v.is_finite()) {
                    return Err(Error::invalid("--focus", format!("{what} is {v}; it must be 0 or more")));
                }
            }
        }
        Ok(Foci { scales: vec![[1.0; 2]; foci.len()], foci })
    }

    /// The same foci where a CRS unit is `scale(place)` metres.
    pub fn scaled(mut self, scale: impl Fn([f64; 2]) -> [f64; 2]) -> Foci {
        self.scales = self.foci.iter().map(|f| scale(f.center)).collect();
        self
    }

    pub fn foci(&self) -> &[Focus] {
        &self.foci
    }

    /// A point as focus k sees it: metres east and north.
    fn local(&self, k: usize, p: [f64; 2]) -> [f64; 2] {
        [0, 1].map(|a| (p[a] - self.foci[k].center[a]) * self.scales[k][a])
    }

    fn allowed(&self, k: usize, distance: f64) -> f64 {
        let f = &self.foci[k];
        (f.error + f.growth * (distance - f.radius).max(0.0)).min(f64::MAX)
    }

    /// The focus that allows least at a point, the first of them.
    fn strictest(&self, p: [f64; 2]) -> (usize, f64) {
        let at = |k: usize| {
            let [x, y] = self.local(k, p);
            self.allowed(k, x.hypot(y))
        };
        (1..self.foci.len()).fold((0, at(0)), |(best, least), k| {
            let here = at(k);
            if here < least { (k, here) } else { (best, least) }
        })
    }

    /// The strictest focus at a point, the way to the point from there and its length, if the tolerance grows there.
    fn growing(&self, p: [f64; 2]) -> Option<(usize, [f64; 2], f64)> {
        let (k, _) = self.strictest(p);
        let d = self.local(k, p);
        let r = d[0].hypot(d[1]);
        (r > self.foci[k].radius && r > 0.0).then_some((k, d, r))
    }
}

impl Cut for Foci {
    fn bounds(&self, polygon: &[[f64; 2]]) -> (f64, f64) {
        let (mut lo, mut hi) = (f64::INFINITY, f64::INFINITY);
        for k in 0..self.foci.len() {
            let seen: Vec<[f64; 2]> = polygon.iter().map(|p| self.local(k, *p)).collect();
            let far = seen.iter().fold(0.0f64, |m, p| m.max(p[0].hypot(p[1])));
            // The last digits of the coordinates: bounds may be loose, never tight in the wrong direction.
            let slack = 1e-12 * (far + bounds(polygon).iter().fold(1.0f64, |m, v| m.max(v.abs())));
            lo = lo.min(self.allowed(k, distance_to_origin(seen.iter().copied()) - slack));
            hi = hi.min(self.allowed(k, far + slack));
        }
        (lo * (1.0 - 1e-12), (hi * (1.0 + 1e-12)).min(f64::MAX))
    }

    fn at(&self, p: [f64; 2]) -> f64 {
        self.strictest(p).1
    }

    fn gradient(&self, p: [f64; 2]) -> [f64; 2] {
        let Some((k, d, r)) = self.growing(p) else { return [0.0; 2] };
        [0, 1].map(|a| self.foci[k].growth * d[a] / r * self.scales[k][a])
    }

    /// 0 inside a radius. There are kinks on the circles and where foci meet.
    fn hessian(&self, p: [f64; 2]) -> [f64; 3] {
        let Some((k, [x, y], r)) = self.growing(p) else { return [0.0; 3] };
        let (c, [sx, sy]) = (self.foci[k].growth / (r * r * r), self.scales[k]);
        [c * y * y * sx * sx, -c * x * y * sx * sy, c * x * x * sy * sy]
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::{derivatives_hold, random, within_bounds};
    use super::*;

    fn some(s: &mut u64, count: usize) -> Foci {
        let foci = (0..count)
            .map(|_| Focus {
                center: [4000.0 * random(s) - 2000.0, 5_000_000.0 + 4000.0 * random(s) - 2000.0],
                radius: if random(s) < 0.3 { 0.0 } else { 800.0 * random(s) },
                error: 3.0 * random(s),
                growth: 0.1 * random(s),
            })
            .collect();
        Foci::new(foci).unwrap()
    }

    #[test]
    fn bounds_hold_over_polygons() {
        let mut s = 11;
        for n in 0..3000 {
            let mut f = some(&mut s, 1 + n % 4);
            if n % 3 == 0 {
                f = f.scaled(|_| [78_000.0, 111_000.0]);
            }
            within_bounds(&f, [0.0, 5_000_000.0], 3000.0, 60, &mut s);
        }
    }

    #[test]
    fn bounds_are_those_of_a_cone() {
        let f = Foci::new(vec![Focus { center: [0.0; 2], radius: 10.0, error: 1.0, growth: 0.5 }]).unwrap();
        let (lo, hi) = f.bounds(&[[20.0, -5.0], [30.0, -5.0], [30.0, 0.0], [20.0, 5.0]]);
        assert!((lo - 6.0).abs() < 1e-6, "20 m from the focus: {lo}");
        assert!((hi - (1.0 + 0.5 * (30f64.hypot(5.0) - 10.0))).abs() < 1e-6, "{hi}");
        assert_eq!(f.at([6.0, 8.0]), 1.0);
        assert_eq!(f.at([0.0, -30.0]), 11.0);
    }

    #[test]
    fn gradient_and_hessian_are_the_derivatives() {
        let mut s = 5;
        for _ in 0..50 {
            let f = some(&mut s, 1).scaled(|_| [0.7, 1.3]);
            let p = [9000.0 * random(&mut s), 5_000_000.0 + 9000.0 * random(&mut s)];
            derivatives_hold(&f, p, |p| f.hessian(p));
        }
        let flat =
            Foci::new(vec![Focus { center: [0.0; 2], radius: 10.0, error: 1.0, growth: 0.5 }]).unwrap();
        assert_eq!((flat.gradient([3.0, 0.0]), flat.hessian([0.0; 2])), ([0.0; 2], [0.0; 3]));
    }

    #[test]
    fn impossible_foci_are_refused() {
        let good = Focus { center: [0.0; 2], radius: 1.0, error: 1.0, growth: 0.0 };
        assert!(Foci::new(Vec::new()).is_err());
        for bad in [
            Focus { radius: -1.0, ..good },
            Focus { error: f64::NAN, ..good },
            Focus { growth: -0.1, ..good },
            Focus { center: [f64::INFINITY, 0.0], ..good },
        ] {
            assert!(Foci::new(vec![good, bad]).is_err(), "{bad:?}");
        }
    }
}
