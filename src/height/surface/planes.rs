//! Heights of many points, one array for each thing that is said of them.

use super::Evaluation;

/// The surface at many points: what an [`Evaluation`] says without gradients, in arrays. 21 bytes a point, 29 with seams
/// corrected.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Planes {
    /// Heights, metres; NaN where there is no data.
    pub z: Vec<f64>,
    /// Largest errors of the contributing patches, metres; NaN where there is no data.
    pub error_m: Vec<f64>,
    /// Stated accuracies of the best surveys there, metres; NaN where there is no data.
    pub accuracy_m: Vec<f32>,
    /// [`Planes::DATA`], [`Planes::CERTIFIED`] and [`Planes::CONTRADICTION`].
    pub marks: Vec<u8>,
    /// What the correction of seams added, metres; empty where seams are not corrected.
    pub correction_m: Vec<f64>,
}

/// Some consecutive points of [`Planes`], to be filled.
pub struct Band<'a> {
    pub(super) z: &'a mut [f64],
    pub(super) error_m: &'a mut [f64],
    pub(super) accuracy_m: &'a mut [f32],
    pub(super) marks: &'a mut [u8],
    pub(super) correction_m: &'a mut [f64],
}

impl Planes {
    /// There is a height.
    pub const DATA: u8 = 1;
    /// Its error is promised.
    pub const CERTIFIED: u8 = 2;
    /// Its correction comes from surveys that contradict each other.
    pub const CONTRADICTION: u8 = 4;

    /// Of `points` points without data, with room for corrections of seams where `corrected`.
    pub fn new(points: usize, corrected: bool) -> Planes {
        Planes {
            z: vec![f64::NAN; points],
            error_m: vec![f64::NAN; points],
            accuracy_m: vec![f32::NAN; points],
            marks: vec![0; points],
            correction_m: vec![0.0; if corrected { points } else { 0 }],
        }
    }

    /// Of as many points, to be filled: what they say until then has no meaning. Memory is touched once only.
    pub fn unfilled(points: usize, corrected: bool) -> Planes {
        let mut planes = Planes::default();
        planes.resize(points, corrected);
        planes
    }

    /// Makes it one of `points` points in the memory that it has, to be filled as [`Planes::unfilled`].
    pub fn resize(&mut self, points: usize, corrected: bool) {
        fn to<T: Clone>(plane: &mut Vec<T>, points: usize, zero: T) {
            if plane.capacity() < points {
                // Fresh memory comes as zeros.
                *plane = vec![zero; points];
            } else {
                plane.resize(points, zero);
            }
        }
        to(&mut self.z, points, 0.0);
        to(&mut self.error_m, points, 0.0);
        to(&mut self.accuracy_m, points, 0.0);
        to(&mut self.marks, points, 0);
        to(&mut self.correction_m, if corrected { points } else { 0 }, 0.0);
    }

    /// Of points whose evaluations are known.
    pub fn of(found: &[Option<Evaluation>], corrected: bool) -> Planes {
        let mut planes = Planes::new(found.len(), corrected);
        for mut band in planes.bands(found.len().max(1)) {
            found.iter().enumerate().for_each(|(k, e)| band.set(k, e.as_ref()));
        }
        planes
    }

    pub fn len(&self) -> usize {
        self.z.len()
    }

    pub fn is_empty(&self) -> bool {
        self.z.is_empty()
    }

    /// The marks of a point with a height.
    pub(super) fn marks(certified: bool, contradiction: bool) -> u8 {
        let mut marks = Planes::DATA;
        if certified {
            marks |= Planes::CERTIFIED;
        }
        if contradiction {
            marks |= Planes::CONTRADICTION;
        }
        marks
    }

    pub fn has_data(&self, k: usize) -> bool {
        self.marks[k] & Planes::DATA != 0
    }

    pub fn is_certified(&self, k: usize) -> bool {
        self.marks[k] & Planes::CERTIFIED != 0
    }

    /// What is said of a point, in one piece; `None` where there is no data.
    #[inline]
    pub fn evaluation(&self, k: usize) -> Option<Evaluation> {
        let marks = self.marks[k];
        (marks & Planes::DATA != 0).then(|| Evaluation {
            z: self.z[k],
            gradient: [0.0; 2],
            error_m: self.error_m[k],
            accuracy_m: f64::from(self.accuracy_m[k]),
            certified: marks & Planes::CERTIFIED != 0,
            correction_m: self.correction_m.get(k).copied().unwrap_or(0.0),
            contradiction: marks & Planes::CONTRADICTION != 0,
        })
    }

    /// What is said of all points, in order.
    pub fn evaluations(&self) -> Vec<Option<Evaluation>> {
        (0..self.len()).map(|k| self.evaluation(k)).collect()
    }

    /// Its points in parts of `points`, the last one smaller.
    pub fn bands(&mut self, points: usize) -> Vec<Band<'_>> {
        let mut corrections = self.correction_m.chunks_mut(points);
        self.z
            .chunks_mut(points)
            .zip(self.error_m.chunks_mut(points))
            .zip(self.accuracy_m.chunks_mut(points))
            .zip(self.marks.chunks_mut(points))
            .map(|(((z, error_m), accuracy_m), marks)| {
                let correction_m = corrections.next().unwrap_or_default();
                Band { z, error_m, accuracy_m, marks, correction_m }
            })
            .collect()
    }

    /// Copies a point of `from` to place `to`.
    #[inline]
    pub fn put_one(&mut self, to: usize, from: &Planes, k: usize) {
        (self.z[to], self.error_m[to]) = (from.z[k], from.error_m[k]);
        (self.accuracy_m[to], self.marks[to]) = (from.accuracy_m[k], from.marks[k]);
        if let Some(c) = self.correction_m.get_mut(to) {
            *c = from.correction_m[k];
        }
    }

    /// Copies rows of `cols` points of `from` to the block whose first point is `first`, in rows of `width`.
    pub fn put(&mut self, first: usize, width: usize, from: &Planes, cols: usize) {
        fn rows<T: Copy>(to: &mut [T], first: usize, width: usize, from: &[T], cols: usize) {
            for (k, row) in from.chunks(cols).enumerate() {
                to[first + k * width..][..cols].copy_from_slice(row);
            }
        }
        rows(&mut self.z, first, width, &from.z, cols);
        rows(&mut self.error_m, first, width, &from.error_m, cols);
        rows(&mut self.accuracy_m, first, width, &from.accuracy_m, cols);
        rows(&mut self.marks, first, width, &from.marks, cols);
        rows(&mut self.correction_m, first, width, &from.correction_m, cols);
    }
}

impl Band<'_> {
    /// Writes what was found at a point.
    pub(super) fn set(&mut self, k: usize, found: Option<&Evaluation>) {
        let Some(e) = found else {
            (self.z[k], self.error_m[k], self.accuracy_m[k], self.marks[k]) =
                (f64::NAN, f64::NAN, f32::NAN, 0);
            if let Some(c) = self.correction_m.get_mut(k) {
                *c = 0.0;
            }
            return;
        };
        self.z[k] = e.z;
        self.error_m[k] = e.error_m;
        // Accuracies are stored as f32: the same number.
        self.accuracy_m[k] = e.accuracy_m as f32;
        self.marks[k] = Planes::marks(e.certified, e.contradiction);
        if let Some(c) = self.correction_m.get_mut(k) {
            *c = e.correction_m;
        }
    }
}
