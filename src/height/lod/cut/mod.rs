//! Tolerance surfaces: how much error is allowed where. Predicates only; the tree does not know which is which.

mod camera;
mod foci;
mod raster;
mod region;
#[cfg(test)]
mod testing;

pub use camera::Camera;
pub use foci::{Foci, Focus};
pub use raster::ErrorRaster;
pub use region::{Clip, Lies, Region, bounds};

/// A tolerance over the plane, metres (section 5.2 of the LOD-space specification).
pub trait Cut: Sync {
    /// Bounds `(lo, hi)` of the tolerance over a convex polygon; loose ones only return extra patches.
    fn bounds(&self, polygon: &[[f64; 2]]) -> (f64, f64);
    /// The tolerance, if it is the same everywhere.
    fn even(&self) -> Option<f64> {
        None
    }
    /// What [`Cut::bounds`] will say, from discs alone: far cheaper, and enough for most patches. The middle of disc k is at
    /// `x[k]`, `y[k]`. `out` has as many places; a tolerance that knows no better leaves them as they are.
    fn foresee(&self, _x: &[f64], _y: &[f64], _radius: &[f64], _out: &mut [Foreseen]) {}
    /// The tolerance at a point.
    fn at(&self, p: [f64; 2]) -> f64;
    /// Its derivatives by x and y there.
    fn gradient(&self, p: [f64; 2]) -> [f64; 2];
    /// Its second derivatives by xx, xy and yy there; where it has a kink, those of one side.
    fn hessian(&self, p: [f64; 2]) -> [f64; 3];
    /// The tolerance, if it is the same at every point.
    fn everywhere(&self) -> Option<f64> {
        None
    }
}

/// Between what the bounds `(lo, hi)` lie over any convex polygon within a disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Foreseen {
    /// `lo` is no less, `hi` no more.
    pub lo_least: f64,
    pub hi_most: f64,
    /// Over a polygon that holds the middle of the disc: `lo` is no more, `hi` no less.
    pub lo_most: f64,
    pub hi_least: f64,
}

impl Foreseen {
    pub const NOTHING: Foreseen = Foreseen {
        lo_least: f64::NEG_INFINITY,
        hi_most: f64::INFINITY,
        lo_most: f64::INFINITY,
        hi_least: f64::NEG_INFINITY,
    };
}

/// The same tolerance everywhere.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Constant(pub f64);

impl Cut for Constant {
    fn bounds(&self, _: &[[f64; 2]]) -> (f64, f64) {
        (self.0, self.0)
    }
    fn even(&self) -> Option<f64> {
        Some(self.0)
    }
    fn at(&self, _: [f64; 2]) -> f64 {
        self.0
    }
    fn gradient(&self, _: [f64; 2]) -> [f64; 2] {
        [0.0; 2]
    }
    fn hessian(&self, _: [f64; 2]) -> [f64; 3] {
        [0.0; 3]
    }
    fn everywhere(&self) -> Option<f64> {
        Some(self.0)
    }
}
