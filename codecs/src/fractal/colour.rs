//! Colour as brightness and two differences (YIQ): the eye forgives coarse ones.

/// Rows: Y, I, Q of red, green, blue.
const TO: [[f64; 3]; 3] =
    [[0.299, 0.587, 0.114], [0.595716, -0.274453, -0.321263], [0.211456, -0.522591, 0.311135]];

/// The inverse of a 3 x 3 matrix, by cofactors.
const fn inverse(m: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
    let mut c = [[0.0; 3]; 3];
    let mut i = 0;
    while i < 3 {
        let mut j = 0;
        while j < 3 {
            let (a, b, p, q) = ((i + 1) % 3, (i + 2) % 3, (j + 1) % 3, (j + 2) % 3);
            c[j][i] = m[a][p] * m[b][q] - m[a][q] * m[b][p];
            j += 1;
        }
        i += 1;
    }
    let det = m[0][0] * c[0][0] + m[0][1] * c[1][0] + m[0][2] * c[2][0];
    let mut i = 0;
    while i < 9 {
        c[i / 3][i % 3] /= det;
        i += 1;
    }
    c
}

const FROM: [[f64; 3]; 3] = inverse(TO);

fn times(m: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    m.map(|row| row[0] * v[0] + row[1] * v[1] + row[2] * v[2])
}

/// Y, I, Q of a colour.
pub(super) fn yiq(rgb: [f64; 3]) -> [f64; 3] {
    times(&TO, rgb)
}

/// The colour of Y, I, Q; exact to rounding.
pub(super) fn rgb(yiq: [f64; 3]) -> [f64; 3] {
    times(&FROM, yiq)
}

/// A plane whose samples are the means of `by` x `by`; of fewer at the far borders.
pub(super) fn reduced(values: &[f64], [cols, rows]: [usize; 2], by: usize) -> (Vec<f64>, [usize; 2]) {
    let size = [cols.div_ceil(by), rows.div_ceil(by)];
    let mut out = Vec::with_capacity(size[0] * size[1]);
    for y in 0..size[1] {
        for x in 0..size[0] {
            let (mut sum, mut count) = (0.0, 0.0);
            for row in y * by..rows.min((y + 1) * by) {
                for v in &values[row * cols + x * by..row * cols + cols.min((x + 1) * by)] {
                    sum += v;
                    count += 1.0;
                }
            }
            out.push(sum / count);
        }
    }
    (out, size)
}

/// A value between the centres of samples, straight along rows and columns; beyond the outer centres theirs. `x`, `y` in samples from the corner.
pub(super) fn between(values: &[f64], stride: usize, [cols, rows]: [usize; 2], x: f64, y: f64) -> f64 {
    let axis = |v: f64, n: usize| {
        let v = (v - 0.5).max(0.0).min((n - 1) as f64);
        let k = (v as usize).min(n.saturating_sub(2));
        (k, (k + 1).min(n - 1), v - k as f64)
    };
    let ((x0, x1, fx), (y0, y1, fy)) = (axis(x, cols), axis(y, rows));
    let row = |y: usize| values[y * stride + x0] * (1.0 - fx) + values[y * stride + x1] * fx;
    row(y0) * (1.0 - fy) + row(y1) * fy
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_is_exact_to_rounding() {
        for k in 0..4096_u32 {
            let colour = [k & 15, k >> 4 & 15, k >> 8].map(|v| f64::from(v * 17));
            let back = rgb(yiq(colour));
            assert!((0..3).all(|c| (back[c] - colour[c]).abs() < 1e-9), "{colour:?} {back:?}");
        }
    }
}
