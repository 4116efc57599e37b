//! How much power a grid has at which wavelengths, and bicubic interpolation to compare with.

use std::f64::consts::TAU;

/// Power of the octaves of a grid, row by row, the finest first: wavelengths of 2 to 4 samples, 4 to 8, ... The plane that fits best is
/// taken away, a Hann window weighs the rest; frequencies count by their distance from 0. By the definition of the Fourier transform:
/// cols * rows * (cols + rows) complex products.
pub fn octaves(values: &[f64], cols: usize, octaves: usize) -> Vec<f64> {
    let rows = values.len() / cols;
    let flat = without_plane(values, cols, rows);
    let window = |k: usize, n: usize| 0.5 - 0.5 * (TAU * (k as f64 + 0.5) / n as f64).cos();
    let real: Vec<[f64; 2]> = flat
        .iter()
        .enumerate()
        .map(|(k, v)| [v * window(k % cols, cols) * window(k / cols, rows), 0.0])
        .collect();
    // Of real numbers the second half of the frequencies mirrors the first.
    let wide = cols / 2 + 1;
    let across: Vec<[f64; 2]> = real.chunks_exact(cols).flat_map(|row| transformed(row, wide)).collect();
    let mut power = vec![0.0; octaves];
    let frequency = |k: usize, n: usize| k.min(n - k) as f64 / n as f64;
    for x in 0..wide {
        let twice = if x == 0 || 2 * x == cols { 1.0 } else { 2.0 };
        let column: Vec<[f64; 2]> = across.iter().skip(x).step_by(wide).copied().collect();
        for (y, [a, b]) in transformed(&column, rows).into_iter().enumerate() {
            let f = frequency(x, cols).hypot(frequency(y, rows));
            let within = |o: &usize| (0.25..0.5).contains(&(f * 2_f64.powi(*o as i32)));
            if let Some(octave) = (0..octaves).find(within) {
                power[octave] += twice * (a * a + b * b);
            }
        }
    }
    power
}

fn without_plane(values: &[f64], cols: usize, rows: usize) -> Vec<f64> {
    // The axes of a grid are orthogonal: each slope by itself.
    let along = |k: usize, n: usize| k as f64 - (n - 1) as f64 / 2.0;
    let count = values.len() as f64;
    let (mut mean, mut x, mut y, mut xx, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for (k, v) in values.iter().enumerate() {
        let (dx, dy) = (along(k % cols, cols), along(k / cols, rows));
        mean += v / count;
        x += dx * v;
        y += dy * v;
        xx += dx * dx;
        yy += dy * dy;
    }
    let plane = |k: usize| mean + x / xx * along(k % cols, cols) + y / yy * along(k / cols, rows);
    values.iter().enumerate().map(|(k, v)| v - plane(k)).collect()
}

/// The first `count` frequencies.
fn transformed(line: &[[f64; 2]], count: usize) -> Vec<[f64; 2]> {
    let n = line.len();
    let turns: Vec<[f64; 2]> = (0..n)
        .map(|k| {
            let (sin, cos) = (-TAU * k as f64 / n as f64).sin_cos();
            [cos, sin]
        })
        .collect();
    (0..count)
        .map(|k| {
            let (mut re, mut im, mut at) = (0.0, 0.0, 0);
            for [a, b] in line {
                let [c, s] = turns[at];
                re += a * c - b * s;
                im += a * s + b * c;
                at += k;
                if at >= n {
                    at -= n;
                }
            }
            [re, im]
        })
        .collect()
}

/// Catmull-Rom's bicubic interpolation of a grid as heights at the centres of its cells, at `zoom` samples a cell; the border is repeated.
pub fn bicubic(values: &[f64], cols: usize, zoom: usize) -> Vec<f64> {
    let rows = values.len() / cols;
    let weights = |t: f64| {
        [
            ((-0.5 * t + 1.0) * t - 0.5) * t,
            (1.5 * t - 2.5) * t * t + 1.0,
            ((-1.5 * t + 2.0) * t + 0.5) * t,
            (0.5 * t - 0.5) * t * t,
        ]
    };
    let line = |n: usize, value: &dyn Fn(usize) -> f64| -> Vec<f64> {
        (0..n * zoom)
            .map(|k| {
                let at = (k as f64 + 0.5) / zoom as f64 - 0.5;
                let first = at.floor();
                weights(at - first)
                    .into_iter()
                    .enumerate()
                    .map(|(j, w)| w * value((first + j as f64 - 1.0).clamp(0.0, (n - 1) as f64) as usize))
                    .sum()
            })
            .collect()
    };
    let wide = cols * zoom;
    let across: Vec<f64> = values.chunks_exact(cols).flat_map(|row| line(cols, &|k| row[k])).collect();
    let mut out = vec![0.0; wide * rows * zoom];
    for x in 0..wide {
        for (y, v) in line(rows, &|k| across[k * wide + x]).into_iter().enumerate() {
            out[y * wide + x] = v;
        }
    }
    out
}

/// Root of the mean squared difference.
pub fn rms(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>() / a.len() as f64).sqrt()
}
