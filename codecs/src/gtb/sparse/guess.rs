//! The surplus that a post will have, by least squares over the selected posts so far.

use super::around::FEATURES;

/// Sums of products, forgotten slowly, and the weights that solve them.
pub(super) struct Guess {
    /// Upper triangle and right side.
    sums: [[f64; FEATURES + 1]; FEATURES],
    weights: [f64; FEATURES],
    seen: u32,
}

const KEPT: f64 = 0.9995;
const OFTEN: u32 = 16;

impl Guess {
    pub fn new() -> Guess {
        let mut sums = [[0.0; FEATURES + 1]; FEATURES];
        (0..FEATURES).for_each(|k| sums[k][k] = 16.0);
        Guess { sums, weights: [0.0; FEATURES], seen: 0 }
    }

    pub fn of(&self, features: &[f64; FEATURES]) -> f64 {
        let mut sum = 0.0;
        for (w, f) in self.weights.iter().zip(features) {
            sum += w * f;
        }
        sum.clamp(-67_108_864.0, 67_108_864.0)
    }

    /// Learns a surplus; `scale`: how large the miss was expected to be.
    pub fn learn(&mut self, features: &[f64; FEATURES], surplus: f64, scale: f64) {
        let w = 1.0 / (scale * scale);
        for i in 0..FEATURES {
            for j in i..FEATURES {
                self.sums[i][j] = self.sums[i][j] * KEPT + w * features[i] * features[j];
            }
            self.sums[i][FEATURES] = self.sums[i][FEATURES] * KEPT + w * features[i] * surplus;
        }
        self.seen += 1;
        if self.seen % OFTEN == 0 {
            self.solve();
        }
    }

    /// Cholesky's way, with a little more on the diagonal.
    fn solve(&mut self) {
        let mut l = [[0.0; FEATURES]; FEATURES];
        let mut y = [0.0; FEATURES];
        for i in 0..FEATURES {
            for j in 0..=i {
                let mut sum = self.sums[j][i];
                for k in 0..j {
                    sum -= l[i][k] * l[j][k];
                }
                if i == j {
                    sum += 0.5 + self.sums[i][i] * 1e-6;
                    if !(sum > 1e-9) {
                        return;
                    }
                    l[i][i] = sum.sqrt();
                } else {
                    l[i][j] = sum / l[j][j];
                }
            }
            let mut sum = self.sums[i][FEATURES];
            for k in 0..i {
                sum -= l[i][k] * y[k];
            }
            y[i] = sum / l[i][i];
        }
        for i in (0..FEATURES).rev() {
            let mut sum = y[i];
            for k in i + 1..FEATURES {
                sum -= l[k][i] * self.weights[k];
            }
            self.weights[i] = sum / l[i][i];
        }
        if self.weights.iter().any(|w| !w.is_finite()) {
            self.weights = [0.0; FEATURES];
        }
    }
}
