//! Finding the patches near a point.

/// Which patches may contain a point: a uniform grid of lists, about two squares a patch.
pub(super) struct Buckets {
    min: [f64; 2],
    per_unit: [f64; 2],
    count: [usize; 2],
    /// Ends of the lists, row by row; the lists themselves, each ascending.
    ends: Vec<u32>,
    lists: Vec<u32>,
}

impl Buckets {
    /// `boxes`: xmin, ymin, xmax, ymax of each patch.
    pub fn new(boxes: &[[f64; 4]]) -> Buckets {
        let b = boxes
            .iter()
            .fold([f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY], |b, x| {
                [b[0].min(x[0]), b[1].min(x[1]), b[2].max(x[2]), b[3].max(x[3])]
            });
        if boxes.is_empty() {
            return Buckets {
                min: [0.0; 2],
                per_unit: [0.0; 2],
                count: [0; 2],
                ends: Vec::new(),
                lists: Vec::new(),
            };
        }
        let (w, h) = ((b[2] - b[0]).max(1e-12), (b[3] - b[1]).max(1e-12));
        let squares = (2 * boxes.len()).clamp(1, 1 << 20) as f64;
        let nx = ((squares * w / h).sqrt().ceil().clamp(1.0, squares)) as usize;
        let ny = ((squares / nx as f64).ceil().clamp(1.0, squares)) as usize;
        let mut grid = Buckets {
            min: [b[0], b[1]],
            per_unit: [nx as f64 / w, ny as f64 / h],
            count: [nx, ny],
            ends: vec![0; nx * ny],
            lists: Vec::new(),
        };
        let spans: Vec<([usize; 2], [usize; 2])> =
            boxes.iter().map(|x| (grid.square([x[0], x[1]]), grid.square([x[2], x[3]]))).collect();
        for (lo, hi) in &spans {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    grid.ends[y * nx + x] += 1;
                }
            }
        }
        let mut total = 0;
        for e in &mut grid.ends {
            total += *e;
            *e = total - *e;
        }
        grid.lists = vec![0; total as usize];
        for (k, (lo, hi)) in spans.iter().enumerate() {
            for y in lo[1]..=hi[1] {
                for x in lo[0]..=hi[0] {
                    let at = &mut grid.ends[y * nx + x];
                    grid.lists[*at as usize] = k as u32;
                    *at += 1;
                }
            }
        }
        grid
    }

    fn square(&self, p: [f64; 2]) -> [usize; 2] {
        [0, 1].map(|k| {
            let t = (p[k] - self.min[k]) * self.per_unit[k];
            (t.max(0.0) as usize).min(self.count[k].saturating_sub(1))
        })
    }

    /// Number of squares.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// The square of a point; of one outside, the nearest.
    pub fn number(&self, p: [f64; 2]) -> u32 {
        let s = self.square(p);
        (s[1] * self.count[0] + s[0]) as u32
    }

    /// The list of a square.
    pub fn list(&self, number: u32) -> &[u32] {
        let Some(end) = self.ends.get(number as usize) else { return &[] };
        let from = if number == 0 { 0 } else { self.ends[number as usize - 1] };
        &self.lists[from as usize..*end as usize]
    }

    pub fn at(&self, p: [f64; 2]) -> &[u32] {
        self.list(self.number(p))
    }

    /// Which patches may contain a point of a box, ascending.
    pub fn within(&self, min: [f64; 2], max: [f64; 2], out: &mut Vec<u32>) {
        out.clear();
        if self.ends.is_empty() {
            return;
        }
        let (lo, hi) = (self.square(min), self.square(max));
        for y in lo[1]..=hi[1] {
            for x in lo[0]..=hi[0] {
                out.extend_from_slice(self.list((y * self.count[0] + x) as u32));
            }
        }
        if lo != hi {
            out.sort_unstable();
            out.dedup();
        }
    }
}
