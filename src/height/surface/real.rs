//! Numbers with or without derivatives: one formula serves heights, normals and curvature, with the same bits.

use crate::height::patch::{Kind, Local};
use std::ops::{Add, Div, Mul, Sub};

/// What the surface is evaluated in: `f64`, [`Dual`] or [`Jet`].
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    /// Derivatives that are carried along: none, first, first and second.
    const ORDER: u8;
    fn constant(v: f64) -> Self;
    /// A value that is linear in x and y, with its derivatives.
    fn with_gradient(v: f64, dx: f64, dy: f64) -> Self {
        Self::with_hessian(v, [dx, dy], [0.0; 3])
    }
    /// A value with its derivatives by x and y, and by xx, xy and yy.
    fn with_hessian(v: f64, gradient: [f64; 2], hessian: [f64; 3]) -> Self;
    fn value(self) -> f64;
    /// By x and y; 0 where they are not carried.
    fn gradient(self) -> [f64; 2];
    /// By xx, xy and yy; 0 where they are not carried.
    fn hessian(self) -> [f64; 3];
    #[inline(always)]
    fn scale(self, k: f64) -> Self {
        self * Self::constant(k)
    }
    /// A patch at (a, b), which are linear in x and y.
    #[inline(always)]
    fn of_patch(patch: Local, a: Self, b: Self) -> Self {
        let (ga, gb) = (a.gradient(), b.gradient());
        let ([s, t], [ss, st, tt]) = (patch.first, patch.second);
        let second = |x: usize, y: usize| {
            ss * (ga[x] * ga[y]) + st * (ga[x] * gb[y] + gb[x] * ga[y]) + tt * (gb[x] * gb[y])
        };
        Self::with_hessian(
            patch.z,
            [s * ga[0] + t * gb[0], s * ga[1] + t * gb[1]],
            [second(0, 0), second(0, 1), second(1, 1)],
        )
    }
    /// The ramp g of section 5.4: 0 below 0, 1 above 1; between them linear, or of class C2.
    #[inline(always)]
    fn ramp(self, kind: Kind) -> Self {
        let c = Self::constant;
        if self.value() <= 0.0 {
            return c(0.0);
        }
        if self.value() >= 1.0 {
            return c(1.0);
        }
        match kind {
            Kind::Bilinear => self,
            // 10 t^3 - 15 t^4 + 6 t^5
            Kind::Bicubic => self * self * self * (self * (self.scale(6.0) - c(15.0)) + c(10.0)),
        }
    }
    /// The weight of a patch in one direction, from the distance to the border of its domain: 0 there, 1 in the middle.
    /// The hat t, or t^3 (4 - 3t), which is (1 - |x|)^3 (3|x| + 1) for x = 1 - t (section 7).
    #[inline(always)]
    fn bump(self, kind: Kind) -> Self {
        match kind {
            Kind::Bilinear => self,
            Kind::Bicubic => self * self * self * (Self::constant(4.0) - self.scale(3.0)),
        }
    }
}

impl Real for f64 {
    const ORDER: u8 = 0;
    fn constant(v: f64) -> f64 {
        v
    }
    fn with_hessian(v: f64, _: [f64; 2], _: [f64; 3]) -> f64 {
        v
    }
    fn value(self) -> f64 {
        self
    }
    fn gradient(self) -> [f64; 2] {
        [0.0; 2]
    }
    fn hessian(self) -> [f64; 3] {
        [0.0; 3]
    }
}

/// A value and its gradient.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual {
    pub v: f64,
    pub x: f64,
    pub y: f64,
}

impl Real for Dual {
    const ORDER: u8 = 1;
    fn constant(v: f64) -> Dual {
        Dual { v, x: 0.0, y: 0.0 }
    }
    fn with_hessian(v: f64, [x, y]: [f64; 2], _: [f64; 3]) -> Dual {
        Dual { v, x, y }
    }
    fn value(self) -> f64 {
        self.v
    }
    fn gradient(self) -> [f64; 2] {
        [self.x, self.y]
    }
    fn hessian(self) -> [f64; 3] {
        [0.0; 3]
    }
}

impl Add for Dual {
    type Output = Dual;
    fn add(self, o: Dual) -> Dual {
        Dual { v: self.v + o.v, x: self.x + o.x, y: self.y + o.y }
    }
}
impl Sub for Dual {
    type Output = Dual;
    fn sub(self, o: Dual) -> Dual {
        Dual { v: self.v - o.v, x: self.x - o.x, y: self.y - o.y }
    }
}
impl Mul for Dual {
    type Output = Dual;
    fn mul(self, o: Dual) -> Dual {
        Dual { v: self.v * o.v, x: self.x * o.v + self.v * o.x, y: self.y * o.v + self.v * o.y }
    }
}
impl Div for Dual {
    type Output = Dual;
    fn div(self, o: Dual) -> Dual {
        let v = self.v / o.v;
        Dual { v, x: (self.x - v * o.x) / o.v, y: (self.y - v * o.y) / o.v }
    }
}

/// A value with its gradient and its second derivatives. Value and gradient have the bits of [`Dual`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jet {
    pub first: Dual,
    pub xx: f64,
    pub xy: f64,
    pub yy: f64,
}

impl Real for Jet {
    const ORDER: u8 = 2;
    fn constant(v: f64) -> Jet {
        Jet { first: Dual::constant(v), xx: 0.0, xy: 0.0, yy: 0.0 }
    }
    fn with_hessian(v: f64, gradient: [f64; 2], [xx, xy, yy]: [f64; 3]) -> Jet {
        Jet { first: Dual::with_hessian(v, gradient, [0.0; 3]), xx, xy, yy }
    }
    fn value(self) -> f64 {
        self.first.v
    }
    fn gradient(self) -> [f64; 2] {
        self.first.gradient()
    }
    fn hessian(self) -> [f64; 3] {
        [self.xx, self.xy, self.yy]
    }
}

impl Add for Jet {
    type Output = Jet;
    fn add(self, o: Jet) -> Jet {
        Jet { first: self.first + o.first, xx: self.xx + o.xx, xy: self.xy + o.xy, yy: self.yy + o.yy }
    }
}
impl Sub for Jet {
    type Output = Jet;
    fn sub(self, o: Jet) -> Jet {
        Jet { first: self.first - o.first, xx: self.xx - o.xx, xy: self.xy - o.xy, yy: self.yy - o.yy }
    }
}
impl Mul for Jet {
    type Output = Jet;
    fn mul(self, o: Jet) -> Jet {
        let (a, b) = (self.first, o.first);
        Jet {
            first: a * b,
            xx: self.xx * b.v + 2.0 * (a.x * b.x) + a.v * o.xx,
            xy: self.xy * b.v + (a.x * b.y + a.y * b.x) + a.v * o.xy,
            yy: self.yy * b.v + 2.0 * (a.y * b.y) + a.v * o.yy,
        }
    }
}
impl Div for Jet {
    type Output = Jet;
    fn div(self, o: Jet) -> Jet {
        // q b = a, differentiated twice.
        let (q, b) = (self.first / o.first, o.first);
        Jet {
            first: q,
            xx: (self.xx - 2.0 * (q.x * b.x) - q.v * o.xx) / b.v,
            xy: (self.xy - (q.x * b.y + q.y * b.x) - q.v * o.xy) / b.v,
            yy: (self.yy - 2.0 * (q.y * b.y) - q.v * o.yy) / b.v,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything that the evaluator does with numbers.
    fn formula<T: Real>(x: f64, y: f64, kind: Kind) -> T {
        let (a, b) = (T::with_gradient(x, 1.0, 0.0), T::with_gradient(y, 0.0, 1.0));
        let z = T::with_hessian(x * x * y, [2.0 * x * y, x * x], [2.0 * y, 2.0 * x, 0.0]);
        let g = (a * b).ramp(kind) + (T::constant(0.9) - b).bump(kind);
        (z * g + a.scale(3.0)) / (g + b * b)
    }

    #[test]
    fn one_formula_has_the_same_bits_with_and_without_derivatives() {
        for kind in Kind::ALL {
            for (x, y) in [(0.3, 0.8), (1.7, 0.2), (-0.4, 0.6), (2.0, 0.7)] {
                let (v, d, j) =
                    (formula::<f64>(x, y, kind), formula::<Dual>(x, y, kind), formula::<Jet>(x, y, kind));
                assert_eq!(v.to_bits(), d.v.to_bits());
                assert_eq!(d, j.first);
                let h = 1e-5;
                let central = |f: &dyn Fn(f64) -> f64| (f(h) - f(-h)) / (2.0 * h);
                let found = [j.first.x, j.first.y, j.xx, j.xy, j.yy];
                let truth = [
                    central(&|e| formula::<f64>(x + e, y, kind)),
                    central(&|e| formula::<f64>(x, y + e, kind)),
                    central(&|e| formula::<Dual>(x + e, y, kind).x),
                    central(&|e| formula::<Dual>(x + e, y, kind).y),
                    central(&|e| formula::<Dual>(x, y + e, kind).y),
                ];
                for (f, t) in found.iter().zip(truth) {
                    assert!((f - t).abs() < 1e-7 * (1.0 + t.abs()), "{kind:?} {x} {y}: {found:?} {truth:?}");
                }
            }
        }
    }

    #[test]
    fn ramps_and_weights_end_with_two_derivatives() {
        for t in [1e-9, 1.0 - 1e-9] {
            // Near 1 the polynomial keeps some 14 digits.
            let g = Jet::with_gradient(t, 1.0, 0.0).ramp(Kind::Bicubic);
            let off = [g.value() - t.round(), g.gradient()[0], g.xx];
            assert!(off[0].abs() < 1e-13 && off[1].abs() < 1e-12 && off[2].abs() < 1e-6, "{t}: {off:?}");
        }
        let w = |t: f64| Jet::with_gradient(t, 1.0, 0.0).bump(Kind::Bicubic);
        assert!(w(0.0).hessian()[0] == 0.0 && w(0.0).gradient()[0] == 0.0 && w(0.0).value() == 0.0);
        // The middle: slope 0 and curvature -12 from both sides.
        assert_eq!((w(1.0).value(), w(1.0).gradient()[0], w(1.0).hessian()[0]), (1.0, 0.0, -12.0));
        assert_eq!(0.25f64.bump(Kind::Bilinear), 0.25);
        assert_eq!(0.25f64.ramp(Kind::Bilinear), 0.25);
    }
}
