//! Tolerance surfaces: how much error is allowed where. Predicates only; the tree does not know which is which.

mod bits;
mod camera;
mod foci;
mod lots;
mod raster;
mod region;
#[cfg(test)]
mod testing;

pub use bits::pack;
pub use camera::Camera;
pub use foci::{Foci, Focus};
pub use lots::LOT;
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
    /// What is certain of boxes of LOD space, many at a time: far cheaper than [`Cut::bounds`], and enough for most patches. A tolerance
    /// that knows no better says nothing.
    fn foresee(&self, _boxes: &Boxes, _kappa: f64) -> Foreseen {
        Foreseen::default()
    }
    /// The same of parts of domains: `above_lo` and `below_hi` hold for the bounds over every part that holds the middle, however
    /// little else. The other two are not told.
    fn foresee_middles(&self, _boxes: &Boxes, _kappa: f64) -> Foreseen {
        Foreseen::default()
    }
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

/// Boxes of LOD space in columns, 64 at most: domains (parallelograms) in CRS units, and how far they reach along the axis of errors,
/// metres.
#[derive(Clone, Copy, Debug)]
pub struct Boxes<'a> {
    /// Middles of domains.
    pub x: &'a [f64],
    pub y: &'a [f64],
    /// From the middle to the farthest corner.
    pub radius: &'a [f64],
    pub top: &'a [f32],
    pub bot: &'a [f32],
    /// From the middle to the first corner and to the second: x, y, x, y.
    pub arms: [&'a [f32]; 4],
}

/// What is certain of boxes, bit k of the k-th (bits after the last box mean nothing): how their tops, times kappa, and bots compare with the bounds `(lo, hi)` that
/// [`Cut::bounds`] gives. The first two hold for the bounds over the whole domain, the others for those over any part of it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Foreseen {
    /// `lo < kappa top`
    pub above_lo: u64,
    /// `bot <= hi`
    pub below_hi: u64,
    /// `lo >= kappa top`
    pub not_above_lo: u64,
    /// `bot > hi`
    pub not_below_hi: u64,
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
