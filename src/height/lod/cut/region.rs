//! Convex regions of the plane, in CRS units.

use super::pack;
use multiversion::multiversion;

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

/// How a disc lies to a region, as far as that is certain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lies {
    /// All of it inside.
    Inside,
    /// Its middle is inside.
    Middle,
    /// It may meet the region or not.
    Unclear,
    Outside,
}

/// A directed line whose left side stays. A little slack keeps what lies on it.
#[derive(Clone, Copy, Debug)]
struct Line {
    from: [f64; 2],
    along: [f64; 2],
    slack: f64,
    /// Of length 1, to the left.
    normal: [f64; 2],
}

impl Line {
    /// How far to the left a point is.
    #[inline(always)]
    fn depth(&self, p: [f64; 2]) -> f64 {
        self.normal[0] * (p[0] - self.from[0]) + self.normal[1] * (p[1] - self.from[1])
    }

    fn side(&self, p: [f64; 2]) -> f64 {
        self.along[0] * (p[1] - self.from[1]) - self.along[1] * (p[0] - self.from[0]) + self.slack
    }
}

/// Cuts many polygons along one region, without an allocation for each.
#[derive(Clone, Debug)]
pub struct Clip {
    lines: Vec<Line>,
    /// The largest coordinate of the region.
    reach: f64,
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
            let length = along[0].hypot(along[1]);
            Line { from: a, along, slack, normal: [-along[1] / length, along[0] / length] }
        });
        let reach = p.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
        Clip { lines: lines.collect(), reach, part: Vec::new(), next: Vec::new(), sides: Vec::new() }
    }

    /// How a disc lies to the region: some operations a border, where [`Clip::part`] takes some dozens. It agrees with what that makes
    /// of a convex polygon within the disc: of one [`Lies::Inside`] the part is the polygon itself, of one [`Lies::Outside`] it is
    /// empty, and with [`Lies::Middle`] it is not empty if the polygon holds the middle.
    ///
    /// Nothing is certain closer to a border than a hair, 1e-9 of the coordinates: the slack of borders and last digits are less than
    /// half of it. A disc that is inside by two hairs more has every smaller one in it inside.
    #[inline]
    pub fn lies(&self, center: [f64; 2], radius: f64) -> Lies {
        let hair = self.hair(center);
        // Of a border without a length there is no distance (NaN, which is passed over); it cuts nothing off.
        let depth = self.lines.iter().fold(f64::INFINITY, |d, l| d.min(l.depth(center)));
        if self.lines.is_empty() || depth < -(radius + hair) {
            Lies::Outside
        } else if depth > radius + hair {
            Lies::Inside
        } else if depth > hair {
            Lies::Middle
        } else {
            Lies::Unclear
        }
    }

    /// The borders that matter for discs within another, bit k for border k; those beyond the 63rd share the last bit. None: every
    /// such disc lies [`Lies::Inside`].
    #[inline]
    pub fn borders(&self, center: [f64; 2], radius: f64) -> u64 {
        let clear = |l: &Line| l.depth(center) > radius + 3.0 * self.hair(center);
        let borders = self.lines.iter().enumerate().map(|(k, l)| u64::from(!clear(l)) << k.min(63));
        if self.lines.is_empty() { u64::MAX } else { borders.fold(0, |a, b| a | b) }
    }

    #[inline(always)]
    fn hair(&self, at: [f64; 2]) -> f64 {
        1e-9 * (1.0 + self.reach + at[0].abs() + at[1].abs())
    }

    /// Of 64 discs at most, within one that has these [`Clip::borders`]: which lie inside, which have their middle inside, and which may
    /// meet the region, as [`Clip::lies`] tells of each.
    pub fn sort(&self, x: &[f64], y: &[f64], radius: &[f64], borders: u64) -> [u64; 3] {
        let mut out = [[0; 64]; 3];
        sort(self, (x, y, radius), borders, &mut out);
        if self.lines.is_empty() { [0; 3] } else { out.each_ref().map(pack) }
    }

    /// As [`Clip::part`], of a polygon within a disc: borders that the disc is clear of cut nothing off and are passed over.
    pub fn part_within(&mut self, polygon: &[[f64; 2]], center: [f64; 2], radius: f64) -> &[[f64; 2]] {
        let borders = self.borders(center, radius);
        self.cut(polygon, borders)
    }

    /// The part of a convex polygon inside the region (Sutherland-Hodgman); empty if they do not meet. The slack of the
    /// borders may make it a hair larger than the truth, never smaller.
    pub fn part(&mut self, polygon: &[[f64; 2]]) -> &[[f64; 2]] {
        self.cut(polygon, u64::MAX)
    }

    fn cut(&mut self, polygon: &[[f64; 2]], borders: u64) -> &[[f64; 2]] {
        let Clip { lines, part, next, sides, .. } = self;
        part.clear();
        if lines.is_empty() {
            return part;
        }
        part.extend_from_slice(polygon);
        for (_, line) in lines.iter().enumerate().filter(|(k, _)| borders >> k.min(&63) & 1 == 1) {
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

/// [`Clip::sort`] in columns of 0 and 1.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
fn sort(
    clip: &Clip,
    (x, y, radius): (&[f64], &[f64], &[f64]),
    borders: u64,
    [inside, middle, met]: &mut [[u8; 64]; 3],
) {
    let n = x.len().min(64);
    let (x, y, radius) = (&x[..n], &y[..n], &radius[..n]);
    let mut depth = [f64::INFINITY; 64];
    let depth = &mut depth[..n];
    for (k, l) in clip.lines.iter().enumerate() {
        if borders >> k.min(63) & 1 == 1 {
            for k in 0..n {
                depth[k] = depth[k].min(l.depth([x[k], y[k]]));
            }
        }
    }
    for k in 0..n {
        let hair = clip.hair([x[k], y[k]]);
        inside[k] = u8::from(depth[k] > radius[k] + hair);
        middle[k] = u8::from(depth[k] > hair);
        met[k] = u8::from(depth[k] >= -(radius[k] + hair));
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
    /// Quads around random middles, near borders and far from them, held against their parts.
    #[test]
    fn what_is_said_of_a_disc_holds_for_what_lies_in_it() {
        use super::super::testing::random;
        let s = &mut 0x5eed;
        let mut seen = [0; 4];
        for n in 0..40_000 {
            let middle = [600_000.0, 5_000_000.0];
            let reach = [1.0, 300.0, 20_000.0][n % 3];
            let near = |s: &mut u64| [0, 1].map(|k| middle[k] + reach * (2.0 * random(s) - 1.0));
            let region = match n % 4 {
                0 => Region::from_box([
                    middle[0] - reach,
                    middle[1] - reach / 2.0,
                    middle[0],
                    middle[1] + reach,
                ]),
                _ => Region::hull((0..3 + n % 5).map(|_| near(s)).collect()),
            };
            let mut clip = Clip::new(&region);
            let (center, radius) = (near(s), reach * random(s).powi(2));
            let turn = 7.0 * random(s);
            let quad: [[f64; 2]; 4] = std::array::from_fn(|k| {
                let a = turn + std::f64::consts::FRAC_PI_2 * k as f64;
                [center[0] + radius * a.cos(), center[1] + radius * a.sin()]
            });
            let lies = clip.lies(center, radius);
            seen[lies as usize] += 1;
            let within = radius * (1.0 + random(s));
            let sorted = clip.sort(&[center[0]], &[center[1]], &[radius], clip.borders(center, within));
            let wanted =
                [lies == Lies::Inside, lies == Lies::Inside || lies == Lies::Middle, lies != Lies::Outside];
            assert_eq!(sorted, wanted.map(u64::from));
            let within = clip.part_within(&quad, center, radius).to_vec();
            let part = clip.part(&quad);
            assert_eq!(within, part);
            match lies {
                Lies::Inside => assert_eq!(part, quad),
                Lies::Middle => assert!(!part.is_empty()),
                Lies::Unclear => {}
                Lies::Outside => assert!(part.is_empty(), "{region:?} {quad:?}"),
            }
        }
        assert!(seen.iter().all(|n| *n > 1000), "{seen:?}");
    }
}
