//! A grid of samples in the plane or in space; sample by sample it covers cells of side 1.

/// A box of samples, the first axis running fastest: columns, rows (and layers).
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<const D: usize> {
    /// Samples along each axis.
    pub size: [usize; D],
    /// The samples.
    pub values: Vec<f64>,
}

/// Steps in memory between neighbours along each axis.
pub fn strides<const D: usize>(size: [usize; D]) -> [usize; D] {
    let mut out = [1; D];
    for a in 1..D {
        out[a] = out[a - 1] * size[a - 1];
    }
    out
}

/// Visits every point of a box, the first axis fastest.
#[inline]
pub fn points<const D: usize>(size: [usize; D]) -> impl Iterator<Item = [usize; D]> {
    let count: usize = size.iter().product();
    let mut next = [0; D];
    (0..count).map(move |_| {
        let p = next;
        for a in 0..D {
            next[a] += 1;
            if next[a] < size[a] {
                break;
            }
            next[a] = 0;
        }
        p
    })
}

impl<const D: usize> Grid<D> {
    /// A grid of one value.
    pub fn filled(size: [usize; D], value: f64) -> Grid<D> {
        Grid { size, values: vec![value; size.iter().product()] }
    }

    /// The place of a sample in memory.
    #[inline(always)]
    pub fn at(&self, p: [usize; D]) -> usize {
        let mut out = 0;
        for a in (0..D).rev() {
            out = out * self.size[a] + p[a];
        }
        out
    }

    /// Each 2 x 2 (x 2) box becomes its mean; an odd sample at an end is left out.
    pub fn half(&self) -> Grid<D> {
        let mut out = Grid::filled(self.size.map(|n| n / 2), 0.0);
        self.half_into(&mut out.values);
        out
    }

    /// As [`half`](Grid::half), into memory that is there.
    pub fn half_into(&self, out: &mut [f64]) {
        let strides = strides(self.size);
        let size = self.size.map(|n| n / 2);
        let row = size[0];
        let share = 1.0 / (1 << D) as f64;
        let mut rows = size;
        rows[0] = 1;
        if row == 0 {
            return;
        }
        for (p, out) in points(rows).zip(out.chunks_exact_mut(row)) {
            let start = self.at(p.map(|v| 2 * v));
            match D {
                2 => {
                    let (a, b) = (&self.values[start..], &self.values[start + strides[1]..]);
                    for ((o, a), b) in out.iter_mut().zip(a.chunks_exact(2)).zip(b.chunks_exact(2)) {
                        *o = ((a[0] + a[1]) + (b[0] + b[1])) * share;
                    }
                }
                _ => {
                    for (k, o) in out.iter_mut().enumerate() {
                        let mut sum = 0.0;
                        for corner in points([2; D]) {
                            let step: usize = (0..D).map(|a| corner[a] * strides[a]).sum();
                            sum += self.values[start + 2 * k + step];
                        }
                        *o = sum * share;
                    }
                }
            }
        }
    }

    /// The mean of the 2 x 2 (x 2) box that begins at each sample, the sum taken as [`half`](Grid::half) takes it; past the last whole box 0.
    pub(super) fn boxes(&self) -> Grid<D> {
        let mut out = Grid::filled(self.size, 0.0);
        self.boxes_into(&mut out.values);
        out
    }

    /// As [`boxes`](Grid::boxes), into memory that is there.
    pub(super) fn boxes_into(&self, out: &mut [f64]) {
        let strides = strides(self.size);
        let mut rows = self.size.map(|n| n - n.min(1));
        let row = rows[0];
        rows[0] = rows[0].min(1);
        let share = 1.0 / (1 << D) as f64;
        for p in points(rows) {
            let start = self.at(p);
            for (at, o) in out[start..start + row].iter_mut().enumerate() {
                let v = |k: usize| {
                    let step: usize = (0..D).map(|a| (k >> a & 1) * strides[a]).sum();
                    self.values[start + at + step]
                };
                *o = match D {
                    2 => ((v(0) + v(1)) + (v(2) + v(3))) * share,
                    _ => (0..1 << D).fold(0.0, |sum, k| sum + v(k)) * share,
                };
            }
        }
    }

    /// The samples of the cube of `side` at `corner`, the first axis fastest.
    pub fn block(&self, corner: [usize; D], side: usize, out: &mut [f64]) {
        let mut rows = [side; D];
        rows[0] = 1;
        for (p, out) in points(rows).zip(out.chunks_exact_mut(side)) {
            let mut q = corner;
            (0..D).for_each(|a| q[a] += p[a]);
            let at = self.at(q);
            out.copy_from_slice(&self.values[at..at + side]);
        }
    }
}
