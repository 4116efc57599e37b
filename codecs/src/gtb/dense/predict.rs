//! The cubic: 10/32 of the four nearest posts, -1/32 of eight outer ones (specification of GTB, section 5), a row at a time.

use super::planes::Planes;
use multiversion::multiversion;

/// Which plane a row belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Row {
    Centres(usize),
    Even(usize),
    Odd(usize),
}

/// What is known of the posts of a row before it is coded.
#[derive(Default)]
pub(super) struct Guess {
    /// 32 times the prediction.
    pub p32: Vec<i32>,
    /// The activity around, but for the post to the west, in 32nds of a unit.
    pub still: Vec<u32>,
}

/// The most that a magnitude counts.
pub(super) const MAGNITUDE_MAX: u32 = 65_535;

/// Weights in the activity: magnitudes (quarters of a unit) of nearest posts, of posts of the pass, spread of the nearest (units).
const NEAR: u32 = 1;
pub(super) const OWN: u32 = 5;
const SPREAD: u32 = 5;

/// Predicts a row from heights and magnitudes of residuals.
pub(super) fn predict(z: &Planes<i32>, r: &Planes<u16>, row: Row, guess: &mut Guess) {
    let m = z.m;
    let width = if matches!(row, Row::Odd(_)) { m + 1 } else { m };
    guess.p32.resize(width, 0);
    guess.still.resize(width, 0);
    let (p32, still) = (&mut guess.p32[..width], &mut guess.still[..width]);
    let whole = match row {
        Row::Centres(i) | Row::Odd(i) => i >= 1 && i + 2 <= m,
        Row::Even(i) => i >= 1 && i < m,
    };
    // Columns with all neighbours.
    let last = if matches!(row, Row::Odd(_)) { m } else { m.saturating_sub(1) };
    if whole && last > 1 {
        let n = last - 1;
        let (p, s) = (&mut p32[1..last], &mut still[1..last]);
        match row {
            Row::Centres(i) => {
                let [a, b, c, d] = [i - 1, i, i + 1, i + 2].map(|i| z.k.row(i));
                let near = [&b[1..], &b[2..], &c[1..], &c[2..]];
                let far = [&a[1..], &a[2..], b, &b[3..], c, &c[3..], &d[1..], &d[2..]];
                let [b, c] = [i, i + 1].map(|i| r.k.row(i));
                let own = r.c.row(i - 1);
                let by = [&b[1..], &b[2..], &c[1..], &c[2..]].map(|x| &x[..n]);
                middle(near.map(|x| &x[..n]), far.map(|x| &x[..n]), p, s);
                activity(by, [own, &own[1..], &own[2..]].map(|x| &x[..n]), s);
            }
            Row::Even(i) => {
                let [a, b, c] = [i - 1, i, i + 1].map(|i| z.k.row(i));
                let [n1, s1] = [i - 1, i].map(|i| z.c.row(i));
                let near = [&b[1..], &b[2..], &n1[1..], &s1[1..]];
                let far = [&a[1..], &a[2..], n1, &n1[2..], s1, &s1[2..], &c[1..], &c[2..]];
                let b = r.k.row(i);
                let by = [&b[1..], &b[2..], &r.c.row(i - 1)[1..], &r.c.row(i)[1..]].map(|x| &x[..n]);
                let odd = r.v.row(i - 1);
                middle(near.map(|x| &x[..n]), far.map(|x| &x[..n]), p, s);
                activity(by, [&odd[1..], &odd[2..], &r.h.row(i - 1)[1..]].map(|x| &x[..n]), s);
            }
            Row::Odd(i) => {
                let [b, c] = [i, i + 1].map(|i| z.k.row(i));
                let [n1, o, s1] = [i - 1, i, i + 1].map(|i| z.c.row(i));
                let near = [&b[1..], &c[1..], o, &o[1..]];
                let far = [n1, &n1[1..], b, &b[2..], c, &c[2..], s1, &s1[1..]];
                let o = r.c.row(i);
                let by = [&r.k.row(i)[1..], &r.k.row(i + 1)[1..], o, &o[1..]].map(|x| &x[..n]);
                let even = r.h.row(i);
                middle(near.map(|x| &x[..n]), far.map(|x| &x[..n]), p, s);
                activity(by, [even, &even[1..], &r.v.row(i - 1)[1..]].map(|x| &x[..n]), s);
            }
        }
        (p32[0], still[0]) = at_border(z, r, row, 0);
        (last..width).for_each(|j| (p32[j], still[j]) = at_border(z, r, row, j));
    } else {
        (0..width).for_each(|j| (p32[j], still[j]) = at_border(z, r, row, j));
    }
}

/// Prediction and spread of posts with all neighbours.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn middle(near: [&[i32]; 4], far: [&[i32]; 8], p32: &mut [i32], still: &mut [u32]) {
    let n = p32.len();
    let [a, b, c, d] = near.map(|x| &x[..n]);
    let far = far.map(|x| &x[..n]);
    let still = &mut still[..n];
    for t in 0..n {
        let (a, b, c, d) = (a[t], b[t], c[t], d[t]);
        let sum = a.wrapping_add(b).wrapping_add(c.wrapping_add(d));
        let outer = far.iter().fold(0i32, |s, x| s.wrapping_add(x[t]));
        let most = a.max(b).max(c.max(d));
        let least = a.min(b).min(c.min(d));
        p32[t] = sum.wrapping_mul(10).wrapping_sub(outer);
        still[t] = (most.wrapping_sub(least) as u32).min(1 << 24) * SPREAD;
    }
}

/// Adds the magnitudes around.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512vl", "x86_64+avx2"))]
fn activity(near: [&[u16]; 4], own: [&[u16]; 3], still: &mut [u32]) {
    let n = still.len();
    let (near, own) = (near.map(|x| &x[..n]), own.map(|x| &x[..n]));
    for t in 0..n {
        let near = near.iter().fold(0, |s, x| s + u32::from(x[t]));
        let own = own.iter().fold(0, |s, x| s + u32::from(x[t]));
        still[t] += near * NEAR + own * OWN;
    }
}

/// The definition, for posts that lack neighbours: one that is missing counts as the mean of the nearest that exist.
fn at_border(z: &Planes<i32>, r: &Planes<u16>, row: Row, j: usize) -> (i32, u32) {
    let near = nearest(z, row, j);
    let there = || near.iter().flatten();
    let count = there().count() as i32;
    let sum = there().fold(0i32, |s, v| s.wrapping_add(*v));
    let mean = |n: usize| sum.wrapping_mul(n as i32).div_euclid(count.max(1));
    let far = outer(z, row, j);
    let p32 = sum
        .wrapping_mul(10)
        .wrapping_add(mean(10 * near.iter().filter(|v| v.is_none()).count()))
        .wrapping_sub(far.iter().flatten().fold(0i32, |s, v| s.wrapping_add(*v)))
        .wrapping_sub(mean(far.iter().filter(|v| v.is_none()).count()));
    let most = there().max().copied().unwrap_or(0);
    let least = there().min().copied().unwrap_or(0);
    let spread = (most.wrapping_sub(least) as u32).min(1 << 24);
    let near: u32 = nearest(r, row, j).iter().flatten().map(|v| u32::from(*v)).sum();
    let own: u32 = before(r, row, j).iter().flatten().map(|v| u32::from(*v)).sum();
    (p32, spread * SPREAD + near * NEAR + own * OWN)
}

/// The four nearest.
fn nearest<T: Copy + Default>(z: &Planes<T>, row: Row, j: usize) -> [Option<T>; 4] {
    let j = j as isize;
    match row {
        Row::Centres(i) => {
            let i = i as isize;
            [(i, j), (i, j + 1), (i + 1, j), (i + 1, j + 1)].map(|(i, j)| z.k.get(i, j))
        }
        Row::Even(i) => {
            let i = i as isize;
            [z.k.get(i, j), z.k.get(i, j + 1), z.c.get(i - 1, j), z.c.get(i, j)]
        }
        Row::Odd(i) => {
            let i = i as isize;
            [z.k.get(i, j), z.k.get(i + 1, j), z.c.get(i, j - 1), z.c.get(i, j)]
        }
    }
}

/// The eight outer ones.
fn outer<T: Copy + Default>(z: &Planes<T>, row: Row, j: usize) -> [Option<T>; 8] {
    let j = j as isize;
    let k = |i: isize, j: isize| z.k.get(i, j);
    let c = |i: isize, j: isize| z.c.get(i, j);
    match row {
        Row::Centres(i) => {
            let i = i as isize;
            [
                k(i - 1, j),
                k(i - 1, j + 1),
                k(i, j - 1),
                k(i, j + 2),
                k(i + 1, j - 1),
                k(i + 1, j + 2),
                k(i + 2, j),
                k(i + 2, j + 1),
            ]
        }
        Row::Even(i) => {
            let i = i as isize;
            [
                k(i - 1, j),
                k(i - 1, j + 1),
                c(i - 1, j - 1),
                c(i - 1, j + 1),
                c(i, j - 1),
                c(i, j + 1),
                k(i + 1, j),
                k(i + 1, j + 1),
            ]
        }
        Row::Odd(i) => {
            let i = i as isize;
            [
                c(i - 1, j - 1),
                c(i - 1, j),
                k(i, j - 1),
                k(i, j + 1),
                k(i + 1, j - 1),
                k(i + 1, j + 1),
                c(i + 1, j - 1),
                c(i + 1, j),
            ]
        }
    }
}

/// Those of the pass in rows before.
fn before<T: Copy + Default>(z: &Planes<T>, row: Row, j: usize) -> [Option<T>; 3] {
    let j = j as isize;
    match row {
        Row::Centres(i) => [-1, 0, 1].map(|d| z.c.get(i as isize - 1, j + d)),
        Row::Even(i) => {
            let i = i as isize;
            [z.v.get(i - 1, j), z.v.get(i - 1, j + 1), z.h.get(i - 1, j)]
        }
        Row::Odd(i) => {
            let i = i as isize;
            [z.h.get(i, j - 1), z.h.get(i, j), z.v.get(i - 1, j)]
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows at once and the definition give the same.
    #[test]
    fn rows_are_the_definition() {
        let mut state = 7u64;
        let mut random = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 40) as i32 - (1 << 23)
        };
        let mut z = Planes::new([1, -5, 900, 33]);
        let mut r = Planes::new([0u16, 4, 9, 2]);
        for _ in 0..6 {
            for p in [&mut z.c, &mut z.h, &mut z.v] {
                (0..p.len() / p.width).for_each(|i| p.row_mut(i).iter_mut().for_each(|v| *v = random()));
            }
            for p in [&mut r.c, &mut r.h, &mut r.v] {
                (0..p.len() / p.width)
                    .for_each(|i| p.row_mut(i).iter_mut().for_each(|v| *v = random() as u16));
            }
            let m = z.m;
            let rows = (0..m).map(Row::Centres).chain((0..=m).map(Row::Even)).chain((0..m).map(Row::Odd));
            for row in rows {
                let mut guess = Guess::default();
                predict(&z, &r, row, &mut guess);
                for j in 0..guess.p32.len() {
                    assert_eq!((guess.p32[j], guess.still[j]), at_border(&z, &r, row, j), "{row:?} {j}");
                }
            }
            (z, r) = (z.finer(), r.finer());
        }
    }
}
