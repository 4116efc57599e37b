//! How low and how high the ground of a version can be: splines swing beyond their samples, corrections bend the ground
//! beyond them. A camera sees all of it only if its footprint is taken between these heights.

use super::database::Snapshot;
use super::seams::Fields;
use super::view::Tables;
use crate::height::lod::{KERNEL, SurveyNumber};
use crate::height::patch::Kind;
use crate::height::surface::{How, Seams};
use std::collections::HashMap;

/// How far the natural tensor spline through 33 x 33 vertices may be from a middle height, if its vertices are within 1 of
/// it: the square of the largest sum of absolute cardinal splines, 1.5491, rounded up (see the test).
const SWING: f64 = 2.4;
/// Vertices beside the data continue its slope, halved with each step: they may be one range beyond it on either side
/// ([`crate::height::patch::bicubic::extend`]), so three half ranges from its middle.
const EXTENDED: f64 = 3.0;

type Range = [f64; 2];

fn union(a: Range, b: Range) -> Range {
    [a[0].min(b[0]), a[1].max(b[1])]
}

/// What patches through samples of a range can reach.
fn swung(kind: Kind, z: Range) -> Range {
    match kind {
        Kind::Bilinear => z,
        Kind::Bicubic => {
            let (middle, half) = ((z[0] + z[1]) / 2.0, (z[1] - z[0]) / 2.0 * SWING * EXTENDED);
            [middle - half, middle + half]
        }
    }
}

impl Snapshot {
    /// Bounds of the surface's heights, metres: no point of any answer asked so is outside. `None` without surveys.
    ///
    /// A correction is a mean of gaps and of 0, at nodes and between them (section 15.1; B-splines have positive weights). A
    /// gap is the corrected height of a better survey nearby less the own one. So surveys are taken by falling
    /// authority: the corrected range of a better one less the own range bounds the own correction. Each link of a
    /// chain of surveys adds one range at most.
    pub(super) fn relief(&self, how: How) -> Option<Range> {
        let samples = self.z_range()?;
        if how.seams == Seams::Off {
            return Some(swung(self.kind(), samples));
        }
        let fields = self.fields(how);
        let mut surveys: Vec<SurveyNumber> = self.entries().map(|e| e.number).collect();
        surveys.sort_by(|a, b| fields.authority(*b, *a));
        // By survey: its samples, corrected.
        let mut corrected: HashMap<SurveyNumber, Range> = HashMap::new();
        let mut all = samples;
        for s in surveys {
            let e = &self.view.entries()[&s];
            let own = [e.z[0], e.z[1]];
            // Borders of places two rows away are felt.
            let near = e.geometry.core.grow(4 * KERNEL);
            let mut by: Range = [0.0; 2];
            for better in fields.above(s, &near) {
                let z = corrected[&better];
                by = union(by, fields.held(s, better, [z[0] - own[1], z[1] - own[0]]));
            }
            corrected.insert(s, [own[0] + by[0], own[1] + by[1]]);
            let shown = swung(self.kind(), own);
            all = union(all, [shown[0] + by[0], shown[1] + by[1]]);
        }
        Some(all)
    }

    /// The corrections of a way to ask.
    pub(super) fn fields(&self, how: How) -> Fields<'_> {
        Fields {
            view: &self.view,
            unit: self.unit,
            axis: self.crs.unit,
            consistent: how.seams == Seams::Consistent,
            smooth: self.kind() == Kind::Bicubic,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::height::lod::SIDE;
    use crate::height::patch::{Shape, Vertices};

    #[test]
    fn a_spline_swings_no_further_than_said() {
        // Cardinal splines along one axis: vertices that are 1 in one column.
        const PARTS: usize = 40;
        let mut sums = vec![0.0; (SIDE - 1) * PARTS];
        for k in 0..SIDE {
            let z: Vec<f64> = (0..SIDE * SIDE).map(|v| f64::from(u8::from(v % SIDE == k))).collect();
            let z: Box<Vertices> = z.into_boxed_slice().try_into().unwrap();
            let shape = Shape::new(Kind::Bicubic, z);
            for (n, sum) in sums.iter_mut().enumerate() {
                *sum += shape.at(n as f64 / PARTS as f64, 16.0).z.abs();
            }
        }
        let most = sums.into_iter().fold(0.0, f64::max);
        println!("sum of absolute cardinal splines: {most}");
        assert!((1.54..1.55).contains(&most) && most * most <= SWING);
    }
}
