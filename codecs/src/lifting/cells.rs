//! Wavelets on pictures of 2^n x 2^n cells (specification of GTB, section 6.1).
//!
//! A level filters rows, then columns, and leaves the quarter of the low band in the corner of row 0, column 0; the next level goes on
//! there. A plane stays one array, row by row; the side of a band is the side of the plane, halved once a level:
//!
//! ```text
//! LL HL     LL: low along rows and columns     HL: high along rows (differences from west to east)
//! LH HH     HH: high along both                LH: high along columns (differences from north to south)
//! ```
//!
//! All arithmetic is in integers, wrapping where coefficients are absurd, so that every machine has the same bytes.

use std::ops::Range;

/// A wavelet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wavelet {
    /// CDF 5/3: reversible. The low band keeps the scale of the cells.
    FiveThree,
    /// CDF 9/7, coefficients in 16384ths: better where few coefficients are kept. Its inverse is exact within 8 units a level: give it
    /// cells with some bits of fraction, at most 15 bits with their sign.
    NineSeven,
}

/// A band of details.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Band {
    /// High along rows.
    Hl,
    /// High along columns.
    Lh,
    /// High along both.
    Hh,
}

impl Band {
    /// The bands in the order in which they are told.
    pub const ALL: [Band; 3] = [Band::Hl, Band::Lh, Band::Hh];

    /// Rows and columns that the band of a level has in a plane of `side` cells; level 1 is the finest.
    pub fn area(self, side: usize, level: u32) -> [Range<usize>; 2] {
        let half = side >> level;
        let (y, x) = match self {
            Band::Hl => (0, half),
            Band::Lh => (half, 0),
            Band::Hh => (half, half),
        };
        [y..y + half, x..x + half]
    }
}

/// Columns that are lifted together.
const LANES: usize = 16;

/// One lifting step: the cells of one parity gain `(by * (left + right) + round) >> shift`.
struct Step {
    /// Whether the odd cells change, by the even ones beside them; else the even by the odd.
    odd: bool,
    by: i32,
    round: i32,
    shift: u32,
}

const fn step(odd: bool, by: i32, shift: u32) -> Step {
    // -floor(s / 2) is (-s + 1) >> 1: the 5/3 of the standards.
    Step { odd, by, round: 1 << (shift - 1), shift }
}

const FIVE_THREE: [Step; 2] = [step(true, -1, 1), step(false, 1, 2)];
const NINE_SEVEN: [Step; 4] =
    [step(true, -25_987, 14), step(false, -868, 14), step(true, 14_466, 14), step(false, 7_266, 14)];
/// The low band of the 9/7 is brought back to the scale of the cells: 1 / 1.230174 and its inverse, in 16384ths.
const NINE_SEVEN_LOW: [i32; 2] = [13_318, 20_155];

impl Wavelet {
    fn steps(self) -> &'static [Step] {
        match self {
            Wavelet::FiveThree => &FIVE_THREE,
            Wavelet::NineSeven => &NINE_SEVEN,
        }
    }

    /// Transforms `plane`, `side * side` cells, in place, over `levels` levels; `side` is a power of two and `levels` at most its
    /// logarithm. Time: linear; memory beside the plane: 64 bytes a row.
    pub fn forward(self, plane: &mut [i32], side: usize, levels: u32) {
        check(plane, side, levels);
        let mut line = Line::new(side);
        for level in 0..levels {
            let m = side >> level;
            for y in 0..m {
                line.one.lift(self, false, &mut plane[y * side..][..m], 1, 0);
            }
            line.columns(self, false, plane, side, m);
        }
    }

    /// Undoes [`Wavelet::forward`]; the same costs.
    pub fn inverse(self, plane: &mut [i32], side: usize, levels: u32) {
        check(plane, side, levels);
        let mut line = Line::new(side);
        for level in (0..levels).rev() {
            let m = side >> level;
            line.columns(self, true, plane, side, m);
            for y in 0..m {
                line.one.lift(self, true, &mut plane[y * side..][..m], 1, 0);
            }
        }
    }
}

fn check(plane: &[i32], side: usize, levels: u32) {
    assert!(
        side.is_power_of_two() && plane.len() == side * side && levels <= side.trailing_zeros(),
        "{} cells are no square of side {side} = 2^n with {levels} levels",
        plane.len()
    );
}

/// Room for lines under way: of one row, and of several columns together.
struct Line {
    one: Lifted<1>,
    many: Lifted<LANES>,
}

impl Line {
    fn new(side: usize) -> Line {
        Line { one: Lifted::new(side), many: Lifted::new(if side >= LANES { side } else { 0 }) }
    }

    /// Lifts the columns of the `m` x `m` corner, many at a time where there are so many.
    fn columns(&mut self, wavelet: Wavelet, back: bool, plane: &mut [i32], side: usize, m: usize) {
        let corner = &mut plane[..(m - 1) * side + m];
        if m >= LANES {
            (0..m).step_by(LANES).for_each(|x| self.many.lift(wavelet, back, corner, side, x));
        } else {
            (0..m).for_each(|x| self.one.lift(wavelet, back, corner, side, x));
        }
    }
}

/// `L` lines beside each other, even and odd cells apart.
struct Lifted<const L: usize> {
    even: Vec<[i32; L]>,
    odd: Vec<[i32; L]>,
}

impl<const L: usize> Lifted<L> {
    fn new(side: usize) -> Lifted<L> {
        Lifted { even: Vec::with_capacity(side / 2), odd: Vec::with_capacity(side / 2) }
    }

    /// Transforms the `L` lines from `x` on, whose cells lie `by` apart, or brings them `back`. As bands, the low half comes first;
    /// as cells, even and odd ones take turns.
    fn lift(&mut self, wavelet: Wavelet, back: bool, lines: &mut [i32], by: usize, x: usize) {
        let half = lines.len().div_ceil(by) / 2;
        self.even.clear();
        self.odd.clear();
        for (k, row) in lines.chunks(by).enumerate() {
            let even = if back { k < half } else { k % 2 == 0 };
            let mut cells = [0; L];
            cells.copy_from_slice(&row[x..x + L]);
            if even { self.even.push(cells) } else { self.odd.push(cells) }
        }
        if back {
            if wavelet == Wavelet::NineSeven {
                self.scale(NINE_SEVEN_LOW[1]);
            }
            wavelet.steps().iter().rev().for_each(|s| self.step(s, true));
            let cells = self.even.iter().zip(&self.odd).flat_map(|(e, o)| [e, o]);
            lines.chunks_mut(by).zip(cells).for_each(|(row, v)| row[x..x + L].copy_from_slice(v));
        } else {
            wavelet.steps().iter().for_each(|s| self.step(s, false));
            if wavelet == Wavelet::NineSeven {
                self.scale(NINE_SEVEN_LOW[0]);
            }
            let cells = self.even.iter().chain(&self.odd);
            lines.chunks_mut(by).zip(cells).for_each(|(row, v)| row[x..x + L].copy_from_slice(v));
        }
    }

    fn scale(&mut self, by: i32) {
        for v in self.even.iter_mut().flatten() {
            *v = v.wrapping_mul(by).wrapping_add(1 << 13) >> 14;
        }
    }

    /// Adds a step, or takes it back. Beyond an end the line goes on as in a mirror that stands on the last cell.
    fn step(&mut self, step: &Step, back: bool) {
        let (even, odd) = (&mut self.even[..], &mut self.odd[..]);
        let n = even.len();
        if step.odd {
            for k in 0..n {
                change(&mut odd[k], &even[k], &even[(k + 1).min(n - 1)], step, back);
            }
        } else {
            for k in 0..n {
                change(&mut even[k], &odd[k.saturating_sub(1)], &odd[k], step, back);
            }
        }
    }
}

#[inline(always)]
fn change<const L: usize>(to: &mut [i32; L], a: &[i32; L], b: &[i32; L], step: &Step, back: bool) {
    for k in 0..L {
        let gain = a[k].wrapping_add(b[k]).wrapping_mul(step.by).wrapping_add(step.round) >> step.shift;
        to[k] = if back { to[k].wrapping_sub(gain) } else { to[k].wrapping_add(gain) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn plane(n: u32, seed: u64, span: i32) -> Vec<i32> {
        let mut state = seed | 1;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as i32
        };
        (0..1usize << (2 * n)).map(|_| if span == 0 { next() } else { next() % span }).collect()
    }

    proptest! {
        /// The 5/3 comes back exactly, the 9/7 within eight units a level, whatever the cells are.
        #[test]
        fn the_inverse_undoes(n in 0u32..=7, cut in 0u32..=7, seed in any::<u64>(), wild in any::<bool>()) {
            let (side, levels) = (1usize << n, n.saturating_sub(cut));
            let cells = plane(n, seed, if wild { 0 } else { 4096 });
            let mut there = cells.clone();
            Wavelet::FiveThree.forward(&mut there, side, levels);
            Wavelet::FiveThree.inverse(&mut there, side, levels);
            prop_assert_eq!(&there, &cells);
            let cells = plane(n, seed, 4096);
            let mut there = cells.clone();
            Wavelet::NineSeven.forward(&mut there, side, levels);
            Wavelet::NineSeven.inverse(&mut there, side, levels);
            for (a, b) in cells.iter().zip(&there) {
                prop_assert!((a - b).unsigned_abs() <= 8 * levels, "{} became {}", a, b);
            }
        }
    }

    /// A flat picture has no details and keeps its level; a slope from west to east has details only at the mirror.
    #[test]
    fn flat_and_sloping() {
        let side = 32;
        for wavelet in [Wavelet::FiveThree, Wavelet::NineSeven] {
            let mut flat = vec![1000; side * side];
            wavelet.forward(&mut flat, side, 5);
            assert!((flat[0] - 1000).abs() <= 3, "{wavelet:?} {}", flat[0]);
            assert!(flat[1..].iter().all(|v| v.abs() <= 1));
        }
        let mut slope: Vec<i32> = (0..side * side).map(|k| (k % side) as i32 * 8).collect();
        Wavelet::FiveThree.forward(&mut slope, side, 1);
        let [rows, columns] = Band::Hl.area(side, 1);
        for y in rows {
            assert_eq!(slope[y * side + columns.end - 1], 8);
            assert!(slope[y * side..][columns.start..columns.end - 1].iter().all(|v| *v == 0));
        }
        for band in [Band::Lh, Band::Hh] {
            let [rows, columns] = band.area(side, 1);
            for y in rows {
                assert!(slope[y * side..][columns.clone()].iter().all(|v| *v == 0), "{band:?}");
            }
        }
    }
}
