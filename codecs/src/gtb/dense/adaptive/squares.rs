//! Least squares: sums of products, and the weights that they ask for. All in single precision and in a fixed order.

use multiversion::multiversion;

/// Inputs and, last, the target: three vectors of eight.
pub(super) const WIDE: usize = 24;
/// Inputs.
pub(super) const INPUTS: usize = WIDE - 1;
/// A post's inputs and target; or weights, the last 0.
pub(super) type Row = [f32; WIDE];
/// Sums of products: the upper triangle counts, in blocks of eight columns.
pub(super) type Sums = [Row; WIDE];

/// No sums.
pub(super) const NONE: Sums = [[0.0; WIDE]; WIDE];

/// `sums[i][j] += weight v[i] v[j]`.
#[inline(always)]
pub(super) fn add(sums: &mut Sums, v: &Row, weight: f32) {
    for i in 0..WIDE {
        let f = weight * v[i];
        for j in i / 8 * 8..WIDE {
            sums[i][j] += f * v[j];
        }
    }
}

/// `w . v` in eight lanes.
#[inline(always)]
pub(super) fn dot(w: &Row, v: &Row) -> f32 {
    let mut s = [0.0f32; 8];
    for k in 0..WIDE / 8 {
        for l in 0..8 {
            s[l] += w[8 * k + l] * v[8 * k + l];
        }
    }
    ((s[0] + s[4]) + (s[1] + s[5])) + ((s[2] + s[6]) + (s[3] + s[7]))
}

/// `to = to * keep + from * part`.
#[inline(always)]
fn blend_plain(to: &mut Sums, keep: f32, from: &Sums, part: f32) {
    for i in 0..WIDE {
        for j in i / 8 * 8..WIDE {
            to[i][j] = to[i][j] * keep + from[i][j] * part;
        }
    }
}

/// `to = to * keep + from * part`, in the widest vectors that the processor has.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub(super) fn blend(to: &mut Sums, keep: f32, from: &Sums, part: f32) {
    blend_plain(to, keep, from, part);
}

#[inline(always)]
fn solve_plain(sums: [&Sums; 3], part: f32, prior: &Row, ridge: f32) -> Row {
    let mut a = NONE;
    for i in 0..WIDE {
        for j in i / 8 * 8..WIDE {
            a[i][j] = sums[0][i][j] * part + (sums[1][i][j] + sums[2][i][j]);
        }
    }
    let mut trace = 0.0;
    for k in 0..INPUTS {
        trace += a[k][k];
    }
    let r = trace * (ridge / INPUTS as f32) + 1e-6;
    for k in 0..INPUTS {
        a[k][k] += r;
        a[k][INPUTS] += r * prior[k];
    }
    // Elimination; its factors by row, for the way back.
    let mut factors = NONE;
    let mut w = [0.0; WIDE];
    for k in 0..INPUTS {
        let (known, rest) = a.split_at_mut(k + 1);
        let row = &known[k];
        let inverse = 1.0 / row[k].max(1e-9);
        w[k] = row[INPUTS] * inverse;
        for i in k + 1..INPUTS {
            let f = row[i] * inverse;
            factors[i][k] = f;
            let to = &mut rest[i - k - 1];
            for part in i / 8..WIDE / 8 {
                let (to, from) = (&mut to[8 * part..8 * part + 8], &row[8 * part..8 * part + 8]);
                for l in 0..8 {
                    to[l] -= f * from[l];
                }
            }
        }
    }
    for k in (1..INPUTS).rev() {
        let f = w[k];
        for l in 0..WIDE {
            w[l] -= f * factors[k][l];
        }
    }
    // Sums of rubbish may give anything, not numbers among them.
    let sane = w.iter().all(|v| v.abs() < 64.0);
    if sane { w } else { *prior }
}

/// The weights of least squares for `sums[0] * part + (sums[1] + sums[2])`, drawn towards `prior` by `ridge` of the mean of the
/// diagonal; `prior` itself where they come out beyond 64. About 4000 operations.
#[multiversion(targets("x86_64+avx512f+avx512dq+avx512vl+avx512bw", "x86_64+avx2"))]
pub(super) fn solve(sums: [&Sums; 3], part: f32, prior: &Row, ridge: f32) -> Row {
    solve_plain(sums, part, prior, ridge)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn posts() -> impl Strategy<Value = Vec<Row>> {
        prop::collection::vec(prop::array::uniform24(-1000.0f32..1000.0), 1..80)
    }

    proptest! {
        /// Wide vectors give the bits of plain code.
        #[test]
        fn wide_is_plain(posts in posts(), part in 0.0f32..40.0) {
            let (mut a, mut b) = (NONE, NONE);
            for v in &posts {
                add(&mut a, v, 0.01);
                blend(&mut b, 0.9, &a, 0.3);
            }
            let mut plain = NONE;
            let mut sums = NONE;
            for v in &posts {
                add(&mut sums, v, 0.01);
                blend_plain(&mut plain, 0.9, &sums, 0.3);
            }
            prop_assert_eq!(b.map(|r| r.map(f32::to_bits)), plain.map(|r| r.map(f32::to_bits)));
            let prior = [0.125; WIDE];
            let wide = solve([&a, &b, &NONE], part, &prior, 1e-5);
            let plain = solve_plain([&a, &b, &NONE], part, &prior, 1e-5);
            prop_assert_eq!(wide.map(f32::to_bits), plain.map(f32::to_bits));
        }
    }

    /// Targets that are a weighted sum of the inputs give the weights.
    #[test]
    fn weights_come_back() {
        let mut state = 1u32;
        let mut random = move || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / 16_777_216.0 - 0.5
        };
        let truth: Row = std::array::from_fn(|k| if k < INPUTS { k as f32 * 0.1 - 1.0 } else { 0.0 });
        let mut sums = NONE;
        for _ in 0..500 {
            let mut v: Row = std::array::from_fn(|_| random());
            v[INPUTS] = 0.0;
            v[INPUTS] = dot(&truth, &v);
            add(&mut sums, &v, 1.0);
        }
        let w = solve([&NONE, &sums, &NONE], 0.0, &[0.0; WIDE], 1e-7);
        for k in 0..INPUTS {
            assert!((w[k] - truth[k]).abs() < 1e-3, "{k}: {} for {}", w[k], truth[k]);
        }
    }

    /// Rubbish gives the prior, never something that is not a number.
    #[test]
    fn rubbish_gives_the_prior() {
        let mut sums = NONE;
        add(&mut sums, &[3e18; WIDE], 10.0);
        add(&mut sums, &[f32::INFINITY; WIDE], 1.0);
        let prior = [0.25; WIDE];
        assert_eq!(solve([&NONE, &sums, &NONE], 0.0, &prior, 1e-5), prior);
    }
}
