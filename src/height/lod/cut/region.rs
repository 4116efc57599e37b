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

    /// The part of a convex polygon inside this region: see [`Clip::part`].
    pub fn clip(&self, polygon: &[[f64; 2]]) -> Vec<[f64; 2]> {
        Clip::new(self).part(polygon).to_vec()
    }
}

/// A directed line whose left side stays. A little slack keeps what lies on it.
#[derive(Clone, Copy, Debug)]
struct Line {
    from: [f64; 2],
    along: [f64; 2],
    slack: f64,
}

impl Line {
    fn side(&self, p: [f64; 2]) -> f64 {
        self.along[0] * (p[1] - self.from[1]) - self.along[1] * (p[0] - self.from[0]) + self.slack
    }
}

/// Cuts many polygons along one region, without an allocation for each.
#[derive(Clone, Debug)]
pub struct Clip {
    lines: Vec<Line>,
    part: Vec<[f64; 2]>,
    next: Vec<[f64; 2]>,
    sides: Vec<f64>,
}

impl Clip {
    pub fn new(region: &Region) -> Clip {
        let p = &region.polygon;
        let lines = (0..p.len()).map(|k| {
            let (a, b) = (p[k], p[(k + 1) % p.len()]);
            let along = [b[0] - a[0], b[1] - a[1]];
            let slack = (along[0].abs() + along[1].abs()) * (a[0].abs() + a[1].abs() + 1.0) * 1e-12;
            Line { from: a, along, slack }
        });
        Clip { lines: lines.collect(), part: Vec::new(), next: Vec::new(), sides: Vec::new() }
    }

    /// The part of a convex polygon inside the region (Sutherland-Hodgman); empty if they do not meet. The slack of the
    /// borders may make it a hair larger than the truth, never smaller.
    pub fn part(&mut self, polygon: &[[f64; 2]]) -> &[[f64; 2]] {
        let Clip { lines, part, next, sides } = self;
        part.clear();
        if lines.is_empty() {
            return part;
        }
        part.extend_from_slice(polygon);
        for line in lines {
            let mut inside = true;
            sides.resize(part.len(), 0.0);
            for (side, p) in sides.iter_mut().zip(part.iter()) {
                *side = line.side(*p);
                inside &= *side >= 0.0;
            }
            if inside {
                continue;
            }
            next.clear();
            for m in 0..part.len() {
                let n = if m + 1 < part.len() { m + 1 } else { 0 };
                let (p, q, sp, sq) = (part[m], part[n], sides[m], sides[n]);
                if sp >= 0.0 {
                    next.push(p);
                }
                if (sp > 0.0 && sq < 0.0) || (sp < 0.0 && sq > 0.0) {
                    let t = sp / (sp - sq);
                    next.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
                }
            }
            std::mem::swap(part, next);
            if part.is_empty() {
                break;
            }
        }
        part
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
