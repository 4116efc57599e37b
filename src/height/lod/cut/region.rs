//! Convex regions of the plane, in CRS units.

/// A convex region: a polygon, counter-clockwise, possibly empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Region {
    pub polygon: Vec<[f64; 2]>,
}

impl Region {
    pub fn from_box(b: [f64; 4]) -> Region {
        Region { polygon: vec![[b[0], b[1]], [b[2], b[1]], [b[2], b[3]], [b[0], b[3]]] }
    }

    /// The convex hull of points (Andrew's monotone chain).
    pub fn hull(mut points: Vec<[f64; 2]>) -> Region {
        points.sort_by(|a, b| a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])));
        points.dedup();
        if points.len() < 3 {
            return Region { polygon: points };
        }
        let turn = |a: [f64; 2], b: [f64; 2], c: [f64; 2]| {
            (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        };
        let mut hull: Vec<[f64; 2]> = Vec::new();
        for pass in 0..2 {
            let start = hull.len();
            let chain: Box<dyn Iterator<Item = &[f64; 2]>> =
                if pass == 0 { Box::new(points.iter()) } else { Box::new(points.iter().rev()) };
            for p in chain {
                while hull.len() >= start + 2 && turn(hull[hull.len() - 2], hull[hull.len() - 1], *p) <= 0.0 {
                    hull.pop();
                }
                hull.push(*p);
            }
            hull.pop();
        }
        Region { polygon: hull }
    }

    pub fn is_empty(&self) -> bool {
        self.polygon.is_empty()
    }

    pub fn bounds(&self) -> [f64; 4] {
        bounds(&self.polygon)
    }

    /// The part of a convex polygon inside this region (Sutherland-Hodgman). A little slack keeps the borders in,
    /// so the result may be a hair larger than the truth, never smaller.
    pub fn clip(&self, polygon: &[[f64; 2]]) -> Vec<[f64; 2]> {
        let mut out = polygon.to_vec();
        let n = self.polygon.len();
        if n == 0 {
            return Vec::new();
        }
        for k in 0..n {
            let (a, b) = (self.polygon[k], self.polygon[(k + 1) % n]);
            let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
            let slack = (ex.abs() + ey.abs()) * (a[0].abs() + a[1].abs() + 1.0) * 1e-12;
            let side = |p: [f64; 2]| ex * (p[1] - a[1]) - ey * (p[0] - a[0]) + slack;
            let mut next = Vec::with_capacity(out.len() + 1);
            for m in 0..out.len() {
                let (p, q) = (out[m], out[(m + 1) % out.len()]);
                let (sp, sq) = (side(p), side(q));
                if sp >= 0.0 {
                    next.push(p);
                }
                if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
                    let t = sp / (sp - sq);
                    next.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
                }
            }
            out = next;
            if out.is_empty() {
                break;
            }
        }
        out
    }
}

/// xmin, ymin, xmax, ymax of points.
pub fn bounds(points: &[[f64; 2]]) -> [f64; 4] {
    points.iter().fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |b, p| {
        [b[0].min(p[0]), b[1].min(p[1]), b[2].max(p[0]), b[3].max(p[1])]
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clip_and_hull() {
        let r = Region::from_box([0.0, 0.0, 10.0, 10.0]);
        let b = bounds(&r.clip(&[[-5.0, 5.0], [5.0, -5.0], [15.0, 5.0], [5.0, 15.0]]));
        assert!((b[0] + b[1]).abs() < 1e-6 && (b[2] - 10.0).abs() < 1e-6);
        assert!(r.clip(&[[11.0, 11.0], [12.0, 11.0], [12.0, 12.0]]).is_empty());
        let h = Region::hull(vec![[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [2.0, 2.0], [0.0, 2.0], [1.0, 0.0]]);
        assert_eq!(h.polygon.len(), 4);
    }
}
