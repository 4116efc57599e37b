//! Numbers with or without a gradient: one formula serves heights and normals, with the same bits.

use std::ops::{Add, Div, Mul, Sub};

/// What the surface is evaluated in.
pub trait Real:
    Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Div<Output = Self>
{
    fn constant(v: f64) -> Self;
    /// A value with its derivatives by x and y.
    fn with_gradient(v: f64, dx: f64, dy: f64) -> Self;
    fn value(self) -> f64;
    fn gradient(self) -> [f64; 2];
    fn scale(self, k: f64) -> Self {
        self * Self::constant(k)
    }
    /// `0` below 0, `1` above 1: the ramp g of class C0.
    fn ramp(self) -> Self {
        if self.value() <= 0.0 {
            Self::constant(0.0)
        } else if self.value() >= 1.0 {
            Self::constant(1.0)
        } else {
            self
        }
    }
}

impl Real for f64 {
    fn constant(v: f64) -> f64 {
        v
    }
    fn with_gradient(v: f64, _: f64, _: f64) -> f64 {
        v
    }
    fn value(self) -> f64 {
        self
    }
    fn gradient(self) -> [f64; 2] {
        [0.0; 2]
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
    fn constant(v: f64) -> Dual {
        Dual { v, x: 0.0, y: 0.0 }
    }
    fn with_gradient(v: f64, x: f64, y: f64) -> Dual {
        Dual { v, x, y }
    }
    fn value(self) -> f64 {
        self.v
    }
    fn gradient(self) -> [f64; 2] {
        [self.x, self.y]
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
