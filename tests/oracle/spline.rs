//! Natural tensor-product cubic splines by their cardinal functions, which the product does not know: the second
//! derivatives at the knots from the closed form of the inverse of the matrix (1, 4, 1), the pieces in powers.
//!
//! Nothing here shares an order of operations with the product: results agree to rounding, not bit for bit.

use super::survey::{mean_near, sample};
use super::{KERNEL, MARGIN, OracleSurvey};
use std::sync::OnceLock;

/// Vertices along the side of a patch.
const SIDE: usize = (KERNEL + 2 * MARGIN + 1) as usize;

/// Second derivatives at the knots: `[i][k]` at knot i, of the spline that is 1 at knot k.
fn bends() -> &'static [[f64; SIDE]; SIDE] {
    static BENDS: OnceLock<[[f64; SIDE]; SIDE]> = OnceLock::new();
    BENDS.get_or_init(|| std::array::from_fn(|i| std::array::from_fn(|k| bend(i, k))))
}

/// Values at `x` of the 33 natural splines that are 1 at one knot and 0 at the others.
pub fn cardinal(x: f64) -> [f64; SIDE] {
    let cell = (x.floor() as usize).min(SIDE - 2);
    let t = x - cell as f64;
    std::array::from_fn(|k| {
        let one = |n: usize| f64::from(u8::from(n == k));
        let (p, q, m, n) = (one(cell), one(cell + 1), bends()[cell][k], bends()[cell + 1][k]);
        p + t * (q - p - (2.0 * m + n) / 6.0) + t * t * m / 2.0 + t * t * t * (n - m) / 6.0
    })
}

fn bend(i: usize, k: usize) -> f64 {
    let before = if k > 0 { inverse(i, k - 1) } else { 0.0 };
    6.0 * (before - 2.0 * inverse(i, k) + inverse(i, k + 1))
}

/// Entry of the inverse of the tridiagonal matrix (1, 4, 1) of the 31 inner knots; 0 outside of it.
fn inverse(i: usize, j: usize) -> f64 {
    let end = SIDE - 1;
    if i == 0 || j == 0 || i >= end || j >= end {
        return 0.0;
    }
    let angle = 2f64.acosh();
    let sinh = |n: usize| (n as f64 * angle).sinh();
    let sign = if (i + j) % 2 == 0 { 1.0 } else { -1.0 };
    sign * sinh(i.min(j)) * sinh(end - i.max(j)) / (sinh(1) * sinh(end))
}

/// The patch where its cardinal functions have these values.
pub fn at(vertices: &[f64], along: &[f64; SIDE], across: &[f64; SIDE]) -> f64 {
    let rows = vertices.chunks_exact(SIDE).map(|row| row.iter().zip(along).map(|(z, w)| z * w).sum::<f64>());
    rows.zip(across).map(|(z, w)| z * w).sum()
}

/// Heights of the vertices of a bicubic patch of stride `r`, the first one at post `first`: samples, else fills; and
/// where neither is, what the neighbours suggest, by their distance from the known vertices (in steps of a king).
pub fn vertices(survey: &OracleSurvey, r: i64, first: [i64; 2]) -> Vec<f64> {
    let known: Vec<Option<f64>> = (0..SIDE * SIDE)
        .map(|n| {
            let (i, j) = (first[0] + (n % SIDE) as i64 * r, first[1] + (n / SIDE) as i64 * r);
            sample(survey, i, j).or_else(|| mean_near(survey, r, i, j).filter(|fill| *fill != 0.0))
        })
        .collect();
    let place = |n: usize| [(n % SIDE) as i64, (n / SIDE) as i64];
    let from: Vec<[i64; 2]> = (0..SIDE * SIDE).filter(|n| known[*n].is_some()).map(place).collect();
    let distance = |at: [i64; 2]| {
        let king = |a: &[i64; 2]| (a[0] - at[0]).abs().max((a[1] - at[1]).abs());
        from.iter().map(king).min().unwrap_or(i64::MAX)
    };
    let far: Vec<i64> =
        (0..SIDE * SIDE).map(|n| if known[n].is_some() { 0 } else { distance(place(n)) }).collect();
    let mut z: Vec<f64> = known.iter().map(|k| k.unwrap_or(0.0)).collect();
    for d in 1..SIDE as i64 {
        for n in (0..SIDE * SIDE).filter(|n| far[*n] == d) {
            let nearer = |at: [i64; 2]| {
                let inside = at.iter().all(|k| (0..SIDE as i64).contains(k));
                let n = inside.then(|| at[1] as usize * SIDE + at[0] as usize)?;
                (far[n] < d).then_some(z[n])
            };
            let [a, b] = place(n);
            let says: Vec<f64> = (-1..2)
                .flat_map(|y| (-1..2).map(move |x| [x, y]))
                .filter_map(|[x, y]| {
                    let near = nearer([a + x, b + y])?;
                    Some(nearer([a + 2 * x, b + 2 * y]).map_or(near, |beyond| 1.5 * near - 0.5 * beyond))
                })
                .collect();
            z[n] = says.iter().sum::<f64>() / says.len() as f64;
        }
    }
    z
}

/// Largest distance of a valid sample in the closed domain from the patch. Level 0 is exact.
pub fn delta(survey: &OracleSurvey, level: u32, [i, j]: [i64; 2]) -> f64 {
    if level == 0 {
        return 0.0;
    }
    let r = 1i64 << level;
    let first = [i, j].map(|k| (KERNEL * k - MARGIN) * r);
    let z = vertices(survey, r, first);
    let steps = (SIDE as i64 - 1) * r;
    let weights: Vec<[f64; SIDE]> = (0..=steps).map(|x| cardinal(x as f64 / r as f64)).collect();
    let mut worst = 0f64;
    for y in 0..=steps {
        let columns: [f64; SIDE] =
            std::array::from_fn(|a| (0..SIDE).map(|b| z[b * SIDE + a] * weights[y as usize][b]).sum());
        for x in 0..=steps {
            if let Some(height) = sample(survey, first[0] + x, first[1] + y) {
                let f: f64 = columns.iter().zip(&weights[x as usize]).map(|(z, w)| z * w).sum();
                worst = worst.max((height - f).abs());
            }
        }
    }
    worst
}
