//! A survey as the surface sees it: where its posts lie, and where its measured cells can be.

use super::Real;
use crate::base::lattice::Point;
use crate::height::frame::{Frame, LatticeUnit};
use crate::height::lod::{Geometry, KERNEL, MARGIN};

/// A survey as the surface sees it.
#[derive(Clone, Debug)]
pub struct SurveyField {
    pub accuracy: f32,
    pub(super) frame: Frame,
    /// A post in the middle of the survey, CRS units, and its index coordinates: positions are taken from there.
    pub(super) middle: [f64; 2],
    pub(super) middle_index: [f64; 2],
    /// Index coordinates of one CRS unit in x and y.
    pub(super) by_x: [f64; 2],
    pub(super) by_y: [f64; 2],
    /// Half the side of a level-0 domain, CRS units.
    pub(super) half: [f64; 2],
    /// Where core' can be, in cells, and the ring around it: lowest and highest index.
    pub(super) reach: [[f64; 2]; 2],
}

impl SurveyField {
    /// Positions in a survey are taken from a post of its own, so that digits are kept, and a height is the same bit for bit
    /// from whatever region it is asked.
    pub fn new(g: &Geometry, unit: LatticeUnit) -> SurveyField {
        let (frame, steps, accuracy) = (&g.frame, g.steps, g.accuracy);
        let size = unit.size();
        let post = frame.post((g.core.i0 + g.core.i1) / 2, (g.core.j0 + g.core.j1) / 2);
        let middle = [post.x as f64, post.y as f64];
        let (i, j) = frame.index(Point::new(middle[0] as i64, middle[1] as i64));
        let d = frame.determinant() as f64 * size * size;
        let (u, v) = (frame.u, frame.v);
        let half = (KERNEL / 2 + MARGIN) as f64;
        SurveyField {
            accuracy,
            frame: *frame,
            middle: middle.map(|v| v * size),
            middle_index: [i, j],
            by_x: [v.y as f64 * size / d, -(u.y as f64) * size / d],
            by_y: [-(v.x as f64) * size / d, u.x as f64 * size / d],
            half: [half * steps[0], half * steps[1]],
            reach: [[g.core.i0 - 2, g.core.j0 - 2], [g.core.i1 + 2, g.core.j1 + 2]]
                .map(|r| r.map(|v| v as f64)),
        }
    }

    /// Index coordinates of a point (CRS units).
    #[inline(always)]
    pub(super) fn index<T: Real>(&self, p: [f64; 2]) -> [T; 2] {
        let p = [p[0] - self.middle[0], p[1] - self.middle[1]];
        [0, 1].map(|k| {
            let v = self.middle_index[k] + (self.by_x[k] * p[0] + self.by_y[k] * p[1]);
            T::with_gradient(v, self.by_x[k], self.by_y[k])
        })
    }
}
