//! Whole numbers of a patch as bits: predicted from their neighbours, the rest in adaptive Golomb-Rice codes.

use super::{COUNT, Class};
use crate::base::{Error, Result};
use crate::codec::bits::{BitReader, BitWriter};
use crate::height::lod::SIDE;

/// The largest whole number: sums of a prediction stay below 2^53, so that floats can hold them exactly.
pub const WHOLE_MAX: i64 = 1 << 42;
/// Ones after which a number is written as it is.
const ESCAPE: u32 = 24;
/// Bits of a number that is written as it is.
const ESCAPE_BITS: u32 = 48;
/// Bits that say how many bits a rest has.
const WIDTH_BITS: u32 = 6;
/// Bits of the largest rest.
const REST_BITS: u32 = 43;

/// Weights of a prediction, in parts of 64: for W, NW, NE, WW, NN, each less N, which is added whole.
pub const COEFFICIENTS: usize = 5;
pub type Coefficients = [i64; COEFFICIENTS];
/// W + N - NW.
pub const PLANE: Coefficients = [64, -64, 0, 0, 0];

/// Whole numbers, what they are, and rests.
pub struct Grid {
    pub q: [i64; COUNT],
    pub class: [Class; COUNT],
    pub rest: [i64; COUNT],
}

impl Grid {
    pub fn new() -> Grid {
        Grid { q: [0; COUNT], class: [Class::Whole; COUNT], rest: [0; COUNT] }
    }
}

pub fn zigzag(v: i64) -> u64 {
    ((v << 1) ^ (v >> 63)) as u64
}

pub fn unzigzag(v: u64) -> i64 {
    (v >> 1) as i64 ^ -((v & 1) as i64)
}

/// The six neighbours of vertex (a, b) that come before it in rows of `side`: W, N, NW, NE, WW, NN. What lies outside is
/// stood for by the neighbour beside it; `None` at the first vertex.
#[inline]
pub fn around(a: usize, b: usize, side: usize) -> Option<[usize; 6]> {
    let k = b * side + a;
    if a > 1 && b > 1 && a + 1 < side {
        let n = k - side;
        return Some([k - 1, n, n - 1, n + 1, k - 2, n - side]);
    }
    match (a, b) {
        (0, 0) => None,
        (_, 0) => Some([k - 1; 6]),
        (0, _) => Some([k - side; 6]),
        _ => {
            let (w, n) = (k - 1, k - side);
            let ne = if a + 1 < side { n + 1 } else { n };
            let ww = if a > 1 { k - 2 } else { w };
            let nn = if b > 1 { n - side } else { n };
            Some([w, n, n - 1, ne, ww, nn])
        }
    }
}

/// Number, rest of the code and parameter of a vertex, from those before it.
#[inline]
fn expected(
    q: &[i64; COUNT],
    m: &[u64; COUNT],
    (a, b): (usize, usize),
    first: i64,
    c: &Coefficients,
) -> (i64, u64) {
    let Some([w, n, nw, ne, ww, nn]) = around(a, b, SIDE) else { return (first, 0) };
    let up = q[n];
    let sum = c[0] * (q[w] - up)
        + c[1] * (q[nw] - up)
        + c[2] * (q[ne] - up)
        + c[3] * (q[ww] - up)
        + c[4] * (q[nn] - up);
    let p = (up + ((sum + 32) >> 6)).clamp(-WHOLE_MAX, WHOLE_MAX);
    (p, 2 * (m[w] + m[n]) + m[nw] + m[ne] + m[ww] + m[nn])
}

/// The parameter from eight times the size of what was left around.
#[inline]
fn parameter(s: u64) -> u32 {
    63 - ((3 * s / 32) + 1).leading_zeros()
}

/// Writes what was left, after eight times the size of what was left around.
#[inline]
pub fn put_number(w: &mut BitWriter, left: u64, s: u64) {
    let n = parameter(s);
    let ones = left >> n;
    if ones < u64::from(ESCAPE) {
        w.put_ones(ones as u32);
        w.put(left, n);
    } else {
        w.put((1 << ESCAPE) - 1, ESCAPE);
        w.put(left, ESCAPE_BITS);
    }
}

/// Reads what [`put_number`] wrote.
#[inline]
pub fn take_number(r: &mut BitReader, s: u64) -> Result<u64> {
    let n = parameter(s);
    let ones = r.take_ones(ESCAPE)?;
    if ones == ESCAPE {
        return r.take(ESCAPE_BITS);
    }
    if n > ESCAPE_BITS {
        return Err(Error::corrupt("payload", "bits", format!("a parameter of {n} bits")));
    }
    Ok(u64::from(ones) << n | r.take(n)?)
}

/// Coefficients, classes and numbers after `head`. Numbers of vertices that hold nothing become what is expected there.
pub fn encode(head: Vec<u8>, grid: &mut Grid, first: i64, c: &Coefficients, classes: bool) -> Vec<u8> {
    let mut head = head;
    head.extend(c.iter().map(|c| *c as i8 as u8));
    let mut w = BitWriter::after(head);
    let mut width = 0;
    if classes {
        let mut k = 0;
        while k < COUNT {
            let run = grid.class[k..].iter().take_while(|c| **c == grid.class[k]).count();
            w.put(grid.class[k] as u64, 2);
            w.put_gamma(run as u32);
            k += run;
        }
        width = grid.rest.iter().map(|r| 64 - zigzag(*r).leading_zeros()).max().unwrap_or(0);
        w.put(u64::from(width), WIDTH_BITS);
    }
    let mut m = [0u64; COUNT];
    for (k, at) in (0..SIDE).flat_map(|b| (0..SIDE).map(move |a| (a, b))).enumerate() {
        let (p, s) = expected(&grid.q, &m, at, first, c);
        if grid.class[k] == Class::Nothing {
            grid.q[k] = p;
            m[k] = s / 8;
            continue;
        }
        let left = zigzag(grid.q[k] - p);
        m[k] = left;
        put_number(&mut w, left, s);
        if grid.class[k] == Class::Between {
            w.put(zigzag(grid.rest[k]), width);
        }
    }
    w.end()
}

/// What [`encode`] wrote after the coefficients.
pub fn decode(bytes: &[u8], first: i64, c: &Coefficients, classes: bool) -> Result<Grid> {
    let bad = |k: usize, what: String| Error::corrupt("payload", format!("vertex {k}"), what);
    let mut r = BitReader::new(bytes);
    let mut grid = Grid::new();
    let mut width = 0;
    if classes {
        let mut k = 0;
        while k < COUNT {
            let class = match r.take(2)? {
                0 => Class::Whole,
                1 => Class::Between,
                2 => Class::Nothing,
                other => return Err(bad(k, format!("class {other}"))),
            };
            let run = r.take_gamma()? as usize;
            if run > COUNT - k {
                return Err(bad(k, format!("a run of {run} vertices, {} are left", COUNT - k)));
            }
            grid.class[k..k + run].fill(class);
            k += run;
        }
        width = r.take(WIDTH_BITS)? as u32;
        if width > REST_BITS {
            return Err(bad(0, format!("rests of {width} bits")));
        }
    }
    let mut m = [0u64; COUNT];
    for (k, at) in (0..SIDE).flat_map(|b| (0..SIDE).map(move |a| (a, b))).enumerate() {
        let (p, s) = expected(&grid.q, &m, at, first, c);
        if grid.class[k] == Class::Nothing {
            grid.q[k] = p;
            m[k] = s / 8;
            continue;
        }
        let left = take_number(&mut r, s)?;
        m[k] = left;
        let q = p + unzigzag(left);
        if q.abs() > WHOLE_MAX {
            return Err(bad(k, format!("number {q}")));
        }
        grid.q[k] = q;
        if grid.class[k] == Class::Between {
            grid.rest[k] = unzigzag(r.take(width)?);
        }
    }
    r.end()?;
    Ok(grid)
}

/// Coefficients that predict a patch best in the least-squares sense; those of a plane where that is not determined.
/// Sums run row by row: the same bits on every machine.
pub fn fit(grid: &Grid) -> Coefficients {
    const N: usize = COEFFICIENTS;
    let q = &grid.q;
    let (mut a, mut y) = ([[0.0f64; N]; N], [0.0f64; N]);
    for b in 2..SIDE {
        for k in b * SIDE + 2..(b + 1) * SIDE - 1 {
            let n = k - SIDE;
            let up = q[n];
            let x = [k - 1, n - 1, n + 1, k - 2, n - SIDE].map(|k| (q[k] - up) as f64);
            let target = (q[k] - up) as f64;
            for r in 0..N {
                for c in 0..=r {
                    a[r][c] += x[r] * x[c];
                }
                y[r] += x[r] * target;
            }
        }
    }
    // Cholesky, with a hair on the diagonal so that flat ground has an answer.
    let hair = (0..N).map(|k| a[k][k]).sum::<f64>() * 1e-9 + 1e-9;
    for (k, row) in a.iter_mut().enumerate() {
        row[k] += hair;
    }
    for r in 0..N {
        for c in 0..=r {
            let s = (0..c).map(|k| a[r][k] * a[c][k]).sum::<f64>();
            if r == c {
                let d = a[r][r] - s;
                if !(d > 0.0 && d.is_finite()) {
                    return PLANE;
                }
                a[r][r] = d.sqrt();
            } else {
                a[r][c] = (a[r][c] - s) / a[c][c];
            }
        }
    }
    for r in 0..N {
        y[r] = (y[r] - (0..r).map(|k| a[r][k] * y[k]).sum::<f64>()) / a[r][r];
    }
    for r in (0..N).rev() {
        y[r] = (y[r] - (r + 1..N).map(|k| a[k][r] * y[k]).sum::<f64>()) / a[r][r];
    }
    if y.iter().all(|v| v.is_finite()) {
        y.map(|v| (v * 64.0).round().clamp(-127.0, 127.0) as i64)
    } else {
        PLANE
    }
}
