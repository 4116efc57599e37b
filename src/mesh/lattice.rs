//! The points at which triangles are measured.

/// A lattice 4 times finer than the posts, and how the points on it are kept on the grid of vertices.
pub(super) struct Lattice {
    pub origin: [f64; 2],
    /// Distance of posts, metres.
    pub step: f64,
    pub unit: f64,
    pub bound: f64,
    /// Horizontal distance within which a wall may be met, metres.
    pub wall: f64,
}

impl Lattice {
    /// The rows that cross a triangle: the first, and the one after the last.
    pub fn rows(&self, at: &[[f64; 3]; 3]) -> (i64, i64) {
        let h = self.step / 4.0;
        let low = at.iter().fold(f64::INFINITY, |m, p| m.min(p[1])) - self.origin[1];
        let high = at.iter().fold(f64::NEG_INFINITY, |m, p| m.max(p[1])) - self.origin[1];
        ((low / h).ceil() as i64, (high / h).floor() as i64 + 1)
    }

    fn snap(&self, x: f64) -> f64 {
        (x / self.unit).round() * self.unit
    }

    /// The points in some rows of a triangle, rounded to the grid where that leaves them in it.
    pub fn points(&self, at: &[[f64; 3]; 3], rows: (i64, i64), out: &mut Vec<[f64; 2]>) {
        let h = self.step / 4.0;
        for row in rows.0..rows.1 {
            let y = self.origin[1] + row as f64 * h;
            let (mut west, mut east) = (f64::INFINITY, f64::NEG_INFINITY);
            for k in 0..3 {
                let (a, b) = (at[k], at[(k + 1) % 3]);
                if (a[1] <= y) != (b[1] <= y) || a[1] == y {
                    let flat = a[1] == b[1];
                    let x = if flat { a[0] } else { a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]) };
                    west = west.min(x);
                    east = east.max(x);
                }
            }
            if west > east {
                continue;
            }
            let first = ((west - self.origin[0]) / h).ceil() as i64;
            let last = ((east - self.origin[0]) / h).floor() as i64;
            for column in first..=last {
                let p = [self.origin[0] + column as f64 * h, y];
                let snapped = p.map(|v| self.snap(v));
                out.push(if contains(at, snapped, 0.0) { snapped } else { p });
            }
        }
    }

    /// The points along an edge: every quarter of a step or nearer, the middle among them.
    pub fn along(&self, a: [f64; 3], b: [f64; 3], out: &mut Vec<[f64; 2]>) {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let count = (dx.hypot(dy) / (self.step / 4.0) / 2.0).ceil().max(1.0) as usize * 2;
        out.extend((1..count).map(|i| i as f64 / count as f64).map(|t| [a[0] + t * dx, a[1] + t * dy]));
    }
}

/// Whether a point is in the triangle or at most `slack` outside.
pub(super) fn contains(at: &[[f64; 3]; 3], p: [f64; 2], slack: f64) -> bool {
    (0..3).all(|k| {
        let (a, b) = (at[k], at[(k + 1) % 3]);
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        dx * (p[1] - a[1]) - (p[0] - a[0]) * dy >= -slack * (dx.abs() + dy.abs())
    })
}
