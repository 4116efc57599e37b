//! The lattice of one step, taken apart: known posts, centres and the two kinds of edges as dense planes.
//!
//! ```text
//! K H K H K      K  known before the step: rows and columns of even number, (m + 1) x (m + 1)
//! V C V C V      C  centres: m x m
//! K H K H K      H  edges in even rows: (m + 1) x m
//! V C V C V      V  edges in odd rows: m x (m + 1)
//! K H K H K
//! ```
//!
//! So every neighbour of a row of posts is a run of consecutive numbers, at every step.

use crate::lattice::Lattice;

/// Numbers in rows.
#[derive(Clone, Default)]
pub(super) struct Plane<T> {
    pub width: usize,
    values: Vec<T>,
}

impl<T: Copy + Default> Plane<T> {
    pub fn new(width: usize, rows: usize) -> Plane<T> {
        Plane { width, values: vec![T::default(); width * rows] }
    }
    #[inline(always)]
    pub fn row(&self, i: usize) -> &[T] {
        &self.values[i * self.width..][..self.width]
    }
    #[inline(always)]
    pub fn row_mut(&mut self, i: usize) -> &mut [T] {
        &mut self.values[i * self.width..][..self.width]
    }
    #[cfg(test)]
    pub fn len(&self) -> usize {
        self.values.len()
    }
    /// The value at a place that may lie outside.
    pub fn get(&self, i: isize, j: isize) -> Option<T> {
        let inside = i >= 0 && j >= 0 && (j as usize) < self.width;
        inside.then(|| self.values.get(i as usize * self.width + j as usize).copied()).flatten()
    }
}

/// The planes of one step.
pub(super) struct Planes<T> {
    /// Squares along a side of the coarser lattice.
    pub m: usize,
    pub k: Plane<T>,
    pub c: Plane<T>,
    pub h: Plane<T>,
    pub v: Plane<T>,
}

impl<T: Copy + Default> Planes<T> {
    /// Of the coarsest step, from the corners (in the order of [`Lattice::corners`]).
    pub fn new(corners: [T; 4]) -> Planes<T> {
        Planes::around(1, Plane { width: 2, values: corners.to_vec() })
    }

    fn around(m: usize, k: Plane<T>) -> Planes<T> {
        Planes { m, k, c: Plane::new(m, m), h: Plane::new(m, m + 1), v: Plane::new(m + 1, m) }
    }

    /// The next finer step: all four planes become its known one.
    pub fn finer(self) -> Planes<T> {
        let width = 2 * self.m + 1;
        let mut k = Plane { width, values: Vec::with_capacity(width * width) };
        for i in 0..=self.m {
            weave(&mut k.values, self.k.row(i), self.h.row(i));
            if i < self.m {
                weave(&mut k.values, self.v.row(i), self.c.row(i));
            }
        }
        drop((self.k, self.c, self.h, self.v));
        Planes::around(2 * self.m, k)
    }
}

/// `even[0] odd[0] even[1] ... even[n]`.
fn weave<T: Copy>(out: &mut Vec<T>, even: &[T], odd: &[T]) {
    let n = odd.len();
    out.extend(even[..n].iter().zip(odd).flat_map(|(a, b)| [*a, *b]));
    out.push(even[n]);
}

impl Planes<i32> {
    /// Writes all posts of the step into the lattice; those that are not coded yet are 0 there.
    pub fn write(&self, lattice: Lattice, z: &mut [i32]) {
        let (side, m) = (lattice.side(), self.m);
        let s = lattice.last() / (2 * m);
        let mut put = |y: usize, first: usize, row: &[i32]| {
            let row = row.iter().enumerate();
            row.for_each(|(j, v)| z[y * side + first + 2 * s * j] = *v);
        };
        for i in 0..=m {
            put(2 * s * i, 0, self.k.row(i));
            put(2 * s * i, s, self.h.row(i));
        }
        for i in 0..m {
            put(2 * s * i + s, 0, self.v.row(i));
            put(2 * s * i + s, s, self.c.row(i));
        }
    }
}
